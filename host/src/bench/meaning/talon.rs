//! The Talon SRX's own frames in words, by the names of its manual.

use windlass_core::dialect::talon_srx::wire::{
    self, BrakeOverride, Control1, Control2, Control3, Control5, Encoding, FeedbackDevice, General,
    GlobalEnable, LimitOverride, Parameter, ParameterRequest, ParameterValue, Status1, Status2,
    Status3, Status4, Status5, Status6, Status7, id,
};
use windlass_core::frame::Frame;

use super::{Named, append_flags};
use crate::client::talon::{FaultBits, mode_word, units};

/// A frame of the bus that is addressed to nobody in particular.
pub(super) fn broadcast(raw: u32, frame: &Frame) -> Option<String> {
    match raw {
        id::DISABLE_ALL => Some("DISABLE: all devices".to_owned()),
        id::GLOBAL_ENABLE => {
            let word = if GlobalEnable::parse(frame)?.enabled {
                "enabled"
            } else {
                "disabled"
            };
            Some(format!("GLOBAL_ENABLE: {word}"))
        }
        _ => None,
    }
}

/// A frame with a device number.
pub(super) fn frame(base: u32, frame: &Frame) -> Option<Named> {
    Some(match base {
        id::CONTROL_1 => ("CONTROL_1", control_1(&Control1::parse(frame)?)),
        id::CONTROL_2 => {
            let [general, feedback, encoder, analog] = Control2::parse(frame)?.periods;
            let text = format!("status periods {general}, {feedback}, {encoder}, {analog} ms");
            ("CONTROL_2", text)
        }
        id::CONTROL_3 => ("CONTROL_3", control_3(Control3::parse(frame)?)),
        id::CONTROL_5 => ("CONTROL_5", general(&Control5::parse(frame)?.general)),
        id::STATUS_1 => ("STATUS_1", status_1(&Status1::parse(frame)?)),
        id::STATUS_2 => ("STATUS_2", status_2(&Status2::parse(frame)?)),
        id::STATUS_3 => ("STATUS_3", status_3(&Status3::parse(frame)?)),
        id::STATUS_4 => ("STATUS_4", status_4(&Status4::parse(frame)?)),
        id::STATUS_5 => {
            let Status5 {
                reset_count,
                reset_flags,
                version: [major, minor],
            } = Status5::parse(frame)?;
            let text =
                format!("firmware {major}.{minor}, {reset_count} resets, flags {reset_flags:#x}");
            ("STATUS_5", text)
        }
        id::STATUS_6 => {
            let status = Status6::parse(frame)?;
            let (current, temperature) = (status.current, status.temperature);
            let (battery, analog) = (status.battery, status.analog);
            let text = format!(
                "conversions: current {current}, temperature {temperature}, battery {battery}, analog {analog}"
            );
            ("STATUS_6", text)
        }
        id::STATUS_7 => {
            let Status7 {
                failures,
                successes,
                ..
            } = Status7::parse(frame)?;
            (
                "STATUS_7",
                format!("tokens: {successes} good, {failures} bad"),
            )
        }
        id::PARAMETER_REQUEST => {
            let ParameterRequest { parameter } = ParameterRequest::parse(frame)?;
            ("PARAM_REQUEST", parameter_name(parameter))
        }
        id::PARAMETER_SET => ("PARAM_SET", parameter(&ParameterValue::parse_set(frame)?)),
        id::PARAMETER_RESPONSE => {
            let response = ParameterValue::parse_response(frame)?;
            ("PARAM_RESPONSE", parameter(&response))
        }
        _ => return None,
    })
}

fn control_1(control: &Control1) -> String {
    control
        .general
        .as_ref()
        .map_or_else(|| "enable".to_owned(), general)
}

fn general(told: &General) -> String {
    let mut text = format!("{}, demand {}", mode_word(told.mode), told.demand);
    if told.ramp != 0 {
        text += &format!(", ramp {}", told.ramp);
    }
    if told.feedback != FeedbackDevice::Quadrature {
        text += &format!(", sensor {}", feedback(told.feedback));
    }
    if let LimitOverride::Forced { forward, reverse } = told.limits {
        let word = |on| if on { "on" } else { "off" };
        text += &format!(
            ", limits forced forward {} reverse {}",
            word(forward),
            word(reverse)
        );
    }
    let flags = [
        (told.slot_1, "slot 1"),
        (told.brake == BrakeOverride::Brake, "brake"),
        (told.brake == BrakeOverride::Coast, "coast"),
        (told.reverse_sensor, "sensor reversed"),
        (told.reverse_output, "output reversed"),
    ];
    append_flags(text, &flags)
}

fn feedback(device: FeedbackDevice) -> &'static str {
    match device {
        FeedbackDevice::Quadrature => "quadrature",
        FeedbackDevice::AnalogPotentiometer => "potentiometer",
        FeedbackDevice::AnalogEncoder => "analog encoder",
        FeedbackDevice::RisingEdges => "rising edges",
        FeedbackDevice::Unsupported(_) => "not supported",
    }
}

fn control_3(control: Control3) -> String {
    let flags = [
        (control.zero_sensor, "zero the sensor"),
        (control.clear_sticky, "clear sticky faults"),
    ];
    let named = flags.into_iter().filter(|(set, _)| *set);
    let named: Vec<&str> = named.map(|(_, name)| name).collect();
    named.join(", ")
}

fn status_1(status: &Status1) -> String {
    let duty = units::share(status.throttle) * 100.0;
    let mode = mode_word(status.mode);
    let mut text = format!("{mode}, duty {duty:.1} %, error {}", status.error);
    let flags = [
        (!status.token_locked, "disabled"),
        (status.forward_closed, "forward switch closed"),
        (status.reverse_closed, "reverse switch closed"),
    ];
    text = append_flags(text, &flags);
    for fault in FaultBits::from(status.faults).names() {
        text += &format!(", fault {fault}");
    }
    text
}

fn status_2(status: &Status2) -> String {
    let (position, velocity) = (status.position, status.velocity);
    let current = wire::current(status.current).to_num::<f64>();
    let text = format!("position {position}, velocity {velocity}, {current:.2} A");
    let flags = [(status.slot_1, "slot 1"), (status.brake, "brake")];
    let mut text = append_flags(text, &flags);
    for fault in FaultBits::from(status.sticky).names() {
        text += &format!(", sticky {fault}");
    }
    text
}

fn status_3(status: &Status3) -> String {
    let (position, velocity, rises) = (status.position, status.velocity, status.index_rises);
    let pins = [status.pin_a, status.pin_b, status.pin_index].map(u8::from);
    let [a, b, index] = pins;
    format!("encoder {position}, velocity {velocity}, {rises} index rises, pins {a}{b}{index}")
}

fn status_4(status: &Status4) -> String {
    let temperature = wire::temperature(status.temperature).to_num::<f64>();
    let battery = wire::battery(status.battery).to_num::<f64>();
    let (analog, velocity) = (status.position, status.velocity);
    format!("analog {analog}, velocity {velocity}, {temperature:.1} °C, {battery:.2} V")
}

fn parameter(told: &ParameterValue) -> String {
    let name = parameter_name(told.parameter);
    let raw = told.value as i32;
    let encoding = Parameter::from_code(told.parameter).map(Parameter::encoding);
    match encoding {
        Some(Encoding::Unsigned10Q22) => format!("{name} = {}", units::gain_from(raw)),
        Some(Encoding::Signed10Q22) => format!("{name} = {}", units::feed_forward_from(raw)),
        _ => format!("{name} = {raw}"),
    }
}

fn parameter_name(code: u8) -> String {
    Parameter::from_code(code).map_or_else(
        || format!("parameter {code}"),
        |parameter| format!("{parameter:?}"),
    )
}
