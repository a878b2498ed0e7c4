//! A topic to which the node listens.

use std::sync::{Arc, Mutex};

use rosrust::api::Ros;
use rosrust::{Message, Subscriber};

use super::ros1::{Part, reason};
use super::{Carrier, Node, NodeError, Quality, lock};

/// Keeps a subscription alive, also over masters that go and come back; it ends with the node.
pub(crate) struct Inlet;

/// What becomes of a message, and of the name of the node that published it.
type Handler<M> = dyn Fn(M, &str) + Send + Sync;

struct InletPart<M: Message> {
    topic: String,
    queue: usize,
    handler: Arc<Handler<M>>,
    subscriber: Mutex<Option<Subscriber>>,
}

impl Inlet {
    /// Subscribes; `handler` runs on a thread of the topic and must not block.
    pub(crate) fn open<M: Message>(
        node: &Node,
        topic: &str,
        quality: Quality,
        handler: impl Fn(M) + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        Self::open_named(node, topic, quality, move |message, _| handler(message))
    }

    /// Subscribes; `handler` is also told the name of the node that published the message.
    pub(crate) fn open_named<M: Message>(
        node: &Node,
        topic: &str,
        quality: Quality,
        handler: impl Fn(M, &str) + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        match &node.inner.carrier {
            Carrier::Ros1(ros) => {
                let part = InletPart {
                    topic: topic.to_owned(),
                    queue: quality.queue(),
                    handler: Arc::new(handler),
                    subscriber: Mutex::new(None),
                };
                ros.add(topic, Arc::new(part))
            }
            #[cfg(feature = "ros2")]
            Carrier::Ros2(ros) => {
                let (kind, definition) = (M::msg_type(), M::msg_definition());
                ros.reader(
                    topic,
                    &kind,
                    &definition,
                    quality,
                    move |mut bytes, from| {
                        if let Ok(message) = M::decode(&mut bytes) {
                            handler(message, from);
                        }
                    },
                )
            }
        }
    }
}

impl<M: Message> Part for InletPart<M> {
    fn register(&self, ros: &Ros) -> Result<(), NodeError> {
        self.close();
        let handler = Arc::clone(&self.handler);
        let subscriber = ros
            .subscribe_with_ids::<M, _>(&self.topic, self.queue, move |message, from| {
                handler(message, from);
            })
            .map_err(|error| NodeError::Register {
                name: self.topic.clone(),
                reason: reason(&error),
            })?;
        *lock(&self.subscriber) = Some(subscriber);
        Ok(())
    }

    fn close(&self) {
        let subscriber = lock(&self.subscriber).take();
        drop(subscriber);
    }
}
