//! `windlass sim` and `windlass demo` as processes: what they print and how they end.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::process::{Child, Command, Stdio};

fn windlass(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_windlass"));
    command.args(arguments).env_remove("WINDLASS_TRANSPORT");
    command
}

/// Exit code, and the error and next lines.
fn refusal(arguments: &[&str]) -> (Option<i32>, String) {
    let output = windlass(arguments).output().unwrap();
    assert!(output.stdout.is_empty(), "{arguments:?}: {output:?}");
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(text.contains("\nnext: "), "{arguments:?}: {text}");
    (output.status.code(), text)
}

/// Starts a bench and reads what it says until it is ready.
fn start(arguments: &[&str]) -> (Child, Vec<String>) {
    let mut child = windlass(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut said = Vec::new();
    for line in lines {
        let line = line.unwrap();
        let ready = line == "ready";
        said.push(line);
        if ready {
            break;
        }
    }
    (child, said)
}

#[test]
fn wrong_arguments_end_with_2_and_say_what_is_allowed() {
    for (arguments, names) in [
        (&["--node", "pump:1"][..], "dmc60c"),
        (&["--node", "dmc60c:64"], "63"),
        (&["--speed", "0"], "0.001 to 1000"),
        (&["--speed", "fast"], "0.001 to 1000"),
        (&["--speed", "2", "--paused"], "--paused"),
        (&["--loss", "1.5"], "0 to 1"),
        (&["--seed", "one"], "--seed"),
        (&["--slcan", "127.0.0.1"], "HOST:PORT"),
        (&["--http", "127.0.0.1:70000"], "HOST:PORT"),
    ] {
        let (code, text) = refusal(&[&["sim"], arguments].concat());
        assert_eq!(code, Some(2), "{arguments:?}: {text}");
        assert!(text.contains(names), "{arguments:?}: {text}");
    }
    let (code, text) = refusal(&["demo", "--seconds", "0"]);
    assert_eq!(code, Some(2), "{text}");
}

#[test]
fn a_port_in_use_ends_with_3_and_names_a_way_out() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for option in ["--slcan", "--http"] {
        let (code, text) = refusal(&["sim", option, &address]);
        assert_eq!(code, Some(3), "{text}");
        assert!(text.contains(&address), "{text}");
        assert!(text.contains(&format!("{option} 127.0.0.1:0")), "{text}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn the_endpoints_are_printed_and_a_signal_ends_it_cleanly() {
    use std::net::TcpStream;

    for signal in ["-INT", "-TERM"] {
        let (mut child, said) = start(&["sim", "--paused", "--pty"]);
        let [slcan, http, pty, ready] = said.as_slice() else {
            panic!("{said:?}");
        };
        assert_eq!(ready, "ready");
        assert!(pty.starts_with("pty /dev/pts/"), "{pty}");
        let slcan = slcan.strip_prefix("slcan ").unwrap();
        let http = http.strip_prefix("http http://").unwrap();
        let http = http.strip_suffix('/').unwrap();
        let _client = TcpStream::connect(slcan).unwrap();
        let _browser = TcpStream::connect(http).unwrap();

        let id = child.id().to_string();
        let sent = Command::new("kill").args([signal, &id]).status().unwrap();
        assert!(sent.success());
        assert_eq!(child.wait().unwrap().code(), Some(0), "{signal}");
    }
}
