//! The supervisor: bounds and watchdogs outside any law. It only ever holds or stops.

use std::time::Duration;

use hal::telemetry::Telemetry;
use hal::{ArmMode, ArmState, FaultReason, Stamp};
use nalgebra::{Point3, Unit, Vector3};
use serde::Serialize;

use crate::config::Config;
use crate::monitor::plausibility::Implausible;
use crate::monitor::{Stale, Stalled};
use crate::outcome::Cause;

/// The tip has to follow within this time at rest, or the run ends: the longest breath, in which
/// tissue may draw the tip back.
const STALL_STOP: Duration = Duration::from_secs(5);
/// A springs model without an equilibrium for longer holds the arm; its bounds are not read.
const MODEL_HOLD: Duration = Duration::from_millis(100);
/// The same for longer ends the run.
const MODEL_STOP: Duration = Duration::from_secs(2);

/// Bounds in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds {
    /// Largest tissue stretch \[m\].
    pub tissue_stretch: f64,
    /// Largest lateral force at the entry \[N\].
    pub entry_force: f64,
    /// Nominal axis: entry point and direction into the tissue, in World.
    pub axis: (Point3<f64>, Unit<Vector3<f64>>),
    /// Largest distance of the needle's base from the nominal axis \[m\].
    pub workspace_radius: f64,
    /// Without an image for longer: hold still.
    pub image_hold: Duration,
    /// Without an image for longer: stop the run.
    pub image_stop: Duration,
    /// Measurements older than this at their arrival are not taken.
    pub image_age: Duration,
    /// Encoders read longer ago: stop the run.
    pub encoder_stop: Duration,
    /// Dead-man's token refreshed longer ago: stop the run; without, no token is asked for.
    pub dead_man: Option<Duration>,
}

impl Bounds {
    /// The bounds of a configuration.
    pub fn of(config: &Config) -> Self {
        let s = &config.supervisor;
        let ms = |value: f64| Duration::from_secs_f64(value * 1e-3);
        Self {
            tissue_stretch: s.tissue_stretch_mm * 1e-3,
            entry_force: s.entry_force_n,
            axis: (config.entry(), config.inward()),
            workspace_radius: s.workspace_radius_mm * 1e-3,
            image_hold: ms(s.image_hold_ms),
            image_stop: ms(s.image_stop_ms),
            image_age: ms(s.image_age_ms),
            encoder_stop: ms(s.encoder_stop_ms),
            dead_man: (s.dead_man_ms > 0.0).then(|| ms(s.dead_man_ms)),
        }
    }
}

/// Why the supervisor stopped the run; latched until the run ends.
#[derive(Clone, Debug, PartialEq, Serialize, thiserror::Error)]
#[serde(tag = "reason", rename_all = "snake_case")]
pub enum StopReason {
    /// The arm faulted.
    #[error("the arm faulted: {fault:?}")]
    ArmFault {
        /// The arm's own reason.
        fault: FaultReason,
    },
    /// The arm left its enabled state.
    #[error("the arm is not enabled but {mode:?}")]
    ArmNotEnabled {
        /// The arm's mode.
        mode: ArmMode,
    },
    /// No encoder reading for too long.
    #[error("no encoder reading for {age_s:.3} s")]
    EncoderTimeout {
        /// Age of the newest reading \[s\].
        age_s: f64,
    },
    /// No image for too long.
    #[error("no image for {age_s:.3} s")]
    ImageTimeout {
        /// Age of the newest image \[s\].
        age_s: f64,
    },
    /// Images came, but no needle was found in them for too long.
    #[error("the needle was not found in the images for {age_s:.3} s: {problem}")]
    NeedleLost {
        /// Age of the newest image in which it was \[s\].
        age_s: f64,
        /// Why it was not found in the newest image.
        problem: String,
    },
    /// Every measurement comes too late.
    #[error(
        "measurements are {age_s:.2} s old when they arrive; the bound is {bound_s:.2} s (supervisor.image_age_ms)"
    )]
    MeasurementsLate {
        /// Age of the newest at its arrival \[s\].
        age_s: f64,
        /// The bound \[s\].
        bound_s: f64,
    },
    /// Every measurement is stamped ahead of the run's clock.
    #[error(
        "measurements are stamped {by_s:.2} s ahead of this machine's clock: set the clocks of both machines"
    )]
    MeasurementsAhead {
        /// How far ahead \[s\].
        by_s: f64,
    },
    /// The measurements cannot be of this needle.
    #[error("{problem}")]
    Implausible {
        /// What is wrong with the newest.
        problem: Implausible,
    },
    /// The tip stays behind the base.
    #[error(
        "the base advanced by {:.1} mm, the measured tip by {:.1} mm: the shaft buckles or the tip is held",
        stalled.base_m * 1e3,
        stalled.tip_m * 1e3
    )]
    Stall {
        /// What was measured.
        #[serde(flatten)]
        stalled: Stalled,
    },
    /// The springs model has no equilibrium.
    #[error("the needle model has no equilibrium for {for_s:.1} s: {problem}")]
    ModelFailed {
        /// For how long \[s\].
        for_s: f64,
        /// The model's words.
        problem: String,
    },
    /// Estimate and measurement disagree about where the tip is.
    #[error(
        "the estimated tip has passed the target, the measured one is {ahead_m:.4} m in front of it"
    )]
    Disagreement {
        /// Target ahead of the measured tip \[m\].
        ahead_m: f64,
    },
    /// The needle is not in the tissue where it passes the target.
    #[error("the needle passed the target outside the tissue")]
    OutsideTissue,
    /// Tissue stretched too far.
    #[error("tissue stretched by {value_m:.4} m, bound {bound_m:.4} m")]
    TissueStretch {
        /// The model's largest stretch \[m\].
        value_m: f64,
        /// The bound \[m\].
        bound_m: f64,
    },
    /// Lateral force at the entry too high.
    #[error("lateral force at the entry {value_n:.2} N, bound {bound_n:.2} N")]
    EntryForce {
        /// The model's force \[N\].
        value_n: f64,
        /// The bound \[N\].
        bound_n: f64,
    },
    /// The needle's base left the workspace.
    #[error("needle base {distance_m:.4} m from the nominal axis, bound {bound_m:.4} m")]
    Workspace {
        /// Distance of the base from the axis \[m\].
        distance_m: f64,
        /// The bound \[m\].
        bound_m: f64,
    },
    /// The dead-man's switch was let go.
    #[error("dead-man's switch released for {age_s:.3} s")]
    DeadMan {
        /// Age of the newest token \[s\].
        age_s: f64,
    },
    /// A non-finite number in the state or the command.
    #[error("a non-finite number in {place}")]
    NonFinite {
        /// Where it was.
        place: &'static str,
    },
}

impl StopReason {
    /// Which of the causes it is.
    pub const fn cause(&self) -> Cause {
        match self {
            Self::ArmFault { .. }
            | Self::ArmNotEnabled { .. }
            | Self::EncoderTimeout { .. }
            | Self::Workspace { .. } => Cause::Device,
            Self::ImageTimeout { .. }
            | Self::MeasurementsLate { .. }
            | Self::MeasurementsAhead { .. } => Cause::MeasurementsLate,
            Self::NeedleLost { .. } | Self::Implausible { .. } => Cause::NeedleLost,
            Self::TissueStretch { .. } | Self::EntryForce { .. } => Cause::Tear,
            Self::Stall { .. } => Cause::Stall,
            Self::ModelFailed { .. }
            | Self::NonFinite { .. }
            | Self::Disagreement { .. }
            | Self::OutsideTissue => Cause::ModelFailed,
            Self::DeadMan { .. } => Cause::Operator,
        }
    }
}

/// What the monitor found out before a command goes out.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// The needle is being drawn back: that needs neither images nor a model.
    pub withdrawing: bool,
    /// The tip stays behind the base.
    pub stalled: Option<Stalled>,
    /// Measurements are refused for their stamps.
    pub stale: Option<Stale>,
    /// The newest measurement cannot be of this needle.
    pub implausible: Option<Implausible>,
    /// Since when the springs model has no equilibrium, and why.
    pub model: Option<(Stamp, String)>,
}

/// Verdict on one arm period.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// The command may go out.
    Go,
    /// Zero velocity instead of the command, for this cause.
    Hold(Cause),
    /// Stop and end the run.
    Stop(StopReason),
}

/// Watches one run.
#[derive(Clone, Debug)]
pub struct Supervisor {
    bounds: Bounds,
    newest_image: Stamp,
    newest_sight: Stamp,
    problem: String,
    implausible: Option<Implausible>,
    stalled: Option<Stamp>,
    dead_man: (u64, Stamp),
    latched: Option<StopReason>,
}

impl Supervisor {
    /// A supervisor for a run that starts at `start`.
    pub fn new(bounds: Bounds, start: Stamp) -> Self {
        Self {
            bounds,
            newest_image: start,
            newest_sight: start,
            problem: String::new(),
            implausible: None,
            stalled: None,
            dead_man: (0, start),
            latched: None,
        }
    }

    /// Notes an image that arrived at `now`, and why the needle was not found in it, if it was not.
    pub fn image(&mut self, now: Stamp, problem: Option<String>) {
        self.newest_image = now;
        match problem {
            None => self.newest_sight = now,
            Some(problem) => self.problem = problem,
        }
    }

    /// Notes the count of dead-man's tokens.
    pub fn dead_man(&mut self, now: Stamp, count: u64) {
        if count != self.dead_man.0 {
            self.dead_man = (count, now);
        }
    }

    /// The latched reason, if any.
    pub fn latched(&self) -> Option<&StopReason> {
        self.latched.as_ref()
    }

    /// Judges the state, the newest telemetry and the monitor's evidence before a command goes out.
    pub fn judge(
        &mut self,
        now: Stamp,
        arm: &ArmState,
        telemetry: &Telemetry,
        evidence: &Evidence,
    ) -> Verdict {
        // The time counts from when the arm was held, not from when the tip fell behind.
        self.stalled = evidence.stalled.and(self.stalled.or(Some(now)));
        self.implausible = evidence.implausible.or(self.implausible);
        if self.latched.is_none() {
            self.latched = self
                .device(now, arm, telemetry)
                .and_then(|()| {
                    if evidence.withdrawing {
                        return Ok(());
                    }
                    self.measurements(now, evidence)?;
                    self.needle(now, telemetry, evidence)
                })
                .err();
        }
        match &self.latched {
            Some(reason) => Verdict::Stop(reason.clone()),
            None => self.doubt(now, evidence).map_or(Verdict::Go, Verdict::Hold),
        }
    }

    /// Why the arm stands still for now.
    fn doubt(&self, now: Stamp, evidence: &Evidence) -> Option<Cause> {
        let model_fails = |(since, _): &(Stamp, String)| now.since(*since) > MODEL_HOLD;
        if evidence.withdrawing {
            None
        } else if evidence.stalled.is_some() {
            Some(Cause::Stall)
        } else if evidence.implausible.is_some() {
            Some(Cause::NeedleLost)
        } else if now.since(self.newest_image) > self.bounds.image_hold || evidence.stale.is_some()
        {
            Some(Cause::MeasurementsLate)
        } else if now.since(self.newest_sight) > self.bounds.image_hold {
            Some(Cause::NeedleLost)
        } else if evidence.model.as_ref().is_some_and(model_fails) {
            Some(Cause::ModelFailed)
        } else {
            None
        }
    }

    /// The arm, its operator, and numbers that are none.
    fn device(&self, now: Stamp, arm: &ArmState, t: &Telemetry) -> Result<(), StopReason> {
        let bounds = &self.bounds;
        match arm.mode {
            ArmMode::Enabled | ArmMode::Moving => {}
            ArmMode::Faulted(fault) => return Err(StopReason::ArmFault { fault }),
            mode => return Err(StopReason::ArmNotEnabled { mode }),
        }
        if now.since(arm.stamp) > bounds.encoder_stop {
            return Err(StopReason::EncoderTimeout {
                age_s: now.secs_since(arm.stamp),
            });
        }
        if bounds
            .dead_man
            .is_some_and(|longest| now.since(self.dead_man.1) > longest)
        {
            return Err(StopReason::DeadMan {
                age_s: now.secs_since(self.dead_man.1),
            });
        }
        let tip = t.world_from_tip.origin().coords();
        for (finite, place) in [
            (arm.positions.is_finite(), "joint positions"),
            (t.joint_rates.is_finite(), "joint rates"),
            (tip.iter().all(|x| x.is_finite()), "the estimated tip"),
        ] {
            if !finite {
                return Err(StopReason::NonFinite { place });
            }
        }
        let offset = t.world_from_base.origin().point() - bounds.axis.0;
        let distance = (offset - bounds.axis.1.scale(offset.dot(&bounds.axis.1))).norm();
        if exceeds(distance, bounds.workspace_radius) {
            return Err(StopReason::Workspace {
                distance_m: distance,
                bound_m: bounds.workspace_radius,
            });
        }
        Ok(())
    }

    /// Whether the needle is seen.
    fn measurements(&self, now: Stamp, evidence: &Evidence) -> Result<(), StopReason> {
        let bounds = &self.bounds;
        match evidence.stale {
            Some(Stale::Late { age_s }) => {
                return Err(StopReason::MeasurementsLate {
                    age_s,
                    bound_s: bounds.image_age.as_secs_f64(),
                });
            }
            Some(Stale::Ahead { by_s }) => return Err(StopReason::MeasurementsAhead { by_s }),
            None => {}
        }
        if now.since(self.newest_image) > bounds.image_stop {
            return Err(StopReason::ImageTimeout {
                age_s: now.secs_since(self.newest_image),
            });
        }
        if now.since(self.newest_sight) > bounds.image_stop {
            return Err(self.implausible.map_or_else(
                || StopReason::NeedleLost {
                    age_s: now.secs_since(self.newest_sight),
                    problem: self.problem.clone(),
                },
                |problem| StopReason::Implausible { problem },
            ));
        }
        Ok(())
    }

    /// Needle and tissue, by measurement and by a model that is not read while it fails.
    fn needle(&self, now: Stamp, t: &Telemetry, evidence: &Evidence) -> Result<(), StopReason> {
        let bounds = &self.bounds;
        if let (Some(since), Some(stalled)) = (self.stalled, evidence.stalled)
            && now.since(since) > STALL_STOP
        {
            return Err(StopReason::Stall { stalled });
        }
        if let Some((since, problem)) = &evidence.model {
            return if now.since(*since) > MODEL_STOP {
                Err(StopReason::ModelFailed {
                    for_s: now.secs_since(*since),
                    problem: problem.clone(),
                })
            } else {
                Ok(())
            };
        }
        if exceeds(t.model.max_stretch, bounds.tissue_stretch) {
            return Err(StopReason::TissueStretch {
                value_m: t.model.max_stretch,
                bound_m: bounds.tissue_stretch,
            });
        }
        if exceeds(t.model.entry_force, bounds.entry_force) {
            return Err(StopReason::EntryForce {
                value_n: t.model.entry_force,
                bound_n: bounds.entry_force,
            });
        }
        Ok(())
    }
}

/// Beyond the bound; a value that is not a number is.
fn exceeds(value: f64, bound: f64) -> bool {
    value.is_nan() || value > bound
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::frame::{NeedleBase, World};
    use hal::telemetry::{LawReport, ModelReport, Phase, Tracking};
    use hal::{Joints, Position, Transform, Twist};
    use nalgebra::Isometry3;

    fn bounds() -> Bounds {
        Bounds {
            tissue_stretch: 8e-3,
            entry_force: 5.0,
            axis: (Point3::origin(), -Vector3::z_axis()),
            workspace_radius: 0.06,
            image_hold: Duration::from_millis(200),
            image_stop: Duration::from_secs(2),
            image_age: Duration::from_millis(550),
            encoder_stop: Duration::from_millis(350),
            dead_man: None,
        }
    }

    fn state() -> ArmState {
        let positions = Joints::from([0.0; 6]);
        ArmState {
            stamp: Stamp::ZERO,
            positions,
            rates: positions,
            mode: ArmMode::Moving,
        }
    }

    fn telemetry() -> Telemetry {
        let world_from_base: Transform<World, NeedleBase> =
            Transform::assume(Isometry3::translation(0.01, 0.0, 0.1));
        Telemetry {
            step: 1,
            stamp: Stamp::ZERO,
            image_stamp: None,
            phase: Phase::Steering,
            tracking: Tracking::Tracked,
            arm_mode: ArmMode::Moving,
            joints: state().positions,
            joint_rates: state().positions,
            world_from_base,
            world_from_tip: Transform::identity(),
            base_twist: Twist::zero(),
            measured_tip: None,
            target: Position::new(Point3::origin()),
            lateral_error: 0.0,
            axial_distance: 0.0,
            depth: 0.0,
            law: LawReport::default(),
            model: ModelReport::default(),
            truth: None,
        }
    }

    #[test]
    fn bounds_are_kept_and_latched() {
        type Change = fn(&mut Telemetry);
        let changes: [(&str, Change); 5] = [
            ("stretch", |t| t.model.max_stretch = 9e-3),
            ("stretch", |t| t.model.max_stretch = f64::NAN),
            ("force", |t| t.model.entry_force = 6.0),
            ("rates", |t| t.joint_rates[2] = f64::NAN),
            ("base", |t| {
                t.world_from_base = Transform::assume(Isometry3::translation(0.05, 0.05, 0.1));
            }),
        ];
        for (what, change) in changes {
            let mut supervisor = Supervisor::new(bounds(), Stamp::ZERO);
            let good = telemetry();
            assert_eq!(
                supervisor.judge(Stamp::ZERO, &state(), &good, &Evidence::default()),
                Verdict::Go
            );
            let mut bad = telemetry();
            change(&mut bad);
            let verdict = supervisor.judge(Stamp::ZERO, &state(), &bad, &Evidence::default());
            let Verdict::Stop(reason) = verdict else {
                panic!("{what}: {verdict:?}")
            };
            assert!(reason.to_string().contains(what), "{what}: {reason}");
            // Compared as text: a reason may hold NaN.
            let again = supervisor.judge(Stamp::ZERO, &state(), &good, &Evidence::default());
            let Verdict::Stop(kept) = again else {
                panic!("{what}: {again:?}")
            };
            assert_eq!(kept.to_string(), reason.to_string());
            assert_eq!(
                supervisor.latched().map(ToString::to_string),
                Some(reason.to_string())
            );
        }
    }

    #[test]
    fn watchdogs_hold_before_they_stop() {
        let mut supervisor = Supervisor::new(bounds(), Stamp::ZERO);
        let mut at = |seconds: f64| {
            let now = Stamp::from_secs(seconds);
            supervisor.judge(
                now,
                &ArmState {
                    stamp: now,
                    ..state()
                },
                &telemetry(),
                &Evidence::default(),
            )
        };
        assert_eq!(at(0.2), Verdict::Go);
        assert_eq!(at(0.21), Verdict::Hold(Cause::MeasurementsLate));
        assert!(matches!(
            at(2.1),
            Verdict::Stop(StopReason::ImageTimeout { .. })
        ));
        let mut supervisor = Supervisor::new(bounds(), Stamp::ZERO);
        let late = supervisor.judge(
            Stamp::from_secs(0.36),
            &state(),
            &telemetry(),
            &Evidence::default(),
        );
        assert!(matches!(
            late,
            Verdict::Stop(StopReason::EncoderTimeout { .. })
        ));
    }
}
