//! A watchdog between a program and velocity controllers: `ros_control`'s hold the last velocity
//! that they heard for ever, so a program that dies leaves the arm moving.
//!
//! The relay runs beside the controllers, forwards velocities, and sends zeros when they stop. One
//! publisher at a time has the arm: others are passed over until it is silent.

use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::arm::{Refused, RosArmError};
use crate::msg::std_msgs::Float64MultiArray;
use crate::seam::{Inlet, Node, Outlet, Quality, lock};

/// How long zeros are sent after velocities have stopped, and at the start.
const ZEROS: Duration = Duration::from_secs(1);
/// Wait between two looks, and between two zeros.
const PERIOD: Duration = Duration::from_millis(10);
/// Looks between two questions to the master.
const LOOKS: u32 = 50;
/// Shortest time between two complaints of one kind.
const COMPLAINT: Duration = Duration::from_secs(1);

/// What a relay connects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RelayOptions {
    /// Topic of the program's velocities (`std_msgs/Float64MultiArray`).
    pub input: String,
    /// Topic of the controllers' velocities (`std_msgs/Float64MultiArray`).
    pub output: String,
    /// Joints of the arm.
    pub joints: usize,
    /// Silence after which zeros are sent.
    pub silence: Duration,
}

/// A relay that cannot start.
#[derive(Debug, thiserror::Error)]
pub enum RelayError {
    /// It would feed itself.
    #[error("input and output of the relay are one topic: {topic}")]
    Loop {
        /// The topic.
        topic: String,
    },
    /// A topic cannot be registered, or another node commands the controllers.
    #[error(transparent)]
    Arm(#[from] RosArmError),
}

/// The relay; dropping it sends zeros and ends it.
#[derive(Debug)]
pub struct Relay {
    end: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Relay {
    /// Sends zeros, then forwards.
    ///
    /// # Errors
    /// See [`RelayError`].
    pub fn start(node: &Node, options: &RelayOptions) -> Result<Self, RelayError> {
        let output = node.resolved(&options.output);
        if node.resolved(&options.input) == output {
            return Err(RelayError::Loop { topic: output });
        }
        let nodes = node.other_publishers(&output).unwrap_or_default();
        if !nodes.is_empty() {
            let topic = output;
            return Err(RosArmError::from(Refused::SecondController { topic, nodes }).into());
        }
        let velocities =
            Outlet::new(node, &options.output, Quality::Event(1)).map_err(RosArmError::from)?;
        let gate = Arc::new(Mutex::new(Gate::new(options, now())));
        let line = Arc::new(Line {
            node: node.clone(),
            output,
            velocities,
            gate,
        });
        let forwarding = Arc::downgrade(&line);
        let newest = Quality::Stream(1);
        Inlet::open_named::<Float64MultiArray>(
            node,
            &options.input,
            newest,
            move |message, from| {
                if let Some(line) = forwarding.upgrade() {
                    line.forward(message, from);
                }
            },
        )
        .map_err(RosArmError::from)?;
        let (end, ended) = sync_channel::<()>(1);
        let thread = std::thread::Builder::new()
            .name("ros-relay".to_owned())
            .spawn(move || {
                for look in 1_u32.. {
                    let over = ended.recv_timeout(PERIOD) != Err(RecvTimeoutError::Timeout);
                    line.watch(over);
                    if over {
                        return;
                    }
                    if look.is_multiple_of(LOOKS) {
                        line.look_for_others();
                    }
                }
            })
            .map_err(RosArmError::Thread)?;
        Ok(Self {
            end: Some(end),
            thread: Some(thread),
        })
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.end = None;
        if let Some(thread) = self.thread.take() {
            // A panic has been reported where it happened.
            let _ = thread.join();
        }
    }
}

/// What is between the topics.
struct Line {
    node: Node,
    output: String,
    velocities: Outlet<Float64MultiArray>,
    gate: Arc<Mutex<Gate>>,
}

impl Line {
    fn forward(&self, message: Float64MultiArray, from: &str) {
        // Held while sending, so that no zeros come between a verdict and its message.
        let mut gate = lock(&self.gate);
        let complaint = match gate.admit(now(), &message.data, from) {
            Ok(()) => return self.velocities.send(message),
            Err(complaint) => gate.complain(now(), complaint),
        };
        drop(gate);
        if let Some(complaint) = complaint {
            self.node.warn(&complaint);
        }
    }

    /// Sends the zeros that are due; at the end, always.
    fn watch(&self, over: bool) {
        let mut gate = lock(&self.gate);
        let (zeros, news) = gate.watch(now());
        if zeros || over {
            self.velocities.send(Float64MultiArray {
                data: vec![0.0; gate.joints],
                ..Float64MultiArray::default()
            });
        }
        drop(gate);
        if let Some(news) = news {
            self.node.warn(&news);
        }
    }

    fn look_for_others(&self) {
        let Some(nodes) = self.node.other_publishers(&self.output) else {
            return;
        };
        let topic = self.output.clone();
        let mut gate = lock(&self.gate);
        gate.others =
            (!nodes.is_empty()).then(|| Refused::SecondController { topic, nodes }.to_string());
    }
}

#[expect(clippy::disallowed_methods, reason = "silence is wall-clock time")]
fn now() -> Instant {
    Instant::now()
}

/// Which velocities pass, and when zeros are due: no I/O.
#[derive(Debug)]
struct Gate {
    joints: usize,
    silence: Duration,
    /// Who has the arm, and since when it is silent.
    stream: Option<(String, Instant)>,
    /// Zeros are due until then.
    zeros_until: Instant,
    /// Others that command the controllers themselves.
    others: Option<String>,
    said: Option<Instant>,
}

impl Gate {
    fn new(options: &RelayOptions, now: Instant) -> Self {
        Self {
            joints: options.joints,
            silence: options.silence,
            stream: None,
            // An arm that a relay before this one left moving stops.
            zeros_until: now + ZEROS,
            others: None,
            said: None,
        }
    }

    /// Whether these velocities may pass; else why not.
    fn admit(&mut self, now: Instant, rates: &[f64], from: &str) -> Result<(), String> {
        if let Some(others) = &self.others {
            return Err(format!("not forwarding: {others}"));
        }
        if rates.len() != self.joints || !rates.iter().all(|rate| rate.is_finite()) {
            // As good as silence: the watchdog sends zeros.
            return Err(format!(
                "not forwarding what {from} sends: {rates:?} is not a finite rate for each of {} \
                 joints",
                self.joints
            ));
        }
        match &mut self.stream {
            Some((owner, last)) if owner == from => *last = now,
            Some((owner, _)) => {
                return Err(format!(
                    "not forwarding what {from} sends: {owner} has the arm"
                ));
            }
            None => self.stream = Some((from.to_owned(), now)),
        }
        self.zeros_until = now;
        Ok(())
    }

    /// Whether zeros are due, and what is to be said of it.
    fn watch(&mut self, now: Instant) -> (bool, Option<String>) {
        let silent = self.stream.take_if(|(_, last)| {
            self.others.is_some() || now.saturating_duration_since(*last) >= self.silence
        });
        let news = silent.map(|(owner, last)| {
            self.zeros_until = now + ZEROS;
            match &self.others {
                Some(others) => format!("the arm is stopped: {others}"),
                None => format!(
                    "no velocities from {owner} for {} ms: the arm is stopped",
                    now.saturating_duration_since(last).as_millis()
                ),
            }
        });
        (now < self.zeros_until, news)
    }

    /// The complaint, unless there was one a moment ago.
    fn complain(&mut self, now: Instant, complaint: String) -> Option<String> {
        let said = self.said.is_some_and(|last| now < last + COMPLAINT);
        (!said).then(|| {
            self.said = Some(now);
            complaint
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SILENCE: Duration = Duration::from_millis(100);

    fn gate(now: Instant) -> Gate {
        let options = RelayOptions {
            input: "in".to_owned(),
            output: "out".to_owned(),
            joints: 2,
            silence: SILENCE,
        };
        Gate::new(&options, now)
    }

    #[test]
    fn zeros_come_at_the_start_and_when_velocities_stop() {
        let start = now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut gate = gate(start);
        assert!(gate.watch(at(10)).0, "at the start");
        gate.admit(at(20), &[0.1, 0.0], "/a").unwrap();
        for ms in (30..120).step_by(10) {
            assert!(!gate.watch(at(ms)).0, "{ms}");
        }
        let (zeros, news) = gate.watch(at(120));
        assert!(zeros && news.unwrap().contains("/a"));
        assert!(gate.watch(at(1100)).0);
        assert_eq!(gate.watch(at(1130)), (false, None), "then it is silent");
    }

    #[test]
    fn one_publisher_has_the_arm_until_it_is_silent() {
        let start = now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut gate = gate(start);
        gate.admit(at(0), &[0.1, 0.0], "/a").unwrap();
        let refused = gate.admit(at(50), &[0.5, 0.0], "/b").unwrap_err();
        assert!(refused.contains("/a has the arm"), "{refused}");
        assert!(gate.watch(at(101)).0);
        gate.admit(at(110), &[0.5, 0.0], "/b").unwrap();
        assert!(!gate.watch(at(120)).0);
    }

    #[test]
    fn nonsense_is_silence_and_another_controller_stops_everything() {
        let start = now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut gate = gate(start);
        gate.admit(at(0), &[0.1, 0.0], "/a").unwrap();
        for bad in [&[0.1][..], &[0.1, f64::NAN], &[0.0; 3]] {
            assert!(gate.admit(at(90), bad, "/a").is_err());
        }
        assert!(gate.watch(at(100)).0);
        gate.admit(at(110), &[0.1, 0.0], "/a").unwrap();
        gate.others = Some("another".to_owned());
        assert!(gate.watch(at(111)).0, "at once");
        assert!(gate.admit(at(112), &[0.1, 0.0], "/a").is_err());
    }
}
