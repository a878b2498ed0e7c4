//! Insertion by hand: what is asked of the hand, and how far it has pushed by the sensor of the tip.
//!
//! The joint that slides along the needle stands for the needle in its guide: nothing drives it, its
//! position is measured (`HandFed`). The run asks for a step when the guide has moved, and to hold while
//! it moves (`Prompter`).

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hal::frame::{LeftCamera, World};
use hal::{
    Arm, ArmDescription, ArmState, Error, Joints, RateCommand, SensedShape, ShapeSensor, Stamp,
    Transform,
};
use nalgebra::{Point3, Unit, Vector3};
use phantom::Hand;
use robots::kinematics::{Chain, JointKind};

use crate::world::Body;

/// Share by which the measured advance follows a measurement at rest, and where the needle moves: 0.1 mm
/// of noise leave 0.02 mm.
const FOLLOWS: (f64, f64) = (0.05, 0.3);
/// Difference of a measurement from which the needle moves \[m\]: four deviations of a coil's noise.
const MOVES: f64 = 0.4e-3;
/// Motion of the guide across below which it counts as done \[m/s\].
const DONE: f64 = 0.1e-3;
/// Longest wait for that \[s\]: a plan follows every measurement a little.
const PATIENCE: f64 = 4.0;
/// Least time between two steps \[s\]: measurements of the needle at rest.
const RESTS: f64 = 1.0;
/// A step is over when the needle has moved and stands for so long \[s\].
const STANDS: f64 = 0.7;
/// Share of a step from which it counts as begun.
const BEGUN: f64 = 0.2;
/// Least step that is asked for \[m\].
const LEAST: f64 = 0.3e-3;
/// Before a stop the hand is asked for this share of the way, so that its error does not lead beyond;
/// what is shorter than the second it is asked for at once \[m\].
const APPROACH: (f64, f64) = (0.6, 1.0e-3);

/// What the operator is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Prompt {
    /// Hold the needle where it is.
    #[default]
    Hold,
    /// Advance it by so much \[m\].
    Advance(f64),
}

impl core::fmt::Display for Prompt {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Hold => f.write_str("hold"),
            Self::Advance(by) => write!(f, "advance {:.1} mm", by * 1e3),
        }
    }
}

#[derive(Debug, Default)]
struct State {
    prompt: Prompt,
    /// Number of the prompt.
    number: u64,
    /// Advance by the tip's sensor \[m\].
    advance: f64,
    /// When it last moved.
    moved: Stamp,
}

/// The needle in its guide, pushed by hand; clones share it.
#[derive(Clone, Debug, Default)]
pub struct Slide(Arc<Mutex<State>>);

impl Slide {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is asked of the hand.
    pub fn prompt(&self) -> Prompt {
        self.lock().prompt
    }

    /// Advance since the start by the sensor of the tip \[m\].
    pub fn advance(&self) -> f64 {
        self.lock().advance
    }

    /// Number of the newest request, and the step that it asks for.
    fn asked(&self) -> (u64, Option<f64>) {
        let state = self.lock();
        match state.prompt {
            Prompt::Hold => (state.number, None),
            Prompt::Advance(by) => (state.number, Some(by)),
        }
    }

    fn ask(&self, prompt: Prompt) {
        let mut state = self.lock();
        state.number += 1;
        state.prompt = prompt;
    }

    /// Takes in a measured advance.
    fn measure(&self, stamp: Stamp, measured: f64) {
        if !measured.is_finite() {
            return;
        }
        let mut state = self.lock();
        let off = measured - state.advance;
        let share = if off.abs() > MOVES {
            state.moved = stamp;
            FOLLOWS.1
        } else {
            FOLLOWS.0
        };
        state.advance += share * off;
    }
}

/// Asks the hand for steps while the guide stands, and to hold while it moves.
#[derive(Clone, Debug)]
pub(crate) struct Prompter {
    slide: Slide,
    step: f64,
    /// When the prompt was given, and the advance then \[m\].
    since: Option<(Stamp, f64)>,
}

impl Prompter {
    pub(crate) const fn new(slide: Slide, step: f64) -> Self {
        Self {
            slide,
            step,
            since: None,
        }
    }

    /// A new prompt, where there is one. `across`: motion of the guide \[m/s\]; `ahead`: way to
    /// where it has to stop next \[m\]; `goes`: whether the needle may advance at all.
    pub(crate) fn update(
        &mut self,
        now: Stamp,
        across: f64,
        ahead: f64,
        goes: bool,
    ) -> Option<Prompt> {
        let (advance, moved) = {
            let state = self.slide.lock();
            (state.advance, state.moved)
        };
        let (since, from) = *self.since.get_or_insert((now, advance));
        let waited = now.secs_since(since);
        let next = match self.slide.prompt() {
            Prompt::Hold => {
                let done = across < DONE || waited > PATIENCE;
                let rests = waited > RESTS && now.secs_since(moved) > RESTS;
                (goes && done && rests).then(|| Prompt::Advance(self.step_to(ahead)))
            }
            Prompt::Advance(by) => {
                let way = advance - from;
                let stands = way > BEGUN * by && now.secs_since(moved) > STANDS;
                (!goes || way > by || stands).then_some(Prompt::Hold)
            }
        }?;
        self.slide.ask(next);
        self.since = Some((now, advance));
        Some(next)
    }
}

impl Prompter {
    /// The next step towards a stop that is so far ahead \[m\].
    fn step_to(&self, ahead: f64) -> f64 {
        let share = if ahead > APPROACH.1 { APPROACH.0 } else { 1.0 };
        self.step.min(share * ahead).max(LEAST)
    }
}

/// The joint along the needle, and whether it goes into the tissue with rising position.
pub(crate) fn sliding_joint(chain: &Chain, q: &Joints) -> Option<(usize, f64)> {
    let along = chain.forward(q).rotation * Vector3::z();
    let jacobian = chain.jacobian(q);
    let of = |joint: usize| jacobian.fixed_view::<3, 1>(0, joint).dot(&along);
    let slides = chain.kinds().iter().enumerate();
    slides
        .filter(|(_, kind)| **kind == JointKind::Prismatic)
        .map(|(joint, _)| (joint, of(joint)))
        .find(|(_, along)| along.abs() > 0.99)
        .map(|(joint, along)| (joint, along.signum()))
}

/// Joints of a device whose needle is pushed by hand.
#[derive(Clone, Debug)]
pub(crate) struct ByHand {
    pub(crate) slide: Slide,
    joint: usize,
    sense: f64,
    home: f64,
}

impl ByHand {
    pub(crate) fn new(chain: &Chain, home: &Joints) -> Option<Self> {
        let (joint, sense) = sliding_joint(chain, home)?;
        Some(Self {
            slide: Slide::default(),
            joint,
            sense,
            home: home[joint],
        })
    }

    fn with(&self, joints: &Joints, advance: f64) -> Joints {
        let mut joints = *joints;
        joints[self.joint] = self.home + self.sense * advance;
        joints
    }
}

/// A device whose needle is pushed by hand: the position of the joint along it is measured, and what
/// is commanded of it goes nowhere.
pub(crate) struct HandFed {
    arm: Box<dyn Arm>,
    by: ByHand,
}

impl HandFed {
    pub(crate) const fn new(arm: Box<dyn Arm>, by: ByHand) -> Self {
        Self { arm, by }
    }
}

impl Arm for HandFed {
    fn description(&self) -> &ArmDescription {
        self.arm.description()
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        let state = self.arm.state()?;
        Ok(ArmState {
            positions: self.by.with(&state.positions, self.by.slide.advance()),
            ..state
        })
    }

    fn enable(&mut self) -> Result<(), Error> {
        self.arm.enable()
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        let mut command = *command;
        command.rates[self.by.joint] = 0.0;
        self.arm.command(&command)
    }

    fn stop(&mut self) -> Result<(), Error> {
        self.arm.stop()
    }

    fn reset(&mut self) -> Result<(), Error> {
        self.arm.reset()
    }

    fn explanation(&self) -> Option<String> {
        self.arm.explanation()
    }
}

/// The same in the simulated world: what the device's joints leave open, a hand does.
pub(crate) struct HandBody {
    body: Box<dyn Body>,
    by: ByHand,
    hand: Hand,
}

impl HandBody {
    pub(crate) const fn new(body: Box<dyn Body>, by: ByHand, hand: Hand) -> Self {
        Self { body, by, hand }
    }
}

impl Body for HandBody {
    fn advance_to(&mut self, stamp: Stamp) -> Joints {
        let joints = self.body.advance_to(stamp);
        let pushed = self.hand.advance_to(stamp, self.by.slide.asked());
        self.by.with(&joints, pushed)
    }
}

/// A sensor of the tip that tells how far the needle was pushed.
pub(crate) struct AdvanceByTip {
    sensor: Box<dyn ShapeSensor>,
    slide: Slide,
    /// The tip at the start, and the direction of insertion.
    from: (Point3<f64>, Unit<Vector3<f64>>),
    left_from_world: Transform<LeftCamera, World>,
}

impl AdvanceByTip {
    pub(crate) const fn new(
        sensor: Box<dyn ShapeSensor>,
        slide: Slide,
        from: (Point3<f64>, Unit<Vector3<f64>>),
        left_from_world: Transform<LeftCamera, World>,
    ) -> Self {
        Self {
            sensor,
            slide,
            from,
            left_from_world,
        }
    }
}

impl ShapeSensor for AdvanceByTip {
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        let shape = self.sensor.poll()?;
        if let Some(shape) = &shape {
            let tip = self.left_from_world.inverse() * shape.tip.position;
            let advance = self.from.1.dot(&(tip.point() - self.from.0));
            self.slide.measure(shape.stamp, advance);
        }
        Ok(shape)
    }

    fn hindrance(&self) -> Option<String> {
        self.sensor.hindrance()
    }
}
