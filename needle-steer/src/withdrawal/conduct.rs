//! Carries a withdrawal out. Like the run loop it commands the arm, and every way out stops it.

use std::time::Duration;

use hal::frame::LeftCamera;
use hal::telemetry::{Phase, Telemetry};
use hal::{Arm, ArmMode, ArmState, Joints, Position, RateCommand, Stamp, Twist};
use nalgebra::{Isometry3, Vector3};

use super::path::{BasePath, Lead, Place};
use super::record::Record;
use super::verdict::{Refusal, Stop, Summary, Verdict};
use crate::bearings::{base_pose, first_telemetry};
use crate::config::Config;
use crate::controls::Controls;
use crate::monitor::plausibility::Plausibility;
use crate::observer::Observer;
use crate::rig::{Eyes, Rig};
use crate::supervisor::in_words;

/// Longest wait for an arm to be ready: a link may have to be made anew.
const PATIENCE: Duration = Duration::from_secs(3);
/// A joint slower than this rests \[rad/s\]; encoders' noise is less.
const AT_REST: f64 = 0.02;
/// A base that comes no further back for so long is stopped.
const STALL: Duration = Duration::from_secs(5);
/// Part of the way that a base has to do in that time.
const STALL_SHARE: f64 = 0.1;
/// Time over which the base's speed is measured \[s\].
const SPEED_WINDOW: f64 = 0.1;
/// The base may move this many times as fast as it is told to, ...
const SPEED_RATIO: f64 = 2.0;
/// ... and by so much faster \[m/s\].
const SPEED_MARGIN: f64 = 2e-3;
/// The base may be so far beside the path: distance \[m\], tilt \[rad\].
const BESIDE: (f64, f64) = (2e-3, 0.1);

/// Longest wait for a measurement of the needle when the base is back: half a second of latency, and
/// some images.
const LOOK: Duration = Duration::from_millis(700);
/// A tip deeper than this is inside, however arm and sensor are registered \[m\].
const INSIDE: f64 = 3e-3;

/// What is to be withdrawn.
#[derive(Debug)]
pub struct Request<'a> {
    /// The path that the base came.
    pub path: &'a mut BasePath,
    /// Where the base may be beyond the recorded end.
    pub lead: Lead,
    /// Number of the last step before.
    pub last_step: u64,
}

impl<'a> Request<'a> {
    /// Of an insertion in this process.
    pub const fn of_run(path: &'a mut BasePath, last_step: u64) -> Self {
        Self {
            path,
            lead: Lead::WENT_ON,
            last_step,
        }
    }
}

/// Makes the arm ready to withdraw: waits for its link, clears a latched fault whose cause is gone,
/// enables it, and finds its base on the path. Nothing moves.
///
/// # Errors
/// The arm does not get ready within `patience`, or stands elsewhere; a hand pushed the needle.
pub fn make_ready(
    rig: &mut Rig,
    path: &mut BasePath,
    lead: Lead,
    patience: Duration,
) -> Result<Place, Refusal> {
    if rig.slide.is_some() {
        return Err(Refusal::ByHand);
    }
    if path.is_empty() {
        return Err(Refusal::NoPath);
    }
    let deadline = rig.clock.now() + patience;
    let period = rig.arm.description().period;
    let mut before: Option<Joints> = None;
    loop {
        let problem = match advance(rig) {
            // It may have been taken over while it moved.
            Ok((state, true))
                if before
                    .replace(state.positions)
                    .is_none_or(|before| moves(&before, &state.positions, period)) =>
            {
                "it does not come to rest".to_owned()
            }
            Ok((state, true)) => {
                let pose = base_pose(&rig.bearings, &state);
                return Ok(path.rejoin(&pose, &state.positions, lead)?);
            }
            Ok((state, false)) => {
                let pose = base_pose(&rig.bearings, &state);
                let place = path.clone().rejoin(&pose, &state.positions, lead)?;
                if place == Place::AtStart {
                    return Ok(Place::AtStart);
                }
                match state.mode {
                    ArmMode::Faulted(fault) => in_words(fault, rig.arm.explanation().as_deref()),
                    mode => format!("{mode:?}"),
                }
            }
            Err(error) => told(&error),
        };
        let now = rig.clock.now();
        if now >= deadline {
            return Err(Refusal::Arm(problem));
        }
        rig.clock.wait_until(now + period);
    }
}

/// Whether a joint moves, by two readings a `period` apart.
fn moves(before: &Joints, now: &Joints, period: Duration) -> bool {
    let moved = now.zip(before, |now, before| now - before);
    moved.max_abs() > AT_REST * period.as_secs_f64()
}

/// One step towards an enabled arm; whether it is one.
fn advance(rig: &mut Rig) -> Result<(ArmState, bool), hal::Error> {
    let state = rig.arm.state()?;
    match state.mode {
        ArmMode::Enabled | ArmMode::Moving => return Ok((state, true)),
        ArmMode::Connected => rig.arm.enable()?,
        ArmMode::Faulted(_) => rig.arm.reset()?,
        ArmMode::Stopping | ArmMode::Disconnected => {}
    }
    Ok((state, false))
}

/// An error with its causes in one line.
pub fn told(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        text = format!("{text}: {cause}");
        next = cause.source();
    }
    text
}

/// Withdraws the needle, watched by `observer` and logged by `record`.
pub fn withdraw(
    config: &Config,
    rig: &mut Rig,
    request: Request<'_>,
    observer: &mut dyn Observer,
    controls: &Controls,
    mut record: Record,
) -> Summary {
    let Request {
        path,
        lead,
        last_step,
    } = request;
    let begun = rig.clock.now();
    let mut summary = Summary {
        ended: Verdict::AtStart,
        insertion: None,
        withdrawn_mm: 0.0,
        left_mm: 0.0,
        gap_mm: 0.0,
        off_path_mm: 0.0,
        tip_depth_mm: None,
        duration_s: 0.0,
        steps: 0,
        log_complete: false,
        out: None,
        log: None,
    };
    match make_ready(rig, path, lead, PATIENCE) {
        Err(refusal) => summary.ended = Verdict::Refused(refusal),
        Ok(Place::AtStart) => {}
        Ok(Place::On { left, gap }) => {
            summary.gap_mm = gap * 1e3;
            let mut course = Course::new(config, rig, last_step);
            let verdict = course.drive(rig, path, observer, controls, &mut record);
            summary.ended = match rig.come_to_rest() {
                Err(error) if verdict.is_success() => Verdict::Stopped(Stop::Device(told(&error))),
                _ => verdict,
            };
            summary.off_path_mm = course.farthest * 1e3;
            summary.steps = course.step - last_step;
            summary.left_mm = course.left * 1e3;
            summary.withdrawn_mm = (left - course.left).max(0.0) * 1e3;
        }
    }
    if summary.ended.is_success()
        && let Some(depth) = tip_depth(config, rig).filter(|depth| *depth > INSIDE)
    {
        summary.ended = Verdict::TipInside {
            depth_mm: depth * 1e3,
        };
    }
    let now = rig.clock.now();
    summary.duration_s = now.secs_since(begun);
    summary.tip_depth_mm = true_tip_depth(config, rig).map(|depth| depth * 1e3);
    record.finish(now, config, summary)
}

/// Depth of the true tip below the surface, in a simulated world \[m\].
fn true_tip_depth(config: &Config, rig: &Rig) -> Option<f64> {
    let tip = rig.world.as_ref()?.true_tip() - config.entry().coords;
    Some(tip.dot(&config.inward()))
}

/// Depth of the tip below the surface now that the base is back \[m\]: in a simulated world the true
/// one, else by a measurement from now on, where a sensor of shapes makes one that can be of this needle.
fn tip_depth(config: &Config, rig: &mut Rig) -> Option<f64> {
    let truly = true_tip_depth(config, rig);
    if truly.is_some() || !matches!(rig.eyes, Eyes::Shape(_)) {
        return truly;
    }
    let since = rig.clock.now();
    let period = rig.arm.description().period;
    while rig.clock.now() < since + LOOK {
        let next = rig.clock.now() + period;
        rig.clock.wait_until(next);
        let sight = rig.eyes.poll().ok()?;
        let Some(shape) = sight.shape().filter(|shape| shape.stamp >= since) else {
            continue;
        };
        let base = base_pose(&rig.bearings, &rig.arm.state().ok()?);
        let in_world =
            |place: &Position<LeftCamera>| *(rig.bearings.world_from_left_camera * *place).point();
        let tip = in_world(&shape.tip.position);
        let shaft = shape.points.iter().map(|point| in_world(&point.position));
        let mut plausibility = Plausibility::new(config.needle.length_mm * 1e-3);
        return plausibility
            .admit(shape.stamp, &base, &tip, shaft)
            .then(|| config.inward().dot(&(tip - config.entry())));
    }
    None
}

/// A withdrawal under way.
struct Course<'a> {
    config: &'a Config,
    speed: f64,
    spin: f64,
    step: u64,
    /// Where and when the base's speed was measured last.
    measured: Option<(Stamp, Vector3<f64>)>,
    /// Least effort left so far, and when.
    progress: (f64, Stamp),
    farthest: f64,
    left: f64,
}

impl<'a> Course<'a> {
    fn new(config: &'a Config, rig: &Rig, last_step: u64) -> Self {
        Self {
            config,
            speed: config.run.insertion_speed_mm_s * 1e-3,
            spin: config.limits.spin_speed_deg_s.to_radians(),
            step: last_step,
            measured: None,
            progress: (f64::INFINITY, rig.clock.now()),
            farthest: 0.0,
            left: 0.0,
        }
    }

    /// Drives the base to the start of `path`.
    fn drive(
        &mut self,
        rig: &mut Rig,
        path: &mut BasePath,
        observer: &mut dyn Observer,
        controls: &Controls,
        record: &mut Record,
    ) -> Verdict {
        let period = rig.arm.description().period;
        let mut deadline = rig.clock.now();
        loop {
            if controls.is_stopped() {
                return controls
                    .why_interrupted()
                    .map_or(Verdict::Interrupted, |why| {
                        Verdict::Stopped(Stop::NodeEnded(why))
                    });
            }
            let now = rig.clock.now();
            let state = match rig.arm.state() {
                Ok(state) => state,
                Err(error) => return Verdict::Stopped(Stop::Device(told(&error))),
            };
            observer.arm(&state);
            let pose = base_pose(&rig.bearings, &state);
            let (left, effort) = path.left(&pose, &state.positions);
            self.left = left;
            let holds = controls.is_holding();
            if let Err(stop) = self.check(now, &state, &pose, path, (effort, holds)) {
                return Verdict::Stopped(match stop {
                    Stop::ArmFault(fault, _) => Stop::ArmFault(fault, rig.arm.explanation()),
                    stop => stop,
                });
            }
            let wanted = path.rates(&pose, &state.positions, self.speed, self.spin);
            let Some((rates, twist)) = wanted else {
                self.left = 0.0;
                return Verdict::Retracted;
            };
            let (phase, rates, twist) = if holds {
                (Phase::Paused, rates.zeroed(), Twist::zero())
            } else {
                (Phase::Retracting, rates, twist)
            };
            self.step += 1;
            let mut telemetry = self.telemetry(now, &state, &pose, phase);
            telemetry.base_twist = twist;
            telemetry.joint_rates = rates;
            let limits = &mut telemetry.law.limits;
            limits.extend_from_slice(rig.arm.inner().acted());
            telemetry.truth = rig.world.as_ref().map(|world| world.report());
            if let Err(stop) = Self::send(rig, now, &rates, &state, &telemetry, (observer, record))
            {
                return Verdict::Stopped(stop);
            }
            deadline = deadline + period;
            rig.clock.wait_until(deadline);
        }
    }

    fn send(
        rig: &mut Rig,
        now: Stamp,
        rates: &Joints,
        state: &ArmState,
        telemetry: &Telemetry,
        (observer, record): (&mut dyn Observer, &mut Record),
    ) -> Result<(), Stop> {
        let command = RateCommand {
            sequence: rig.next_sequence(),
            stamp: now,
            rates: *rates,
        };
        let sent = rig.arm.command(&command);
        for observer in [observer, record as &mut dyn Observer] {
            observer.inputs(state, None);
            observer.step(telemetry);
            if sent.is_ok() {
                observer.command(&command);
            }
        }
        match (sent, rig.arm.state().map(|state| state.mode)) {
            (Ok(()), _) => Ok(()),
            (Err(_), Ok(ArmMode::Faulted(fault))) => {
                Err(Stop::ArmFault(fault, rig.arm.explanation()))
            }
            (Err(error), _) => Err(Stop::Device(told(&error))),
        }
    }

    /// The withdrawal's own bounds.
    fn check(
        &mut self,
        now: Stamp,
        state: &ArmState,
        pose: &Isometry3<f64>,
        path: &BasePath,
        (effort, holds): (f64, bool),
    ) -> Result<(), Stop> {
        match state.mode {
            ArmMode::Enabled | ArmMode::Moving => {}
            ArmMode::Faulted(fault) => return Err(Stop::ArmFault(fault, None)),
            mode => return Err(Stop::ArmNotEnabled(mode)),
        }
        let age = now.secs_since(state.stamp);
        if age > self.config.supervisor.encoder_stop_ms * 1e-3 {
            return Err(Stop::EncoderTimeout { age_s: age });
        }
        if !(state.positions.is_finite() && state.rates.is_finite()) {
            return Err(Stop::NonFinite);
        }
        self.check_speed(state.stamp, pose.translation.vector)?;
        let (distance, tilt) = path.beside(pose);
        self.farthest = self.farthest.max(distance);
        if distance > BESIDE.0 || tilt > BESIDE.1 {
            return Err(Stop::OffPath {
                distance_mm: distance * 1e3,
                tilt_deg: tilt.to_degrees(),
            });
        }
        let least = BasePath::pace(self.speed, self.spin) * STALL.as_secs_f64() * STALL_SHARE;
        let stalled = now.since(self.progress.1);
        if holds || effort < self.progress.0 - least {
            self.progress = (effort, now);
        } else if stalled > STALL {
            return Err(Stop::NoProgress {
                seconds: stalled.as_secs_f64(),
                left_mm: self.left * 1e3,
            });
        }
        Ok(())
    }

    fn check_speed(&mut self, stamp: Stamp, place: Vector3<f64>) -> Result<(), Stop> {
        let Some((since, before)) = self.measured else {
            self.measured = Some((stamp, place));
            return Ok(());
        };
        let time = stamp.secs_since(since);
        if time < SPEED_WINDOW {
            return Ok(());
        }
        self.measured = Some((stamp, place));
        let speed = (place - before).norm() / time;
        let bound = SPEED_RATIO * self.speed + SPEED_MARGIN;
        if speed <= bound {
            return Ok(());
        }
        Err(Stop::TooFast {
            speed_mm_s: speed * 1e3,
            bound_mm_s: bound * 1e3,
        })
    }

    /// What is known without a measurement: the arm, and where a straight needle would be.
    fn telemetry(
        &self,
        now: Stamp,
        state: &ArmState,
        pose: &Isometry3<f64>,
        phase: Phase,
    ) -> Telemetry {
        let length = self.config.needle.length_mm * 1e-3;
        let tip = pose * Isometry3::translation(0.0, 0.0, length);
        let depth =
            (tip.translation.vector - self.config.entry().coords).dot(&self.config.inward());
        let mut telemetry = first_telemetry(state, pose, &tip);
        telemetry.step = self.step;
        telemetry.stamp = now;
        telemetry.phase = phase;
        telemetry.depth = depth.max(0.0);
        telemetry
    }
}
