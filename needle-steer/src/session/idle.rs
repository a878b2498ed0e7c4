//! A session without an insertion under way: it waits for a start, or for what may follow a run. The
//! arm may be moved by hand and home, as long as the needle is outside the tissue.

use std::io::Write;
use std::time::Duration;

use hal::request::{Command, Request};
use hal::{Arm, ArmMode, ArmState, Joints, RateCommand};
use nalgebra::Vector3;
use robots::kinematics::RateSettings;

use super::{Session, readiness};
use crate::config::{Config, RosClock};
use crate::controls::Controls;
use crate::cycle::{Bearings, Cycle};
use crate::rig::Rig;
use crate::ros::to_rates;
use crate::run::RunError;
use crate::withdrawal::{BasePath, Lead, Place, Verdict, make_ready};

/// Depth of the tip that still counts as outside \[m\].
const OUTSIDE: f64 = 0.5e-3;
/// How far ahead motion by hand is looked at \[s\].
const AHEAD: f64 = 0.1;
/// Speed of the fastest joint on the way home \[rad/s\].
const HOMING: f64 = 0.1;
/// Longest wait for an arm that is to withdraw: who asked waits for an answer.
const ANSWER: Duration = Duration::from_millis(700);
/// Time between two showings of a simulated truth.
const SHOWN_EVERY: Duration = Duration::from_millis(50);
/// Places at which the way home is looked at.
const LOOKS: u32 = 100;

/// Why the waiting ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Leave {
    /// An insertion is to start.
    Start,
    /// The needle is to be withdrawn.
    Retract,
    /// The program is to end.
    Quit,
}

/// Whether an insertion is to come or has been.
#[derive(Debug)]
enum Stage<'a> {
    Before,
    /// Along this path of the base.
    After(&'a mut BasePath),
}

impl Stage<'_> {
    const fn is_before(&self) -> bool {
        matches!(self, Self::Before)
    }
}

/// Waits for a start, before the insertion.
///
/// # Errors
/// The arm or the controller fails.
pub fn wait(
    config: &Config,
    rig: &mut Rig,
    session: &mut Session,
    controls: &Controls,
) -> Result<Leave, RunError> {
    idle(config, rig, session, controls, Stage::Before)
}

/// Waits for what may follow, after the insertion.
///
/// # Errors
/// As [`wait`].
pub(super) fn linger(
    config: &Config,
    rig: &mut Rig,
    session: &mut Session,
    controls: &Controls,
    path: &mut BasePath,
) -> Result<Leave, RunError> {
    idle(config, rig, session, controls, Stage::After(path))
}

fn idle(
    config: &Config,
    rig: &mut Rig,
    session: &mut Session,
    controls: &Controls,
    mut stage: Stage<'_>,
) -> Result<Leave, RunError> {
    let period = rig.arm.description().period;
    let to_rates = to_rates(&rig.bearings, RateSettings::default());
    let mut by_hand = false;
    let mut shown = rig.clock.now();
    loop {
        if controls.is_interrupted() {
            stop(rig, by_hand);
            return Ok(Leave::Quit);
        }
        let now = rig.clock.now();
        // A silent arm is told of by the services that need it.
        let state = rig.arm.state().ok();
        if let Some(state) = &state {
            session.show_arm(state);
        }
        while let Some(request) = session.poll() {
            let place = (&mut stage, state.as_ref());
            if let Some(leave) = obey(request, config, rig, session, controls, place) {
                stop(rig, by_hand);
                return Ok(leave);
            }
        }
        let rates = state.as_ref().and_then(|state| {
            let hand = session.hand.as_mut()?;
            let rates = hand.rates(now, state, &*to_rates)?;
            let ok = session.allowed && stays_outside(config, rig, state, &rates);
            if !ok {
                hand.drop_all();
            }
            ok.then_some((rates, state.mode))
        });
        match rates {
            Some((rates, mode)) => by_hand = drive(rig, mode, rates),
            None if by_hand => {
                stop(rig, by_hand);
                by_hand = false;
                if stage.is_before() {
                    show(config, rig, session)?;
                }
            }
            None => {}
        }
        // A program that plays tracker in a simulated world measures before the start, too.
        if rig.tracker.is_some() && stage.is_before() && now.since(shown) >= SHOWN_EVERY {
            shown = now;
            session.show_truth(rig.world.as_ref().map(|world| world.newest()));
        }
        rig.clock.wait_until(now + period);
        if config.ros.clock == RosClock::Simulated {
            pause(period);
        }
    }
}

/// Simulated time costs none: waiting has to.
#[expect(clippy::disallowed_methods, reason = "waits for what is asked")]
fn pause(period: Duration) {
    std::thread::sleep(period);
}

/// Shows the needle as it would start from here, if the arm says where it is.
///
/// # Errors
/// The configuration makes no controller.
pub fn show(config: &Config, rig: &mut Rig, session: &mut Session) -> Result<(), RunError> {
    let Ok(state) = rig.arm.state() else {
        return Ok(());
    };
    let mut cycle = Cycle::new(config, rig.bearings.clone(), &state)?;
    let telemetry = cycle.telemetry_mut();
    telemetry.truth = rig.world.as_ref().map(|world| world.newest());
    session.show(telemetry);
    Ok(())
}

/// Stops motion by hand. An arm that does not take the stop comes to rest by itself, and the node
/// stays for what may still be asked of it.
fn stop(rig: &mut Rig, moving: bool) {
    if moving && let Err(error) = rig.arm.stop() {
        // Nothing can be done about a closed stderr.
        let _ = writeln!(std::io::stderr(), "{error}");
    }
}

/// One command by hand; whether it was taken.
fn drive(rig: &mut Rig, mode: ArmMode, rates: Joints) -> bool {
    if mode == ArmMode::Connected && rig.arm.enable().is_err() {
        return false;
    }
    let command = RateCommand {
        sequence: rig.next_sequence(),
        stamp: rig.clock.now(),
        rates,
    };
    rig.arm.command(&command).is_ok()
}

/// Answers a request; says so if it ends the waiting.
fn obey(
    request: Request,
    config: &Config,
    rig: &mut Rig,
    session: &mut Session,
    controls: &Controls,
    (stage, state): (&mut Stage<'_>, Option<&ArmState>),
) -> Option<Leave> {
    match request.command {
        Command::Start | Command::Retract | Command::Home if !session.allowed => {
            request.refuse("motion is not enabled");
        }
        Command::Start if stage.is_before() => {
            match readiness::prepare(config, rig, session.target) {
                Ok(()) => {
                    if let Some(target) = session.target {
                        controls.aim(target);
                    }
                    request.accept("starting");
                    return Some(Leave::Start);
                }
                Err(reason) => request.refuse(reason),
            }
        }
        Command::Start => request.refuse(
            "the insertion has ended and is not resumed: retract withdraws the needle; \
             launch another",
        ),
        Command::Retract => match stage {
            Stage::Before => request.refuse("nothing is inserted"),
            Stage::After(path) => match make_ready(rig, path, Lead::WENT_ON, ANSWER) {
                Ok(Place::AtStart) => request.accept(Verdict::AtStart.to_string()),
                Ok(Place::On { .. }) => {
                    request.accept("withdrawing the needle");
                    return Some(Leave::Retract);
                }
                Err(refusal) => request.refuse(refusal.to_string()),
            },
        },
        Command::Pause => request.refuse("no insertion is under way"),
        Command::Stop => {
            session.drop_motion();
            match rig.arm.stop() {
                Ok(()) => request.accept("at rest"),
                Err(error) => request.refuse(readiness::words(&error)),
            }
        }
        Command::Home if session.hand.is_none() => {
            request.refuse("motion outside the tissue needs ROS (ros.publish)");
        }
        Command::Home => match state.map(|state| way_home(config, rig, state)) {
            Some(true) => {
                let home = rig.home;
                if let (Some(state), Some(hand)) = (state, &mut session.hand) {
                    hand.go(rig.clock.now(), state, home, HOMING);
                }
                request.accept("moving home");
            }
            Some(false) => request.refuse("the way home passes through the tissue: retract first"),
            None => request.refuse(silence(rig)),
        },
        Command::ClearFault => match rig.arm.reset() {
            Ok(()) => request.accept("no fault"),
            Err(error) => request.refuse(readiness::words(&error)),
        },
        Command::Enable(allowed) => {
            session.allowed = allowed;
            if !allowed {
                session.drop_motion();
            }
            request.accept(if allowed { "enabled" } else { "not enabled" });
        }
        Command::Target(target) if stage.is_before() => {
            match readiness::target(config, rig, Some(target)) {
                Ok(aimed) => {
                    session.target = Some(target);
                    request.accept(aimed.to_string());
                }
                Err(reason) => request.refuse(reason),
            }
        }
        Command::Target(_) => request.refuse("the insertion has ended"),
    }
    None
}

/// Why there is no state of the arm.
fn silence(rig: &mut Rig) -> String {
    match rig.arm.state() {
        Ok(_) => "the arm did not report a moment ago; call again".to_owned(),
        Err(error) => readiness::words(&error),
    }
}

/// Depth of the straight needle's tip below the surface \[m\]; negative above.
fn depth(config: &Config, bearings: &Bearings, joints: &Joints) -> f64 {
    let base = bearings.world_from_arm_base.isometry() * bearings.chain.forward(joints);
    let length = config.needle.length_mm * 1e-3;
    let tip = base.translation.vector + base.rotation * Vector3::z() * length;
    (tip - config.entry().coords).dot(&config.inward())
}

/// Whether motion by hand leaves the needle outside the tissue.
fn stays_outside(config: &Config, rig: &Rig, state: &ArmState, rates: &Joints) -> bool {
    let next = state.positions.zip(rates, |q, rate| q + rate * AHEAD);
    [&state.positions, &next]
        .iter()
        .all(|joints| depth(config, &rig.bearings, joints) <= OUTSIDE)
}

/// Whether the needle stays outside the tissue all the way home.
fn way_home(config: &Config, rig: &Rig, state: &ArmState) -> bool {
    (0..=LOOKS).all(|i| {
        let share = f64::from(i) / f64::from(LOOKS);
        let joints = state.positions.zip(&rig.home, |a, b| a + share * (b - a));
        depth(config, &rig.bearings, &joints) <= OUTSIDE
    })
}
