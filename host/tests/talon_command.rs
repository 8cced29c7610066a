//! The `windlass` command on Talon-driven devices, from the outside.

use std::process::{Command, Output};

use serde_json::Value;
use windlass::image::{Format, Image, parse};
use windlass_core::boot::image::{Hardware, INFO_OFFSET, Identity, InfoBlock, PAGE_SIZE};
use windlass_core::node::PRODUCT_DMC60C;

fn windlass(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_windlass"))
        .args(arguments)
        .env_remove("WINDLASS_TRANSPORT")
        .output()
        .unwrap()
}

fn text(arguments: &[&str], code: i32) -> String {
    let output = windlass(arguments);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(
        output.status.code(),
        Some(code),
        "{arguments:?}: {text}{error}"
    );
    format!("{text}{error}")
}

fn documents(arguments: &[&str], code: i32) -> Vec<Value> {
    let text = text(&[&["--json"], arguments].concat(), code);
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

const MIXED: &str = "--transport=sim:talon:3,dmc60c:3,talon:4";

#[test]
fn scan_lists_both_dialects_once_and_the_same_number_is_no_clash() {
    let documents = documents(&[MIXED, "scan"], 0);
    let devices = documents[0]["devices"].as_array().unwrap();
    let mut seen: Vec<_> = devices
        .iter()
        .map(|device| {
            (
                device["number"].as_u64().unwrap(),
                device["dialect"].as_str().unwrap(),
            )
        })
        .collect();
    seen.sort_unstable();
    assert_eq!(seen, [(3, "dmc60c"), (3, "talon"), (4, "talon")]);
    assert!(
        documents[0]["duplicate_numbers"]
            .as_array()
            .unwrap()
            .is_empty()
    );
    let twice = &self::documents(&["--transport=sim:talon:0,talon:0", "scan"], 0)[0];
    assert_eq!(
        twice["duplicate_numbers"][0], 0,
        "0 is a number like any other for Talons"
    );
}

#[test]
fn row_16_row_17_the_self_test_of_a_talon_is_the_manual_s_report() {
    let report = text(&["--transport=sim:talon:3", "test", "talon:3"], 0);
    assert!(report.starts_with("TALON IS NOT ENABLED!"), "{report}");
    for label in [
        "Mode",
        "Faults",
        "Sticky faults",
        "Fwd. limit switch",
        "Rev. limit switch",
        "Applied throttle",
        "Brake during neutral",
        "Profile slot",
        "Closed-loop error",
        "Selected device",
        "Quadrature encoder",
        "Analog input",
        "Battery",
    ] {
        assert!(report.contains(label), "{label} is missing in\n{report}");
    }
    assert!(
        report.lines().last().unwrap().contains("built 2"),
        "{report}"
    );
    let document = &documents(&["--transport=sim:talon:3", "test"], 0)[0]["devices"][0];
    assert_eq!(
        (&document["enabled"], &document["responding"]),
        (&false.into(), &true.into())
    );
    assert_eq!(document["mode"], "No Drive");
    assert!((document["battery_v"].as_f64().unwrap() - 12.7).abs() < 0.1);
}

#[test]
fn row_77_an_absent_talon_is_not_responding() {
    let report = text(&["--transport=sim:talon:3", "test", "talon:9"], 7);
    assert!(
        report.starts_with("X  Talon SRX (Device ID 9) is not responding"),
        "{report}"
    );
    let document = &documents(&["--transport=sim:dmc60c:9", "test", "talon:9"], 7)[0]["devices"][0];
    assert_eq!(document["responding"], false);
    let message = text(
        &["--transport=sim:talon:3", "run", "talon:9", "--duty", "5"],
        4,
    );
    assert!(message.contains("there is no device talon:9"), "{message}");
}

#[test]
fn test_without_a_name_tests_every_device_by_its_dialect() {
    let document = &documents(&[MIXED, "test"], 0)[0];
    let devices = document["devices"].as_array().unwrap();
    let reports = devices
        .iter()
        .filter(|device| device["report"].is_object())
        .count();
    let checks = devices
        .iter()
        .filter(|device| device["checks"].is_array())
        .count();
    assert_eq!((reports, checks), (2, 1));
}

#[test]
fn run_drives_the_duty_cycle_a_velocity_a_position_and_a_follower() {
    let bus = "--transport=sim:talon:3,talon:4";
    let last = |arguments: &[&str]| {
        let start = &[bus, "run", "talon:3", "--seconds", "0.5"][..];
        documents(&[start, arguments].concat(), 0).pop().unwrap()
    };
    let duty = last(&["--duty", "-50%"]);
    assert!(
        (duty["duty_percent"].as_f64().unwrap() + 50.0).abs() < 0.1,
        "{duty}"
    );
    assert_eq!(
        (&duty["mode"], &duty["enabled"]),
        (&"duty".into(), &true.into())
    );
    assert!(duty["velocity_counts_per_100ms"].as_i64().unwrap() < -1000);
    assert_eq!(last(&["--velocity", "100"])["error"], 100, "no gains yet");
    assert_eq!(last(&["--position", "500"])["mode"], "position");
    assert_eq!(last(&["--follow", "4"])["mode"], "follower");
    let ramped = last(&["--duty", "100%", "--ramp", "5", "--coast"]);
    let percent = ramped["duty_percent"].as_f64().unwrap();
    assert!((22.0..=26.0).contains(&percent), "{percent}");
    assert_eq!(ramped["brake"], false);
}

#[test]
fn run_refuses_what_a_talon_cannot_do() {
    for arguments in [
        &["--current", "5"][..],
        &["--voltage", "6"],
        &["--duty", "5", "--ramp", "256"],
        &["--duty", "5", "--reverse-motor"],
        &["--follow", "63"],
    ] {
        let start = &["--transport=sim:talon:3", "run", "talon:3"][..];
        let message = text(&[start, arguments].concat(), 6);
        assert!(
            message.contains("error: ") && message.contains("next: "),
            "{message}"
        );
    }
}

#[test]
fn row_02_a_talon_is_not_given_the_number_63() {
    let message = text(
        &["--transport=sim:talon:3", "id", "set", "talon:3", "63"],
        6,
    );
    assert!(message.contains("0 to 62"), "{message}");
    text(
        &["--transport=sim:talon:3", "id", "set", "talon:3", "62"],
        0,
    );
    text(
        &["--transport=sim:talon:3", "id", "set", "talon:3", "64"],
        6,
    );
}

#[test]
fn monitor_and_faults_show_talons() {
    let samples = documents(&[MIXED, "monitor", "--bus", "--seconds", "0.3"], 0);
    let talons = samples.iter().filter(|sample| sample["dialect"] == "talon");
    assert!(talons.count() >= 4);
    let bus = samples
        .iter()
        .rfind(|sample| sample["bus_load_percent"].is_number())
        .unwrap();
    for counter in ["bus_off", "tx_full", "receive_errors", "transmit_errors"] {
        assert_eq!(bus[counter], 0, "{counter}");
    }
    let faults = &documents(&[MIXED, "faults", "--clear"], 0)[0]["devices"];
    let talons = faults
        .as_array()
        .unwrap()
        .iter()
        .filter(|device| device["dialect"] == "talon");
    assert_eq!(talons.count(), 2);
}

#[test]
fn parameters_and_strings_are_reached_by_the_dialect_s_name() {
    let set = text(
        &[
            "--transport=sim:talon:3",
            "param",
            "set",
            "talon:3",
            "ThrottlePGainSlot0",
            "0.2",
        ],
        0,
    );
    assert!(set.contains("paramThrottlePGainSlot0"), "{set}");
    text(&["--transport=sim:talon:3", "info", "talon:3"], 0);
    text(&["--transport=sim:talon:3", "info", "dmc60c:3"], 4);
}

/// A bench in a process of its own that ends with the test.
struct Bench {
    process: std::process::Child,
    slcan: String,
    http: String,
}

impl Bench {
    fn start() -> Self {
        use std::io::{BufRead, BufReader};
        let free = "127.0.0.1:0";
        let mut process = Command::new(env!("CARGO_BIN_EXE_windlass"))
            .args(["sim", "--node", "talon:3", "--slcan", free, "--http", free])
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let mut endpoint = |name: &str| {
            let found = lines.by_ref().map(Result::unwrap).find_map(|line| {
                let rest = line.strip_prefix(name)?.trim().to_owned();
                Some(
                    rest.trim_start_matches("http://")
                        .trim_end_matches('/')
                        .to_owned(),
                )
            });
            found.unwrap()
        };
        let (slcan, http) = (endpoint("slcan "), endpoint("http "));
        lines
            .find(|line| line.as_ref().is_ok_and(|line| line == "ready"))
            .unwrap()
            .unwrap();
        Self {
            process,
            slcan,
            http,
        }
    }

    fn request(&self, what: &str, body: &str) -> Value {
        use std::io::{Read, Write};
        let mut stream = std::net::TcpStream::connect(&self.http).unwrap();
        write!(
            stream,
            "{what} HTTP/1.1\r\nHost: bench\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
            body.len()
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        let (_, body) = answer.split_once("\r\n\r\n").unwrap();
        serde_json::from_str(body).unwrap()
    }

    fn poke(&self, body: &str) {
        self.request("PATCH /api/sim/nodes/0", body);
    }

    fn transport(&self) -> String {
        format!("--transport=tcp:{}", self.slcan)
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn row_19_two_quick_commands_clear_sticky_faults() {
    let bench = Bench::start();
    let memory = std::env::temp_dir().join(format!("windlass-test-{}", std::process::id()));
    std::fs::create_dir_all(&memory).unwrap();
    let bus = format!("tcp:{}", bench.slcan);
    let test = || {
        let output = Command::new(env!("CARGO_BIN_EXE_windlass"))
            .args(["--transport", &bus, "--json", "test", "talon:3"])
            .env("XDG_RUNTIME_DIR", &memory)
            .output()
            .unwrap();
        let document: Value = serde_json::from_slice(&output.stdout).unwrap();
        (output.status.code(), document["devices"][0].clone())
    };
    bench.poke(r#"{"battery_v": 6.0}"#);
    let (code, first) = test();
    assert_eq!(
        (code, &first["cleared"]),
        (Some(7), &false.into()),
        "{first}"
    );
    assert_eq!(first["sticky_faults"][0], "Under Vbat");
    bench.poke(r#"{"battery_v": 12.0}"#);
    let (code, second) = test();
    std::fs::remove_dir_all(&memory).unwrap();
    assert_eq!(
        (code, &second["cleared"]),
        (Some(0), &true.into()),
        "{second}"
    );
    assert!(
        second["sticky_faults"].as_array().unwrap().is_empty(),
        "{second}"
    );
}

#[test]
fn a_bench_takes_talons_from_0_to_62_and_refuses_63() {
    let refused = text(&["sim", "--node", "talon:63"], 2);
    assert!(
        refused.contains("'63' is no device number; give 0 to 62"),
        "{refused}"
    );
    let listed = &documents(&["--transport=sim:talon:0,talon:62", "scan"], 0)[0]["devices"];
    assert_eq!(
        (&listed[0]["number"], &listed[1]["number"]),
        (&0.into(), &62.into())
    );
}

#[test]
fn monitor_shows_leds_on_demand() {
    let bus = "--transport=sim:talon:3,dmc60c:3";
    let samples = documents(&[bus, "monitor", "talon:3", "--leds", "--seconds", "2"], 0);
    let colours: Vec<&str> = samples
        .iter()
        .filter_map(|sample| sample["leds"]["ring"][0].as_str())
        .collect();
    assert!(colours.len() >= 15, "{colours:?}");
    // Disabled it blinks orange at 1 Hz, brake on (manual 16.3, 4.1).
    assert!(colours.contains(&"orange") && colours.contains(&"off"));
    assert!(
        colours
            .iter()
            .all(|colour| ["orange", "off"].contains(colour))
    );
    assert_eq!(samples[0]["leds"]["brake"], "red");
    let shown = text(&[bus, "monitor", "--leds", "--seconds", "0.3"], 0);
    for kind in ["talon 3", "device 3"] {
        let line = |line: &&str| line.contains(kind) && line.contains("LEDs o");
        assert!(shown.lines().any(|shown| line(&shown)), "{shown}");
    }
    let silent = documents(&[bus, "monitor", "talon:3", "--seconds", "0.3"], 0);
    assert!(silent.iter().all(|sample| sample["leds"].is_null()));
}

#[test]
fn the_api_shows_leds_and_frames_of_a_talon() {
    let bench = Bench::start();
    documents(&[&bench.transport(), "param", "get", "talon:3", "Leds"], 0);
    let node = bench.request("GET /api/sim/nodes/0", "");
    assert_eq!(node["leds"]["brake"], "red");
    // Disabled it blinks orange; red if the client's last frame is too long ago on a busy machine.
    assert!(["orange", "red", "off"].contains(&node["leds"]["ring"][0].as_str().unwrap()));
    let trace = bench.request("GET /api/sim/trace?since=0&limit=10000&decode=true", "");
    let frames = trace.as_array().unwrap().iter();
    let texts: Vec<&str> = frames.filter_map(|frame| frame["text"].as_str()).collect();
    for start in [
        "ENUMRSP0 talon #3: session",
        "STATUS_1 talon #3: no drive",
        "PARAMRESP talon #3: paramLeds",
    ] {
        let found = texts.iter().any(|text| text.starts_with(start));
        assert!(found, "{start}: {texts:#?}");
    }
}

#[test]
fn row_10_without_firmware_the_tool_shows_the_bootloader_and_255_255() {
    let bench = Bench::start();
    let bus = format!("tcp:{}", bench.slcan).parse::<windlass::transport::Transport>();
    let mut client = windlass::client::Client::new(bus.unwrap().open().unwrap());
    let device = client.find(&"talon:3".parse().unwrap()).unwrap();
    let address = client.enter_bootloader(device.address).unwrap();
    // The first page of an update voids the application.
    let identity = Identity {
        product: PRODUCT_DMC60C,
        hardware: Hardware::F405.id,
        version: 0x0203,
        rollback: 0,
    };
    let mut bytes = vec![0; PAGE_SIZE];
    let info = InfoBlock { identity }.to_bytes();
    bytes[INFO_OFFSET..INFO_OFFSET + info.len()].copy_from_slice(&info);
    let image = Image::packed(parse(Format::Bin, &bytes).unwrap()).unwrap();
    let (number, page) = image.pages().iter().last().unwrap();
    let patience = std::time::Duration::from_secs(10);
    let code = client.write_page(address, number, page, patience).unwrap();
    assert_eq!(code, Some(0));
    drop(client);
    let bus = bench.transport();
    let listed = &documents(&[&bus, "scan"], 0)[0]["devices"][0];
    for (field, value) in [
        ("image", "bootloader"),
        ("application_version", "255.255"),
        ("dialect", "talon"),
    ] {
        assert_eq!(listed[field], value, "{field}");
    }
    let shown = text(&[&bus, "info", "talon:3"], 0);
    assert!(
        shown.contains("bootloader") && shown.contains("255.255"),
        "{shown}"
    );
    text(&[&bus, "id", "set", "talon:3", "7"], 0);
    assert_eq!(bench.request("GET /api/sim/nodes/0", "")["number"], 7);
}
