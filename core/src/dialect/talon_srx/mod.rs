//! The Talon SRX dialect (firmware 1.1): one control frame in, periodic status frames out, parameters by
//! number.
//!
//! Source: Talon SRX Software Reference Manual, rev 1.0; frames, tables and decisions by
//! `docs/talon-srx.md`.

mod parameters;
pub mod wire;

#[cfg(test)]
mod tests;

use heapless::Deque;
use wire::{
    BROADCAST_NUMBER, BrakeOverride, Control2, Control3, FeedbackDevice, GlobalEnable,
    LimitOverride, LiveFaults, ModeSelect, Parameter, RawGeneral, Status1, Status2, Status3,
    Status4, Status5, Status6, Status7, Sticky, id,
};

use parameters::Promised;

use super::schedule::{Periodic, earlier};
use super::{Bad, Decoded, Dialect, Intent, Outcome, Outgoing, View};
use crate::engine::command::{self, DriveOpts, Neutral, SensorSelect, Setpoint, Slot};
use crate::engine::policy::{
    Enabling, Indicated, Law, Policy, Resume, SensorSet, SoftThreshold, Sticky as StickyRule,
};
use crate::engine::limit::Directions;
use crate::engine::snapshot::{DriveState, Fault, Faults, Pin};
use crate::field::saturate_i16;
use crate::frame::{ExtendedMatch, Frame};
use crate::led::Style;
use crate::frc_id::{NUMBER_MASK, base, number, with_number};
use crate::management::Identity;
use crate::management::identity::Manufacturer;
use crate::params::{Params, SaveRule};
use crate::params::table::ParameterId;
use crate::time::{Duration, Instant, TICKS_PER_MS};
use crate::units::Duty;

/// Parameter answers that may wait for the bus at one time: requests have the higher priority on the bus,
/// and a host may ask for every parameter in one burst.
const ANSWER_CAPACITY: usize = 96;

/// Default periods of Status_1, 2, 3, 4, 6 and 7 in ms, 0 = off (manual 20.1 to 20.4; 6 and 7 by
/// docs/talon-srx.md).
const PERIODS: [u8; 6] = [10, 20, 100, 100, 0, 0];

/// Product identifier in the answer to an enumeration: product 0x204, variant 1, firmware id 1; our own.
pub const PRODUCT_TALON_SRX: u32 = 0x2040_0101;

/// Bit of an identifier that tells Control_5 from Control_1.
const ONLY_CONTROL_5: u32 = id::CONTROL_5 & !id::CONTROL_1;
const _: () = assert!(id::CONTROL_1 & id::CONTROL_5 == id::CONTROL_1);

/// What the dialect remembers.
#[derive(Clone, Debug)]
pub struct TalonSrx {
    /// What the host said last; it is shown until the host says something else.
    told: RawGeneral,
    /// General status of the controller that is followed.
    master: ExtendedMatch,
    /// A global disable holds until the next global enable …
    held_by_global: bool,
    /// … and the broadcast of the field's controller until the next Control_1.
    held_by_broadcast: bool,
    periods: [u8; 6],
    rhythms: [Periodic; 6],
    /// Status_5 has not been sent since the reset.
    start_up_owed: bool,
    /// Parameters whose answers wait for the bus.
    owed: Deque<Parameter, ANSWER_CAPACITY>,
    /// What live values will be once the engine has carried out an order.
    promised: Promised,
    /// The parameter of the table whose write is being carried out.
    writing: Option<Parameter>,
    /// Rising edges of the index that are not counted any more.
    index_origin: u16,
    token_seed: u8,
    tokens: u16,
}

impl Default for TalonSrx {
    fn default() -> Self {
        Self {
            told: RawGeneral::default(),
            master: ExtendedMatch::NONE,
            held_by_global: false,
            held_by_broadcast: false,
            periods: PERIODS,
            rhythms: [Periodic::default(); 6],
            start_up_owed: true,
            owed: Deque::new(),
            promised: Promised::default(),
            writing: None,
            index_origin: 0,
            token_seed: 0,
            tokens: 0,
        }
    }
}

impl Dialect for TalonSrx {
    const NAME: &'static str = "talon";

    /// Numbers 0 to 62 (manual 1, 2.1); 0 is the number of a new device (2.2). Everything else is our own:
    /// the product id of this protocol is not public.
    const IDENTITY: Identity = Identity {
        manufacturer: Manufacturer::CrossTheRoad,
        product_id: PRODUCT_TALON_SRX,
        manufacturer_name: "Windlass",
        product_name: "Talon SRX (Windlass)",
        first_number: 0,
        last_number: wire::MAX_DEVICE_NUMBER,
    };

    /// Enable and command 100 ms, follower 100 ms (manual 16.5); of the faults only a failure of the power
    /// stage stops (manual 21.5), for 3 s; under-voltage below 6.5 V and over-temperature from 100 °C are
    /// shown; a changed limit switch type pauses for 100 ms (docs/talon-srx.md).
    const POLICY: Policy = Policy {
        command_timeout_ticks: (100 * TICKS_PER_MS) as u16,
        master_timeout_ticks: (100 * TICKS_PER_MS) as u16,
        fault_hold_ticks: (3000 * TICKS_PER_MS) as u16,
        resume: Resume::AnyCommand,
        enabling: Enabling::Separate,
        law: Law::Throttle,
        sensors: SensorSet::All,
        soft_threshold: SoftThreshold::Exclusive,
        stopping: Faults::NONE.with(Fault::GateDriver),
        indicated: Some(Indicated {
            under_voltage: (65 << 16) / 10,
            over_temperature: 100 << 16,
            ticks: 4,
        }),
        sticky: StickyRule::Presence,
        pause_ticks: (100 * TICKS_PER_MS) as u16,
    };

    /// At most once in 15 s, the latest values always (manual 11.1).
    const SAVE_RULE: SaveRule = SaveRule::SinceLastSave;

    /// Manual 2.2, 4.1 and 16.3; rates by docs/leds.md.
    const LED_STYLE: Style = Style::Blinking;

    #[inline]
    fn decode(&mut self, own: u8, frame: &Frame) -> Decoded {
        let to = number(frame.raw_id());
        let meant = to == own
            || to == BROADCAST_NUMBER
            || frame.is(self.master)
            || frame.is(ExtendedMatch::new(id::DISABLE_ALL));
        if !meant {
            return Decoded::Ignored;
        }
        self.read(own, frame)
    }

    fn answer(&mut self, _: Outcome) {
        // A refused value is answered with the one in force, as every other set is.
        if let Some(parameter) = self.writing.take() {
            self.owe(parameter);
        }
    }

    fn start(&mut self, now: Instant, _: &Params) {
        for (rhythm, period) in self.rhythms.iter_mut().zip(self.periods) {
            if period > 0 {
                rhythm.start(now, millis(period));
            }
        }
    }

    fn stop(&mut self) {
        self.promised = Promised::default();
        for rhythm in &mut self.rhythms {
            rhythm.stop();
        }
        self.owed.clear();
        self.master = ExtendedMatch::NONE;
        self.told = RawGeneral::default();
    }

    fn encode(&mut self, now: Instant, view: &View<'_>) -> Option<Outgoing> {
        if let Some(parameter) = self.owed.pop_front() {
            let value = self.value(parameter, view);
            let response = wire::ParameterValue { parameter: parameter.code(), value };
            return Some(Outgoing::Answer(response.emit_response(view.number)));
        }
        if self.start_up_owed {
            self.start_up_owed = false;
            return Some(Outgoing::Status(status_5(view).emit(view.number)));
        }
        let own = view.number;
        let frame = match self.due(now)? {
            0 => {
                self.token_seed = self.token_seed.wrapping_add(1);
                self.status_1(view).emit(own)
            }
            1 => self.status_2(view).emit(own),
            2 => self.status_3(view).emit(own),
            3 => status_4(view).emit(own),
            4 => status_6(view).emit(own),
            _ => Status7 { successes: self.tokens, ..Status7::default() }.emit(own),
        };
        Some(Outgoing::Status(frame))
    }

    fn next_deadline(&self) -> Option<Instant> {
        if !self.owed.is_empty() || self.start_up_owed {
            return Some(Instant::ZERO);
        }
        self.rhythms.iter().fold(None, |next, rhythm| earlier(next, rhythm.due()))
    }
}

const fn millis(period: u8) -> Duration {
    Duration::from_millis(period as u32)
}

impl TalonSrx {
    /// A frame that may be meant for device `own`.
    #[inline(never)]
    fn read(&mut self, own: u8, frame: &Frame) -> Decoded {
        // What comes most often.
        let control = ExtendedMatch::new(with_number(id::CONTROL_1, own));
        if frame.is_but_for(ONLY_CONTROL_5, control) {
            return self.control(frame);
        }
        self.read_other(frame)
    }

    /// A frame to this device, to every device or of the followed controller, but no control frame to this device.
    #[inline(never)]
    fn read_other(&mut self, frame: &Frame) -> Decoded {
        let Some(id) = frame.extended_id() else { return Decoded::Ignored };
        if id == id::DISABLE_ALL {
            // Whatever its length and kind: this one is never refused.
            self.held_by_broadcast = true;
            return Decoded::Intent(Intent::Enable(false));
        }
        let refused = if frame.is_remote() { Bad::Remote } else { Bad::Length };
        let decoded = match base(id) {
            id::CONTROL_1 | id::CONTROL_5 => return self.control(frame),
            id::CONTROL_2 => Control2::parse(frame).map(|control| self.control_2(&control)),
            id::CONTROL_3 => Control3::parse(frame).map(|control| self.control_3(&control)),
            id::STATUS_1 if frame.is(self.master) => Status1::parse_throttle(frame).map(|throttle| {
                let duty = Duty::from_throttle(i32::from(throttle));
                Decoded::Intent(Intent::MasterReport(duty))
            }),
            id::PARAMETER_REQUEST => wire::ParameterRequest::parse(frame)
                .map(|request| self.parameter_request(request.parameter)),
            id::PARAMETER_SET => wire::ParameterValue::parse_set(frame)
                .map(|set| self.parameter_set(set.parameter, set.value)),
            _ if id == id::GLOBAL_ENABLE => {
                GlobalEnable::parse(frame).map(|enable| self.global_enable(enable))
            }
            _ => return Decoded::Ignored,
        };
        decoded.unwrap_or(Decoded::Bad(refused))
    }

    /// Which periodic frame is due, by its place in [`PERIODS`].
    fn due(&mut self, now: Instant) -> Option<usize> {
        let mut due = None;
        for (at, (rhythm, period)) in self.rhythms.iter_mut().zip(self.periods).enumerate() {
            if period == 0 {
                rhythm.stop();
            } else if rhythm.due().is_none() {
                rhythm.start(now, millis(period));
            } else if due.is_none() && rhythm.take(now, millis(period)) {
                due = Some(at);
            }
        }
        due
    }

    /// Control_1 or Control_5.
    #[inline]
    fn control(&mut self, frame: &Frame) -> Decoded {
        let enables = frame.raw_id() & ONLY_CONTROL_5 == 0;
        let Some(general) = RawGeneral::read(frame) else { return self.short(frame, enables) };
        if enables {
            self.enabled();
        }
        self.tell(general, enables && !self.held_by_global)
    }

    /// A control frame without the 8 bytes: the short form of Control_1, which only enables.
    #[inline(never)]
    fn short(&mut self, frame: &Frame, enables: bool) -> Decoded {
        if frame.is_remote() {
            return Decoded::Bad(Bad::Remote);
        }
        if !enables || frame.exact::<2>().is_none() {
            return Decoded::Bad(Bad::Length);
        }
        self.enabled();
        if self.held_by_global {
            return Decoded::Ignored;
        }
        Decoded::Intent(Intent::Enable(true))
    }

    /// A Control_1 has come.
    fn enabled(&mut self) {
        self.held_by_broadcast = false;
        self.tokens = self.tokens.wrapping_add(1);
    }

    fn global_enable(&mut self, enable: GlobalEnable) -> Decoded {
        self.held_by_global = !enable.enabled;
        if enable.enabled && self.held_by_broadcast {
            return Decoded::Ignored;
        }
        Decoded::Intent(Intent::Enable(enable.enabled))
    }

    fn control_2(&mut self, control: &Control2) -> Decoded {
        for (period, new) in self.periods.iter_mut().zip(control.periods) {
            if new > 0 {
                *period = new;
            }
        }
        Decoded::Done
    }

    fn control_3(&mut self, control: &Control3) -> Decoded {
        Decoded::Intent(Intent::Clear {
            position: control.zero_sensor,
            sticky: control.clear_sticky,
        })
    }

    /// Takes over what the host says, enabled or not.
    #[inline]
    fn tell(&mut self, general: RawGeneral, enabled: bool) -> Decoded {
        self.told = general;
        let setpoint = setpoint(general);
        self.master = match setpoint {
            Setpoint::Follow(master) => ExtendedMatch::new(with_number(id::STATUS_1, master)),
            _ => ExtendedMatch::NONE,
        };
        let opts = drive_opts(general);
        Decoded::Intent(if enabled {
            Intent::Drive(setpoint, opts)
        } else {
            Intent::Prepare(setpoint, opts)
        })
    }

    /// `STATUS_1` of the present state.
    fn status_1(&self, view: &View<'_>) -> Status1 {
        let snapshot = view.snapshot;
        Status1 {
            error: snapshot.error,
            throttle: snapshot.duty().throttle() as i16,
            faults: live_faults(view),
            token_locked: snapshot.state == DriveState::Running,
            forward_closed: !snapshot.pins.is_high(Pin::ForwardLimit),
            reverse_closed: !snapshot.pins.is_high(Pin::ReverseLimit),
            feedback: self.told.feedback(),
            limits: self.told.limits(),
            mode: self.told.mode(),
            token_seed: self.token_seed,
        }
    }

    fn status_2(&self, view: &View<'_>) -> Status2 {
        let snapshot = view.snapshot;
        Status2 {
            position: snapshot.position,
            velocity: saturate_i16(snapshot.velocity),
            current: wire::current_raw(snapshot.current),
            sticky: sticky(view),
            slot_1: self.told.slot_1(),
            brake: snapshot.neutral == Neutral::Brake,
            ..Status2::default()
        }
    }

    fn status_3(&self, view: &View<'_>) -> Status3 {
        let snapshot = view.snapshot;
        Status3 {
            position: snapshot.raw.encoder.position,
            velocity: saturate_i16(snapshot.raw.encoder.velocity),
            index_rises: self.index_rises(view),
            pin_a: snapshot.pins.is_high(Pin::EncoderA),
            pin_b: snapshot.pins.is_high(Pin::EncoderB),
            pin_index: snapshot.pins.is_high(Pin::EncoderIndex),
        }
    }
}

/// The setpoint of a control frame. What firmware 1.1 does not drive is neutral (manual 21).
fn setpoint(general: RawGeneral) -> Setpoint {
    let sensed = !matches!(general.feedback(), FeedbackDevice::Unsupported(_));
    match general.mode() {
        ModeSelect::Duty => Setpoint::Duty(Duty::from_throttle(general.demand())),
        ModeSelect::Position if sensed => Setpoint::Position(general.demand()),
        ModeSelect::Velocity if sensed => Setpoint::Velocity(general.demand()),
        ModeSelect::Follower => Setpoint::Follow((general.demand() as u32 & NUMBER_MASK) as u8),
        ModeSelect::Position
        | ModeSelect::Velocity
        | ModeSelect::Current
        | ModeSelect::VoltageCompensation
        | ModeSelect::NoDrive
        | ModeSelect::Reserved(_) => Setpoint::Neutral,
    }
}

fn drive_opts(general: RawGeneral) -> DriveOpts {
    // Not the duty cycle (manual 7.4, 9.4).
    let turns = !matches!(general.mode(), ModeSelect::Duty);
    DriveOpts {
        slot: if general.slot_1() { Slot::One } else { Slot::Zero },
        neutral: match general.brake() {
            BrakeOverride::Stored | BrakeOverride::Reserved => None,
            BrakeOverride::Coast => Some(Neutral::Coast),
            BrakeOverride::Brake => Some(Neutral::Brake),
        },
        limits: match general.limits() {
            LimitOverride::Stored(_) => command::LimitOverride::NONE,
            LimitOverride::Forced { forward, reverse } => command::LimitOverride {
                enabled: true,
                disabled: Directions::new(!forward, !reverse),
            },
        },
        sensor: match general.feedback() {
            FeedbackDevice::Quadrature => SensorSelect::Quadrature,
            FeedbackDevice::AnalogPotentiometer => SensorSelect::AnalogPotentiometer,
            FeedbackDevice::AnalogEncoder => SensorSelect::AnalogEncoder,
            FeedbackDevice::RisingEdges => SensorSelect::RisingEdges,
            FeedbackDevice::Unsupported(_) => SensorSelect::None,
        },
        reverse_sensor: general.reverse_sensor(),
        reverse_motor: general.reverse_output() && turns,
        ramp: u16::from(general.ramp()),
    }
}

/// A limit switch is a fault while it is enabled and tripped, whatever is asked for.
fn live_faults(view: &View<'_>) -> LiveFaults {
    let snapshot = view.snapshot;
    let (tripped, soft) = (snapshot.limits.tripped(), snapshot.limits.soft_hit);
    LiveFaults {
        over_temperature: snapshot.faults.contains(Fault::OverTemperature),
        under_voltage: snapshot.faults.contains(Fault::UnderVoltage),
        forward_limit: tripped.forward(),
        reverse_limit: tripped.reverse(),
        forward_soft: soft.forward(),
        reverse_soft: soft.reverse(),
        hardware: snapshot.faults.contains(Fault::GateDriver),
    }
}

fn sticky(view: &View<'_>) -> Sticky {
    let limits = view.params.get(ParameterId::StickyLimits);
    Sticky {
        over_temperature: view.device.sticky.contains(Fault::OverTemperature),
        under_voltage: view.device.sticky.contains(Fault::UnderVoltage),
        forward_limit: limits & 1 != 0,
        reverse_limit: limits & 2 != 0,
        forward_soft: limits & 4 != 0,
        reverse_soft: limits & 8 != 0,
    }
}

fn status_4(view: &View<'_>) -> Status4 {
    let snapshot = view.snapshot;
    Status4 {
        position: snapshot.raw.analog.position,
        velocity: saturate_i16(snapshot.raw.analog.velocity),
        temperature: wire::temperature_raw(snapshot.temperature),
        battery: wire::battery_raw(snapshot.bus_voltage),
    }
}

fn status_5(view: &View<'_>) -> Status5 {
    Status5 {
        reset_count: view.device.reset_count,
        reset_flags: view.device.reset_flags,
        version: view.device.version.to_be_bytes(),
    }
}

/// The upper 10 bits of the 12-bit conversions.
fn status_6(view: &View<'_>) -> Status6 {
    let conversions = view.snapshot.raw.conversions;
    Status6 {
        current: conversions.current >> 2,
        chip_select: false,
        temperature: conversions.temperature >> 2,
        battery: conversions.bus_voltage >> 2,
        analog: conversions.analog_in >> 2,
    }
}
