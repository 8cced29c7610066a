//! `windlass flash` from the outside, over TCP.

mod fake;

use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

use fake::Device;
use serde_json::Value;
use windlass::image::{Format, Image, parse};
use windlass_core::boot::image::{Hardware, INFO_OFFSET, Identity, InfoBlock, PAGE_SIZE};
use windlass_core::frc_id;
use windlass_core::management::vendor::CommandCode;
use windlass_core::management::wire::id;
use windlass_core::node::PRODUCT_DMC60C;
use windlass_core::slcan;

const IDENTITY: Identity = Identity {
    product: PRODUCT_DMC60C,
    hardware: Hardware::F405.id,
    version: 0x0119,
    rollback: 0,
};

/// A file in the folder of the tests; `raw` as a linker makes it, else sealed.
fn file(name: &str, identity: Identity, raw: bool) -> String {
    let mut bytes = vec![0x3C; 3 * PAGE_SIZE];
    let info = InfoBlock { identity }.to_bytes();
    bytes[INFO_OFFSET..INFO_OFFSET + info.len()].copy_from_slice(&info);
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if !raw {
        let image = Image::packed(parse(Format::Bin, &bytes).unwrap()).unwrap();
        bytes = image.write(Format::of_name(&path).unwrap()).unwrap();
    }
    fs::write(&path, bytes).unwrap();
    path.to_str().unwrap().to_owned()
}

fn windlass(bus: &str, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_windlass"))
        .args(["--transport", bus])
        .args(arguments)
        .output()
        .unwrap()
}

/// What happens to the first connection after so many data frames.
enum Mishap {
    /// It is closed.
    Cut(usize),
    /// Nothing reaches the devices any more, and the test is told.
    Silence(usize, Sender<()>),
}

/// Devices behind an SLCAN server for as many connections.
fn serve(
    mut devices: Vec<Device>,
    connections: usize,
    mut mishap: Option<Mishap>,
) -> (String, JoinHandle<Vec<Device>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let bus = format!("tcp:{}", listener.local_addr().unwrap());
    let server = std::thread::spawn(move || {
        for _ in 0..connections {
            let (stream, _) = listener.accept().unwrap();
            session(stream, &mut devices, mishap.take());
        }
        devices
    });
    (bus, server)
}

fn session(mut stream: TcpStream, devices: &mut [Device], mishap: Option<Mishap>) {
    let mut channel = slcan::Channel::new();
    let mut bytes = [0; 4096];
    let mut data_frames = 0;
    loop {
        // An error means as well that the client has gone.
        let count = stream.read(&mut bytes).unwrap_or(0);
        if count == 0 {
            return;
        }
        for byte in &bytes[..count] {
            let Some(frame) = channel.push(*byte).and_then(|answer| answer.transmit) else {
                continue;
            };
            let identifier = frame.extended_id().unwrap_or(0);
            data_frames += usize::from(frc_id::base(identifier) == id::VENDOR_DATA_OUT);
            match &mishap {
                Some(Mishap::Cut(limit)) if data_frames > *limit => return,
                Some(Mishap::Silence(limit, told)) if data_frames > *limit => {
                    let _ = told.send(());
                    continue;
                }
                _ => {}
            }
            for device in devices.iter_mut() {
                for (_, answer) in device.on_frame(&frame) {
                    let _ = stream.write_all(&slcan::format(&answer, None));
                }
            }
        }
    }
}

fn errors(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn fails(output: &Output, code: i32, part: &str) {
    let text = errors(output);
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(
        text.starts_with("error: ") && text.contains("\nnext: "),
        "{text}"
    );
    assert!(text.contains(part), "{part}: {text}");
}

#[test]
fn an_update_is_shown_phase_by_phase() {
    let (bus, server) = serve(vec![Device::new(5, 0x1234)], 1, None);
    let output = windlass(&bus, &["flash", &file("shown.wlimg", IDENTITY, false)]);
    assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
    let text = text(&output);
    let mut lines = text.lines();
    for phase in [
        "look", "enter", "erase", "write", "verify", "restart", "confirm",
    ] {
        assert_eq!(
            lines.next(),
            Some(format!("5@0x1234  {phase}").as_str()),
            "{text}"
        );
    }
    let last = lines.next().unwrap();
    assert!(
        last.starts_with("device 5@0x1234: version 1.25 runs (before: 1.23, 4 of 4 pages sent"),
        "{text}"
    );
    assert_eq!(server.join().unwrap()[0].version, 0x0119);
}

#[test]
fn several_devices_are_updated_one_after_the_other() {
    let devices = vec![
        Device::new(5, 0x1234),
        Device::new(6, 0x2345),
        Device::new(7, 0x3456),
    ];
    let (bus, server) = serve(devices, 2, None);
    let file = file("several.crf", IDENTITY, false);
    let output = windlass(&bus, &["--json", "flash", &file, "5", "@0x2345"]);
    assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let list = document["devices"].as_array().unwrap();
    assert_eq!(list.len(), 2);
    for (device, name) in list.iter().zip(["5@0x1234", "6@0x2345"]) {
        assert_eq!(
            (&device["device"], &device["version"]),
            (&name.into(), &"1.25".into())
        );
        assert_eq!(
            (&device["sent"], &device["before"]),
            (&4.into(), &"1.23".into())
        );
    }
    let output = windlass(&bus, &["--json", "flash", &file, "--all"]);
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let sent: Vec<&Value> = document["devices"]
        .as_array()
        .unwrap()
        .iter()
        .map(|device| &device["sent"])
        .collect();
    assert_eq!(sent, [0, 0, 4]);
    let devices = server.join().unwrap();
    assert!(devices.iter().all(|device| device.version == 0x0119));
}

#[test]
fn one_device_that_fails_does_not_stop_the_others() {
    let mut first = Device::new(5, 0x1234);
    first.refusals.push_back(CommandCode::BadSignature);
    let (bus, server) = serve(vec![first, Device::new(6, 0x2345)], 1, None);
    let file = file("some.wlimg", IDENTITY, false);
    let output = windlass(&bus, &["--json", "flash", &file, "5", "6"]);
    assert_eq!(output.status.code(), Some(6), "{}", errors(&output));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document["error"]["kind"], "refused");
    assert_eq!(document["devices"][0]["error"]["code"], 6);
    assert_eq!(document["devices"][1]["version"], "1.25");
    server.join().unwrap();
}

#[test]
fn a_connection_that_breaks_is_opened_again_and_the_update_goes_on() {
    // In the middle of the second page.
    let (bus, server) = serve(vec![Device::new(5, 0x1234)], 2, Some(Mishap::Cut(700)));
    let output = windlass(
        &bus,
        &["flash", &file("broken.wlimg", IDENTITY, false), "5"],
    );
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}{}",
        text(&output),
        errors(&output)
    );
    let devices = server.join().unwrap();
    assert_eq!(devices[0].written, [30, 2, 1, 0]);
    assert_eq!(devices[0].version, 0x0119);
}

#[test]
fn the_fallback_is_put_back_on_demand() {
    let mut device = Device::new(5, 0x1234);
    device.fallback = 0x0105;
    let (bus, server) = serve(vec![device], 2, None);
    let output = windlass(&bus, &["flash", "--rollback", "5"]);
    assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
    assert!(
        text(&output).contains("version 1.5 runs"),
        "{}",
        text(&output)
    );
    let output = windlass(&bus, &["--json", "flash", "--rollback"]);
    assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
    assert_eq!(server.join().unwrap()[0].version, 0x0105);
}

#[test]
fn what_does_not_fit_is_refused_with_its_exit_code() {
    let (bus, server) = serve(
        vec![Device::new(5, 0x1234), Device::new(6, 0x2345)],
        7,
        None,
    );
    let good = file("fits.hex", IDENTITY, false);
    let other = Identity {
        hardware: Hardware::G474.id,
        ..IDENTITY
    };
    fails(
        &windlass(&bus, &["flash", &file("other.bin", other, false), "5"]),
        8,
        "stm32g474",
    );
    fails(&windlass(&bus, &["flash", &good]), 4, "2 devices");
    fails(&windlass(&bus, &["flash", &good, "9"]), 4, "no device 9");
    fails(
        &windlass(&bus, &["flash", &good, "5", "@0x1234"]),
        2,
        "named twice",
    );
    fails(
        &windlass(&bus, &["flash", "--rollback", "5"]),
        6,
        "no fallback",
    );
    let raw = file("linked.bin", IDENTITY, true);
    let packed = windlass(&bus, &["flash", &raw, "--pack", "5"]);
    assert_eq!(packed.status.code(), Some(0), "{}", errors(&packed));
    // Nothing is sent to the first if the second is something else.
    let mixed = windlass(&bus, &["flash", &file("mixed.bin", other, false), "--all"]);
    fails(&mixed, 8, "stm32g474");
    let devices = server.join().unwrap();
    assert_eq!(devices[1].changes, 0);

    // No connection is made for these.
    fails(&windlass(&bus, &["flash", &raw, "5"]), 8, "no seal");
    fails(
        &windlass(&bus, &["flash", "no-such-file.hex"]),
        8,
        "no-such-file",
    );
    fails(&windlass(&bus, &["flash", &good, "motor"]), 2, "motor");
    fails(&windlass(&bus, &["flash", &good, "5", "--all"]), 2, "--all");
    fails(&windlass(&bus, &["flash"]), 2, "");
    fails(
        &windlass(&bus, &["flash", "--rollback", "--force", "5"]),
        2,
        "",
    );
}

#[test]
fn a_key_is_installed_only_on_purpose() {
    let (bus, server) = serve(vec![Device::new(5, 0x1234)], 1, None);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let name = folder.join("flash-maker");
    for extension in ["key", "pub"] {
        let _ = fs::remove_file(name.with_extension(extension));
    }
    let made = windlass(&bus, &["image", "keygen", name.to_str().unwrap()]);
    assert_eq!(made.status.code(), Some(0), "{}", errors(&made));
    let public = name.with_extension("pub");
    let install = ["image", "install-key", "5", public.to_str().unwrap()];
    fails(&windlass(&bus, &install), 2, "--permanently");
    let output = windlass(&bus, &[&install[..], &["--permanently"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
    let device = server.join().unwrap().remove(0);
    assert_eq!(device.order.len(), 32);
    assert!(!device.in_bootloader);
}

#[test]
#[cfg(unix)]
fn ctrl_c_ends_with_130_and_tells_how_to_go_on() {
    let (told, signal) = channel();
    let mishap = Mishap::Silence(700, told);
    let (bus, server) = serve(vec![Device::new(5, 0x1234)], 2, Some(mishap));
    let file = file("interrupted.wlimg", IDENTITY, false);
    let child = Command::new(env!("CARGO_BIN_EXE_windlass"))
        .args(["--transport", &bus, "flash", &file, "5"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    signal.recv().unwrap();
    let id = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &id])
            .status()
            .unwrap()
            .success()
    );
    let output = child.wait_with_output().unwrap();
    fails(&output, 130, "same command again");
    let output = windlass(&bus, &["flash", &file, "5"]);
    assert_eq!(output.status.code(), Some(0), "{}", errors(&output));
    assert!(
        text(&output).contains("3 of 4 pages sent"),
        "{}",
        text(&output)
    );
    assert_eq!(server.join().unwrap()[0].written, [30, 2, 1, 0]);
}
