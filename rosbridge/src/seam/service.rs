//! A service that the node offers.

use std::sync::{Arc, Mutex};

use rosrust::ServicePair;
use rosrust::api::Ros;

use super::{Node, NodeError, Part, lock, reason, sockets};

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
    ) -> Result<(), NodeError> {
        let part = ServicePart::<S> {
            name: name.to_owned(),
            handler: Arc::new(handler),
            offered: Mutex::default(),
        };
        node.add(name, Arc::new(part))
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
