//! The only module that knows how ROS is reached: a node, topics and services, over ROS 1 (rosrust) or,
//! with the feature `ros2`, over ROS 2 (`ros2wire`). Everything else is the same code for both.
//!
//! What rosrust leaves open is cured here: calls to the master happen on threads with a deadline,
//! registrations are renewed when a master comes back, sockets time out, and a node unregisters
//! what it registered.

mod arguments;
mod inlet;
mod life;
mod lookup;
mod outlet;
mod quality;
mod ros1;
#[cfg(feature = "ros2")]
mod ros2;
mod service;
mod sockets;
mod speech;
mod watch;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant, SystemTime};

use hal::Stamp;
#[cfg(test)]
pub(crate) use rosrust::Duration as Span;
pub(crate) use rosrust::{Message, RosMsg, Time};

pub use arguments::plain_arguments;
pub(crate) use inlet::Inlet;
use life::Life;
pub use life::NodeEnd;
pub(crate) use outlet::Outlet;
pub(crate) use quality::Quality;
use ros1::Ros1;
#[cfg(feature = "ros2")]
use ros2::Ros2;
pub(crate) use service::Service;
pub use speech::Severity;
use speech::Speech;

/// Longest wait for the master at the start, and at the end.
const CONNECT_DEADLINE: Duration = Duration::from_secs(5);
const SHUTDOWN_DEADLINE: Duration = Duration::from_secs(2);
/// What stands for the origin of a simulated clock.
const FIRST: Stamp = Stamp::from_nanos(1);

/// What ROS time is on the run's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeBase {
    /// Wall-clock time; the run's clock started `origin` after the Unix epoch.
    Wall {
        /// Start of the run's clock.
        origin: Duration,
    },
    /// The run's clock itself, published on `/clock`; see [`Node::set_time`].
    Simulated,
    /// The clock of another node, which publishes `/clock`; see [`Node::set_time`].
    Remote,
}

/// How to become a ROS node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeOptions {
    /// Name of the node; `__name:=` on the command line replaces it.
    pub name: String,
    /// Whether other machines may connect. ROS has no authentication.
    pub network: bool,
    /// What ROS time is.
    pub time: TimeBase,
    /// The domain of ROS 2 to join; without one, the node is one of ROS 1.
    pub domain: Option<Domain>,
}

/// A domain of ROS 2, and how its nodes are numbered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Domain {
    /// Its number (`ROS_DOMAIN_ID`).
    pub number: u16,
    /// Whether its nodes are numbered as up to Humble.
    pub long_gids: bool,
}

/// A node that cannot start, or a topic or service that cannot be registered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NodeError {
    /// The node would be open to other machines.
    #[error(
        "the ROS node would listen to other machines (as {hostname}), and ROS 1 has no \
         authentication: set ROS_IP=127.0.0.1, or allow the network in the configuration"
    )]
    NotLocal {
        /// The name by which others would reach it.
        hostname: String,
    },
    /// The master did not answer in time.
    #[error("the ROS master at {master} does not answer within {seconds} s")]
    Deadline {
        /// The master's address.
        master: String,
        /// How long it was waited for \[s\].
        seconds: u64,
    },
    /// The master refused or is not there.
    #[error("no ROS master at {master}: {reason}")]
    Master {
        /// The master's address.
        master: String,
        /// What went wrong.
        reason: String,
    },
    /// This build does not speak ROS 2.
    #[error(
        "this build does not speak ROS 2: build it with `cargo build --release -p needle-steer \
         --features ros2`"
    )]
    NoRos2,
    /// The domain of ROS 2 cannot be joined.
    #[error("ROS 2: {reason}")]
    Wire {
        /// What went wrong.
        reason: String,
    },
    /// The node of ROS 2 would listen to other machines.
    #[error(
        "the ROS 2 node would listen to other machines: its sockets cannot be confined to the \
         loopback interface ({reason}; it takes Linux 5.7), and ROS 2 has no authentication: allow \
         the network in the configuration"
    )]
    NotConfined {
        /// Why not.
        reason: String,
    },
    /// A topic or service could not be registered.
    #[error("cannot register {name}: {reason}")]
    Register {
        /// Topic or service.
        name: String,
        /// What went wrong.
        reason: String,
    },
}

/// A ROS node. Clones are the same node; it ends with [`shutdown`](Self::shutdown) or with the
/// last clone.
#[derive(Clone)]
pub struct Node {
    inner: Arc<Inner>,
}

/// How ROS is reached.
enum Carrier {
    Ros1(Ros1),
    #[cfg(feature = "ros2")]
    Ros2(Ros2),
}

struct Inner {
    carrier: Carrier,
    life: Life,
    clock: NodeClock,
    speech: Arc<Speech>,
    doubts: Mutex<Vec<(String, Doubt)>>,
}

/// Says in words what a device behind the node waits for, if anything.
type Doubt = Box<dyn Fn() -> Option<String> + Send>;

/// A node, without keeping it alive.
#[derive(Clone)]
pub(crate) struct WeakNode(Weak<Inner>);

impl WeakNode {
    pub(crate) fn upgrade(&self) -> Option<Node> {
        self.0.upgrade().map(|inner| Node { inner })
    }
}

/// The node's time, without keeping the node alive.
#[derive(Clone, Debug)]
pub(crate) struct NodeClock {
    /// A stamp and the instant it belongs to.
    started: (Stamp, Instant),
    base: TimeBase,
    /// Nanoseconds, where time is not wall-clock time.
    told: Arc<AtomicU64>,
    /// How far the run's clock is behind wall-clock time by now \[ns\].
    behind: Arc<AtomicU64>,
}

impl NodeClock {
    /// The present time on the run's clock; monotonic but where that falls behind the wall clock.
    pub(crate) fn now(&self) -> Stamp {
        if let TimeBase::Simulated | TimeBase::Remote = self.base {
            return Stamp::from_nanos(self.told.load(Ordering::Acquire));
        }
        let (stamp, instant) = self.started;
        stamp + instant.elapsed() - self.fallen()
    }

    fn fallen(&self) -> Duration {
        Duration::from_nanos(self.behind.load(Ordering::Acquire))
    }

    /// Tells the time where it is not wall-clock time; it never goes back.
    pub(crate) fn tell(&self, now: Stamp) {
        self.told.fetch_max(now.as_nanos(), Ordering::AcqRel);
    }

    /// ROS time of a stamp of the run.
    pub(crate) fn ros_stamp(&self, stamp: Stamp) -> Stamp {
        match self.base {
            TimeBase::Wall { origin } => stamp + origin + self.fallen(),
            // rosrust replaces a stamp of zero by its own clock.
            TimeBase::Simulated | TimeBase::Remote => stamp.max(FIRST),
        }
    }

    /// How far a ROS time is behind the present \[s\]; negative: ahead.
    pub(crate) fn behind(&self, time: Time) -> f64 {
        self.ros_stamp(self.now())
            .secs_since(crate::convert::stamp(time))
    }

    /// Stamp of the run for a ROS time.
    pub(crate) fn run_stamp(&self, time: Time) -> Stamp {
        let stamp = crate::convert::stamp(time);
        match self.base {
            TimeBase::Wall { origin } => stamp - origin - self.fallen(),
            TimeBase::Simulated | TimeBase::Remote if stamp == FIRST => Stamp::ZERO,
            TimeBase::Simulated | TimeBase::Remote => stamp,
        }
    }
}

impl Node {
    /// Registers a node with the master that the environment names (`ROS_MASTER_URI`), or joins a
    /// domain of ROS 2.
    ///
    /// With ROS 1 it takes at most 5 s for the node and 5 s for each of the services that every node
    /// has (`~get_loggers`, `~set_logger_level`).
    ///
    /// # Errors
    /// No master, a master that does not answer, a domain that cannot be joined, or a node open to
    /// other machines that should not be.
    #[expect(clippy::disallowed_methods, reason = "ROS time is wall-clock time")]
    pub fn connect(options: &NodeOptions) -> Result<Self, NodeError> {
        let carrier = Carrier::connect(options)?;
        let started = match options.time {
            TimeBase::Wall { origin } => {
                let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
                Stamp::ZERO + now.unwrap_or_default().saturating_sub(origin)
            }
            TimeBase::Simulated | TimeBase::Remote => Stamp::ZERO,
        };
        let life = Life::default();
        let clock = NodeClock {
            started: (started, Instant::now()),
            base: options.time,
            told: Arc::default(),
            behind: Arc::default(),
        };
        let speech = Arc::new(Speech::new(carrier.name(), clock.clone()));
        let node = Self {
            inner: Arc::new(Inner {
                carrier,
                life,
                clock,
                speech: Arc::clone(&speech),
                doubts: Mutex::default(),
            }),
        };
        node.inner.carrier.watch(&node.inner.life, &speech);
        speech.open(&node)?;
        Ok(node)
    }

    /// Has `/diagnostics` ask a device what it waits for. `doubt` is not to hold this node.
    pub(crate) fn ask_about(
        &self,
        device: &str,
        doubt: impl Fn() -> Option<String> + Send + 'static,
    ) {
        lock(&self.inner.doubts).push((device.to_owned(), Box::new(doubt)));
    }

    /// The devices that are asked, and what each waits for.
    pub(crate) fn doubts(&self) -> Vec<(String, Option<String>)> {
        lock(&self.inner.doubts)
            .iter()
            .map(|(device, doubt)| (device.clone(), doubt()))
            .collect()
    }

    /// Full name of the node.
    pub fn name(&self) -> &str {
        self.inner.carrier.name()
    }

    /// The time base the node was given.
    pub fn time_base(&self) -> TimeBase {
        self.inner.clock.base
    }

    /// Tells the time of the run's clock, where that is not wall-clock time.
    pub fn set_time(&self, now: Stamp) {
        self.inner.clock.tell(now);
    }

    /// Tells how far the run's clock is behind wall-clock time for good: ROS time goes on with the wall,
    /// so that what the run stamps from now on is dated as late as it comes.
    pub fn fall_behind(&self, by: Duration) {
        let by = u64::try_from(by.as_nanos()).unwrap_or(u64::MAX);
        self.inner.clock.behind.store(by, Ordering::Release);
    }

    /// The present time on the run's clock.
    pub fn now(&self) -> Stamp {
        self.inner.clock.now()
    }

    /// Calls `listener` when the node is asked to end or loses its name to another node, at once
    /// if that has happened. Topics and services are out of reach from then on.
    pub fn on_end(&self, listener: impl Fn(&NodeEnd) + Send + 'static) {
        self.inner.life.on_end(Box::new(listener));
    }

    /// Says something on `/rosout` and on standard error, unless it matters less than what is said at
    /// present (`~set_logger_level`, `~set_logger_levels`).
    pub fn say(&self, severity: Severity, text: &str) {
        self.inner.speech.say(severity, text);
    }

    /// Says a warning.
    pub fn warn(&self, text: &str) {
        self.say(Severity::Warning, text);
    }

    /// The full name of a topic.
    pub fn resolved(&self, topic: &str) -> String {
        match &self.inner.carrier {
            Carrier::Ros1(ros) => ros.resolved(topic),
            #[cfg(feature = "ros2")]
            Carrier::Ros2(ros) => ros.resolved(topic),
        }
    }

    /// Other live nodes that publish on a topic; those that died without a word do not count.
    /// Nothing if the master does not answer within 5 s.
    pub fn other_publishers(&self, topic: &str) -> Option<Vec<String>> {
        match &self.inner.carrier {
            Carrier::Ros1(ros) => ros.other_publishers(topic),
            #[cfg(feature = "ros2")]
            Carrier::Ros2(ros) => ros.other_publishers(topic),
        }
    }

    /// Unregisters everything and closes all connections; takes at most 2 s, even if the master
    /// hangs.
    pub fn shutdown(self) {
        self.inner.close();
    }

    pub(crate) fn downgrade(&self) -> WeakNode {
        WeakNode(Arc::downgrade(&self.inner))
    }

    /// The node's time.
    pub(crate) fn clock(&self) -> NodeClock {
        self.inner.clock.clone()
    }
}

impl Carrier {
    fn connect(options: &NodeOptions) -> Result<Self, NodeError> {
        match options.domain {
            None => Ros1::connect(options).map(Self::Ros1),
            #[cfg(feature = "ros2")]
            Some(domain) => Ros2::connect(options, domain).map(Self::Ros2),
            #[cfg(not(feature = "ros2"))]
            Some(_) => Err(NodeError::NoRos2),
        }
    }

    /// Watches what a node may lose; one of ROS 2 has no master, and nobody can take its name.
    fn watch(&self, life: &Life, speech: &Arc<Speech>) {
        match self {
            Self::Ros1(ros) => ros.watch(life, speech),
            #[cfg(feature = "ros2")]
            Self::Ros2(_) => {}
        }
    }

    const fn is_ros1(&self) -> bool {
        match self {
            Self::Ros1(_) => true,
            #[cfg(feature = "ros2")]
            Self::Ros2(_) => false,
        }
    }

    fn name(&self) -> &str {
        match self {
            Self::Ros1(ros) => ros.name(),
            #[cfg(feature = "ros2")]
            Self::Ros2(ros) => ros.name(),
        }
    }

    fn close(&self) {
        match self {
            Self::Ros1(ros) => ros.close(),
            #[cfg(feature = "ros2")]
            Self::Ros2(ros) => ros.close(),
        }
    }
}

impl std::fmt::Debug for Node {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Node")
            .field("name", &self.name())
            .finish_non_exhaustive()
    }
}

impl Inner {
    fn close(&self) {
        self.life.stop();
        self.carrier.close();
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.close();
    }
}

/// Runs something that may hang; nothing if it has not ended in time or has panicked.
fn within<T: Send + 'static>(
    deadline: Duration,
    work: impl FnOnce() -> T + Send + 'static,
) -> Option<T> {
    let (sender, receiver) = sync_channel(1);
    std::thread::Builder::new()
        .name("ros-call".to_owned())
        .spawn(move || {
            // Nobody waits any more if the deadline has passed.
            let _ = sender.send(work());
        })
        .ok()?;
    receiver.recv_timeout(deadline).ok()
}

/// Locks; the data behind these locks is whole at every moment, so a panic elsewhere does not
/// matter.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
