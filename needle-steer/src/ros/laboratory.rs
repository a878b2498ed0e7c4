//! `emulate ros`: the simulated arm, phantom and sensors as a node.

use std::sync::Arc;
use std::time::Duration;

use hal::{Arm, Stamp};
use robots::kinematics::RateSettings;
use robots::sim::SimulatedArm;
use rosbridge::TimeBase;
use rosbridge::emulator::{ArmNode, LabNode, Reports, Seen};

use super::Link;
use super::{camera_models, to_rates};
use crate::config::{Backend, Config, RosClock};
use crate::controls::Controls;
use crate::rig::{Pace, Rig, RigBuildError, Sighting};
use crate::score::Scoring;

/// Period of the feedback on the wall clock.
const PERIOD: Duration = Duration::from_millis(8);
/// Wait for a controller in lockstep, between looks at services and at the end.
const PATIENCE: Duration = Duration::from_millis(20);

/// What the arm does when velocities stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watchdog {
    /// It stops after 100 ms.
    Stops,
    /// It goes on for ever, as `ros_control`'s velocity controllers do.
    Missing,
}

/// Serves a laboratory whose arm stops when velocities stop; see [`serve`].
///
/// # Errors
/// As [`serve`].
pub fn emulate(
    config: &Config,
    controls: &Arc<Controls>,
    ready: impl FnOnce(),
) -> Result<(), RigBuildError> {
    serve(config, Watchdog::Stops, controls, |_, _| ready())
}

/// Serves a laboratory until `controls` are interrupted; calls `ready` when it does, with the arm
/// and its reports, to which something may be done.
///
/// # Errors
/// The configuration makes no laboratory, there is no master, or the arm fails.
pub fn serve(
    config: &Config,
    watchdog: Watchdog,
    controls: &Arc<Controls>,
    ready: impl FnOnce(&SimulatedArm, &Reports),
) -> Result<(), RigBuildError> {
    let mut config = config.clone();
    config.run.backend = Backend::Sim;
    let link = Link::named(&config, "needle_steer_laboratory", TimeBase::Simulated)?;
    link.end_with_node(controls);
    let lockstep = config.ros.clock == RosClock::Simulated;
    let pace = if lockstep {
        Pace::Free
    } else {
        Pace::Wall(link.time())
    };
    let mut rig = Rig::simulated(&config, pace)?;
    let (Some(simulated), Some(truth)) = (rig.simulated_arm.take(), rig.world.take()) else {
        return Err(RigBuildError::NoNode);
    };
    // The controller on the other side has the guard.
    let mut arm = simulated.driver();
    let names = rig.bearings.chain.names().to_vec();
    let kinematics = to_rates(&rig.bearings, RateSettings::default());
    let cameras = rig
        .bearings
        .cameras
        .as_ref()
        .map(|pair| camera_models(pair).map(Some));
    let mut topics = ArmNode::new(&link.node, names, cameras)?.with_kinematics(kinematics);
    if watchdog == Watchdog::Missing {
        topics = topics.without_watchdog();
    }
    let mut lab = LabNode::new(&link.node, topics)?;
    show_next(&mut lab, &mut rig, &mut arm, truth.as_ref())?;
    ready(&simulated, &lab.arm.reports());
    let mut shown = Stamp::ZERO;
    while !controls.is_interrupted() {
        if lockstep {
            let Some(until) = lab.await_answer(&mut arm, PATIENCE)? else {
                continue;
            };
            rig.clock.wait_until(until);
            show_next(&mut lab, &mut rig, &mut arm, truth.as_ref())?;
        } else {
            let next = rig.clock.now() + PERIOD;
            rig.clock.wait_until(next);
            lab.arm.step(&mut arm, rig.clock.now())?;
            let (exposed, sight) = (truth.newest().stamp, rig.eyes.poll()?);
            if exposed != shown || !sight.is_none() {
                shown = exposed;
                show(&mut lab, &rig, &mut arm, truth.as_ref(), sight)?;
            }
        }
    }
    drop(lab);
    link.node.shutdown();
    Ok(())
}

fn show_next(
    lab: &mut LabNode,
    rig: &mut Rig,
    arm: &mut dyn Arm,
    truth: &dyn Scoring,
) -> Result<(), hal::Error> {
    let sight = rig.eyes.poll()?;
    show(lab, rig, arm, truth, sight)
}

fn show(
    lab: &mut LabNode,
    rig: &Rig,
    arm: &mut dyn Arm,
    truth: &dyn Scoring,
    sight: Sighting,
) -> Result<(), hal::Error> {
    let state = arm.state()?;
    let (shape, pair) = match sight {
        Sighting::Nothing => (None, None),
        Sighting::Shape(shape) => (Some(shape), None),
        Sighting::Pair(pair) => (None, Some(pair)),
    };
    let seen = Seen {
        shapes: shape.into_iter().collect(),
        pairs: pair.into_iter().collect(),
        stereo_from_world: truth.stereo_from_world(),
        truth: truth.report(),
        pre_insertion: truth.pre_insertion(),
    };
    lab.show(rig.clock.now(), &state, &seen);
    Ok(())
}
