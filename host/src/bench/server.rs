//! The thread that owns the simulated world, its clients and its clock.

use std::net::TcpListener;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration as WallDuration, Instant as WallInstant};

use serde_json::{Map, Value};
use windlass_core::frame::Frame;
use windlass_core::time::{Duration, Instant};
use windlass_sim::{ParticipantId, World};

use super::link::{Link, Port, TcpPort};
use super::pace::Pacer;
use super::patch::Patch;
#[cfg(unix)]
use super::pty::Pty;
use super::{BenchError, Job, Log};

/// How often a bench in real time advances and looks at its clients.
const PERIOD: WallDuration = WallDuration::from_millis(1);
/// How often a paused bench looks at its clients.
const IDLE_PERIOD: WallDuration = WallDuration::from_millis(2);
/// Longest virtual span between two looks at the clients' outputs during a step.
const STEP_CHUNK_US: u64 = 10_000;
/// Pause between two attempts to write to clients that have not read.
const WRITE_RETRY: WallDuration = WallDuration::from_micros(200);
/// Frames of one client that may wait for the bus before no more is read from it.
const LARGEST_QUEUE: usize = 100_000;
/// Virtual time in which the last frames of a client that has gone may still leave.
const LINGER: Duration = Duration::from_millis(100);

/// What the bench counts about itself.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ServerCounters {
    /// Clients that were disconnected because they did not read.
    pub(super) disconnected: u64,
    /// Clients that have ever connected.
    pub(super) accepted: u64,
}

/// The world and everything that is connected to it.
pub(super) struct Bench {
    world: World,
    pacer: Option<Pacer>,
    listener: TcpListener,
    links: Vec<Link>,
    #[cfg(unix)]
    pty: Option<PtySlot>,
    http: Option<ParticipantId>,
    held: Vec<Map<String, Value>>,
    frame_replies: bool,
    counters: ServerCounters,
    stopping: bool,
    log: Log,
}

/// The pseudo-terminal and who uses it.
#[cfg(unix)]
struct PtySlot {
    pty: Pty,
    user: Option<ParticipantId>,
    /// The program that has it open was given up; it is taken back when it writes or opens anew.
    given_up: bool,
}

/// What [`Bench`] needs to begin.
pub(super) struct Parts {
    pub(super) world: World,
    pub(super) pacer: Option<Pacer>,
    pub(super) listener: TcpListener,
    #[cfg(unix)]
    pub(super) pty: Option<Pty>,
    pub(super) frame_replies: bool,
    pub(super) log: Log,
}

impl Bench {
    pub(super) fn new(parts: Parts) -> Self {
        Self {
            held: vec![Map::new(); parts.world.nodes()],
            world: parts.world,
            pacer: parts.pacer,
            listener: parts.listener,
            links: Vec::new(),
            #[cfg(unix)]
            pty: parts.pty.map(|pty| PtySlot {
                pty,
                user: None,
                given_up: false,
            }),
            http: None,
            frame_replies: parts.frame_replies,
            counters: ServerCounters::default(),
            stopping: false,
            log: parts.log,
        }
    }

    pub(super) fn world(&self) -> &World {
        &self.world
    }

    pub(super) fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    pub(super) fn links(&self) -> &[Link] {
        &self.links
    }

    pub(super) fn pacer(&self) -> Option<&Pacer> {
        self.pacer.as_ref()
    }

    pub(super) fn counters(&self) -> ServerCounters {
        self.counters
    }

    /// Ends [`Bench::run`] after the present job.
    pub(super) fn stop(&mut self) {
        self.stopping = true;
    }

    /// Runs jobs, clients and virtual time until it is told to stop or nobody can send a job any more.
    pub(super) fn run(mut self, jobs: &Receiver<Job>) {
        while !self.stopping {
            let wait = if self.pacer.is_some() {
                PERIOD
            } else {
                IDLE_PERIOD
            };
            match jobs.recv_timeout(wait) {
                Ok(job) => job(&mut self),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            self.read_clients();
            self.follow_wall_clock();
            self.flush_clients();
        }
        let now = self.world.now();
        for link in &mut self.links {
            link.flush(now);
            link.close(now);
        }
    }

    /// Advances a paused bench by exactly `us` after everything that clients have sent was put on the
    /// bus; returns when every frame of that span was written to every client.
    ///
    /// # Errors
    /// The bench runs in real time.
    pub(super) fn step(&mut self, us: u64) -> Result<Instant, BenchError> {
        if self.pacer.is_some() {
            return Err(BenchError::NotPaused);
        }
        self.read_clients();
        let mut left = us;
        while left > 0 {
            let span = left.min(STEP_CHUNK_US);
            self.advance(span);
            self.flush_and_wait();
            left -= span;
        }
        self.flush_and_wait();
        self.remove_ended();
        Ok(self.world.now())
    }

    /// Interferes with a node.
    pub(super) fn apply(&mut self, index: usize, patch: Patch) {
        if let (Some(node), Some(held)) = (self.world.node_mut(index), self.held.get_mut(index)) {
            for poke in patch.pokes {
                node.poke(poke);
            }
            held.extend(patch.held);
            held.retain(|_, value| !value.is_null());
        }
    }

    /// The fields that were set at a node and are still in force.
    pub(super) fn held(&self, index: usize) -> &Map<String, Value> {
        &self.held[index]
    }

    /// Puts a frame on the bus as the participant "http", which joins with its first frame.
    pub(super) fn send_from_http(&mut self, frame: Frame) {
        let id = match self.http {
            Some(id) => id,
            None => *self.http.insert(self.world.join("http")),
        };
        self.world.send(id, frame);
    }

    /// Advances the world and gives the frames of that span to the clients.
    fn advance(&mut self, us: u64) {
        self.world.advance(Duration::from_micros(us));
        for link in &mut self.links {
            while let Some(received) = self.world.receive(link.participant()) {
                link.deliver(&received.frame, received.at);
            }
            if let Some(own) = self.world.participant(link.participant()) {
                link.note_controller(&own);
            }
        }
        if let Some(id) = self.http {
            while self.world.receive(id).is_some() {}
        }
    }

    fn follow_wall_clock(&mut self) {
        let Some(pacer) = &mut self.pacer else { return };
        let mut due = pacer.due_us(WallInstant::now(), self.world.now().as_micros());
        let chunk = pacer.virtual_us(PERIOD).max(1);
        while due > 0 {
            let span = due.min(chunk);
            self.advance(span);
            due -= span;
            if due > 0 {
                self.flush_clients();
                self.read_clients();
            }
        }
    }

    /// Takes new clients in and puts everything that all of them have sent on the bus.
    fn read_clients(&mut self) {
        self.accept();
        #[cfg(unix)]
        self.accept_on_pty();
        let now = self.world.now();
        for link in &mut self.links {
            let id = link.participant();
            while self.world.pending(id) < LARGEST_QUEUE
                && link.read(now, |frame| self.world.send(id, frame))
            {}
        }
        self.remove_ended();
    }

    fn accept(&mut self) {
        // An error is "nobody waits", or a connection that is gone again.
        while let Ok((stream, peer)) = self.listener.accept() {
            match TcpPort::new(stream) {
                Ok(port) => drop(self.connect(peer.to_string(), Box::new(port))),
                Err(error) => self
                    .log
                    .line(format_args!("client {peer} refused: {error}")),
            }
        }
    }

    #[cfg(unix)]
    fn accept_on_pty(&mut self) {
        let Some(slot) = &mut self.pty else { return };
        let in_use = |link: &Link| Some(link.participant()) == slot.user && !link.has_ended();
        if self.links.iter().any(in_use) {
            return;
        }
        let state = slot.pty.state();
        slot.given_up &= state.open && !state.input;
        if !state.open || slot.given_up {
            return;
        }
        let path = slot.pty.path().display().to_string();
        match slot.pty.connect() {
            Ok(port) => {
                let id = self.connect(path, Box::new(port));
                if let Some(slot) = &mut self.pty {
                    slot.user = Some(id);
                }
            }
            Err(error) => self
                .log
                .line(format_args!("{path} cannot be used: {error}")),
        }
    }

    fn connect(&mut self, name: String, port: Box<dyn Port>) -> ParticipantId {
        self.log.line(format_args!("client {name} connected"));
        self.counters.accepted += 1;
        let id = self.world.join(&name);
        self.links
            .push(Link::new(name, id, port, self.frame_replies));
        id
    }

    /// Writes what the kernel takes and disconnects clients that are overdue.
    fn flush_clients(&mut self) {
        let now = self.world.now();
        for link in &mut self.links {
            link.flush(now);
        }
        self.disconnect_overdue();
    }

    /// Writes everything to every client, waiting for those that are slow to read.
    fn flush_and_wait(&mut self) {
        self.flush_clients();
        while self.links.iter().any(|link| link.backlog() > 0) {
            let before = WallInstant::now();
            std::thread::sleep(WRITE_RETRY);
            let waited = before.elapsed();
            for link in &mut self.links {
                link.add_wait(waited);
            }
            self.flush_clients();
        }
    }

    fn disconnect_overdue(&mut self) {
        let now = self.world.now();
        for link in &mut self.links {
            let Some(reason) = link.overdue() else {
                continue;
            };
            self.log.line(format_args!(
                "client {} disconnected: {reason}",
                link.name()
            ));
            self.counters.disconnected += 1;
            link.close(now);
            #[cfg(unix)]
            if let Some(slot) = &mut self.pty {
                slot.given_up |= slot.user == Some(link.participant());
            }
        }
    }

    /// Lets go of clients that have gone, once their last frames are on the bus.
    fn remove_ended(&mut self) {
        let now = self.world.now();
        let (world, log) = (&mut self.world, &self.log);
        self.links.retain(|link| {
            let id = link.participant();
            let stays = match link.ended_at() {
                None => true,
                Some(ended) => world.pending(id) > 0 && now.since(ended) < LINGER,
            };
            if !stays {
                log.line(format_args!("client {} has gone", link.name()));
                world.leave(id);
            }
            stays
        });
    }
}
