//! `windlass sim`.

use super::{Failure, Global, Kind, Outcome};

/// Arguments of `windlass sim`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Arguments {
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS")]
    pub seconds: Option<u64>,
}

/// Runs the bench server.
///
/// # Errors
/// The bench could not be started.
pub fn run(_arguments: &Arguments, _global: &Global) -> Result<Outcome, Failure> {
    Err(Failure::new(
        Kind::Unexpected,
        "not built yet",
        "see windlass --help",
    ))
}
