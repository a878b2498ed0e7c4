//! A node of ROS 1: what it has registered with the master.

use std::sync::{Arc, Mutex};

use rosrust::api::{Ros, resolve};

use super::life::Life;
use super::speech::Speech;
use super::watch::Watch;
use super::{CONNECT_DEADLINE, NodeError, NodeOptions, SHUTDOWN_DEADLINE, lock, lookup, within};

/// Something registered with the master.
pub(super) trait Part: Send + Sync {
    /// Registers anew; what was registered before is given up first.
    fn register(&self, ros: &Ros) -> Result<(), NodeError>;
    /// Gives up the registration and closes its connections.
    fn close(&self);
}

/// What the node has registered.
#[derive(Default)]
pub(super) struct Parts {
    pub(super) list: Mutex<Vec<Arc<dyn Part>>>,
    /// Held while registering; true once the node has ended.
    closed: Mutex<bool>,
}

impl Parts {
    /// Registers a part unless the node has ended.
    pub(super) fn register(&self, part: &dyn Part, ros: &Ros) -> Result<(), NodeError> {
        let closed = lock(&self.closed);
        if *closed { Ok(()) } else { part.register(ros) }
    }

    fn close(&self) {
        *lock(&self.closed) = true;
        for part in std::mem::take(&mut *lock(&self.list)) {
            part.close();
        }
    }
}

/// A node with the master.
pub(super) struct Ros1 {
    ros: Arc<Ros>,
    parts: Arc<Parts>,
    watch: Mutex<Option<Watch>>,
}

impl Ros1 {
    /// Registers a node with the master that the environment names; takes at most 5 s.
    pub(super) fn connect(options: &NodeOptions) -> Result<Self, NodeError> {
        let hostname = resolve::hostname();
        if !options.network && !is_loopback(&hostname) {
            return Err(NodeError::NotLocal { hostname });
        }
        let name = options.name.clone();
        let ros = within(CONNECT_DEADLINE, move || {
            Ros::new(&name).map_err(|e| reason(&e))
        })
        .ok_or_else(|| NodeError::Deadline {
            master: resolve::master(),
            seconds: CONNECT_DEADLINE.as_secs(),
        })?
        .map_err(|reason| NodeError::Master {
            master: resolve::master(),
            reason,
        })?;
        Ok(Self {
            ros: Arc::new(ros),
            parts: Arc::default(),
            watch: Mutex::default(),
        })
    }

    /// Watches the master, and whether the node still is what ROS knows by its name.
    pub(super) fn watch(&self, life: &Life, speech: &Arc<Speech>) {
        life.watch(Arc::clone(&self.ros));
        let watch = Watch::start(
            Arc::clone(&self.ros),
            Arc::clone(&self.parts),
            life.clone(),
            Arc::clone(speech),
        );
        *lock(&self.watch) = Some(watch);
    }

    pub(super) fn name(&self) -> &str {
        self.ros.name()
    }

    pub(super) fn resolved(&self, topic: &str) -> String {
        let translated = self.ros.param(topic);
        translated.map_or_else(|| topic.to_owned(), |name| name.name().to_owned())
    }

    pub(super) fn other_publishers(&self, topic: &str) -> Option<Vec<String>> {
        let (ros, topic) = (Arc::clone(&self.ros), self.resolved(topic));
        within(CONNECT_DEADLINE, move || {
            let state = ros.state().ok()?;
            let names = state
                .publishers
                .into_iter()
                .find(|entry| entry.name == topic)
                .map_or_else(Vec::new, |entry| entry.connections);
            let master = resolve::master();
            let is_alive = |name: &String| {
                lookup::node_uri(&master, ros.name(), name)
                    .is_ok_and(|uri| uri.is_some_and(|uri| lookup::is_alive(&uri)))
            };
            Some(
                names
                    .into_iter()
                    .filter(|name| name != ros.name() && is_alive(name))
                    .collect(),
            )
        })
        .flatten()
    }

    /// Registers a part; blocks while the master is asked, 5 s at most.
    pub(super) fn add(&self, name: &str, part: Arc<dyn Part>) -> Result<(), NodeError> {
        let (ros, parts) = (Arc::clone(&self.ros), Arc::clone(&self.parts));
        within(CONNECT_DEADLINE, move || {
            parts.register(part.as_ref(), &ros)?;
            lock(&parts.list).push(part);
            Ok(())
        })
        .unwrap_or_else(|| {
            let reason = "no answer".to_owned();
            Err(NodeError::Register {
                name: name.to_owned(),
                reason,
            })
        })
    }

    pub(super) fn close(&self) {
        if let Some(watch) = &*lock(&self.watch) {
            watch.stop();
        }
        let (ros, parts) = (Arc::clone(&self.ros), Arc::clone(&self.parts));
        // A master that hangs must not keep the process from ending.
        let _ = within(SHUTDOWN_DEADLINE, move || {
            parts.close();
            ros.shutdown_sender().shutdown();
        });
    }
}

fn is_loopback(hostname: &str) -> bool {
    hostname == "localhost" || hostname.starts_with("127.")
}

/// The chain of causes in one line.
pub(super) fn reason(error: &rosrust::error::Error) -> String {
    error
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(": ")
}
