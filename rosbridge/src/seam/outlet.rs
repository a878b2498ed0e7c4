//! A topic to which the node publishes.

use std::sync::{Arc, Mutex};

use rosrust::api::Ros;
use rosrust::{Message, Publisher};

use super::ros1::{Part, reason};
#[cfg(feature = "ros2")]
use super::ros2::Outgoing;
use super::{Carrier, Node, NodeError, Quality, lock, sockets};

/// Publishes; survives a master that goes and comes back. Never blocks: what a slow subscriber
/// does not take is dropped.
pub(crate) struct Outlet<M: Message> {
    way: Way<M>,
}

enum Way<M: Message> {
    Ros1(Arc<OutletPart<M>>),
    /// And whether it is latched.
    #[cfg(feature = "ros2")]
    Ros2(Outgoing, bool),
}

struct OutletPart<M: Message> {
    topic: String,
    queue: usize,
    latched: bool,
    state: Mutex<State<M>>,
}

struct State<M: Message> {
    publisher: Option<Publisher<M>>,
    ports: Vec<u16>,
    last: Option<M>,
}

impl<M: Message> Outlet<M> {
    /// Advertises `topic`.
    pub(crate) fn new(node: &Node, topic: &str, quality: Quality) -> Result<Self, NodeError> {
        let latched = quality.is_latched();
        let way = match &node.inner.carrier {
            Carrier::Ros1(ros) => {
                let state = Mutex::new(State {
                    publisher: None,
                    ports: Vec::new(),
                    last: None,
                });
                let part = Arc::new(OutletPart {
                    topic: topic.to_owned(),
                    queue: quality.queue(),
                    latched,
                    state,
                });
                ros.add(topic, Arc::clone(&part) as Arc<dyn Part>)?;
                Way::Ros1(part)
            }
            #[cfg(feature = "ros2")]
            Carrier::Ros2(ros) => {
                let (kind, definition) = (M::msg_type(), M::msg_definition());
                let outgoing = ros.writer(topic, &kind, &definition, quality)?;
                Way::Ros2(outgoing, latched)
            }
        };
        Ok(Self { way })
    }

    /// Hands a message over. While a registration is renewed, messages are lost.
    pub(crate) fn send(&self, message: M) {
        match &self.way {
            Way::Ros1(part) => part.send(message),
            #[cfg(feature = "ros2")]
            Way::Ros2(outgoing, _) => {
                let mut bytes = Vec::new();
                // Only encoding to memory can fail, and it does not.
                if message.encode(&mut bytes).is_ok() {
                    outgoing.send(&bytes);
                }
            }
        }
    }

    /// Number of connected subscribers.
    pub(crate) fn subscribers(&self) -> usize {
        match &self.way {
            Way::Ros1(part) => lock(&part.state)
                .publisher
                .as_ref()
                .map_or(0, Publisher::subscriber_count),
            #[cfg(feature = "ros2")]
            Way::Ros2(outgoing, _) => outgoing.readers(),
        }
    }

    /// Whether all that was sent lately waits for late subscribers; ROS 1 keeps the last one alone.
    pub(crate) fn keeps(&self) -> bool {
        match &self.way {
            Way::Ros1(_) => false,
            #[cfg(feature = "ros2")]
            Way::Ros2(_, latched) => *latched,
        }
    }
}

impl<M: Message> OutletPart<M> {
    fn send(&self, message: M) {
        let mut state = lock(&self.state);
        if self.latched {
            state.last = Some(message.clone());
        }
        if let Some(publisher) = &state.publisher {
            // Only encoding to memory can fail, and it does not.
            let _ = publisher.send(message);
        }
    }
}

impl<M: Message> Part for OutletPart<M> {
    fn register(&self, ros: &Ros) -> Result<(), NodeError> {
        self.close();
        let (publisher, ports) = sockets::limited(|| ros.publish::<M>(&self.topic, self.queue));
        let mut publisher = publisher.map_err(|error| NodeError::Register {
            name: self.topic.clone(),
            reason: reason(&error),
        })?;
        publisher.set_latching(self.latched);
        let mut state = lock(&self.state);
        if let Some(last) = &state.last {
            let _ = publisher.send(last.clone());
        }
        state.publisher = Some(publisher);
        state.ports = ports;
        Ok(())
    }

    fn close(&self) {
        // Dropping asks the master: not under the lock, behind which senders wait.
        let (publisher, ports) = {
            let mut state = lock(&self.state);
            (state.publisher.take(), std::mem::take(&mut state.ports))
        };
        drop(publisher);
        sockets::wake(&ports);
    }
}
