//! An arm moved by hand over ROS, while no insertion is under way: twists of the needle's base on
//! `twist_cmd` (`geometry_msgs/TwistStamped`) and joint trajectories on
//! `joint_trajectory_controller/command` (`trajectory_msgs/JointTrajectory`).
//!
//! What is older than 100 ms when it arrives or is looked at is dropped, as is what carries a stamp
//! from the future; the node says so on `/rosout`. A twist acts for 200 ms
//! and has to be renewed; a trajectory runs to its end, or until an empty one or a twist comes.

use std::fmt;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use hal::frame::{Frame, NeedleBase, World};
use hal::{ArmState, Joints, Stamp, Twist};

use crate::arm::skew;
use crate::convert;
use crate::msg::{geometry_msgs, trajectory_msgs};
use crate::seam::{Inlet, Node, NodeClock, NodeError, Quality, Time, WeakNode, lock};

/// Topic of the twists.
pub const TWISTS: &str = "twist_cmd";
/// Topic of the trajectories.
pub const TRAJECTORIES: &str = "joint_trajectory_controller/command";
/// Age at which a message is dropped.
const AGE_LIMIT: Duration = Duration::from_millis(100);
/// How far ahead of the present a stamp may be.
const AHEAD_LIMIT: Duration = Duration::from_millis(50);
/// Shortest time between two complaints.
const COMPLAINT: Duration = Duration::from_secs(1);
/// Silence after which a twist ends.
const SILENCE: Duration = Duration::from_millis(200);
/// Gain from the distance to a trajectory to a rate \[1/s\].
const GAIN: f64 = 5.0;
/// Distance at which a trajectory's end is reached \[rad\].
const REACHED: f64 = 1e-3;
/// Rate at which the arm counts as standing there \[rad/s\].
const AT_REST: f64 = 5e-3;
/// Longest wait for the arm at a trajectory's end.
const SETTLING: Duration = Duration::from_secs(2);

/// The axes of a twist; it is always that of the needle base's origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TwistAxes {
    /// Those of World.
    World,
    /// Those of the needle's base.
    NeedleBase,
}

/// Joint rates for a twist, from an arm's kinematics.
pub type ToRates = dyn Fn(&Joints, &Twist, TwistAxes) -> Joints + Send;

/// What was asked for.
#[derive(Clone, Debug, PartialEq)]
enum Motion {
    Twist(Twist, TwistAxes),
    Trajectory(Vec<Waypoint>),
}

/// A place on a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Waypoint {
    after: Duration,
    positions: Joints,
}

/// The motion in force and when it came.
#[derive(Clone, Debug)]
struct Active {
    motion: Motion,
    since: Stamp,
    from: Joints,
}

/// Listens to twists and trajectories.
pub struct Hand {
    arrived: Arc<Mutex<Option<(Stamp, Motion)>>>,
    active: Option<Active>,
}

impl Hand {
    /// Listens for an arm with these joints.
    ///
    /// # Errors
    /// The master does not register the topics.
    pub fn new(node: &Node, joint_names: &[String]) -> Result<Self, NodeError> {
        let arrived = Arc::<Mutex<Option<(Stamp, Motion)>>>::default();
        let (filled, clock) = (Arc::clone(&arrived), node.clock());
        let gate = Gate::new(node, TWISTS);
        Inlet::open::<geometry_msgs::TwistStamped>(
            node,
            TWISTS,
            Quality::Stream(1),
            move |message| {
                if gate.admits(message.header.stamp)
                    && let Some(motion) = twist(&message)
                {
                    *lock(&filled) = Some((clock.now(), motion));
                }
            },
        )?;
        let (filled, clock) = (Arc::clone(&arrived), node.clock());
        let (names, gate) = (joint_names.to_vec(), Gate::new(node, TRAJECTORIES));
        let quality = Quality::Event(1);
        Inlet::open::<trajectory_msgs::JointTrajectory>(
            node,
            TRAJECTORIES,
            quality,
            move |message| {
                if gate.admits(message.header.stamp)
                    && let Some(motion) = trajectory(&message, &names)
                {
                    *lock(&filled) = Some((clock.now(), motion));
                }
            },
        )?;
        Ok(Self {
            arrived,
            active: None,
        })
    }

    /// Joint rates for the present moment; nothing while nothing is asked for.
    pub fn rates(&mut self, now: Stamp, arm: &ArmState, to_rates: &ToRates) -> Option<Joints> {
        if let Some((arrived, motion)) = lock(&self.arrived).take()
            && now.since(arrived) <= AGE_LIMIT
        {
            self.active = Some(Active {
                motion,
                // A run that fell behind the node's time would hold on to it longer.
                since: arrived.min(now),
                from: arm.positions,
            });
        }
        let rates = self
            .active
            .as_ref()
            .and_then(|active| active.rates(now, arm, to_rates));
        if rates.is_none() {
            self.active = None;
        }
        rates
    }

    /// Goes straight to `goal` in joint space, the fastest joint at `speed` \[rad/s\].
    pub fn go(&mut self, now: Stamp, arm: &ArmState, goal: Joints, speed: f64) {
        let farthest = goal.zip(&arm.positions, |a, b| a - b).max_abs();
        let after = Duration::try_from_secs_f64(farthest / speed).unwrap_or(Duration::ZERO);
        self.active = Some(Active {
            motion: Motion::Trajectory(vec![Waypoint {
                // Never zero: it divides.
                after: after.max(Duration::from_millis(1)),
                positions: goal,
            }]),
            since: now,
            from: arm.positions,
        });
    }

    /// Forgets what is under way and what has arrived.
    pub fn drop_all(&mut self) {
        self.active = None;
        *lock(&self.arrived) = None;
    }
}

impl fmt::Debug for Hand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Hand")
            .field("active", &self.active)
            .finish_non_exhaustive()
    }
}

impl Active {
    fn rates(&self, now: Stamp, arm: &ArmState, to_rates: &ToRates) -> Option<Joints> {
        let age = now.since(self.since);
        match &self.motion {
            Motion::Twist(twist, axes) => {
                (age <= SILENCE).then(|| to_rates(&arm.positions, twist, *axes))
            }
            Motion::Trajectory(points) => {
                let end = points.last()?;
                let (wanted, forward) = along(&self.from, points, age);
                let off = wanted.zip(&arm.positions, |wanted, q| wanted - q);
                let over = age >= end.after;
                let there = off.max_abs() < REACHED && arm.rates.max_abs() < AT_REST;
                if over && (there || age > end.after + SETTLING) {
                    return None;
                }
                Some(forward.zip(&off, |rate, off| rate + GAIN * off))
            }
        }
    }
}

/// Place and rate on straight lines from `from` through the points.
fn along(from: &Joints, points: &[Waypoint], age: Duration) -> (Joints, Joints) {
    let mut last = Waypoint {
        after: Duration::ZERO,
        positions: *from,
    };
    for point in points {
        if age < point.after {
            let span = point.after.saturating_sub(last.after).as_secs_f64();
            let share = age.saturating_sub(last.after).as_secs_f64() / span;
            let step = point.positions.zip(&last.positions, |b, a| b - a);
            return (
                last.positions.zip(&step, |a, step| a + share * step),
                step.map(|step| step / span),
            );
        }
        last = *point;
    }
    (last.positions, last.positions.zeroed())
}

/// Refuses what is too old or carries a stamp from the future, and says so once a second.
struct Gate {
    node: WeakNode,
    clock: NodeClock,
    topic: &'static str,
    said: Mutex<Option<Stamp>>,
}

impl Gate {
    fn new(node: &Node, topic: &'static str) -> Self {
        Self {
            node: node.downgrade(),
            clock: node.clock(),
            topic,
            said: Mutex::default(),
        }
    }

    fn admits(&self, stamp: Time) -> bool {
        let refusal = timely(stamp, self.clock.behind(stamp));
        if let Err(words) = &refusal {
            self.say(words);
        }
        refusal.is_ok()
    }

    fn say(&self, words: &str) {
        let now = self.clock.now();
        let mut said = lock(&self.said);
        if said.is_some_and(|last| now.since(last) < COMPLAINT) {
            return;
        }
        *said = Some(now);
        drop(said);
        if let Some(node) = self.node.upgrade() {
            node.warn(&format!("{} refused: {words}", self.topic));
        }
    }
}

/// Whether a message counts whose stamp is `behind` the present \[s\]; a stamp of zero says "now".
fn timely(stamp: Time, behind: f64) -> Result<(), String> {
    let none = stamp.sec == 0 && stamp.nsec == 0;
    if none || (-AHEAD_LIMIT.as_secs_f64()..=AGE_LIMIT.as_secs_f64()).contains(&behind) {
        return Ok(());
    }
    Err(format!("{}, or the message was late", skew("its", behind)))
}

fn twist(message: &geometry_msgs::TwistStamped) -> Option<Motion> {
    let axes = match message.header.frame_id.trim_start_matches('/') {
        World::NAME => TwistAxes::World,
        NeedleBase::NAME => TwistAxes::NeedleBase,
        _ => return None,
    };
    let twist = convert::from_twist(&message.twist);
    twist.is_finite().then_some(Motion::Twist(twist, axes))
}

/// A trajectory of exactly these joints in any order, later and later, finite; empty stops.
fn trajectory(message: &trajectory_msgs::JointTrajectory, names: &[String]) -> Option<Motion> {
    if message.points.is_empty() {
        return Some(Motion::Trajectory(Vec::new()));
    }
    if message.joint_names.len() != names.len() {
        return None;
    }
    let order: Option<Vec<usize>> = names
        .iter()
        .map(|name| message.joint_names.iter().position(|other| other == name))
        .collect();
    let order = order?;
    let mut points = Vec::with_capacity(message.points.len());
    let mut last = Duration::ZERO;
    for point in &message.points {
        let time = &point.time_from_start;
        let (sec, nsec) = (
            u64::try_from(time.sec).ok()?,
            u32::try_from(time.nsec).ok()?,
        );
        let after = Duration::new(sec, nsec);
        if after <= last || point.positions.len() != names.len() {
            return None;
        }
        last = after;
        let values: Vec<f64> = order.iter().map(|&at| point.positions[at]).collect();
        let positions = Joints::from_slice(&values).ok()?;
        if !positions.is_finite() {
            return None;
        }
        points.push(Waypoint { after, positions });
    }
    Some(Motion::Trajectory(points))
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::ArmMode;
    use nalgebra::Vector3;

    fn pair(a: f64, b: f64) -> Joints {
        Joints::from_slice(&[a, b]).unwrap()
    }

    fn state(q: f64) -> ArmState {
        ArmState {
            stamp: Stamp::ZERO,
            positions: pair(q, 0.0),
            rates: pair(0.0, 0.0),
            mode: ArmMode::Enabled,
        }
    }

    fn hand(motion: Motion) -> Hand {
        Hand {
            arrived: Arc::new(Mutex::new(Some((Stamp::ZERO, motion)))),
            active: None,
        }
    }

    fn linear(_: &Joints, twist: &Twist, _: TwistAxes) -> Joints {
        pair(twist.linear.x, twist.linear.y)
    }

    #[test]
    fn a_twist_ends_after_silence_and_an_old_one_never_begins() {
        let twist = Twist {
            linear: Vector3::new(0.1, 0.2, 0.0),
            angular: Vector3::zeros(),
        };
        let motion = Motion::Twist(twist, TwistAxes::World);
        let at = |ms: u64| Stamp::from_nanos(ms * 1_000_000);
        let mut moving = hand(motion.clone());
        let rates = moving.rates(at(50), &state(0.0), &linear).unwrap();
        assert_eq!(rates.to_vec(), [0.1, 0.2]);
        assert!(moving.rates(at(200), &state(0.0), &linear).is_some());
        assert!(moving.rates(at(201), &state(0.0), &linear).is_none());
        assert!(hand(motion).rates(at(101), &state(0.0), &linear).is_none());
    }

    #[test]
    fn stamps_from_the_past_and_the_future_are_refused_in_words() {
        let stamp = Time { sec: 1000, nsec: 0 };
        for (behind, good) in [(0.0, true), (0.09, true), (-0.04, true)] {
            assert_eq!(timely(stamp, behind).is_ok(), good, "{behind}");
        }
        assert!(timely(Time { sec: 0, nsec: 0 }, 1e9).is_ok(), "now");
        for (behind, words) in [(0.11, "0.110 s behind"), (-10.0, "10.000 s ahead")] {
            let refusal = timely(stamp, behind).unwrap_err();
            assert!(refusal.contains(words), "{refusal}");
        }
    }

    #[test]
    fn a_trajectory_is_followed_to_its_end() {
        let point = |after, q| Waypoint {
            after: Duration::from_secs_f64(after),
            positions: pair(q, 0.0),
        };
        let mut hand = hand(Motion::Trajectory(vec![point(1.0, 0.2), point(2.0, 0.1)]));
        let (mut q, mut highest, mut steps) = (0.0_f64, 0.0_f64, 0);
        while let Some(rates) = hand.rates(
            Stamp::from_secs(f64::from(steps) * 0.01),
            &state(q),
            &linear,
        ) {
            q += rates[0] * 0.01;
            highest = highest.max(q);
            steps += 1;
        }
        assert!(
            (q - 0.1).abs() < 2e-3 && (highest - 0.2).abs() < 0.01,
            "{q} {highest}"
        );
        assert!((195..260).contains(&steps), "{steps}");
    }

    #[test]
    fn nonsense_is_no_motion() {
        let names = ["a", "b"].map(str::to_owned);
        let point = |sec, positions: &[f64]| trajectory_msgs::JointTrajectoryPoint {
            positions: positions.to_vec(),
            time_from_start: crate::seam::Span { sec, nsec: 0 },
            ..trajectory_msgs::JointTrajectoryPoint::default()
        };
        let message = |names: &[&str], points| trajectory_msgs::JointTrajectory {
            joint_names: names.iter().map(|&name| name.to_owned()).collect(),
            points,
            ..trajectory_msgs::JointTrajectory::default()
        };
        let parse = |m| trajectory(&m, &names);
        let good = parse(message(&["b", "a"], vec![point(1, &[2.0, 1.0])]));
        let Some(Motion::Trajectory(points)) = good else {
            panic!("{good:?}")
        };
        assert_eq!(points[0].positions.to_vec(), [1.0, 2.0]);
        assert_eq!(
            parse(message(&[], vec![])),
            Some(Motion::Trajectory(vec![]))
        );
        for bad in [
            message(&["a", "c"], vec![point(1, &[0.0, 0.0])]),
            message(&["a"], vec![point(1, &[0.0])]),
            message(&["a", "b"], vec![point(1, &[0.0])]),
            message(&["a", "b"], vec![point(0, &[0.0, 0.0])]),
            message(&["a", "b"], vec![point(1, &[0.0, f64::NAN])]),
            message(
                &["a", "b"],
                vec![point(2, &[0.0, 0.0]), point(1, &[0.0, 0.0])],
            ),
            message(&["a", "b"], vec![point(-1, &[0.0, 0.0])]),
        ] {
            assert_eq!(parse(bad), None);
        }
        let frame = |name: &str| geometry_msgs::TwistStamped {
            header: convert::header(Stamp::ZERO, name, 0),
            ..geometry_msgs::TwistStamped::default()
        };
        assert!(twist(&frame("world")).is_some() && twist(&frame("/needle_base")).is_some());
        assert!(twist(&frame("tool0")).is_none());
    }
}
