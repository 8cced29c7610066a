//! The bench as its clients see it: SLCAN over TCP and a pseudo-terminal, and the JSON API. Everything
//! runs in virtual time; what the kernel holds when a step has been answered is all there is, so reads
//! never wait.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};

use serde_json::{Value, json};
use windlass::bench::{BenchError, Config, Pace, Server};

fn paused(nodes: &[&str]) -> Server {
    Server::start(&Config {
        nodes: nodes.iter().map(|node| node.parse().unwrap()).collect(),
        pace: Pace::Paused,
        ..Config::default()
    })
    .unwrap()
}

/// One request on a connection of its own: status code and body.
fn http(server: &Server, method: &str, path: &str, body: &str) -> (u16, Value) {
    let mut stream = TcpStream::connect(server.http()).unwrap();
    let length = body.len();
    write!(
        stream,
        "{method} {path} HTTP/1.1\r\nHost: bench\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n{body}"
    )
    .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    let body = serde_json::from_str(body).unwrap_or(Value::String(body.to_owned()));
    (status, body)
}

fn get(server: &Server, path: &str) -> Value {
    let (status, body) = http(server, "GET", path, "");
    assert_eq!(status, 200, "{path}: {body}");
    body
}

fn post(server: &Server, path: &str, body: &Value) -> Value {
    let (status, answer) = http(server, "POST", path, &body.to_string());
    assert_eq!(status, 200, "{path} {body}: {answer}");
    answer
}

fn step(server: &Server, us: u64) {
    post(server, "/api/sim/step", &json!({ "us": us }));
}

struct Slcan(TcpStream);

impl Slcan {
    fn connect(address: SocketAddr) -> Self {
        Self(TcpStream::connect(address).unwrap())
    }

    fn send(&mut self, text: &str) {
        self.0.set_nonblocking(false).unwrap();
        self.0.write_all(text.as_bytes()).unwrap();
    }

    /// Everything that is there now.
    fn take(&mut self) -> String {
        self.0.set_nonblocking(true).unwrap();
        let mut bytes = Vec::new();
        match self.0.read_to_end(&mut bytes) {
            Ok(_) => {}
            Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock),
        }
        String::from_utf8(bytes).unwrap()
    }
}

#[test]
fn clients_see_each_others_frames_when_the_step_is_answered() {
    let server = paused(&[]);
    let mut first = Slcan::connect(server.slcan());
    let mut second = Slcan::connect(server.slcan());
    for round in 0..50_u8 {
        first.send(&format!("t1231{round:02X}\r"));
        second.send(&format!("T123456781{round:02X}\r"));
        step(&server, 500);
        assert_eq!(first.take(), format!("T123456781{round:02X}\r"));
        assert_eq!(second.take(), format!("t1231{round:02X}\r"));
    }
    assert_eq!(get(&server, "/api/sim")["t_us"], 25_000);
}

#[test]
fn lines_that_were_written_one_by_one_are_all_taken_by_the_next_step() {
    // With Nagle's algorithm on, as in a plain socket, the second line waits for an acknowledgement.
    let server = paused(&[]);
    let mut sender = Slcan::connect(server.slcan());
    let mut receiver = Slcan::connect(server.slcan());
    for _round in 0..20 {
        for line in ["t1", "0", "01AA\r", "t1011BB\r", "V\r"] {
            sender.send(line);
        }
        step(&server, 1000);
        assert_eq!(receiver.take(), "t1001AA\rt1011BB\r");
        assert_eq!(sender.take(), "V0101\r");
    }
}

#[test]
fn frames_of_a_client_that_left_still_reach_the_bus() {
    let server = paused(&[]);
    let mut receiver = Slcan::connect(server.slcan());
    let mut sender = Slcan::connect(server.slcan());
    sender.send("t1230\r");
    drop(sender);
    step(&server, 1000);
    assert_eq!(receiver.take(), "t1230\r");
    assert_eq!(
        get(&server, "/api/sim")["clients"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
}

#[test]
fn a_closed_channel_neither_sends_nor_receives() {
    let server = paused(&[]);
    let mut closed = Slcan::connect(server.slcan());
    let mut listening = Slcan::connect(server.slcan());
    closed.send("C\rt1000\r");
    listening.send("C\rL\rt1000\r");
    post(
        &server,
        "/api/sim/frames",
        &json!({ "id": 0x321, "data": "0A" }),
    );
    step(&server, 1000);
    assert_eq!(closed.take(), "\r\x07");
    assert_eq!(listening.take(), "\r\r\x07t32110A\r");
}

#[test]
fn http_is_one_more_participant() {
    let server = paused(&[]);
    let mut client = Slcan::connect(server.slcan());
    let extended = json!({ "id": 0x0206_F000, "ext": true, "data": "0102030405060708" });
    post(&server, "/api/sim/frames", &extended);
    let remote = json!({ "id": 0x7FF, "ext": false, "rtr": true, "dlc": 3 });
    post(&server, "/api/sim/frames", &remote);
    client.send("t0010\r");
    step(&server, 2000);
    assert_eq!(client.take(), "T0206F00080102030405060708\rr7FF3\r");

    let trace = get(&server, "/api/sim/trace");
    let trace = trace.as_array().unwrap();
    assert_eq!(trace.len(), 3);
    let found = trace.iter().find(|entry| entry["ext"] == true).unwrap();
    assert_eq!(found["id"], 0x0206_F000);
    assert_eq!(found["data"], "0102030405060708");
    assert_eq!(found["dlc"], 8);
    assert_eq!(found["rtr"], false);
    assert_eq!(found["from"], "http");
    let remote = trace.iter().find(|entry| entry["rtr"] == true).unwrap();
    assert_eq!((&remote["dlc"], &remote["data"]), (&json!(3), &json!("")));
}

#[test]
fn the_trace_is_read_in_pages() {
    let server = paused(&[]);
    let mut client = Slcan::connect(server.slcan());
    let _other = Slcan::connect(server.slcan());
    for index in 0..10 {
        client.send(&format!("t1001{index:02X}\r"));
    }
    step(&server, 10_000);
    let mut seen = Vec::new();
    let mut since = 0;
    loop {
        let page = get(&server, &format!("/api/sim/trace?since={since}&limit=3"));
        let page = page.as_array().unwrap();
        assert!(page.len() <= 3);
        let Some(last) = page.last() else { break };
        since = last["seq"].as_u64().unwrap() + 1;
        seen.extend(page.iter().map(|entry| entry["data"].clone()));
    }
    let expected: Vec<Value> = (0..10).map(|index| json!(format!("{index:02x}"))).collect();
    assert_eq!(seen, expected);
    assert_eq!(get(&server, "/api/sim")["trace_end"], since);
}

#[test]
fn bad_requests_are_refused_by_name() {
    let server = paused(&["dmc60c:1"]);
    for (method, path, body, status, names) in [
        ("POST", "/api/sim/step", "{", 400, "no JSON"),
        ("POST", "/api/sim/step", "[]", 400, "an array"),
        ("POST", "/api/sim/step", "{}", 400, "\"us\" is missing"),
        ("POST", "/api/sim/step", r#"{"us":-1}"#, 400, "\"us\""),
        ("POST", "/api/sim/step", r#"{"us":1.5}"#, 400, "\"us\""),
        ("POST", "/api/sim/step", r#"{"us":"1"}"#, 400, "\"us\""),
        (
            "POST",
            "/api/sim/step",
            r#"{"us":3600000001}"#,
            400,
            "\"us\"",
        ),
        ("POST", "/api/sim/step", r#"{"us":1,"s":1}"#, 400, "\"s\""),
        ("POST", "/api/sim/frames", r#"{"data":""}"#, 400, "\"id\""),
        ("POST", "/api/sim/frames", r#"{"id":2048}"#, 400, "\"id\""),
        (
            "POST",
            "/api/sim/frames",
            r#"{"id":1,"ext":1}"#,
            400,
            "\"ext\"",
        ),
        (
            "POST",
            "/api/sim/frames",
            r#"{"id":1,"data":"0"}"#,
            400,
            "\"data\"",
        ),
        (
            "POST",
            "/api/sim/frames",
            r#"{"id":1,"data":"zz"}"#,
            400,
            "\"data\"",
        ),
        (
            "POST",
            "/api/sim/frames",
            r#"{"id":1,"data":"000000000000000000"}"#,
            400,
            "\"data\"",
        ),
        (
            "POST",
            "/api/sim/frames",
            r#"{"id":1,"rtr":true,"data":"00"}"#,
            400,
            "\"data\"",
        ),
        (
            "POST",
            "/api/sim/frames",
            r#"{"id":1,"dlc":2,"data":"00"}"#,
            400,
            "\"dlc\"",
        ),
        (
            "POST",
            "/api/sim/frames",
            r#"{"id":1,"mode":"fd"}"#,
            400,
            "\"mode\"",
        ),
        ("GET", "/api/sim/trace?since=x", "", 400, "\"since\""),
        ("GET", "/api/sim/trace?limit=0", "", 400, "\"limit\""),
        ("GET", "/api/sim/trace?limit=100001", "", 400, "\"limit\""),
        ("GET", "/api/sim/trace?from=1", "", 400, "\"from\""),
        ("GET", "/api/sim/nodes/1", "", 404, "no node 1"),
        ("GET", "/api/sim/nodes/-1", "", 404, "no node -1"),
        ("PATCH", "/api/sim/nodes/one", "{}", 404, "no node one"),
        ("POST", "/api/sim/nodes/9/power-cycle", "", 404, "no node 9"),
        ("DELETE", "/api/sim/nodes/0", "", 405, "method"),
        ("GET", "/api/other", "", 404, "no such resource"),
    ] {
        let (code, answer) = http(&server, method, path, body);
        let message = answer["error"].as_str().unwrap_or_default();
        assert_eq!(code, status, "{method} {path} {body}: {answer}");
        assert!(message.contains(names), "{method} {path} {body}: {message}");
    }
    step(&server, 1000);
    assert_eq!(
        get(&server, "/api/sim/trace"),
        json!([]),
        "nothing was sent"
    );
    assert_eq!(
        get(&server, "/api/sim")["t_us"],
        1000,
        "nothing was stepped"
    );
}

#[test]
fn a_bench_in_real_time_is_not_stepped() {
    let server = Server::start(&Config::default()).unwrap();
    let (status, answer) = http(&server, "POST", "/api/sim/step", r#"{"us":1}"#);
    assert_eq!(status, 409);
    let message = answer["error"].as_str().unwrap();
    assert!(message.contains("--paused"), "{message}");
    assert!(matches!(server.step(1), Err(BenchError::NotPaused)));
    assert_eq!(get(&server, "/api/sim")["paused"], false);
}

#[test]
fn a_port_in_use_is_named() {
    let first = paused(&[]);
    let config = Config {
        slcan: first.slcan(),
        ..Config::default()
    };
    let error = Server::start(&config).unwrap_err();
    assert!(error.to_string().contains(&first.slcan().to_string()));
    assert!(error.next_step().contains("--slcan 127.0.0.1:0"));
}

#[test]
fn stopping_closes_every_connection() {
    let server = paused(&[]);
    let mut client = Slcan::connect(server.slcan());
    client.send("V\r");
    step(&server, 0);
    let address = server.slcan();
    server.stop().unwrap();
    let mut rest = Vec::new();
    client.0.read_to_end(&mut rest).unwrap();
    assert_eq!(rest, b"V0101\r");
    assert!(TcpStream::connect(address).is_err());
}

#[test]
fn the_page_needs_nothing_from_elsewhere() {
    let server = paused(&[]);
    for path in ["/", "/style.css", "/bench.js"] {
        let Value::String(text) = get(&server, path) else {
            panic!("{path} is JSON");
        };
        assert!(
            !text.contains("//cdn") && !text.contains("https:"),
            "{path}"
        );
    }
}

#[cfg(target_os = "linux")]
mod pty {
    use std::fs::{File, OpenOptions};

    use super::*;

    fn open(server: &Server) -> File {
        let path = server.pty().unwrap();
        OpenOptions::new()
            .read(true)
            .write(true)
            .open(path)
            .unwrap()
    }

    fn with_pty() -> Server {
        Server::start(&Config {
            pace: Pace::Paused,
            pty: true,
            ..Config::default()
        })
        .unwrap()
    }

    fn read(file: &mut File, length: usize) -> String {
        let mut bytes = vec![0; length];
        file.read_exact(&mut bytes).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_program_on_the_pty_is_a_participant_while_it_has_it_open() {
        let server = with_pty();
        let mut tcp = Slcan::connect(server.slcan());
        step(&server, 0);
        assert_eq!(
            get(&server, "/api/sim")["clients"]
                .as_array()
                .unwrap()
                .len(),
            1
        );
        for _round in 0..3 {
            let mut pty = open(&server);
            pty.write_all(b"t1231AB\rV\r").unwrap();
            tcp.send("t3211CD\r");
            step(&server, 1000);
            assert_eq!(tcp.take(), "t1231AB\r");
            assert_eq!(read(&mut pty, 14), "V0101\rt3211CD\r");
            assert_eq!(
                get(&server, "/api/sim")["clients"]
                    .as_array()
                    .unwrap()
                    .len(),
                2
            );
            drop(pty);
            step(&server, 0);
            assert_eq!(
                get(&server, "/api/sim")["clients"]
                    .as_array()
                    .unwrap()
                    .len(),
                1
            );
        }
    }

    #[test]
    fn the_next_program_does_not_read_what_the_last_one_left() {
        let server = with_pty();
        let mut tcp = Slcan::connect(server.slcan());
        let pty = open(&server);
        tcp.send("t1000\r");
        step(&server, 1000);
        drop(pty);
        step(&server, 1000);
        let mut pty = open(&server);
        tcp.send("t2000\r");
        step(&server, 1000);
        assert_eq!(read(&mut pty, 6), "t2000\r");
    }
}
