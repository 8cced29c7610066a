//! Interference with a node.

use windlass_core::reset::Reset;

use super::{BOOT_TICKS, Power, SimNode};
use crate::poke::Poke;

impl SimNode {
    /// Interferes with the node.
    pub fn poke(&mut self, poke: Poke) {
        match poke {
            Poke::BusConnected(connected) => {
                self.wiring.connected = connected;
                self.wiring_changed = true;
            }
            Poke::Powered(powered) => self.set_powered(powered),
            Poke::Hang(hangs) => self.hangs = hangs,
            Poke::Button => {
                if let Power::On(node) = &mut self.power {
                    node.press_button(self.now);
                }
            }
            poke => {
                self.rig.poke(poke);
            }
        }
    }

    fn set_powered(&mut self, powered: bool) {
        match (&self.power, powered) {
            (Power::Off, true) => {
                self.reset = Reset::POWER_ON;
                self.memory.power_on();
                self.power = Power::Booting {
                    ticks: BOOT_TICKS,
                    handover: None,
                };
            }
            (Power::Booting { .. } | Power::Starting | Power::On(_) | Power::Loading(_), false) => {
                self.memory.power_off(self.now);
                self.halt(Power::Off);
                self.rig.restart_counters();
            }
            _ => {}
        }
    }
}
