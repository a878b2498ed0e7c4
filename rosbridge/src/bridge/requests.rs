//! Requests from ROS: services and the target topic.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use hal::frame::{Frame, LeftCamera, World};
use hal::request::{Command, Request, Verdict};
use hal::{Position, Transform};
use nalgebra::Vector3;

use crate::convert::{self, ConvertError};
use crate::msg::{geometry_msgs, std_msgs, std_srvs};
use crate::seam::{Inlet, Node, NodeError, Outlet, Quality, Service, Severity, WeakNode};

/// Topic of new targets (`geometry_msgs/PointStamped`).
const TARGET: &str = "target";
/// Frames of a target.
const FRAMES: &str = "left_camera_optical_frame or world";
/// Topic of what became of the newest one (`std_msgs/String`, latched).
const TARGET_ANSWER: &str = "target/answer";

/// Requests that may wait to be polled.
const QUEUE: usize = 16;
/// Age at which a request is refused.
const AGE_LIMIT: Duration = Duration::from_millis(100);
/// Longest wait of a service's caller for the run's verdict.
const ANSWER_DEADLINE: Duration = Duration::from_secs(1);

/// A request and when it came.
#[derive(Debug)]
pub(crate) struct Received {
    request: Request,
    at: Instant,
}

impl Received {
    #[expect(
        clippy::disallowed_methods,
        reason = "the age of a request is wall-clock time"
    )]
    fn new(request: Request) -> Self {
        Self {
            request,
            at: Instant::now(),
        }
    }

    /// The request, if it is not too old; otherwise it is refused.
    pub(crate) fn fresh(self) -> Option<Request> {
        if self.at.elapsed() <= AGE_LIMIT {
            return Some(self.request);
        }
        self.request
            .refuse(format!("not looked at within {} ms", AGE_LIMIT.as_millis()));
        None
    }
}

/// A queue of requests, and what fills it.
pub(crate) struct Requests<'a> {
    node: &'a Node,
    sender: SyncSender<Received>,
    receiver: Receiver<Received>,
}

impl<'a> Requests<'a> {
    pub(crate) fn new(node: &'a Node) -> Self {
        let (sender, receiver) = sync_channel(QUEUE);
        Self {
            node,
            sender,
            receiver,
        }
    }

    /// The end to poll.
    pub(crate) fn receiver(self) -> Receiver<Received> {
        self.receiver
    }

    /// Offers a service that requests `command`.
    pub(crate) fn trigger(&self, name: &str, command: Command) -> Result<(), NodeError> {
        let (sender, answered) = (self.sender.clone(), self.answered(name));
        Service::open::<std_srvs::Trigger>(self.node, name, move |_| {
            let (success, message) = ask(&sender, command);
            answered(success, &message);
            Ok(std_srvs::TriggerRes { success, message })
        })
    }

    /// Offers a service that allows or forbids motion.
    pub(crate) fn enable(&self, name: &str) -> Result<(), NodeError> {
        let (sender, answered) = (self.sender.clone(), self.answered(name));
        Service::open::<std_srvs::SetBool>(self.node, name, move |request| {
            let (success, message) = ask(&sender, Command::Enable(request.data));
            answered(success, &message);
            Ok(std_srvs::SetBoolRes { success, message })
        })
    }

    /// Says what the service `name` answered, for who looks for it.
    fn answered(&self, name: &str) -> impl Fn(bool, &str) + Send + Sync + 'static {
        let (node, name) = (self.node.downgrade(), name.to_owned());
        move |success, message| {
            if let Some(node) = node.upgrade() {
                let verdict = if success { "accepted" } else { "refused" };
                node.say(Severity::Debug, &format!("{name} {verdict}: {message}"));
            }
        }
    }

    /// Listens for targets in the stereo frame or in the world; what becomes of one is said.
    fn target(
        &self,
        world_from_left_camera: Transform<World, LeftCamera>,
    ) -> Result<(), NodeError> {
        let answers = Arc::new(Answers {
            node: self.node.downgrade(),
            topic: Outlet::new(self.node, TARGET_ANSWER, Quality::Latched(1))?,
        });
        let sender = self.sender.clone();
        let quality = Quality::Event(1);
        Inlet::open::<geometry_msgs::PointStamped>(self.node, TARGET, quality, move |message| {
            let target = match target(&message, &world_from_left_camera) {
                Ok(target) => target,
                Err(why) => return answers.say(Err(why.to_string())),
            };
            let answering = Arc::clone(&answers);
            let request = Request::new(Command::Target(target), move |verdict| {
                answering.say(verdict);
            });
            if let Err(unsent) = sender.try_send(Received::new(request)) {
                let (TrySendError::Full(unheard) | TrySendError::Disconnected(unheard)) = unsent;
                unheard.request.refuse("nobody looks at requests");
            }
        })
    }
}

/// Who publishes a target cannot be answered: it is said to all, and refusals on `/rosout` too.
struct Answers {
    node: WeakNode,
    topic: Outlet<std_msgs::String>,
}

impl Answers {
    fn say(&self, verdict: Verdict) {
        let data = match verdict {
            Ok(text) => text,
            Err(reason) => {
                let text = format!("target refused: {reason}");
                if let Some(node) = self.node.upgrade() {
                    node.warn(&text);
                }
                text
            }
        };
        self.topic.send(std_msgs::String { data });
    }
}

/// Everything that a run may be asked for.
pub(super) fn open(
    node: &Node,
    world_from_left_camera: Transform<World, LeftCamera>,
) -> Result<Receiver<Received>, NodeError> {
    let requests = Requests::new(node);
    for (name, command) in [
        ("~start", Command::Start),
        ("~stop", Command::Stop),
        ("~pause", Command::Pause),
        ("~retract", Command::Retract),
        ("~home", Command::Home),
        ("~clear_fault", Command::ClearFault),
    ] {
        requests.trigger(name, command)?;
    }
    requests.enable("~enable")?;
    requests.target(world_from_left_camera)?;
    Ok(requests.receiver())
}

/// Queues a request and waits for the verdict.
fn ask(sender: &SyncSender<Received>, command: Command) -> (bool, String) {
    let (answer, verdict) = sync_channel(1);
    let request = Request::new(command, move |verdict| {
        // The caller may have gone.
        let _ = answer.try_send(verdict);
    });
    match sender.try_send(Received::new(request)) {
        Ok(()) => {}
        Err(TrySendError::Full(_)) => return (false, "too many requests wait".to_owned()),
        Err(TrySendError::Disconnected(_)) => return (false, "the run has ended".to_owned()),
    }
    match verdict.recv_timeout(ANSWER_DEADLINE) {
        Ok(Ok(text)) => (true, text),
        Ok(Err(reason)) => (false, reason),
        Err(_) => (false, "no answer from the run".to_owned()),
    }
}

/// A target given in the stereo frame or in the world.
fn target(
    message: &geometry_msgs::PointStamped,
    world_from_left_camera: &Transform<World, LeftCamera>,
) -> Result<Position<LeftCamera>, ConvertError> {
    let point: Vector3<f64> = convert::from_point(&message.point);
    if !point.iter().all(|x| x.is_finite()) {
        return Err(ConvertError::NonFinite { field: "point" });
    }
    match message.header.frame_id.trim_start_matches('/') {
        LeftCamera::NAME => Ok(convert::position(&message.point)),
        World::NAME => {
            let in_world: Position<World> = convert::position(&message.point);
            Ok(world_from_left_camera.inverse() * in_world)
        }
        _ => Err(ConvertError::Frame {
            found: message.header.frame_id.clone(),
            expected: FRAMES,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    fn message(frame: &str, x: f64) -> geometry_msgs::PointStamped {
        geometry_msgs::PointStamped {
            header: convert::header(hal::Stamp::ZERO, frame, 0),
            point: geometry_msgs::Point { x, y: 0.2, z: 0.3 },
        }
    }

    #[test]
    fn targets_are_taken_in_both_frames_and_refused_elsewhere() {
        let pose = Isometry3::new(Vector3::new(0.4, 0.1, 0.2), Vector3::new(0.2, 0.1, -0.4));
        let world_from_left = Transform::assume(pose);
        let direct = target(&message(LeftCamera::NAME, 0.1), &world_from_left).unwrap();
        assert_eq!(direct.coords(), Vector3::new(0.1, 0.2, 0.3));
        let by_world = target(&message("world", 0.1), &world_from_left).unwrap();
        let back = (world_from_left * by_world).coords();
        assert!((back - Vector3::new(0.1, 0.2, 0.3)).norm() < 1e-15);
        let refused = target(&message("base_link", 0.1), &world_from_left).unwrap_err();
        for frame in ["base_link", LeftCamera::NAME, World::NAME] {
            assert!(refused.to_string().contains(frame), "{refused}");
        }
        assert!(target(&message("world", f64::NAN), &world_from_left).is_err());
    }

    #[test]
    fn callers_get_the_verdict_or_hear_that_there_is_none() {
        let (sender, receiver) = sync_channel(1);
        let asking = sender.clone();
        let caller = std::thread::spawn(move || ask(&asking, Command::Pause));
        let request = receiver.recv().unwrap().fresh().unwrap();
        assert_eq!(request.command, Command::Pause);
        request.refuse("not moving");
        assert_eq!(caller.join().unwrap(), (false, "not moving".to_owned()));

        sender
            .try_send(Received::new(Request::new(Command::Stop, |_| {})))
            .unwrap();
        assert_eq!(
            ask(&sender, Command::Stop),
            (false, "too many requests wait".to_owned())
        );
        drop(receiver);
        assert_eq!(
            ask(&sender, Command::Stop),
            (false, "the run has ended".to_owned())
        );
    }

    #[test]
    fn old_requests_are_refused() {
        let (answer, verdict) = sync_channel(1);
        let request = Request::new(Command::Start, move |verdict| {
            answer.try_send(verdict).unwrap();
        });
        let mut received = Received::new(request);
        received.at = received.at.checked_sub(2 * AGE_LIMIT).unwrap();
        assert!(received.fresh().is_none());
        assert!(verdict.recv().unwrap().unwrap_err().contains("100 ms"));
    }
}
