//! A topic to which the node publishes.

use std::sync::{Arc, Mutex};

use rosrust::api::Ros;
use rosrust::{Message, Publisher};

use super::{Node, NodeError, Part, lock, reason, sockets};

/// Publishes; survives a master that goes and comes back. Never blocks: what a slow subscriber
/// does not take is dropped, oldest first.
pub(crate) struct Outlet<M: Message> {
    part: Arc<OutletPart<M>>,
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
    /// Advertises `topic`; `latched`: the last message is sent to every new subscriber.
    pub(crate) fn new(
        node: &Node,
        topic: &str,
        queue: usize,
        latched: bool,
    ) -> Result<Self, NodeError> {
        let state = Mutex::new(State {
            publisher: None,
            ports: Vec::new(),
            last: None,
        });
        let part = Arc::new(OutletPart {
            topic: topic.to_owned(),
            queue,
            latched,
            state,
        });
        node.add(topic, Arc::clone(&part) as Arc<dyn Part>)?;
        Ok(Self { part })
    }

    /// Hands a message over. While a registration is renewed, messages are lost.
    pub(crate) fn send(&self, message: M) {
        let mut state = lock(&self.part.state);
        if self.part.latched {
            state.last = Some(message.clone());
        }
        if let Some(publisher) = &state.publisher {
            // Only encoding to memory can fail, and it does not.
            let _ = publisher.send(message);
        }
    }

    /// Number of connected subscribers.
    pub(crate) fn subscribers(&self) -> usize {
        lock(&self.part.state)
            .publisher
            .as_ref()
            .map_or(0, Publisher::subscriber_count)
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
