//! The control tick and what crosses between it and thread mode.

use core::sync::atomic::{AtomicU32, Ordering};

use windlass_core::engine::command::Command;
use windlass_core::engine::snapshot::{Actuation, Sample, Snapshot};
use windlass_core::engine::{Engine, Settings};
use windlass_core::time::TICK;

use crate::latest::{Latest, Maybe};

/// Values that cross between the tick and thread mode.
#[derive(Debug)]
pub struct Crossing {
    /// New settings, thread to tick.
    pub settings: Latest<Maybe<Settings>>,
    /// New command, thread to tick.
    pub command: Latest<Maybe<Command>>,
    /// What the latest tick saw and did, tick to thread.
    pub snapshot: Latest<Maybe<Snapshot>>,
    ticks: AtomicU32,
}

impl Crossing {
    /// Nothing crossed yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            settings: Latest::empty(),
            command: Latest::empty(),
            snapshot: Latest::empty(),
            ticks: AtomicU32::new(0),
        }
    }

    /// A tick passes in which there is nothing to measure yet.
    pub fn skip(&self) {
        self.ticks
            .store(self.ticks().wrapping_add(1), Ordering::Relaxed);
    }

    /// Time of the latest tick in µs; starts anew after 24 days. For log lines.
    #[must_use]
    pub fn micros(&self) -> u64 {
        u64::from(self.ticks()) * TICK.as_micros()
    }

    /// Ticks so far, wrapping.
    #[must_use]
    pub fn ticks(&self) -> u32 {
        self.ticks.load(Ordering::Relaxed)
    }
}

impl Default for Crossing {
    fn default() -> Self {
        Self::new()
    }
}

/// What the tick interrupt owns.
#[derive(Debug)]
pub struct Control {
    engine: Engine,
    settings: Maybe<Settings>,
    command: Maybe<Command>,
}

impl Control {
    /// An engine at power-on that has neither settings nor a command yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            engine: Engine::new(),
            settings: Maybe::Nothing,
            command: Maybe::Nothing,
        }
    }

    /// One tick: to be called every 500 µs, its result to be given to the bridge at once. Off until
    /// thread mode has published settings and a command.
    pub fn tick(&mut self, crossing: &Crossing, sample: &Sample) -> Actuation {
        crossing.skip();
        if let Some(settings) = crossing.settings.take() {
            self.settings = Maybe::Just(settings);
        }
        if let Some(command) = crossing.command.take() {
            self.command = Maybe::Just(command);
        }
        let (Some(settings), Some(command)) = (self.settings.as_ref(), self.command.as_ref())
        else {
            return Actuation::Off;
        };
        let snapshot = self.engine.tick(settings, sample, command);
        crossing.snapshot.offer(*snapshot);
        snapshot.actuation
    }
}

impl Default for Control {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use windlass_core::dialect::DialectKind;
    use windlass_core::engine::Board;
    use windlass_core::params::{Params, compile};

    fn sample() -> Sample {
        Sample {
            current: 2048,
            bus_voltage: 1365,
            temperature: 931,
            ..Sample::default()
        }
    }

    #[test]
    fn the_bridge_is_off_and_nothing_is_reported_until_settings_and_command_have_come() {
        let crossing = Crossing::new();
        let mut control = Control::new();
        assert_eq!(control.tick(&crossing, &sample()), Actuation::Off);
        assert_eq!(crossing.snapshot.take(), None);
        let policy = DialectKind::Dmc60c.policy();
        let settings = compile::settings(&Params::default(), &Board::REFERENCE, &policy);
        crossing.settings.offer(settings);
        crossing.command.offer(Command::default());
        for _ in 0..100 {
            control.tick(&crossing, &sample());
        }
        let snapshot = crossing.snapshot.take().expect("a snapshot");
        // Stored neutral behaviour of a running self-checked engine without a driving command.
        assert_eq!(snapshot.actuation, Actuation::Brake);
        assert_eq!(crossing.ticks(), 101);
    }
}
