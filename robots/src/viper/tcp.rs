//! The driver's thread: sockets and, on a wall clock, the period.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, lookup_host};
use tokio::time::timeout;

use super::Port;
use super::arm::{Now, Shared, ViperArm};
use super::config::Config;
use super::driver::{Core, LinkError, SetupError};

/// How long the end of a driver waits for the answer to its last stop.
const LAST_WORDS: Duration = Duration::from_millis(200);
/// Bytes read at once; more wait in the system's bounded buffer.
const CHUNK: usize = 2048;

impl ViperArm {
    /// A driver on a thread of its own that connects, and connects again, by itself. `now` tells
    /// the time of the rig's wall clock.
    ///
    /// # Errors
    /// Settings out of range, or no thread to be had. A controller that cannot be reached is
    /// not an error here: see [`Monitor::link_error`](super::Monitor::link_error).
    pub fn connect(config: Config, now: Now) -> Result<Self, StartError> {
        Self::run(Core::new(config)?, now)
    }

    /// The same for a driver made before, for instance one that guards a tool.
    ///
    /// # Errors
    /// No thread to be had.
    pub fn run(core: Core, now: Now) -> Result<Self, StartError> {
        let shared = Shared::new(core, Some(now));
        let transport = Transport::start(Arc::clone(&shared), true)?;
        Ok(Self::new(shared, Some(transport)))
    }
}

/// Why a driver did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Settings out of range.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The system gave no thread or socket.
    #[error("no thread or socket: {0}")]
    System(#[from] io::Error),
    /// The emulator's server did not start.
    #[error(transparent)]
    Server(#[from] super::emulator::ServerError),
}

/// The thread.
#[derive(Debug)]
pub(super) struct Transport {
    shared: Arc<Shared>,
    ending: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Transport {
    /// `ticking` calls the core's tick every period of the wall clock.
    pub(super) fn start(shared: Arc<Shared>, ticking: bool) -> io::Result<Self> {
        let ending = Arc::new(AtomicBool::new(false));
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let task = Task {
            shared: Arc::clone(&shared),
            ending: Arc::clone(&ending),
        };
        let thread = std::thread::Builder::new()
            .name("viper".into())
            .spawn(move || {
                runtime.block_on(async {
                    tokio::select! {
                        () = task.keep_link() => {}
                        () = task.keep_time(), if ticking => {}
                    }
                });
                // A resolver that hangs must not keep the thread.
                runtime.shutdown_background();
            })?;
        Ok(Self {
            shared,
            ending,
            thread: Some(thread),
        })
    }

    /// Lets the last stop pass, closes and ends the thread.
    pub(super) fn end(mut self) {
        self.ending.store(true, Ordering::Release);
        self.shared.notify();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been reported on its way.
            let _ = thread.join();
        }
        self.shared.core().close();
    }
}

struct Task {
    shared: Arc<Shared>,
    ending: Arc<AtomicBool>,
}

impl Task {
    fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Acquire)
    }

    /// Ticks at monotone deadlines; missed ones are skipped, not made up for.
    async fn keep_time(&self) {
        let (period, mut deadline) = {
            let core = self.shared.core();
            (core.config().period, self.shared.now(&core))
        };
        loop {
            let now = {
                let mut core = self.shared.core();
                let now = self.shared.now(&core);
                core.tick(now);
                now
            };
            self.shared.notify();
            deadline = deadline + period;
            while deadline <= now {
                deadline = deadline + period;
            }
            tokio::time::sleep(deadline.since(now)).await;
        }
    }

    /// Keeps the connection that the core wants.
    async fn keep_link(&self) {
        while !self.is_ending() {
            let (wanted, config) = {
                let core = self.shared.core();
                (core.wanted(), core.config().clone())
            };
            let Some(generation) = wanted else {
                self.shared.notified().await;
                continue;
            };
            let error = match connect(&config).await {
                Ok(streams) => self.converse(generation, streams, &config).await,
                Err(error) => Some(error),
            };
            if let Some(error) = error {
                let mut core = self.shared.core();
                let now = self.shared.now(&core);
                core.lost(now, generation, error);
            }
        }
    }

    /// Carries bytes until the link ends; `None` if the core wants another one, or the end.
    async fn converse(
        &self,
        generation: u64,
        [mut motion, mut state]: [TcpStream; 2],
        config: &Config,
    ) -> Option<LinkError> {
        self.on_core(|core, now| core.connected(now, generation));
        let (mut from_motion, mut from_state) = ([0; CHUNK], [0; CHUNK]);
        let mut last_words = None;
        loop {
            while let Some(bytes) = self.on_core(|core, _| core.transmit(generation)) {
                // A peer that does not read must not hold the thread.
                let writing = motion.write_all(bytes.as_slice());
                match timeout(config.timing.acknowledgement, writing).await {
                    Ok(Ok(())) => {}
                    Ok(Err(error)) => return Some(broken(&error)),
                    Err(_) => return Some(LinkError::Silent),
                }
            }
            if self.on_core(|core, _| core.wanted()) != Some(generation) {
                return None;
            }
            if self.is_ending() {
                let until = *last_words.get_or_insert(tokio::time::Instant::now() + LAST_WORDS);
                let stopping = self.on_core(|core, _| core.is_stopping());
                if !stopping || tokio::time::Instant::now() >= until {
                    return None;
                }
            }
            let (port, bytes) = tokio::select! {
                read = motion.read(&mut from_motion) => (Port::Motion, read.map(|n| &from_motion[..n])),
                read = state.read(&mut from_state) => (Port::State, read.map(|n| &from_state[..n])),
                () = self.shared.notified() => continue,
                () = tokio::time::sleep(LAST_WORDS) => continue,
            };
            match bytes {
                Ok([]) => return Some(LinkError::Closed),
                Ok(bytes) => self.on_core(|core, now| core.received(now, generation, port, bytes)),
                Err(error) => return Some(broken(&error)),
            }
        }
    }

    fn on_core<T>(&self, act: impl FnOnce(&mut Core, hal::Stamp) -> T) -> T {
        let mut core = self.shared.core();
        let now = self.shared.now(&core);
        act(&mut core, now)
    }
}

fn broken(error: &io::Error) -> LinkError {
    LinkError::Broken {
        detail: error.to_string(),
    }
}

async fn connect(config: &Config) -> Result<[TcpStream; 2], LinkError> {
    let both = async {
        let motion = connect_port(&config.host, config.motion_port).await?;
        let state = connect_port(&config.host, config.state_port).await?;
        Ok([motion, state])
    };
    timeout(config.timing.connect, both)
        .await
        .unwrap_or(Err(LinkError::ConnectTimeout))
}

async fn connect_port(host: &str, port: u16) -> Result<TcpStream, LinkError> {
    let addresses: Vec<SocketAddr> = match lookup_host((host, port)).await {
        Ok(addresses) => addresses.collect(),
        Err(error) => {
            return Err(LinkError::Resolve {
                host: host.into(),
                detail: error.to_string(),
            });
        }
    };
    let stream = TcpStream::connect(addresses.as_slice()).await;
    let stream = stream.and_then(|stream| stream.set_nodelay(true).map(|()| stream));
    stream.map_err(|error| LinkError::Connect {
        peer: format!("{host}:{port}"),
        detail: error.to_string(),
    })
}
