//! `windlass sim`: the virtual bench for other programs.

use std::net::{SocketAddr, ToSocketAddrs};
use std::time::Duration;

use serde_json::json;
use windlass_sim::{NodeSpec, WorldConfig};

use super::output::say;
use super::{Failure, Global, Kind, Outcome, interrupted};
use crate::bench::{BenchError, Config, Pace, Server};
use crate::remark::remark;

/// How often the command looks whether it is to end.
const LOOK: Duration = Duration::from_millis(50);

/// Arguments of `windlass sim`.
#[derive(Clone, Debug, clap::Args)]
pub struct Arguments {
    /// A controller on the bus, DIALECT:NUMBER; several make several controllers, also with the same
    /// number, and 0 is one that has no number yet.
    #[arg(
        long = "node",
        value_name = "DIALECT:NUMBER",
        default_value = "dmc60c:1"
    )]
    pub nodes: Vec<NodeSpec>,
    /// Where SLCAN clients connect by TCP; port 0 takes a free port.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:0", value_parser = address)]
    pub slcan: SocketAddr,
    /// Where the JSON API and the web page are; port 0 takes a free port.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:0", value_parser = address)]
    pub http: SocketAddr,
    /// Also serve SLCAN on a pseudo-terminal.
    #[arg(long)]
    pub pty: bool,
    /// Virtual seconds in one second, 0.001 to 1000.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed)]
    pub speed: f64,
    /// Let virtual time pass only by POST /api/sim/step.
    #[arg(long, conflicts_with = "speed")]
    pub paused: bool,
    /// Seed of everything random: the same seed and the same traffic give the same bits.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Probability that a frame is lost for one receiver, 0 to 1.
    #[arg(long, value_name = "PROBABILITY", default_value_t = 0.0, value_parser = probability)]
    pub loss: f64,
    /// Probability that a frame is destroyed by an error frame and sent again, 0 to 1.
    #[arg(long, value_name = "PROBABILITY", default_value_t = 0.0, value_parser = probability)]
    pub corruption: f64,
    /// Answer frames from SLCAN clients with z or Z, for programs that wait for it.
    #[arg(long)]
    pub slcan_replies: bool,
}

fn address(text: &str) -> Result<SocketAddr, String> {
    let hint = "write HOST:PORT, for example 127.0.0.1:0 for a free port of this machine";
    text.to_socket_addrs()
        .map_err(|error| format!("{error}; {hint}"))?
        .next()
        .ok_or_else(|| format!("no such host; {hint}"))
}

fn speed(text: &str) -> Result<f64, String> {
    number(text, 0.001, 1000.0)
}

fn probability(text: &str) -> Result<f64, String> {
    number(text, 0.0, 1.0)
}

fn number(text: &str, low: f64, high: f64) -> Result<f64, String> {
    match text.parse() {
        Ok(number) if (low..=high).contains(&number) => Ok(number),
        Ok(number) => Err(format!("{number} is outside {low} to {high}")),
        Err(_) => Err(format!("not a number from {low} to {high}")),
    }
}

impl Arguments {
    fn config(&self) -> Config {
        Config {
            world: WorldConfig {
                seed: self.seed,
                loss: self.loss,
                corruption: self.corruption,
                ..WorldConfig::default()
            },
            nodes: self.nodes.clone(),
            pace: if self.paused {
                Pace::Paused
            } else {
                Pace::RealTime(self.speed)
            },
            slcan: self.slcan,
            http: self.http,
            pty: self.pty,
            frame_replies: self.slcan_replies,
            log: true,
        }
    }
}

impl From<BenchError> for Failure {
    fn from(error: BenchError) -> Self {
        let kind = match error {
            BenchError::Listen { .. } | BenchError::Pty(_) => Kind::Bus,
            _ => Kind::Unexpected,
        };
        Self::new(kind, error.to_string(), error.next_step())
    }
}

/// Runs the bench until Ctrl-C.
///
/// # Errors
/// An endpoint cannot be opened, standard output is closed, or a thread of the bench has panicked.
pub fn run(arguments: &Arguments, global: &Global) -> Result<Outcome, Failure> {
    let server = Server::start(&arguments.config())?;
    for address in [server.slcan(), server.http()] {
        if !address.ip().is_loopback() {
            remark(format_args!(
                "bench: {address} can be reached from other machines; nothing there asks who they are"
            ));
        }
    }
    announce(&server, global.json)?;
    while !interrupted() && server.is_running() {
        std::thread::sleep(LOOK);
    }
    server.stop()?;
    Ok(Outcome::Done)
}

/// Says where the endpoints are; the last line tells that they can be used.
fn announce(server: &Server, as_json: bool) -> Result<(), Failure> {
    let (slcan, http) = (server.slcan(), server.http());
    let pty = server.pty().map(|path| path.display().to_string());
    if as_json {
        let http = format!("http://{http}/");
        let endpoints = json!({ "slcan": slcan, "http": http, "pty": pty, "ready": true });
        return say!("{endpoints}");
    }
    say!("slcan {slcan}")?;
    say!("http http://{http}/")?;
    if let Some(pty) = pty {
        say!("pty {pty}")?;
    }
    say!("ready")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_need_host_and_port() {
        assert_eq!(address("127.0.0.1:80").unwrap().port(), 80);
        assert!(address("[::1]:0").unwrap().is_ipv6());
        for bad in ["127.0.0.1", "8080", ":", "127.0.0.1:65536"] {
            let error = address(bad).unwrap_err();
            assert!(error.contains("write HOST:PORT"), "{bad}: {error}");
        }
    }

    #[test]
    fn numbers_are_checked_against_their_range() {
        assert_eq!(speed("20"), Ok(20.0));
        assert_eq!(probability("0.01"), Ok(0.01));
        for bad in ["0", "-1", "1001", "inf", "NaN", "fast", ""] {
            assert!(speed(bad).is_err(), "{bad}");
        }
        for bad in ["-0.1", "1.1", "nan"] {
            assert!(probability(bad).is_err(), "{bad}");
        }
    }
}
