//! Notices a master that went and came back, says so, and registers everything anew.

use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rosrust::api::{Ros, resolve};

use super::life::Life;
use super::lock;
use super::ros1::Parts;
use super::speech::{Severity, Speech};

const PERIOD: Duration = Duration::from_millis(500);
/// So many questions in a row without an answer, and the master is lost.
const LOST: u32 = 2;

/// The thread that asks the master twice a second whether it knows the node. It may hang with
/// the master; nothing waits for it.
pub(super) struct Watch {
    end: Mutex<Option<SyncSender<()>>>,
}

impl Watch {
    pub(super) fn start(ros: Arc<Ros>, parts: Arc<Parts>, life: Life, speech: Arc<Speech>) -> Self {
        let (end, ended) = sync_channel::<()>(1);
        let thread = std::thread::Builder::new().name("ros-watch".to_owned());
        let running = thread.spawn(move || {
            let master = resolve::master();
            let mut unanswered = 0_u32;
            while ended.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                speech.repeat();
                let usurper = Life::usurper(&ros);
                if let Ok(Some(end)) = &usurper {
                    life.end(end);
                }
                if life.ended().is_some() {
                    // The name is another's, or nobody's: to register anew would fight for it.
                    return;
                }
                if usurper.is_err() {
                    unanswered = unanswered.saturating_add(1);
                    if unanswered == LOST {
                        let text = format!(
                            "the ROS master at {master} does not answer: connections go on, nobody \
                             new finds this node; when the master is back, all is registered anew"
                        );
                        speech.say(Severity::Warning, &text);
                    }
                    continue;
                }
                if unanswered >= LOST {
                    let text = format!("the ROS master at {master} answers again");
                    speech.say(Severity::Info, &text);
                }
                unanswered = 0;
                let known = lock(&parts.list).clone();
                if known.is_empty() || is_registered(&ros) != Some(false) {
                    continue;
                }
                for part in known {
                    // Failing, the next round tries again.
                    let _ = parts.register(part.as_ref(), &ros);
                }
                let text = format!("registered anew with the ROS master at {master}");
                speech.say(Severity::Info, &text);
            }
        });
        Self {
            end: Mutex::new(running.ok().map(|_| end)),
        }
    }

    pub(super) fn stop(&self) {
        *lock(&self.end) = None;
    }
}

/// Whether the master knows the node; nothing if it does not answer. `/rosout` does not count:
/// rosrust has it, too.
fn is_registered(ros: &Ros) -> Option<bool> {
    let state = ros.state().ok()?;
    let mut entries = state
        .publishers
        .iter()
        .chain(&state.subscribers)
        .chain(&state.services);
    Some(entries.any(|entry| {
        entry.name != "/rosout" && entry.connections.iter().any(|name| name == ros.name())
    }))
}
