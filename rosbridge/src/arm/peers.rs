//! Who else commands the same arm: two controllers on one topic fight.

use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::core::Core;
use super::{Refused, RosArmError};
use crate::msg::std_msgs;
use crate::seam::{Inlet, Node, Quality, lock};

/// How often the master is asked.
const PERIOD: Duration = Duration::from_millis(500);

/// Refuses a topic to which another live node publishes.
pub(super) fn refuse_others(node: &Node, topic: &str) -> Result<(), RosArmError> {
    match node.other_publishers(topic) {
        Some(nodes) if !nodes.is_empty() => {
            let topic = node.resolved(topic);
            Err(Refused::SecondController { topic, nodes }.into())
        }
        _ => Ok(()),
    }
}

/// Looks for other publishers of velocities: by what they publish, at once, and by the master's
/// list, also where they are silent.
#[derive(Debug)]
pub(super) struct Peers {
    /// Dropping it ends the thread.
    _end: SyncSender<()>,
}

impl Peers {
    pub(super) fn watch(
        node: &Node,
        topic: &str,
        core: &Arc<Mutex<Core>>,
    ) -> Result<Self, RosArmError> {
        let (own, name) = (node.name().to_owned(), node.resolved(topic));
        let told = Arc::downgrade(core);
        let heard = Quality::Stream(4);
        Inlet::open_named::<std_msgs::Float64MultiArray>(node, topic, heard, move |_, from| {
            if from != own
                && let Some(core) = told.upgrade()
            {
                lock(&core).others(&name, vec![from.to_owned()]);
            }
        })?;
        let (end, ended) = sync_channel::<()>(1);
        let (told, name) = (Arc::downgrade(core), node.resolved(topic));
        let node = node.downgrade();
        let thread = std::thread::Builder::new().name("ros-peers".to_owned());
        thread
            .spawn(move || {
                while ended.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                    let (Some(node), Some(core)) = (node.upgrade(), told.upgrade()) else {
                        return;
                    };
                    // A master that does not answer says nothing.
                    if let Some(nodes) = node.other_publishers(&name) {
                        lock(&core).others(&name, nodes);
                    }
                }
            })
            .map_err(RosArmError::Thread)?;
        Ok(Self { _end: end })
    }
}
