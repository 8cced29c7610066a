//! What a frame says, in words: its name in the DMC60C guide or the Talon SRX manual, the device number, its
//! fields.

mod talon;

use windlass_core::dialect::dmc60c::wire::{
    Control0, StatusAnalog, StatusEncoder, StatusGeneral, id as drive,
};
use windlass_core::engine::snapshot::Fault;
use windlass_core::frame::Frame;
use windlass_core::frc_id;
use windlass_core::management::identity::Manufacturer;
use windlass_core::management::vendor::{Command, CommandCode};
use windlass_core::management::wire::{
    EnumerateResponse0, EnumerateResponse1, ParameterRequest, ParameterResponse, ParameterSet,
    VendorCommand, VendorStatus, id,
};
use windlass_core::params::table::TABLE;

use crate::client::{Version, image_name, mode_name};

/// One line about a frame; empty if it is none of the two dialects', or has another length than they have.
pub(super) fn of(frame: &Frame) -> String {
    let Some(raw) = frame.extended_id() else {
        return String::new();
    };
    let base = frc_id::base(raw);
    if base == id::ENUMERATE {
        return "ENUM".to_owned();
    }
    if let Some(text) = talon::broadcast(raw, frame) {
        return text;
    }
    let number = frc_id::number(raw);
    let found = [
        ("", drive_frame(base, frame)),
        ("talon ", talon::frame(base, frame)),
        ("", managed(Manufacturer::Digilent, raw, frame)),
        ("talon ", managed(Manufacturer::CrossTheRoad, raw, frame)),
    ];
    let named = found
        .into_iter()
        .find_map(|(kind, found)| Some((kind, found?)));
    match named {
        Some((kind, (name, text))) if text.is_empty() => format!("{name} {kind}#{number}"),
        Some((kind, (name, text))) => format!("{name} {kind}#{number}: {text}"),
        None => String::new(),
    }
}

/// A frame of the management channel of devices of this manufacturer.
fn managed(manufacturer: Manufacturer, raw: u32, frame: &Frame) -> Option<Named> {
    management_frame(frc_id::base(manufacturer.guide_identifier(raw)?), frame)
}

type Named = (&'static str, String);

fn drive_frame(base: u32, frame: &Frame) -> Option<Named> {
    Some(match base {
        drive::CONTROL_0 => ("CANCTRL0", control(&Control0::parse(frame)?)),
        drive::STATUS_GENERAL => ("STSGENERAL", general(&StatusGeneral::parse(frame)?)),
        drive::STATUS_ENCODER => {
            let status = StatusEncoder::parse(frame)?;
            let position = status.position_counts();
            let velocity = status.velocity_counts_per_100ms();
            let text = format!("position {position}, velocity {velocity}");
            ("STSENCODER", text)
        }
        drive::STATUS_ANALOG => ("STSANALOG", analog(&StatusAnalog::parse(frame)?)),
        _ => return None,
    })
}

fn control(control: &Control0) -> String {
    let mut text = format!("{}, target {}", mode_name(control.mode), control.target);
    if control.ramp != 0 {
        text += &format!(", ramp {}", control.ramp);
    }
    let options = [
        (control.slot_1, "slot 1"),
        (control.override_neutral && control.brake, "brake"),
        (control.override_neutral && !control.brake, "coast"),
        (control.reverse_motor, "motor reversed"),
        (control.reverse_sensor, "sensor reversed"),
        (control.limits.enabled, "limits overridden"),
    ];
    append_flags(text, &options)
}

fn general(status: &StatusGeneral) -> String {
    let duty = f64::from(status.duty) / 327.67;
    let mode = mode_name(status.mode);
    let text = format!("{mode}, duty {duty:.1} %, error {}", status.error);
    let faults = status.faults;
    let flags = [
        (status.limit_hit.forward(), "forward switch hit"),
        (status.limit_hit.reverse(), "reverse switch hit"),
        (status.soft_hit.forward(), "forward soft limit"),
        (status.soft_hit.reverse(), "reverse soft limit"),
        (status.current_limited, "current limited"),
        (faults.contains(Fault::OverTemperature), "over-temperature"),
        (faults.contains(Fault::UnderVoltage), "under-voltage"),
        (faults.contains(Fault::GateDriver), "gate driver fault"),
    ];
    append_flags(text, &flags)
}

fn append_flags(mut text: String, flags: &[(bool, &str)]) -> String {
    for (set, name) in flags {
        if *set {
            text += ", ";
            text += name;
        }
    }
    text
}

fn analog(status: &StatusAnalog) -> String {
    let [current, voltage, temperature, analog_in] = [
        status.current,
        status.bus_voltage,
        status.temperature,
        status.analog_in,
    ]
    .map(|value| f64::from(value) / 256.0);
    format!("{current:.2} A, {voltage:.2} V, {temperature:.1} °C, AIN1 {analog_in:.2} V")
}

fn management_frame(base: u32, frame: &Frame) -> Option<Named> {
    Some(match base {
        id::ENUMERATE_RESPONSE => enumeration(frame)?,
        id::VENDOR_COMMAND => ("VENDORCMD", vendor_command(&VendorCommand::parse(frame)?)),
        id::VENDOR_STATUS => {
            let status = VendorStatus::parse(frame)?;
            let name =
                CommandCode::from_code(status.code as u8).map_or("unknown code", CommandCode::name);
            ("VENDORSTS", format!("{name}, {} bytes", status.byte_count))
        }
        id::VENDOR_DATA_OUT => ("VENDORDOUT", text_of(frame.data())),
        id::VENDOR_DATA_IN => ("VENDORDIN", text_of(frame.data())),
        id::PARAMETER_REQUEST => {
            let request = ParameterRequest::parse(frame)?;
            let name = parameter_name(request.parameter);
            (
                "PARAMREQ",
                format!("{name}, session {:#06x}", request.session),
            )
        }
        id::PARAMETER_SET => {
            let set = ParameterSet::parse(frame)?;
            let name = parameter_name(set.parameter);
            (
                "PARAMSET",
                format!("{name} = {:#x}, session {:#06x}", set.value, set.session),
            )
        }
        id::PARAMETER_RESPONSE => {
            let response = ParameterResponse::parse(frame)?;
            let name = parameter_name(response.parameter);
            let text = match response.code {
                0 => format!("{name} = {:#x}", response.value),
                code => format!("{name}: error {code}"),
            };
            ("PARAMRESP", text)
        }
        _ => return None,
    })
}

/// The two answers to an enumeration share their identifier and differ in length.
fn enumeration(frame: &Frame) -> Option<Named> {
    if let Some(first) = EnumerateResponse0::parse(frame) {
        let (session, product) = (first.session, first.product_id);
        return Some((
            "ENUMRSP0",
            format!("session {session:#06x}, product {product:#010x}"),
        ));
    }
    let second = EnumerateResponse1::parse(frame)?;
    let versions = second.versions;
    let text = format!(
        "session {:#06x}, {}, application {}, bootloader {}",
        second.session,
        image_name(versions.image),
        Version(versions.application),
        Version(versions.bootloader),
    );
    Some(("ENUMRSP1", text))
}

fn vendor_command(command: &VendorCommand) -> String {
    let name = Command::TABLE
        .iter()
        .find(|row| row.0 == command.command)
        .map_or("unknown command", |row| row.1);
    format!(
        "{name} ({}, {}), session {:#06x}",
        command.param1, command.param2, command.session
    )
}

fn parameter_name(code: u8) -> String {
    TABLE
        .iter()
        .find(|row| row.id.code() == code)
        .map_or_else(|| format!("parameter {code}"), |row| row.name.to_owned())
}

/// The printable bytes as they are, the others as dots.
fn text_of(data: &[u8]) -> String {
    let shown = data.iter().map(|byte| match byte {
        b' '..=b'~' => char::from(*byte),
        _ => '.',
    });
    format!("\"{}\"", shown.collect::<String>())
}

#[cfg(test)]
mod tests {
    use windlass_core::dialect::dmc60c::wire::ModeSelect;

    use super::*;

    #[test]
    fn frames_are_told_by_name_number_and_fields() {
        let control_frame = Control0 {
            mode: ModeSelect::Velocity,
            target: -300,
            slot_1: true,
            ..Control0::default()
        };
        assert_eq!(
            of(&control_frame.emit(5)),
            "CANCTRL0 #5: velocity, target -300, slot 1"
        );
        assert_eq!(of(&Frame::extended(id::ENUMERATE, [])), "ENUM");
        let request = ParameterRequest {
            session: 0x1234,
            parameter: TABLE[0].id.code(),
        };
        let text = of(&request.emit(0));
        assert!(text.starts_with("PARAMREQ #0: "), "{text}");
        assert!(
            text.contains(TABLE[0].name) && text.ends_with("0x1234"),
            "{text}"
        );
    }

    #[test]
    fn the_talon_s_frames_are_told_by_the_names_of_its_manual() {
        use windlass_core::dialect::talon_srx::wire::{self as talon, General, ParameterValue};

        let general = General {
            mode: talon::ModeSelect::Duty,
            demand: -512,
            ramp: 5,
            limits: talon::LimitOverride::Forced {
                forward: true,
                reverse: false,
            },
            ..General::default()
        };
        let control = talon::Control1 {
            token: 0,
            general: Some(general),
        };
        let status = talon::Status1 {
            throttle: 511,
            forward_closed: true,
            mode: talon::ModeSelect::Duty,
            faults: talon::LiveFaults {
                forward_limit: true,
                ..Default::default()
            },
            ..Default::default()
        };
        let gain = ParameterValue {
            parameter: 1,
            value: 3 << 21,
        };
        let command = VendorCommand {
            session: 7,
            command: 0x61,
            param1: 0,
            param2: 0,
        };
        let managed = command.emit(3).with_extended_id(0x0204_FC03);
        for (frame, text) in [
            (
                control.emit(3),
                "CONTROL_1 talon #3: duty, demand -512, ramp 5, limits forced forward on reverse off",
            ),
            (control.emit(3).shortened(2), "CONTROL_1 talon #3: enable"),
            (
                status.emit(3),
                "STATUS_1 talon #3: duty, duty 50.0 %, error 0, disabled, forward switch closed, fault Fwd. Limit Switch",
            ),
            (gain.emit_set(62), "PARAM_SET talon #62: Slot0P = 1.5"),
            (
                managed,
                "VENDORCMD talon #3: vcmdGetFwver (0, 0), session 0x0007",
            ),
            (
                talon::GlobalEnable { enabled: true }.emit(),
                "GLOBAL_ENABLE: enabled",
            ),
            (Frame::extended(0, []), "DISABLE: all devices"),
        ] {
            assert_eq!(of(&frame), text);
        }
    }

    #[test]
    fn what_is_in_neither_dialect_has_no_meaning() {
        assert_eq!(of(&Frame::standard(0x123, [1, 2])), "");
        assert_eq!(of(&Frame::extended(0x1234_5678, [])), "");
        assert_eq!(of(&Frame::extended(drive::CONTROL_0 | 5, [0; 7])), "");
    }
}
