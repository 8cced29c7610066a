//! What can be seen of a node from outside the bus.

use windlass_core::dialect::DialectKind;
use windlass_core::engine::command::Neutral;
use windlass_core::engine::snapshot::{Actuation, Snapshot};
use windlass_core::led::Leds;
use windlass_core::node::{Counters, Node};
use windlass_core::params::Stored;

use super::{Power, SimNode};
use crate::spec::NodeSpec;
use crate::truth::Truth;

impl SimNode {
    /// What the node was added as.
    #[must_use]
    pub fn spec(&self) -> NodeSpec {
        self.spec
    }

    /// Driving dialect in force.
    #[must_use]
    pub fn dialect(&self) -> DialectKind {
        match &self.power {
            Power::On(node) => node.dialect(),
            _ => self.identity.0,
        }
    }

    /// Device number in force; without power the last one.
    #[must_use]
    pub fn number(&self) -> u8 {
        match &self.power {
            Power::On(node) => node.number(),
            Power::Loading(loading) => loading.loader.number(),
            _ => self.identity.1,
        }
    }

    /// Result of the latest tick; the default while nothing runs.
    #[must_use]
    pub fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// The running application's node; none without power, while booting and in the bootloader.
    #[must_use]
    pub fn node(&self) -> Option<&Node> {
        match &self.power {
            Power::On(node) => Some(node),
            _ => None,
        }
    }

    /// What is in the settings memory: what the node would start with after a power cut now.
    #[must_use]
    pub fn stored(&self) -> Stored {
        self.memory.kept()
    }

    /// What really happens at the node.
    #[must_use]
    pub fn truth(&self) -> Truth {
        let node = self.node();
        let (plant, header) = (&self.rig.plant, &self.rig.header);
        let neutral = match self.actuation {
            Actuation::Off => Neutral::Coast,
            Actuation::Brake => Neutral::Brake,
            Actuation::Drive(_) => self.snapshot.neutral,
        };
        Truth {
            dialect: self.dialect(),
            number: self.number(),
            position_counts: plant.position().floor() as i64,
            velocity_counts_per_100ms: plant.velocity(),
            current_a: plant.current(),
            bus_v: plant.bus_voltage(),
            temp_c: plant.temperature(),
            analog_v: plant.analog_in(),
            duty: self.actuation.duty().units(),
            neutral,
            fwd_limit_closed: header.forward_closed,
            rev_limit_closed: header.reverse_closed,
            index_pin: plant.encoder.index(),
            leds: match &self.power {
                Power::On(node) => node.leds(self.now, &self.snapshot),
                Power::Loading(loading) => loading.loader.leds(self.now),
                _ => Leds::default(),
            },
            mode: self.image,
            powered: !matches!(self.power, Power::Off),
            bus_connected: self.wiring.connected,
            drive_state: self.snapshot.state,
            faults: self.snapshot.faults.bits(),
            flash_writes: self.memory.writes(),
            flash_erases: self.memory.erases(),
            settings: node.map(Node::settings_state),
            session: match &self.power {
                Power::On(node) => node.session(),
                Power::Loading(loading) => loading.loader.session(),
                _ => None,
            },
            tec: self.view.tec,
            rec: self.view.rec,
            error_state: self.view.error_state,
            bus_off_count: self.view.bus_off_count,
            counters: match &self.power {
                Power::On(node) => *node.counters(),
                Power::Loading(loading) => loading.counters(),
                _ => Counters::default(),
            },
        }
    }
}
