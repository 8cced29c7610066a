//! Thread mode: the node between the bus, the tick and the board.

use windlass_core::engine::Settings;
use windlass_core::engine::command::Command;
use windlass_core::engine::snapshot::{Faults, Snapshot};
use windlass_core::node::{Action, Handover, Node, NodeConfig, Tag};
use windlass_core::params::Stored;
use windlass_core::params::journal::{SaveError, Saved};
use windlass_core::time::Instant;

use crate::control::Crossing;
use crate::port::{Board, Bus, BusEvent, Event};

/// Bus events of one pass: more than a saturated bus of 1 Mbit/s delivers in two ticks. A flood of
/// frames cannot keep the node from its other duties.
const EVENTS_PER_PASS: usize = 32;

/// The node with what it has sent to the bus and to the tick.
#[derive(Debug)]
pub struct Thread {
    node: Node,
    snapshot: Snapshot,
    ticks: u32,
    on_the_way: Option<Tag>,
    command: Option<Command>,
    settings: Option<Settings>,
    logged: Logged,
}

/// What the log has told of last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Logged {
    session: Option<u16>,
    faults: Faults,
    dropped: u32,
}

impl Thread {
    /// A node that starts at `now`.
    #[must_use]
    pub fn new(now: Instant, config: &NodeConfig, stored: Option<&Stored>) -> Self {
        Self {
            node: Node::new(now, config, stored),
            snapshot: Snapshot::default(),
            ticks: 0,
            on_the_way: None,
            command: None,
            settings: None,
            logged: Logged::default(),
        }
    }

    /// Thread mode of a board, for ever.
    pub fn run<B: Board>(&mut self, board: &mut B, crossing: &Crossing) -> ! {
        loop {
            if let Some(handover) = self.pass(board, crossing) {
                board.log(Event::Restart(handover));
                board.restart(handover);
            }
            board.idle();
        }
    }

    /// One pass through everything that is to be done now. Gives the handover if the node is to be
    /// restarted, which the caller has to do at once.
    pub fn pass<B: Board>(&mut self, board: &mut B, crossing: &Crossing) -> Option<Handover> {
        if let Some(snapshot) = crossing.snapshot.take() {
            self.snapshot = snapshot;
        }
        self.take_events(board);
        self.tick(board, crossing.ticks());
        let restart = self.act(board);
        self.transmit(board);
        self.publish(crossing);
        self.log(board);
        restart
    }

    /// Logs what has changed. Here, because neither the tick nor an interrupt may format anything.
    fn log<B: Board>(&mut self, board: &mut B) {
        let now = Logged {
            session: self.node.session(),
            faults: self.snapshot.faults,
            dropped: self.node.counters().dropped,
        };
        let before = core::mem::replace(&mut self.logged, now);
        if now.session != before.session {
            board.log(match now.session {
                Some(session) => Event::Connected { session },
                None => Event::Disconnected,
            });
        }
        if now.faults != before.faults {
            board.log(Event::Faults(now.faults));
        }
        if now.dropped != before.dropped {
            board.log(Event::Dropped(now.dropped));
        }
    }

    fn take_events<B: Board>(&mut self, board: &mut B) {
        for _ in 0..EVENTS_PER_PASS {
            let now = board.now();
            match board.bus().poll(now) {
                None => return,
                Some(BusEvent::Received(frame)) => {
                    self.node.on_frame(now, &frame, &self.snapshot);
                }
                Some(BusEvent::Ended(outcome)) => {
                    if let Some(tag) = self.on_the_way.take() {
                        self.node.on_transmitted(now, tag, outcome);
                    }
                }
                Some(BusEvent::Lost) => {
                    self.on_the_way = None;
                    self.node.on_bus_lost(now);
                }
            }
        }
    }

    /// What is due once in a tick. The watchdog is fed here: both the tick and this thread have made
    /// progress.
    fn tick<B: Board>(&mut self, board: &mut B, ticks: u32) {
        if ticks == self.ticks {
            return;
        }
        self.ticks = ticks;
        let now = board.now();
        self.node.set_dropped(board.bus().dropped());
        self.node.set_bus_errors(now, board.bus().errors());
        self.node.poll(now, &self.snapshot);
        if board.button_pressed() {
            self.node.press_button(now);
        }
        board.show(self.node.leds(now, &self.snapshot));
        if self.node.may_erase(now) {
            board.kept().erase_ahead();
        }
        board.feed_watchdog();
    }

    /// Never inlined: a set of settings on the stack is large, and [`Thread::pass`] calls deeper elsewhere.
    #[inline(never)]
    fn act<B: Board>(&mut self, board: &mut B) -> Option<Handover> {
        match self.node.take_action()? {
            Action::Save => {
                let now = board.now();
                let may_erase = self.node.may_erase(now);
                let result = board.kept().save(&self.node.stored(), may_erase);
                self.node.save_ended(board.now(), result);
                match result {
                    Ok(Saved { written: true, .. }) => board.log(Event::Saved),
                    Ok(_) | Err(SaveError::EraseDue) => {}
                    Err(error) => board.log(Event::NotSaved(error)),
                }
                None
            }
            Action::Confirm => {
                board.kept().confirm();
                None
            }
            Action::Healthy => {
                board.kept().healthy();
                None
            }
            Action::PinTest(test) => {
                let failed = board.test_pins(test);
                self.node.pin_test_done(failed);
                None
            }
            Action::Reset(handover) => Some(handover),
        }
    }

    fn transmit<B: Board>(&mut self, board: &mut B) {
        if self.on_the_way.is_some() {
            return;
        }
        let now = board.now();
        if let Some(transmission) = self.node.poll_tx(now, &self.snapshot) {
            self.on_the_way = Some(transmission.tag);
            board.bus().transmit(now, &transmission);
        }
    }

    /// Hands command and settings to the tick when they have changed. The settings go first: a command
    /// never meets settings older than itself.
    fn publish(&mut self, crossing: &Crossing) {
        if self.settings.as_ref() != Some(self.node.settings()) {
            self.settings = Some(*self.node.settings());
            crossing.settings.offer(*self.node.settings());
        }
        if self.command.as_ref() != Some(self.node.command()) {
            self.command = Some(*self.node.command());
            crossing.command.offer(*self.node.command());
        }
    }

    /// The node.
    #[must_use]
    pub const fn node(&self) -> &Node {
        &self.node
    }
}

#[cfg(test)]
mod tests;
