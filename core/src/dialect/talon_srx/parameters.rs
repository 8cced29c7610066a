//! Parameters by their numbers: most live in the one table, the others are part of the running drive.

use super::wire::{self, Access, FeedbackDevice, Parameter};
use super::{TalonSrx, live_faults, sticky};
use crate::dialect::{Decoded, Intent, Request, View};
use crate::engine::command::{Neutral, PositionOf};
use crate::engine::snapshot::Pin;
use crate::params::table::ParameterId;

/// The row of the one table that holds a parameter; none for live values.
pub(super) const fn row(parameter: Parameter) -> Option<ParameterId> {
    Some(match parameter {
        Parameter::Slot0P => ParameterId::ThrottleSlot0P,
        Parameter::Slot0I => ParameterId::ThrottleSlot0I,
        Parameter::Slot0D => ParameterId::ThrottleSlot0D,
        Parameter::Slot0F => ParameterId::ThrottleSlot0F,
        Parameter::Slot0IZone => ParameterId::ThrottleSlot0IZone,
        Parameter::Slot0Ramp => ParameterId::ThrottleSlot0Ramp,
        Parameter::Slot1P => ParameterId::ThrottleSlot1P,
        Parameter::Slot1I => ParameterId::ThrottleSlot1I,
        Parameter::Slot1D => ParameterId::ThrottleSlot1D,
        Parameter::Slot1F => ParameterId::ThrottleSlot1F,
        Parameter::Slot1IZone => ParameterId::ThrottleSlot1IZone,
        Parameter::Slot1Ramp => ParameterId::ThrottleSlot1Ramp,
        Parameter::ForwardSoftThreshold => ParameterId::SoftForwardThreshold,
        Parameter::ReverseSoftThreshold => ParameterId::SoftReverseThreshold,
        Parameter::ForwardSoftEnable => ParameterId::SoftForwardEnable,
        Parameter::ReverseSoftEnable => ParameterId::SoftReverseEnable,
        Parameter::OnBootBrake => ParameterId::BrakeAtNeutral,
        Parameter::OnBootForwardNormallyClosed => ParameterId::ForwardLimitNormallyClosed,
        Parameter::OnBootReverseNormallyClosed => ParameterId::ReverseLimitNormallyClosed,
        Parameter::OnBootForwardDisable => ParameterId::ForwardLimitDisabled,
        Parameter::OnBootReverseDisable => ParameterId::ReverseLimitDisabled,
        _ => return None,
    })
}

/// Values that orders to the engine will bring about at its next tick. A set is answered before that.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Promised {
    position: Option<i32>,
    encoder: Option<i32>,
    accumulator: Option<i32>,
    index: Option<u16>,
}

impl TalonSrx {
    /// An answer that is owed. Once there is no place the host asks faster than the bus can answer.
    pub(super) fn owe(&mut self, parameter: Parameter) {
        let _ = self.owed.push_back(parameter);
    }

    /// A number that is not known gets no answer.
    pub(super) fn parameter_request(&mut self, code: u8) -> Decoded {
        match Parameter::from_code(code) {
            Some(parameter) => {
                self.owe(parameter);
                Decoded::Done
            }
            None => Decoded::Ignored,
        }
    }

    /// Every set of a known number is answered with the value in force.
    pub(super) fn parameter_set(&mut self, code: u8, value: u32) -> Decoded {
        let Some(parameter) = Parameter::from_code(code) else { return Decoded::Ignored };
        if let Some(row) = row(parameter) {
            self.writing = Some(parameter);
            return Decoded::Request(Request::Write(row.code(), value));
        }
        if parameter.access() == Access::ReadOnly {
            self.owe(parameter);
            return Decoded::Done;
        }
        self.set_live(parameter, value)
    }

    /// Live values act at the next tick, so what is answered is what they will be.
    fn set_live(&mut self, parameter: Parameter, value: u32) -> Decoded {
        self.owe(parameter);
        let signed = value as i32;
        let promised = &mut self.promised;
        match parameter {
            Parameter::SensorPosition => {
                // The others are absolute, or nothing to set (manual 13): they answer where they stand.
                promised.position = match self.told.feedback() {
                    FeedbackDevice::AnalogPotentiometer | FeedbackDevice::Unsupported(_) => None,
                    _ => Some(signed),
                };
                Decoded::Intent(Intent::SetPosition(PositionOf::Selected, signed))
            }
            Parameter::EncoderPosition => {
                promised.encoder = Some(signed);
                Decoded::Intent(Intent::SetPosition(PositionOf::Encoder, signed))
            }
            Parameter::IntegralAccumulator => {
                promised.accumulator = Some(signed);
                Decoded::Intent(Intent::SetAccumulator(signed))
            }
            Parameter::IndexRiseEvents => {
                promised.index = Some(value as u16);
                Decoded::Done
            }
            _ => {
                self.set_period(parameter, value);
                Decoded::Done
            }
        }
    }

    /// Periods of 1 to 255 ms; 0 switches Status_6 and 7 off and leaves the others as they are.
    fn set_period(&mut self, parameter: Parameter, value: u32) {
        let Ok(period) = u8::try_from(value) else { return };
        let Some(at) = period_place(parameter) else { return };
        if let Some(place) = self.periods.get_mut(at)
            && (period > 0 || at >= 4)
        {
            *place = period;
        }
    }

    /// The value of a parameter now.
    pub(super) fn value(&mut self, parameter: Parameter, view: &View<'_>) -> u32 {
        if let Some(row) = row(parameter) {
            return view.params.get(row);
        }
        if let Some(at) = period_place(parameter) {
            return self.periods.get(at).map_or(0, |period| u32::from(*period));
        }
        if let Some(promised) = self.promise(parameter) {
            return promised as u32;
        }
        if parameter == Parameter::IndexRiseEvents {
            self.settle_index(view);
            return u32::from(self.index_rises(view));
        }
        fault_value(parameter, view)
            .or_else(|| self.mirror_value(parameter, view))
            .unwrap_or_else(|| sensor_value(parameter, view))
    }

    /// What a set has promised, once.
    fn promise(&mut self, parameter: Parameter) -> Option<i32> {
        match parameter {
            Parameter::SensorPosition => self.promised.position.take(),
            Parameter::EncoderPosition => self.promised.encoder.take(),
            Parameter::IntegralAccumulator => self.promised.accumulator.take(),
            _ => None,
        }
    }

    /// Carries out an order to overwrite the count of the index, now that the present one is known.
    fn settle_index(&mut self, view: &View<'_>) {
        if let Some(count) = self.promised.index.take() {
            self.index_origin = view.snapshot.raw.index_rises.wrapping_sub(count);
        }
    }

    /// Rising edges of the index.
    pub(super) fn index_rises(&self, view: &View<'_>) -> u16 {
        view.snapshot.raw.index_rises.wrapping_sub(self.index_origin)
    }

    /// What the control frame said and what came of it.
    fn mirror_value(&self, parameter: Parameter, view: &View<'_>) -> Option<u32> {
        let (snapshot, told) = (view.snapshot, &self.told);
        Some(match parameter {
            Parameter::AppliedThrottle => snapshot.duty().throttle() as u32,
            Parameter::ClosedLoopError => snapshot.error as u32,
            Parameter::FeedbackDeviceSelect => u32::from(told.feedback().code()),
            Parameter::ReverseOutput => u32::from(told.reverse_output()),
            Parameter::ModeSelect => u32::from(told.mode().code()),
            Parameter::ProfileSlotSelect => u32::from(told.slot_1()),
            Parameter::RampThrottle => u32::from(told.ramp()),
            Parameter::ReverseSensor => u32::from(told.reverse_sensor()),
            Parameter::LimitSwitchEnable => u32::from(told.limits().code()),
            Parameter::BrakeIsEnabled => u32::from(snapshot.neutral == Neutral::Brake),
            Parameter::ResetCount => u32::from(view.device.reset_count),
            Parameter::ResetFlags => u32::from(view.device.reset_flags),
            Parameter::FirmwareVersion => u32::from(view.device.version),
            Parameter::SettingsChanged => u32::from(view.device.unsaved),
            // The counters of the supported boards have their input filters on.
            Parameter::QuadratureFilter => 1,
            _ => return None,
        })
    }
}

/// Place of a frame's period in the list of periods.
const fn period_place(parameter: Parameter) -> Option<usize> {
    Some(match parameter {
        Parameter::Status1Period => 0,
        Parameter::Status2Period => 1,
        Parameter::Status3Period => 2,
        Parameter::Status4Period => 3,
        Parameter::Status6Period => 4,
        Parameter::Status7Period => 5,
        _ => return None,
    })
}

fn fault_value(parameter: Parameter, view: &View<'_>) -> Option<u32> {
    let (live, sticky) = (live_faults(view), sticky(view));
    let flag = match parameter {
        Parameter::FaultOverTemperature => live.over_temperature,
        Parameter::FaultUnderVoltage => live.under_voltage,
        Parameter::FaultForwardLimit => live.forward_limit,
        Parameter::FaultReverseLimit => live.reverse_limit,
        Parameter::FaultHardware => live.hardware,
        Parameter::FaultForwardSoft => live.forward_soft,
        Parameter::FaultReverseSoft => live.reverse_soft,
        Parameter::StickyOverTemperature => sticky.over_temperature,
        Parameter::StickyUnderVoltage => sticky.under_voltage,
        Parameter::StickyForwardLimit => sticky.forward_limit,
        Parameter::StickyReverseLimit => sticky.reverse_limit,
        Parameter::StickyForwardSoft => sticky.forward_soft,
        Parameter::StickyReverseSoft => sticky.reverse_soft,
        _ => return None,
    };
    Some(u32::from(flag))
}

/// Sensors, pins and electrical values.
fn sensor_value(parameter: Parameter, view: &View<'_>) -> u32 {
    let snapshot = view.snapshot;
    let (pins, raw) = (&snapshot.pins, &snapshot.raw);
    let value = match parameter {
        Parameter::ForwardClosed => i32::from(!pins.is_high(Pin::ForwardLimit)),
        Parameter::ReverseClosed => i32::from(!pins.is_high(Pin::ReverseLimit)),
        Parameter::SensorPosition => snapshot.position,
        Parameter::SensorVelocity => snapshot.velocity,
        Parameter::Current => wire::to_10_22(snapshot.current.to_bits().saturating_abs()),
        Parameter::EncoderPosition => raw.encoder.position,
        Parameter::EncoderVelocity => raw.encoder.velocity,
        Parameter::QuadratureA => i32::from(pins.is_high(Pin::EncoderA)),
        Parameter::QuadratureB => i32::from(pins.is_high(Pin::EncoderB)),
        Parameter::QuadratureIndex => i32::from(pins.is_high(Pin::EncoderIndex)),
        Parameter::AnalogPosition => raw.analog.position,
        Parameter::AnalogVelocity => raw.analog.velocity,
        Parameter::Temperature => wire::to_10_22(snapshot.temperature.to_bits()),
        Parameter::Battery => wire::to_10_22(snapshot.bus_voltage.to_bits()),
        Parameter::IntegralAccumulator => snapshot.accumulator,
        _ => 0,
    };
    value as u32
}
