//! Requests on their way to the run.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use hal::request::{Command, Request};

use super::{Budget, now};

/// Requests that may wait to be polled.
const QUEUE: usize = 16;
/// Age at which a request is refused: as over ROS.
const AGE_LIMIT: Duration = Duration::from_millis(100);
/// Targets that are judged in a second: judging one costs the run up to a millisecond.
const TARGETS_HZ: f64 = 5.0;

#[derive(Debug)]
struct Received {
    request: Request,
    at: Instant,
}

/// The run's end.
#[derive(Debug)]
pub(crate) struct Mailbox {
    stops: Receiver<Received>,
    rest: Receiver<Received>,
}

/// The other end; every connection has one.
#[derive(Clone, Debug)]
pub(crate) struct Post {
    stops: SyncSender<Received>,
    rest: SyncSender<Received>,
    targets: Arc<Mutex<Budget>>,
}

/// An empty mailbox, and what posts to it.
pub(crate) fn mailbox() -> (Post, Mailbox) {
    let (stops, stops_received) = sync_channel(QUEUE);
    let (rest, rest_received) = sync_channel(QUEUE);
    let post = Post {
        stops,
        rest,
        targets: Arc::new(Mutex::new(Budget::new(TARGETS_HZ))),
    };
    let mailbox = Mailbox {
        stops: stops_received,
        rest: rest_received,
    };
    (post, mailbox)
}

impl Post {
    /// Hands a request over, or refuses it where there is no room. What stops the arm has a queue of
    /// its own that nothing else fills, and overtakes.
    pub(crate) fn send(&self, request: Request) {
        let at = now();
        let queue = match request.command {
            Command::Stop | Command::Pause | Command::Enable(false) => &self.stops,
            Command::Target(_) => {
                let mut targets = self.targets.lock().unwrap_or_else(PoisonError::into_inner);
                if !targets.spend(at, 1.0) {
                    return request.refuse(format!("more than {TARGETS_HZ} targets a second"));
                }
                &self.rest
            }
            _ => &self.rest,
        };
        match queue.try_send(Received { request, at }) {
            Ok(()) => {}
            Err(TrySendError::Full(unheard)) => unheard.request.refuse("too many requests wait"),
            Err(TrySendError::Disconnected(unheard)) => {
                unheard.request.refuse("nobody looks at requests any more");
            }
        }
    }
}

impl Mailbox {
    /// The next request that is not too old; older ones are refused and skipped, but for those that
    /// stop the arm.
    pub(crate) fn poll(&self) -> Option<Request> {
        if let Ok(received) = self.stops.try_recv() {
            return Some(received.request);
        }
        self.rest.try_iter().find_map(|received| {
            if received.at.elapsed() <= AGE_LIMIT {
                return Some(received.request);
            }
            let reason = format!("not looked at within {} ms", AGE_LIMIT.as_millis());
            received.request.refuse(reason);
            None
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Position;
    use std::sync::mpsc::channel;

    #[test]
    fn a_stop_overtakes_a_flood() {
        let (post, mailbox) = mailbox();
        let (sender, answers) = channel();
        for _ in 0..100 {
            let sender = sender.clone();
            post.send(Request::new(Command::Start, move |verdict| {
                sender.send(verdict).unwrap();
            }));
        }
        post.send(Request::new(Command::Stop, |_| {}));
        assert_eq!(answers.try_iter().count(), 100 - QUEUE);
        assert_eq!(mailbox.poll().unwrap().command, Command::Stop);
        assert_eq!(mailbox.poll().unwrap().command, Command::Start);
    }

    #[test]
    fn targets_do_not_come_faster_than_they_are_judged() {
        let (post, mailbox) = mailbox();
        let target = Command::Target(Position::new([0.0, 0.0, 0.1].into()));
        for _ in 0..100 {
            post.send(Request::new(target, |_| {}));
        }
        let taken = std::iter::from_fn(|| mailbox.poll()).count();
        assert!((5..=6).contains(&taken), "{taken}");
    }

    #[test]
    fn a_run_that_is_gone_refuses() {
        let (post, mailbox) = mailbox();
        drop(mailbox);
        let (sender, answers) = channel();
        post.send(Request::new(Command::Stop, move |verdict| {
            sender.send(verdict).unwrap();
        }));
        assert!(answers.recv().unwrap().is_err());
    }
}
