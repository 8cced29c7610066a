//! The `windlass` command on Talon-driven devices, from the outside.

use std::process::{Command, Output};

use serde_json::Value;

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

    fn poke(&self, body: &str) {
        use std::io::{Read, Write};
        let mut stream = std::net::TcpStream::connect(&self.http).unwrap();
        write!(
            stream,
            "PATCH /api/sim/nodes/0 HTTP/1.1\r\nHost: bench\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
            body.len()
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
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
