//! Times that are looked at only when something changes or ends, against plain restatements that count every tick.

use super::*;
use crate::engine::fault::FaultMonitor;
use crate::engine::mode::Liveness;
use crate::engine::policy::Enabling;
use crate::engine::snapshot::{Fault, Faults};
use proptest::prelude::*;

/// What can be wrong: over-current, conversion at a rail, over-temperature, under-voltage, gate driver.
type Wrong = [bool; 5];

/// Fault detection that counts every condition in every tick.
#[derive(Default)]
struct Counting {
    lasted: [u16; 4],
    hold: u16,
    stopping: Faults,
}

impl Counting {
    fn update(&mut self, settings: &Settings, wrong: Wrong, shown: &mut Snapshot) {
        let thresholds = &settings.board.thresholds;
        let limits = [
            thresholds.over_current_ticks,
            thresholds.current_rail_ticks,
            thresholds.over_temperature_ticks,
            thresholds.under_voltage_ticks,
        ];
        let mut lasts = [false; 4];
        for at in 0..4 {
            self.lasted[at] = if wrong[at] { self.lasted[at] + 1 } else { 0 };
            lasts[at] = wrong[at] && self.lasted[at] >= limits[at];
        }
        let seen = Faults::NONE
            .with_if(Fault::OverCurrent, lasts[0] || lasts[1])
            .with_if(Fault::OverTemperature, lasts[2])
            .with_if(Fault::UnderVoltage, lasts[3])
            .with_if(Fault::GateDriver, wrong[4]);
        let stopping = seen.intersection(settings.policy.stopping);
        if !stopping.is_empty() {
            self.stopping = self.stopping.union(stopping);
            self.hold = settings.policy.fault_hold_ticks.max(1);
        } else if self.hold > 0 {
            self.hold -= 1;
            if self.hold == 0 {
                self.stopping = Faults::NONE;
                shown.faults = Faults::NONE;
            }
        }
        let active = self.stopping.union(seen);
        let new = active.without(shown.faults);
        shown.faults = active;
        for (bit, count) in shown.fault_events.iter_mut().enumerate() {
            *count = count.wrapping_add((new.bits() >> bit) & 1);
        }
    }
}

fn measure(wrong: Wrong, shown: &mut Snapshot) -> Sample {
    let [over_current, rail, hot, low, gate_driver] = wrong;
    let either =
        |is: bool, yes: i32, no: i32| Amps::from_bits(if is { yes << 16 } else { no << 16 });
    shown.current = either(over_current, -70, 10);
    shown.temperature = either(hot, 120, 25);
    shown.bus_voltage = either(low, 5, 12);
    Sample {
        current: if rail { 4095 } else { 2048 },
        pins: Pins::OPEN.with(Pin::GateDriverFault, gate_driver),
        ..Sample::default()
    }
}

/// The separate permission, with every time counted in every tick.
#[derive(Default)]
struct Watching {
    sequence: u32,
    heartbeat: u16,
    enable_sequence: u32,
    permission: u16,
    pause: u32,
    pause_left: u16,
}

impl Watching {
    /// One tick; true while the drive may run.
    fn tick(&mut self, policy: &Policy, command: &Command) -> bool {
        let restarted = |left: u16, is_new: bool, time: u16| {
            if is_new { time } else { left.saturating_sub(1) }
        };
        let timeout = policy.command_timeout_ticks;
        let is_new = command.sequence != self.sequence;
        self.heartbeat = restarted(self.heartbeat, is_new, timeout);
        let is_new = command.enable.sequence != self.enable_sequence;
        self.permission = restarted(self.permission, is_new, timeout);
        if command.enable.withdrawn {
            self.permission = 0;
        }
        let is_new = command.pause != self.pause;
        self.pause_left = restarted(self.pause_left, is_new, policy.pause_ticks);
        self.sequence = command.sequence;
        self.enable_sequence = command.enable.sequence;
        self.pause = command.pause;
        let off = command.setpoint == Setpoint::Off;
        self.heartbeat > 0 && self.permission > 0 && self.pause_left == 0 && !off
    }
}

proptest! {
    #[test]
    fn i3_faults_are_those_of_a_monitor_that_counts_every_tick(
        spans in proptest::collection::vec((any::<Wrong>(), 1..40_u8), 1..30),
        limits in any::<[u8; 4]>(), hold in 0..30_u16, stopping: u8,
    ) {
        let policy = Policy {
            fault_hold_ticks: hold,
            stopping: Faults::from_bits(stopping),
            ..Policy::BASE
        };
        let mut settings = compile::settings(&Params::new(), &Board::REFERENCE, &policy);
        let [current, rail, temperature, voltage] = limits.map(|limit| u16::from(limit % 50));
        let thresholds = &mut settings.board.thresholds;
        thresholds.over_current_ticks = current;
        thresholds.current_rail_ticks = rail;
        thresholds.over_temperature_ticks = temperature;
        thresholds.under_voltage_ticks = voltage;
        let (mut monitor, mut counting) = (FaultMonitor::new(), Counting::default());
        let (mut shown, mut expected) = (Snapshot::new(), Snapshot::new());
        for (wrong, ticks) in spans {
            for _ in 0..ticks {
                let sample = measure(wrong, &mut shown);
                monitor.update(&settings, &sample, &mut shown);
                counting.update(&settings, wrong, &mut expected);
                prop_assert_eq!(shown.faults, expected.faults);
                prop_assert_eq!(shown.fault_events, expected.fault_events);
                prop_assert_eq!(monitor.stops(), !counting.stopping.is_empty());
            }
        }
    }

    #[test]
    fn i2_a_permission_ends_as_if_every_tick_were_counted(
        spans in proptest::collection::vec((any::<[bool; 4]>(), 0..6_u8, 1..40_u8), 1..30),
        command_timeout_ticks in 1..30_u16, pause_ticks in 0..30_u16,
    ) {
        let policy = Policy {
            enabling: Enabling::Separate,
            command_timeout_ticks,
            pause_ticks,
            ..Policy::BASE
        };
        let (mut liveness, mut watching) = (Liveness::new(), Watching::default());
        let mut command = Command::default();
        for ([told, enabled, paused, off], withdrawn, ticks) in spans {
            command.sequence += u32::from(told);
            command.enable.sequence += u32::from(enabled);
            command.enable.withdrawn = withdrawn == 0;
            command.pause += u32::from(paused);
            command.setpoint = if off { Setpoint::Off } else { Setpoint::Position(1) };
            liveness.obey(&policy, &command, false);
            prop_assert_eq!(liveness.is_in_force(), watching.tick(&policy, &command));
            for _ in 1..ticks {
                liveness.update(&command, false);
                prop_assert_eq!(liveness.is_in_force(), watching.tick(&policy, &command));
            }
        }
    }
}
