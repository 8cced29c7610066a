//! The `windlass` binary from the outside: exit codes, error form and JSON output.

use std::io::{Read, Write};
use std::process::{Command, Output};

use serde_json::Value;
use windlass_core::frame::Frame;
use windlass_core::management::vendor::ParameterError;
use windlass_core::management::wire::{
    EnumerateResponse0, EnumerateResponse1, FirmwareVersions, ParameterResponse, ParameterSet, id,
};
use windlass_core::slcan;

fn windlass(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_windlass"))
        .args(arguments)
        .env_remove("WINDLASS_TRANSPORT")
        .output()
        .unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Runs a command that must fail with `code`, in both forms, and gives its message.
fn failure(arguments: &[&str], code: i32) -> String {
    let plain = windlass(arguments);
    let text = String::from_utf8(plain.stderr).unwrap();
    assert_eq!(plain.status.code(), Some(code), "{arguments:?}: {text}");
    let lines: Vec<&str> = text.lines().collect();
    let [error, next] = lines.as_slice() else {
        panic!("{arguments:?} wants one error and one next line: {text}");
    };
    let message = error.strip_prefix("error: ").unwrap();
    let next = next.strip_prefix("next: ").unwrap();
    assert!(
        !message.is_empty() && !next.is_empty(),
        "{arguments:?}: {text}"
    );

    let json = windlass(&[&["--json"], arguments].concat());
    assert_eq!(json.status.code(), Some(code), "{arguments:?}");
    let document: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(document["error"]["code"], code, "{arguments:?}");
    assert_eq!(document["error"]["message"], message, "{arguments:?}");
    assert_eq!(document["error"]["next"], next, "{arguments:?}");
    assert!(document["error"]["kind"].is_string());
    message.to_owned()
}

fn document(arguments: &[&str]) -> Value {
    let output = windlass(&[arguments, &["--json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn wrong_usage_ends_with_2() {
    for arguments in [
        &["spin"][..],
        &["scan", "--fast"],
        &["run", "1"],
        &["run", "1", "--duty", "10", "--velocity", "5"],
        &["run", "1", "--duty", "10", "--brake", "--coast"],
        &["run", "1", "--duty", "10", "--slot", "2"],
        &["run", "1", "--duty", "10", "--ramp", "65536"],
        &["run", "1", "--duty", "10", "--seconds", "NaN"],
        &["run", "1", "--duty", "10", "--seconds", "-1"],
        &["run", "1", "--duty", "10", "--seconds", "0"],
        &["run", "64", "--duty", "10"],
        &["monitor", "pump:5"],
        &["info", "1@0"],
        &["id", "set", "1"],
        &["id", "set", "1", "256"],
        &["param"],
        &["param", "set", "1", "10"],
        &["--timeout", "0", "scan"],
        &["--transport", "usb", "scan"],
        &["--transport", "sim:dmc60c:64", "scan"],
        &["--transport", "slcan:/dev/null@9600", "scan"],
        &["--transport", "tcp:localhost", "scan"],
        &["--transport", "tcp:localhost:0", "scan"],
        &["--transport", "socketcan:", "scan"],
    ] {
        failure(arguments, 2);
    }
}

#[test]
fn a_transport_that_cannot_be_opened_ends_with_3() {
    let message = failure(&["--transport", "slcan:/dev/no-such-port", "scan"], 3);
    assert!(message.contains("/dev/no-such-port"), "{message}");
    // A file that is no terminal.
    failure(&["--transport", "slcan:/dev/null", "scan"], 3);
    // No kernel has an interface of this name, and many have no CAN at all.
    let message = failure(&["--transport", "socketcan:nosuchcan", "scan"], 3);
    assert!(message.contains("nosuchcan"), "{message}");
}

#[test]
fn a_port_where_nobody_listens_ends_with_3() {
    // Bound and closed again, so that nobody listens there.
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    drop(listener);
    let bus = format!("tcp:127.0.0.1:{port}");
    let message = failure(&["--transport", &bus, "scan"], 3);
    assert!(message.contains("refused"), "{message}");
}

#[test]
fn a_bus_that_breaks_ends_with_3() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let server = std::thread::spawn(move || drop(listener.accept().unwrap()));
    let output = windlass(&["--transport", &format!("tcp:127.0.0.1:{port}"), "scan"]);
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(3), "{text}");
    assert!(
        text.contains("failed: ") && text.contains("next: check that"),
        "{text}"
    );
    server.join().unwrap();
}

#[test]
fn a_missing_device_ends_with_4() {
    for arguments in [
        &["info", "2"][..],
        &["info", "@0x0001"],
        &["id", "blink", "2"],
        &["param", "get", "2"],
        &["param", "reset", "2"],
        &["run", "2", "--duty", "10"],
        &["monitor", "2"],
        &["faults", "2"],
        &["test", "2"],
    ] {
        let message = failure(arguments, 4);
        assert!(message.contains("there is no device"), "{message}");
    }
    let twins = ["--transport", "sim:dmc60c:5,dmc60c:5", "info", "5"];
    assert!(failure(&twins, 4).contains("2 devices match"));
}

#[test]
fn an_empty_bus_ends_with_4() {
    // A listener that swallows what it gets is a bus without devices.
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let server = std::thread::spawn(move || {
        for _ in 0..2 {
            let (mut stream, _) = listener.accept().unwrap();
            // Ends when the client closes the connection.
            std::io::copy(&mut stream, &mut std::io::sink()).unwrap();
        }
    });
    let message = failure(
        &["--transport", &format!("tcp:127.0.0.1:{port}"), "scan"],
        4,
    );
    assert!(message.contains("no device answered"), "{message}");
    server.join().unwrap();
}

/// A device 1 over TCP that answers enumerations and refuses parameters, and leaves everything else
/// unanswered. Serves `clients` connections, one after the other.
fn stubborn_device(clients: usize) -> (String, std::thread::JoinHandle<()>) {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let bus = format!("tcp:{}", listener.local_addr().unwrap());
    let server = std::thread::spawn(move || {
        for _ in 0..clients {
            let (stream, _) = listener.accept().unwrap();
            stubborn_session(stream);
        }
    });
    (bus, server)
}

fn stubborn_session(mut stream: std::net::TcpStream) {
    let mut channel = slcan::Channel::new();
    let mut bytes = [0; 512];
    loop {
        // An error means as well that the client has gone.
        let count = stream.read(&mut bytes).unwrap_or(0);
        if count == 0 {
            return;
        }
        let asked = bytes[..count]
            .iter()
            .filter_map(|byte| channel.push(*byte)?.transmit);
        for answer in asked.flat_map(|frame| stubborn_answers(&frame)) {
            let _ = stream.write_all(&slcan::format(&answer, None));
        }
    }
}

fn stubborn_answers(frame: &Frame) -> Vec<Frame> {
    let session = 0x1234;
    if frame.raw_id() == id::ENUMERATE {
        let versions = FirmwareVersions::default();
        let product_id = 0x6020_0103;
        return vec![
            EnumerateResponse0 {
                session,
                product_id,
            }
            .emit(1),
            EnumerateResponse1 { session, versions }.emit(1),
        ];
    }
    if frame.raw_id() == id::PARAMETER_SET | 1 {
        let asked = ParameterSet::parse(frame).unwrap();
        let response = ParameterResponse {
            parameter: asked.parameter,
            value: 0,
            code: ParameterError::BadValue as u8,
        };
        return vec![response.emit(1)];
    }
    Vec::new()
}

#[test]
fn a_device_that_does_not_answer_ends_with_5() {
    let commands = [
        &["--timeout", "10", "info", "1"][..],
        &["--timeout", "10", "id", "blink", "1"],
        &["--timeout", "10", "param", "get", "1", "10"],
        &["run", "1", "--duty", "10"],
    ];
    let (bus, server) = stubborn_device(2 * commands.len());
    for command in commands {
        let message = failure(&[&["--transport", &bus], command].concat(), 5);
        assert!(message.contains("device 1"), "{message}");
    }
    server.join().unwrap();
}

#[test]
fn a_device_that_refuses_ends_with_6_and_its_code() {
    let (bus, server) = stubborn_device(2);
    let message = failure(&["--transport", &bus, "param", "set", "1", "10", "1.5"], 6);
    assert!(message.contains("percBadValue"), "{message}");
    server.join().unwrap();
}

#[test]
fn a_factory_reset_tells_what_it_did_and_under_which_number_the_device_is_now() {
    let kept = document(&["param", "reset", "1"]);
    assert_eq!(
        (&kept["reset"], &kept["all"]),
        (&true.into(), &false.into())
    );
    assert!(kept["device"].as_str().unwrap().starts_with("1@"), "{kept}");
    let all = document(&["param", "reset", "1", "--all"]);
    assert!(all["device"].as_str().unwrap().starts_with("0@"), "{all}");
    let plain = windlass(&["param", "reset", "1"]);
    assert!(stdout(&plain).contains("are at their defaults"));
    let information = document(&["info", "1"]);
    assert_eq!(information["devices"][0]["settings"], "saved");
}

#[test]
fn a_failed_test_ends_with_7() {
    // Without its plug the open-circuit test of the header fails.
    let output = windlass(&["test", "1", "--open"]);
    assert_eq!(output.status.code(), Some(7), "{output:?}");
    assert!(stdout(&output).contains("FAIL  J1 open circuits"));
    let output = windlass(&["test", "1", "--open", "--json"]);
    assert_eq!(output.status.code(), Some(7));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["devices"][0]["passed"], false);
}

#[test]
fn values_out_of_range_end_with_6() {
    for arguments in [
        &["param", "get", "1", "paramNothing"][..],
        &["param", "get", "1", "300"],
        &["param", "set", "1", "10", "NaN"],
        &["param", "set", "1", "10", "40000"],
        &["param", "set", "1", "10", "-inf"],
        &["param", "set", "1", "2", "maybe"],
        &["param", "set", "1", "93", "51"],
        &["param", "set", "1", "17", "101%"],
        &["run", "1", "--duty", "101%"],
        &["run", "1", "--duty", "NaN"],
        &["run", "1", "--duty", "fast"],
        &["run", "1", "--current", "128A"],
        &["run", "1", "--voltage", "inf"],
        &["run", "1", "--rpm", "1e12"],
        &["run", "1", "--velocity", "8388608"],
        &["run", "1", "--follow", "64"],
        &["id", "set", "1", "0"],
        &["id", "set", "1", "64"],
        &["id", "set", "1", "--serial", "1234567890123"],
    ] {
        failure(arguments, 6);
    }
}

#[test]
fn help_and_version_end_with_0_and_name_the_exit_codes() {
    let help = windlass(&["--help"]);
    assert_eq!(help.status.code(), Some(0));
    let text = stdout(&help).replace('\n', " ");
    for code in [
        "0 done",
        "1 unexpected",
        "2 wrong usage",
        "3 transport",
        "130 interrupted",
    ] {
        assert!(text.contains(code), "{code}: {text}");
    }
    assert_eq!(windlass(&["--version"]).status.code(), Some(0));
    for verb in [
        "scan", "info", "id", "test", "param", "run", "monitor", "faults", "demo", "sim",
    ] {
        assert_eq!(windlass(&[verb, "--help"]).status.code(), Some(0), "{verb}");
    }
}

#[test]
fn the_environment_names_the_bus() {
    let output = Command::new(env!("CARGO_BIN_EXE_windlass"))
        .args(["scan", "--json"])
        .env("WINDLASS_TRANSPORT", "sim:dmc60c:7,dmc60c:9")
        .output()
        .unwrap();
    let scanned: Value = serde_json::from_slice(&output.stdout).unwrap();
    let numbers: Vec<&Value> = scanned["devices"]
        .as_array()
        .unwrap()
        .iter()
        .map(|device| &device["number"])
        .collect();
    assert_eq!(numbers, [7, 9]);
}

#[test]
fn every_verb_prints_json_that_parses() {
    let scanned = document(&["scan"]);
    assert_eq!(scanned["devices"][0]["number"], 1);
    assert_eq!(scanned["devices"][0]["image"], "application");

    let info = document(&["info", "dmc60c:1"]);
    assert_eq!(info["devices"][0]["manufacturer_name"], "Digilent");
    assert_eq!(info["devices"][0]["reset"]["cause"], "power-on");
    assert_eq!(info["devices"][0]["reset"]["count"], 0);
    assert_eq!(info["devices"][0]["frames_dropped"], 0);

    assert_eq!(document(&["id", "blink", "1"])["blinking_s"], 5);
    let set = document(&["id", "set", "1", "12", "--name", "left drive"]);
    assert_eq!(set["number"], 12);
    assert_eq!(set["device_name"], "left drive");

    let all = document(&["param", "get", "1"]);
    assert_eq!(
        all["parameters"].as_array().unwrap().len(),
        windlass_core::params::table::COUNT
    );
    let gain = document(&["param", "set", "1", "ClosedLoopPGainSlot0", "-1.5"]);
    assert_eq!(
        (&gain["value"], &gain["raw"]),
        (&Value::from(-1.5), &Value::from(0xFFFE_8000_u32))
    );

    let faults = document(&["faults"]);
    assert_eq!(faults["devices"][0]["counts"]["fltOverCurrent"], 0);

    let test = document(&["test"]);
    assert_eq!(test["devices"][0]["passed"], true);
}

#[test]
fn live_verbs_print_one_json_document_for_each_sample() {
    for arguments in [
        &["run", "1", "--duty", "25%", "--seconds", "1", "--json"][..],
        &["monitor", "--bus", "--seconds", "1", "--json"],
    ] {
        let output = windlass(arguments);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let text = stdout(&output);
        let samples: Vec<Value> = text
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert!(samples.len() >= 9, "{arguments:?}: {text}");
        assert!(samples.iter().all(|sample| sample["t_s"].is_f64()));
    }
}

#[test]
fn a_drive_is_shown_and_switched_off() {
    let output = windlass(&["run", "1", "--duty", "50%", "--seconds", "1"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let text = stdout(&output);
    let lines: Vec<&str> = text.lines().collect();
    assert!(
        lines.iter().any(|line| line.contains("duty  +50.0 %")),
        "{text}"
    );
    assert_eq!(lines.last(), Some(&"output off"));
}

/// Starts a drive that would take hours even in virtual time and reads its first line.
#[cfg(unix)]
fn long_drive() -> (std::process::Child, impl Iterator<Item = String>) {
    use std::io::BufRead;
    let mut child = Command::new(env!("CARGO_BIN_EXE_windlass"))
        .args([
            "--transport",
            "sim",
            "run",
            "1",
            "--duty",
            "20%",
            "--seconds",
            "10000000",
        ])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let output = std::io::BufReader::new(child.stdout.take().unwrap());
    let mut lines = output.lines().map(Result::unwrap);
    assert!(lines.next().unwrap().contains("device 1"));
    (child, lines)
}

#[test]
#[cfg(unix)]
fn ctrl_c_switches_the_drive_off_and_ends_with_130() {
    let (mut child, lines) = long_drive();
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert!(sent.success());
    assert_eq!(lines.last().as_deref(), Some("output off"));
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

#[test]
#[cfg(unix)]
fn a_closed_standard_error_changes_no_exit_code() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_windlass"))
        .args(["-t", "sim", "param", "get", "nonsense"])
        .stderr(writer)
        .status()
        .unwrap();
    let code = windlass(&["-t", "sim", "param", "get", "nonsense"])
        .status
        .code();
    assert_eq!(status.code(), code);
    assert_ne!(code, Some(101));
}

#[test]
#[cfg(unix)]
fn a_closed_pipe_ends_the_drive_without_a_panic() {
    let (child, lines) = long_drive();
    drop(lines);
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.starts_with("error: input or output failed"), "{text}");
}
