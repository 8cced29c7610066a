//! `windlass faults` of a Talon: the six faults of the manual (14), live and sticky.

use serde_json::{Value as Json, json};

use super::{Connection, robot};
use crate::cli::output::say;
use crate::cli::{Failure, Global};
use crate::client::Address;
use crate::client::talon::{FaultBits, SelfTest};

/// The faults of one Talon.
pub(in crate::cli) struct Report {
    address: Address,
    cleared: bool,
    status: SelfTest,
}

/// Reads the faults, and clears the sticky ones afterwards if asked to.
pub(in crate::cli) fn read(
    client: &mut Connection,
    address: Address,
    clear: bool,
    global: &Global,
) -> Result<Report, Failure> {
    let robot = robot(client, global);
    let talon = robot.talon(address.number)?;
    let status = talon.self_test_clearing(false)?;
    talon.faults().fresh()?;
    if clear {
        talon.clear_sticky_faults()?;
    }
    Ok(Report {
        address,
        cleared: clear,
        status,
    })
}

impl Report {
    /// True if a fault is active, or sticky and not cleared.
    pub(in crate::cli) fn remains(&self) -> bool {
        let sticky = self.status.sticky_faults();
        !self.status.faults().is_empty() || (!sticky.is_empty() && !self.cleared)
    }

    /// Prints the faults that are set.
    pub(in crate::cli) fn print(&self) -> Result<(), Failure> {
        say!("device {} (talon)", self.address)?;
        say!("  active: {}", text(self.status.faults()))?;
        say!("  sticky: {}", text(self.status.sticky_faults()))?;
        if self.cleared {
            say!("  sticky faults were cleared after this reading")?;
        }
        Ok(())
    }

    /// The faults as JSON.
    pub(in crate::cli) fn describe(&self) -> Json {
        let names = |faults: FaultBits| faults.names().collect::<Vec<_>>();
        json!({
            "device": self.address.to_string(),
            "dialect": super::DIALECT,
            "active": names(self.status.faults()),
            "sticky": names(self.status.sticky_faults()),
        })
    }
}

fn text(faults: FaultBits) -> String {
    let names: Vec<&str> = faults.names().collect();
    if names.is_empty() {
        return "none".to_owned();
    }
    names.join(", ")
}
