//! A service that the node offers.

use std::sync::{Arc, Mutex};

#[cfg(feature = "ros2")]
use rosrust::RosMsg;
use rosrust::api::Ros;
use rosrust::{Message, ServicePair};

use super::ros1::{Part, reason};
use super::{Carrier, Node, NodeError, lock, sockets};

/// Keeps a service offered, also over masters that go and come back; it ends with the node.
pub(crate) struct Service;

type Handler<S> = dyn Fn(<S as ServicePair>::Request) -> Result<<S as ServicePair>::Response, String>
    + Send
    + Sync;

struct ServicePart<S: ServicePair> {
    name: String,
    handler: Arc<Handler<S>>,
    offered: Mutex<(Option<rosrust::Service>, Vec<u16>)>,
}

impl Service {
    /// Offers a service; `handler` runs on a thread of the request.
    pub(crate) fn open<S: ServicePair>(
        node: &Node,
        name: &str,
        handler: impl Fn(S::Request) -> Result<S::Response, String> + Send + Sync + 'static,
    ) -> Result<(), NodeError>
    where
        S::Request: Message,
        S::Response: Message,
    {
        match &node.inner.carrier {
            Carrier::Ros1(ros) => {
                let part = ServicePart::<S> {
                    name: name.to_owned(),
                    handler: Arc::new(handler),
                    offered: Mutex::default(),
                };
                ros.add(name, Arc::new(part))
            }
            #[cfg(feature = "ros2")]
            Carrier::Ros2(ros) => {
                let definitions = [S::Request::msg_definition(), S::Response::msg_definition()];
                ros.server(name, &S::msg_type(), &definitions, move |mut bytes| {
                    let request = S::Request::decode(&mut bytes).ok()?;
                    let response = handler(request).ok()?;
                    let mut bytes = Vec::new();
                    response.encode(&mut bytes).ok()?;
                    Some(bytes)
                })
            }
        }
    }
}

impl<S: ServicePair> Part for ServicePart<S> {
    fn register(&self, ros: &Ros) -> Result<(), NodeError> {
        self.close();
        let handler = Arc::clone(&self.handler);
        let (service, ports) =
            sockets::limited(|| ros.service::<S, _>(&self.name, move |request| handler(request)));
        let service = service.map_err(|error| NodeError::Register {
            name: self.name.clone(),
            reason: reason(&error),
        })?;
        *lock(&self.offered) = (Some(service), ports);
        Ok(())
    }

    fn close(&self) {
        let (service, ports) = std::mem::take(&mut *lock(&self.offered));
        drop(service);
        sockets::wake(&ports);
    }
}
