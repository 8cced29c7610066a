//! Host side of Windlass: the virtual bench, transports to real and simulated buses, and the client
//! library behind the `windlass` command.

pub mod bench;
pub mod cli;
pub mod client;
pub mod flash;
pub mod image;
mod remark;
pub mod transport;
