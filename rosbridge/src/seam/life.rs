//! Whether the node still is what ROS knows by its name.

use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rosrust::api::{Ros, resolve};

use super::{lock, lookup};

/// How often the node looks whether it was asked to end.
const PERIOD: Duration = Duration::from_millis(20);

/// Why a node is a node no longer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NodeEnd {
    /// Somebody asked it to end.
    #[error("the ROS node {name} was asked to shut down (rosnode kill)")]
    Shutdown {
        /// The node.
        name: String,
    },
    /// Another node has its name, and its services with it.
    #[error(
        "another node took the name {name} (at {uri}), and what was offered under it: start nodes \
         with names of their own (__name:=)"
    )]
    Replaced {
        /// The node.
        name: String,
        /// Address of the other one.
        uri: String,
    },
}

type Listener = Box<dyn Fn(&NodeEnd) + Send>;

#[derive(Default)]
struct State {
    end: Option<NodeEnd>,
    listeners: Vec<Listener>,
}

/// The end of a node, and who wants to know of it.
#[derive(Clone, Default)]
pub(super) struct Life {
    state: Arc<Mutex<State>>,
    watching: Arc<Mutex<Option<SyncSender<()>>>>,
}

impl Life {
    /// Looks for requests to end, on a thread of its own: the one that asks the master may hang
    /// with it.
    pub(super) fn watch(&self, ros: Arc<Ros>) {
        let (stop, stopped) = sync_channel::<()>(1);
        let life = self.clone();
        let thread = std::thread::Builder::new().name("ros-life".to_owned());
        let running = thread.spawn(move || {
            while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                if !ros.is_ok() {
                    let name = ros.name().to_owned();
                    let usurper = Self::usurper(&ros).ok().flatten();
                    life.end(&usurper.unwrap_or(NodeEnd::Shutdown { name }));
                    return;
                }
            }
        });
        *lock(&self.watching) = running.ok().map(|_| stop);
    }

    /// The end by another node of the same name, if the master knows one.
    ///
    /// # Errors
    /// The master does not answer.
    pub(super) fn usurper(ros: &Ros) -> std::io::Result<Option<NodeEnd>> {
        let name = ros.name().to_owned();
        let uri = lookup::node_uri(&resolve::master(), &name, &name)?;
        let other = uri.filter(|uri| *uri != ros.uri());
        Ok(other.map(|uri| NodeEnd::Replaced { name, uri }))
    }

    /// The node has ended; only the first reason counts.
    pub(super) fn end(&self, end: &NodeEnd) {
        let listeners = {
            let mut state = lock(&self.state);
            if state.end.is_some() {
                return;
            }
            state.end = Some(end.clone());
            std::mem::take(&mut state.listeners)
        };
        for listener in listeners {
            listener(end);
        }
    }

    pub(super) fn ended(&self) -> Option<NodeEnd> {
        lock(&self.state).end.clone()
    }

    /// Calls `listener` when the node has ended, at once if it has.
    pub(super) fn on_end(&self, listener: Listener) {
        let ended = {
            let mut state = lock(&self.state);
            match state.end.clone() {
                Some(end) => end,
                None => return state.listeners.push(listener),
            }
        };
        listener(&ended);
    }

    /// Looks no longer: the node ends by itself.
    pub(super) fn stop(&self) {
        *lock(&self.watching) = None;
        lock(&self.state).listeners.clear();
    }
}
