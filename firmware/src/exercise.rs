//! Inputs that take the engine through every mode, flag and fault, and a fingerprint of what it makes of
//! them. Integers only and no clock: the same seed gives the same inputs on every machine.

use windlass_core::dialect::DialectKind;
use windlass_core::engine::command::{
    Command, DriveOpts, LimitOverride, MasterReport, Neutral, SensorSelect, SetPosition, Setpoint,
    Slot,
};
use windlass_core::engine::limit::Directions;
use windlass_core::engine::pidf::Gains;
use windlass_core::engine::settings::{
    Board, CurrentLimit, IndexSettings, LimitSettings, Policy, Resume, Settings, SlotSettings,
};
use windlass_core::engine::snapshot::{
    Actuation, IndexCapture, Pin, Pins, Pulse, Sample, Snapshot,
};
use windlass_core::engine::throttle_law::{ThrottleGains, zone};
use windlass_core::units::{Amps, Duty, Volts};

/// Ticks between two sets of settings: half a second.
const SETTINGS_TICKS: u32 = 1000;
/// Ticks between two commands: 20 ms.
const COMMAND_TICKS: u32 = 40;

/// A source of inputs.
#[derive(Clone, Debug)]
pub struct Exercise {
    random: u32,
    ticks: u32,
    /// Present settings.
    pub settings: Settings,
    /// Present command.
    pub command: Command,
    /// Present sample.
    pub sample: Sample,
    /// Counts per tick, 16.16.
    speed: i32,
    position: i32,
    /// Current in conversion steps from zero, and temperature, towards which they move.
    current: i32,
    celsius: i32,
}

impl Exercise {
    /// Inputs that depend on `seed` only, which is not 0.
    #[must_use]
    pub fn new(seed: u32) -> Self {
        let mut exercise = Self {
            random: seed,
            ticks: 0,
            settings: settings(&mut Random(seed)),
            command: Command::default(),
            sample: Sample {
                current: 2048,
                bus_voltage: 1365,
                temperature: 931,
                ..Sample::default()
            },
            speed: 0,
            position: 0,
            current: 0,
            celsius: 25,
        };
        exercise.random = exercise.random.max(1);
        exercise
    }

    /// Makes the inputs of the next tick; `actuation` is what the tick before decided.
    pub fn advance(&mut self, actuation: Actuation) {
        let mut random = Random(self.random);
        self.ticks = self.ticks.wrapping_add(1);
        if self.ticks.is_multiple_of(SETTINGS_TICKS) {
            self.settings = settings(&mut random);
        }
        // One gap in sixteen is long enough for the heartbeat to end.
        if self.ticks.is_multiple_of(COMMAND_TICKS) && !(self.ticks / 4096).is_multiple_of(16) {
            self.give_command(&mut random);
        }
        self.measure(&mut random, actuation);
        self.random = random.0;
    }

    /// The present inputs for a drive in throttle units: its policy, its gains and every sensor it has.
    #[must_use]
    pub fn in_throttle_units(&self) -> (Settings, Command) {
        let gains = |slot: &SlotSettings| ThrottleGains {
            p: slot.gains.p.unsigned_abs(),
            i: slot.gains.i.unsigned_abs(),
            d: slot.gains.d.unsigned_abs(),
            f: slot.gains.f,
            zone: zone(slot.gains.allowable_error << 8),
            ramp: slot.ramp >> 5,
        };
        let [zero, one] = &self.settings.slots;
        let settings = Settings {
            policy: DialectKind::TalonSrx.policy(),
            throttle_slots: [gains(zero), gains(one)],
            ..self.settings
        };
        let mut command = self.command;
        command.enable.sequence = command.sequence;
        command.opts.ramp >>= 5;
        command.opts.sensor = match command.sequence / 16 % 5 {
            0 => SensorSelect::Quadrature,
            1 => SensorSelect::AnalogPotentiometer,
            2 => SensorSelect::AnalogEncoder,
            3 => SensorSelect::RisingEdges,
            _ => SensorSelect::None,
        };
        (settings, command)
    }

    fn give_command(&mut self, random: &mut Random) {
        let command = &mut self.command;
        command.revision = command.revision.wrapping_add(1);
        command.sequence = command.sequence.wrapping_add(1);
        // Seven of eight commands repeat the one before, as a host does.
        if random.one_in(8) {
            command.setpoint = setpoint(random);
            command.opts = options(random);
        }
        if random.one_in(64) {
            command.set_position = SetPosition {
                counts: random.within(100_000),
                generation: command.set_position.generation.wrapping_add(1),
                ..SetPosition::default()
            };
        }
        command.master = MasterReport {
            duty: Duty::saturating(random.within(32_768)),
            sequence: command.master.sequence.wrapping_add(1),
        };
    }

    /// A motor of sorts: speed and current follow the duty cycle, and now and then something breaks.
    fn measure(&mut self, random: &mut Random, actuation: Actuation) {
        let duty = i32::from(actuation.duty().units());
        self.speed += ((duty * 360) - self.speed) >> 7;
        self.position = self.position.wrapping_add(self.speed >> 16);
        let torque = (duty >> 5) - (self.speed >> 14);
        self.current += (torque - self.current) >> 2;
        if random.one_in(2000) {
            self.celsius = 25 + random.below(90) as i32;
        }
        let sample = &mut self.sample;
        sample.encoder = self.position as u32;
        sample.current = converted(2048 + self.current + random.within(2));
        // 0.5 V at 0 °C and 10 mV/K, 4096 steps over 3.3 V: 12.4 steps per kelvin from 621 on.
        sample.temperature = converted(621 + self.celsius * 124 / 10 + random.within(1));
        sample.analog_in = converted(random.below(4096) as i32);
        if random.one_in(4000) {
            // 12 V, 6 V and 5 V behind 11:1.
            sample.bus_voltage = [1354, 1354, 1354, 677, 564][random.below(5) as usize % 5];
        }
        let pins = &mut sample.pins;
        if random.one_in(500) {
            *pins = Pins::LOW
                .with(Pin::ForwardLimit, !random.one_in(4))
                .with(Pin::ReverseLimit, !random.one_in(4))
                .with(Pin::EncoderA, random.one_in(2))
                .with(Pin::EncoderB, random.one_in(2))
                .with(Pin::EncoderIndex, random.one_in(2))
                .with(Pin::GateDriverFault, random.one_in(16));
        }
        if random.one_in(300) {
            edge(&mut sample.index_rising, sample.encoder);
            edge(&mut sample.index_falling, sample.encoder.wrapping_add(1));
        }
        if self.ticks.is_multiple_of(40) {
            sample.pulse = Pulse {
                width_us: 500 + random.below(2000) as u16,
                count: sample.pulse.count.wrapping_add(1),
            };
        }
    }
}

fn edge(capture: &mut IndexCapture, count: u32) {
    capture.edges = capture.edges.wrapping_add(1);
    capture.count = count;
}

fn converted(steps: i32) -> u16 {
    steps.clamp(0, 4095) as u16
}

/// Xorshift32 (Marsaglia 2003).
struct Random(u32);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    /// 0 to `bound` − 1.
    fn below(&mut self, bound: u32) -> u32 {
        ((u64::from(self.next()) * u64::from(bound)) >> 32) as u32
    }

    /// −`bound` to `bound`.
    fn within(&mut self, bound: u32) -> i32 {
        self.below(2 * bound + 1) as i32 - bound as i32
    }

    fn one_in(&mut self, bound: u32) -> bool {
        self.below(bound) == 0
    }

    fn directions(&mut self, bound: u32) -> Directions {
        let forward = self.one_in(bound);
        Directions::new(forward, self.one_in(bound))
    }
}

fn setpoint(random: &mut Random) -> Setpoint {
    match random.below(9) {
        0 => Setpoint::Off,
        1 => Setpoint::Duty(Duty::saturating(random.within(33_000))),
        2 => Setpoint::Velocity(random.within(40_000)),
        3 => Setpoint::Position(random.within(100_000)),
        4 => Setpoint::Current(Amps::from_bits(random.within(60 << 16))),
        5 => Setpoint::Voltage(Volts::from_bits(random.within(14 << 16))),
        6 => Setpoint::Follow(random.below(64) as u8),
        7 => Setpoint::Pulse,
        // Whatever 32 bits can hold, for the saturations.
        _ => Setpoint::Position(random.next() as i32),
    }
}

fn options(random: &mut Random) -> DriveOpts {
    DriveOpts {
        slot: if random.one_in(2) {
            Slot::Zero
        } else {
            Slot::One
        },
        neutral: [None, Some(Neutral::Brake), Some(Neutral::Coast)][random.below(3) as usize % 3],
        limits: LimitOverride {
            enabled: random.one_in(3),
            disabled: random.directions(2),
        },
        reverse_sensor: random.one_in(4),
        reverse_motor: random.one_in(4),
        ramp: if random.one_in(2) {
            0
        } else {
            random.below(2000) as u16
        },
        ..DriveOpts::default()
    }
}

fn settings(random: &mut Random) -> Settings {
    Settings {
        policy: Policy {
            command_timeout_ticks: 208,
            master_timeout_ticks: 208,
            // Short, or most ticks would be faulted ones.
            fault_hold_ticks: 40,
            resume: if random.one_in(2) {
                Resume::NonZeroSetpoint
            } else {
                Resume::AnyCommand
            },
            ..Policy::BASE
        },
        slots: [slot(random), slot(random)],
        throttle_slots: [ThrottleGains::default(); 2],
        current_limit: CurrentLimit {
            enabled: random.one_in(2),
            begin_above: random.below(20 << 16) as i32,
            begin_after_ticks: random.below(100),
            continuous: random.below(20 << 16) as i32,
            gains: Gains {
                p: 0x0064_0000,
                i: 0x003C_0000,
                d: random.within(1 << 20),
                f: random.within(1 << 12),
                accumulator_limit: 0x014C_C888,
                allowable_error: 0,
            },
        },
        limits: limits(random, 60_000),
        index: IndexSettings {
            clears_position: random.one_in(4),
            rising: random.one_in(2),
        },
        neutral: if random.one_in(2) {
            Neutral::Brake
        } else {
            Neutral::Coast
        },
        current_multiplier: 0x816,
        board: Board::REFERENCE,
    }
}

fn slot(random: &mut Random) -> SlotSettings {
    let limited = random.one_in(2);
    SlotSettings {
        gains: Gains {
            p: random.within(8 << 16),
            i: random.within(1 << 12),
            d: random.within(8 << 16),
            f: random.within(2 << 16),
            accumulator_limit: if random.one_in(2) { i32::MAX } else { 100_000 },
            allowable_error: random.below(20) as i32,
        },
        ramp: if random.one_in(2) {
            0
        } else {
            random.below(2000) as i32
        },
        forward_max: if limited { 20_000 } else { 32_767 },
        reverse_max: if limited { -20_000 } else { -32_768 },
        forward_nominal: random.below(1500) as i32,
        reverse_nominal: -(random.below(1500) as i32),
    }
}

fn limits(random: &mut Random, threshold: i32) -> LimitSettings {
    let [forward, reverse] = [(); 2].map(|()| [4, 2, 2, 8].map(|bound| random.one_in(bound)));
    let [
        normally_closed,
        switch_disabled,
        soft_enabled,
        clears_position,
    ] = [0, 1, 2, 3].map(|at| Directions::new(forward[at], reverse[at]));
    LimitSettings {
        normally_closed,
        switch_disabled,
        soft_enabled,
        clears_position,
        forward_threshold: threshold,
        reverse_threshold: -threshold,
    }
}

/// Fingerprint of a stream of results: FNV-1a over 32-bit words (the prime mixes upwards only, so the
/// upper half is folded down).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fingerprint(u64);

impl Fingerprint {
    /// Nothing seen yet.
    #[must_use]
    pub const fn new() -> Self {
        Self(0xCBF2_9CE4_8422_2325)
    }

    fn word(&mut self, word: u32) {
        self.0 = (self.0 ^ u64::from(word)).wrapping_mul(0x0000_0100_0000_01B3);
        self.0 ^= self.0 >> 32;
    }

    /// Takes one tick's result, whole.
    pub fn add(&mut self, snapshot: &Snapshot) {
        let (kind, duty) = match snapshot.actuation {
            Actuation::Off => (0, 0),
            Actuation::Brake => (1, 0),
            Actuation::Drive(duty) => (2, duty.units()),
        };
        self.word(kind << 16 | u32::from(duty as u16));
        let flags = [
            snapshot.neutral == Neutral::Coast,
            snapshot.limits.switch_hit.forward(),
            snapshot.limits.switch_disabled.forward(),
            snapshot.limits.soft_hit.forward(),
            snapshot.limits.blocked.forward(),
            snapshot.limits.refused.forward(),
            snapshot.limits.switch_hit.reverse(),
            snapshot.limits.switch_disabled.reverse(),
            snapshot.limits.soft_hit.reverse(),
            snapshot.limits.blocked.reverse(),
            snapshot.limits.refused.reverse(),
            snapshot.current_limited,
            snapshot.pulse_valid,
        ];
        let flags = flags
            .iter()
            .fold(0, |word, flag| word << 1 | u32::from(*flag));
        let state = (snapshot.mode as u32) << 24 | (snapshot.state as u32) << 20;
        self.word(state | u32::from(snapshot.faults.bits()) << 13 | flags);
        self.word(u32::from_le_bytes(snapshot.fault_events));
        for value in [
            snapshot.error,
            snapshot.position,
            snapshot.velocity,
            snapshot.current.to_bits(),
            snapshot.bus_voltage.to_bits(),
            snapshot.temperature.to_bits(),
            snapshot.analog_in.to_bits(),
        ] {
            self.word(value as u32);
        }
    }

    /// The fingerprint.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }
}

impl Default for Fingerprint {
    fn default() -> Self {
        Self::new()
    }
}

/// Seed of the exercise that machines are compared by.
pub const SEED: u32 = 1;
/// Its length in ticks.
pub const TICKS: u32 = 1_000_000;
/// Ticks between two reports of it.
const REPORT_TICKS: u32 = 100_000;

/// Runs a new engine through [`TICKS`] ticks and reports ticks and fingerprint ten times on the way.
pub fn run(seed: u32, mut report: impl FnMut(u32, u64)) {
    let mut engine = windlass_core::engine::Engine::new();
    let mut exercise = Exercise::new(seed);
    let mut fingerprint = Fingerprint::new();
    let mut actuation = Actuation::Off;
    for tick in 1..=TICKS {
        exercise.advance(actuation);
        let snapshot = engine.tick(&exercise.settings, &exercise.sample, &exercise.command);
        actuation = snapshot.actuation;
        fingerprint.add(snapshot);
        if tick.is_multiple_of(REPORT_TICKS) {
            report(tick, fingerprint.value());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use windlass_core::engine::Engine;

    #[test]
    fn every_mode_fault_and_flag_is_reached() {
        let mut engine = Engine::new();
        let mut exercise = Exercise::new(1);
        let mut actuation = Actuation::Off;
        let mut modes = BTreeSet::new();
        let (mut faults, mut timeouts, mut limited, mut refused) = (0, 0, 0, 0);
        let (mut braked, mut driven) = (0, 0);
        for _ in 0..200_000 {
            exercise.advance(actuation);
            let snapshot = engine.tick(&exercise.settings, &exercise.sample, &exercise.command);
            actuation = snapshot.actuation;
            if matches!(actuation, Actuation::Drive(_)) {
                modes.insert(snapshot.mode as u8);
                driven += 1;
            }
            faults |= snapshot.faults.bits();
            limited += u32::from(snapshot.current_limited);
            refused += u32::from(!snapshot.limits.refused.is_empty());
            braked += u32::from(actuation == Actuation::Brake);
            let commanded = exercise.command.setpoint != Setpoint::Off;
            timeouts += u32::from(commanded && snapshot.mode as u8 == 7);
        }
        // Mode::Off has the number 7 and never drives.
        assert_eq!(
            modes.into_iter().collect::<std::vec::Vec<_>>(),
            [0, 1, 2, 3, 4, 5, 6]
        );
        // Over-current and under-voltage last longer than these inputs hold them; the engine's own
        // tests cover them.
        assert!(faults & 0b1010 == 0b1010, "{faults:#b}");
        for count in [timeouts, limited, refused, braked, driven] {
            assert!(
                count > 500,
                "{timeouts} {limited} {refused} {braked} {driven}"
            );
        }
    }

    #[test]
    fn a_drive_in_throttle_units_is_taken_through_its_modes_and_sensors() {
        let mut engine = Engine::new();
        let mut exercise = Exercise::new(1);
        let mut actuation = Actuation::Off;
        let mut driven = BTreeSet::new();
        let (mut refused, mut neutral) = (0, 0);
        for _ in 0..200_000 {
            exercise.advance(actuation);
            let (settings, command) = exercise.in_throttle_units();
            let snapshot = engine.tick(&settings, &exercise.sample, &command);
            actuation = snapshot.actuation;
            if matches!(actuation, Actuation::Drive(_)) {
                driven.insert((snapshot.mode as u8, command.opts.sensor as u8));
            }
            refused += u32::from(!snapshot.limits.refused.is_empty());
            neutral += u32::from(actuation == Actuation::Brake);
        }
        // Duty cycle, velocity, position and follower, each with quadrature, both analog ones and edges.
        for mode in [0, 1, 2, 5] {
            let sensors = driven.iter().filter(|found| found.0 == mode);
            assert!(sensors.count() >= 4, "mode {mode}: {driven:?}");
        }
        assert!(refused > 500 && neutral > 500, "{refused} {neutral}");
    }

    #[test]
    fn every_tick_and_every_field_shows_in_the_fingerprint() {
        let of = |snapshots: &[Snapshot]| {
            let mut fingerprint = Fingerprint::new();
            for snapshot in snapshots {
                fingerprint.add(snapshot);
            }
            fingerprint.value()
        };
        let base = Snapshot::default();
        let mut others = std::vec![base; 6];
        others[0].position = 1;
        others[1].limits.refused = Directions::REVERSE;
        others[2].fault_events[3] = 1;
        others[3].actuation = Actuation::Brake;
        others[4].temperature = Volts::from_bits(1);
        others[5].state = windlass_core::engine::snapshot::DriveState::Running;
        let mut seen: BTreeSet<u64> = others.iter().map(|other| of(&[*other])).collect();
        seen.extend([of(&[]), of(&[base]), of(&[base, base])]);
        assert_eq!(seen.len(), 9);
    }
}
