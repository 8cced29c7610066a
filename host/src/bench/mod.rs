//! The bench as a server: a simulated world that SLCAN tools and browsers connect to.
//!
//! One thread owns the world, the SLCAN clients and the clock (`server`); the HTTP thread (`http`)
//! sends it jobs and waits for their results. Every SLCAN connection is one participant on the bus from
//! the moment it is accepted until it is closed.

mod error;
mod frame;
mod http;
mod json;
mod link;
mod meaning;
mod pace;
mod patch;
#[cfg(unix)]
mod pty;
mod server;
mod view;

use std::fmt::Arguments;
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Instant as WallInstant;

use windlass_sim::{NodeSpec, World, WorldConfig};

pub use error::BenchError;
pub use pace::Pace;

use crate::remark::remark;
use pace::Pacer;
use server::{Bench, Parts};

/// What a bench is started with.
#[derive(Clone, Debug)]
pub struct Config {
    /// The bus and the seed of everything random.
    pub world: WorldConfig,
    /// The controllers, in the order of their indices.
    pub nodes: Vec<NodeSpec>,
    /// How virtual time passes.
    pub pace: Pace,
    /// Where SLCAN clients connect; port 0 takes a free one.
    pub slcan: SocketAddr,
    /// Where the JSON API and the web page are served; port 0 takes a free one.
    pub http: SocketAddr,
    /// Whether there is a pseudo-terminal that speaks SLCAN, too.
    pub pty: bool,
    /// Whether SLCAN frames are answered with `z` or `Z`.
    pub frame_replies: bool,
    /// Whether clients that come and go are reported on standard error.
    pub log: bool,
}

impl Default for Config {
    fn default() -> Self {
        let local = SocketAddr::from(([127, 0, 0, 1], 0));
        Self {
            world: WorldConfig::default(),
            nodes: Vec::new(),
            pace: Pace::RealTime(1.0),
            slcan: local,
            http: local,
            pty: false,
            frame_replies: false,
            log: false,
        }
    }
}

/// Work for the thread that owns the world.
type Job = Box<dyn FnOnce(&mut Bench) + Send>;

/// A way to the bench's thread.
#[derive(Clone, Debug)]
struct Handle {
    jobs: mpsc::Sender<Job>,
}

impl Handle {
    /// Runs `work` on the bench's thread; `done` gets its result there.
    fn submit<T>(
        &self,
        work: impl FnOnce(&mut Bench) -> T + Send + 'static,
        done: impl FnOnce(T) + Send + 'static,
    ) -> Result<(), BenchError> {
        self.jobs
            .send(Box::new(move |bench| done(work(bench))))
            .map_err(|_| BenchError::Stopped)
    }

    /// Runs `work` on the bench's thread and blocks for its result.
    fn call<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Bench) -> T + Send + 'static,
    ) -> Result<T, BenchError> {
        let (sender, receiver) = mpsc::channel();
        self.submit(work, move |result| {
            // A caller that has gone needs no result.
            let _ = sender.send(result);
        })?;
        receiver.recv().map_err(|_| BenchError::Stopped)
    }
}

/// Reports on standard error, or nothing.
#[derive(Clone, Copy, Debug)]
struct Log(bool);

impl Log {
    fn line(self, text: Arguments<'_>) {
        if self.0 {
            remark(format_args!("bench: {text}"));
        }
    }
}

/// A bench that is running on threads of its own; dropping it ends it.
#[derive(Debug)]
pub struct Server {
    handle: Handle,
    slcan: SocketAddr,
    http: SocketAddr,
    pty: Option<PathBuf>,
    stop_http: Option<tokio::sync::oneshot::Sender<()>>,
    threads: Vec<JoinHandle<()>>,
}

impl Server {
    /// Opens the endpoints and starts the bench.
    ///
    /// # Errors
    /// An address cannot be listened on, or there is no pseudo-terminal to be had.
    pub fn start(config: &Config) -> Result<Self, BenchError> {
        let (slcan_listener, slcan) = listen("SLCAN", config.slcan)?;
        let (http_listener, http) = listen("HTTP", config.http)?;
        #[cfg(unix)]
        let pty = if config.pty {
            Some(pty::Pty::open().map_err(BenchError::Pty)?)
        } else {
            None
        };
        #[cfg(unix)]
        let pty_path = pty.as_ref().map(|pty| pty.path().to_owned());
        #[cfg(not(unix))]
        let pty_path = if config.pty {
            return Err(BenchError::Pty(std::io::ErrorKind::Unsupported.into()));
        } else {
            None
        };

        let mut world = World::new(config.world.clone());
        for node in &config.nodes {
            world.add_node(*node);
        }
        let pacer = match config.pace {
            Pace::Paused => None,
            Pace::RealTime(speed) => Some(Pacer::new(speed, WallInstant::now(), 0)),
        };
        let bench = Bench::new(Parts {
            world,
            pacer,
            listener: slcan_listener,
            #[cfg(unix)]
            pty,
            frame_replies: config.frame_replies,
            log: Log(config.log),
        });

        let (sender, jobs) = mpsc::channel();
        let handle = Handle { jobs: sender };
        let (stop_http, stopped) = tokio::sync::oneshot::channel();
        let mut server = Self {
            handle: handle.clone(),
            slcan,
            http,
            pty: pty_path,
            stop_http: Some(stop_http),
            threads: Vec::new(),
        };
        server.spawn("bench", move || bench.run(&jobs))?;
        let serve = http::prepare(http_listener, handle).map_err(BenchError::Thread)?;
        server.spawn("http", move || serve.run(stopped))?;
        Ok(server)
    }

    /// Where SLCAN clients connect.
    #[must_use]
    pub const fn slcan(&self) -> SocketAddr {
        self.slcan
    }

    /// Where the JSON API and the web page are.
    #[must_use]
    pub const fn http(&self) -> SocketAddr {
        self.http
    }

    /// The pseudo-terminal's path, if there is one.
    #[must_use]
    pub fn pty(&self) -> Option<&Path> {
        self.pty.as_deref()
    }

    /// Does what `POST /api/sim/step` does; returns the virtual time in microseconds.
    ///
    /// # Errors
    /// The bench runs in real time, or has stopped.
    pub fn step(&self, us: u64) -> Result<u64, BenchError> {
        let now = self.handle.call(move |bench| bench.step(us))??;
        Ok(now.as_micros())
    }

    /// Whether both threads are alive; they end early only by a defect.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.threads.iter().all(|thread| !thread.is_finished())
    }

    /// Closes all connections and waits for the threads.
    ///
    /// # Errors
    /// A thread has panicked.
    pub fn stop(mut self) -> Result<(), BenchError> {
        self.end()
    }

    fn spawn(
        &mut self,
        name: &str,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<(), BenchError> {
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(work)
            .map_err(BenchError::Thread)?;
        self.threads.push(thread);
        Ok(())
    }

    fn end(&mut self) -> Result<(), BenchError> {
        // Either may have ended already; joining tells.
        if let Some(stop) = self.stop_http.take() {
            let _ = stop.send(());
        }
        let _ = self.handle.submit(Bench::stop, drop);
        let mut result = Ok(());
        for thread in self.threads.drain(..) {
            if thread.join().is_err() {
                result = Err(BenchError::Panicked);
            }
        }
        result
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // A panic of a thread was printed by it; there is nobody left to tell.
        let _ = self.end();
    }
}

fn listen(
    what: &'static str,
    address: SocketAddr,
) -> Result<(TcpListener, SocketAddr), BenchError> {
    let open = || {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let actual = listener.local_addr()?;
        Ok((listener, actual))
    };
    open().map_err(|source| BenchError::Listen {
        what,
        address,
        source,
    })
}
