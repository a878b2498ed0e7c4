//! One step of control: from measurements to joint rates. Read this file first.
//!
//! [`Cycle::step`] is the data flow in order, one line a stage. It is a function of the cycle's
//! state and the [`Snapshot`]: no I/O, no clock.

mod measurement;

use hal::frame::LeftCamera;
use hal::telemetry::{Phase, Telemetry, Tracking};
use hal::{
    ArmState, Position, SensedMarker, SensedShape, SensedTip, Stamp, StereoFrame, Transform,
};
use hybrid_control::view::{Decision, Entry, Law, Springs, Target, Tip, View};
use hybrid_control::{
    Estimator, EstimatorError, LawError, Limits, Start, TissueField, lateral_error, law_by_name,
    target_ahead,
};
use nalgebra::{Isometry3, Point3, Vector3};
use robots::kinematics::{RateSettings, TwistRates};
use vision::track::TrackSettingsError;

pub use crate::bearings::{Bearings, base_pose};
use crate::bearings::{entry_point, first_telemetry, freedom};
use crate::config::{Config, InsertionBy};
use crate::guide::Guide;
use crate::monitor::Trace;
use crate::monitor::plausibility::{Implausible, Plausibility};
use crate::odometry::Odometry;
use crate::roll::{joint_rates, roll_travel, within_speed};
use crate::sight::Sight;
use crate::springs::{self, SpringsError, SpringsModel};
use crate::tissue::{Tissue, narrow};

/// Poses kept: more than a second at any arm's rate.
const ODOMETRY: usize = 256;
/// Depth from which a needle is inside, however arm and cameras are registered \[m\].
const INSIDE: f64 = 3e-3;
/// Depth up to which a path is laid anew when its tissue turns out to breathe \[m\].
const SHORT_PATH: f64 = 0.015;

/// Everything a step reads.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// The present time.
    pub now: Stamp,
    /// Time for which the step's rates will act \[s\].
    pub dt: f64,
    /// Newest encoder reading.
    pub arm: &'a ArmState,
    /// A new measurement of the needle, if a shape sensor made one.
    pub shape: Option<&'a SensedShape>,
    /// A new pair of images, if cameras took one.
    pub pair: Option<&'a StereoFrame>,
    /// A new measurement of the marker that the tissue carries, if one arrived.
    pub marker: Option<SensedMarker>,
    /// What the run is doing.
    pub phase: Phase,
}

/// A configuration that makes no cycle.
#[derive(Debug, thiserror::Error)]
pub enum CycleError {
    /// The law.
    #[error(transparent)]
    Law(#[from] LawError),
    /// The springs model.
    #[error(transparent)]
    Springs(#[from] SpringsError),
    /// The estimator.
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
    /// The tracker.
    #[error(transparent)]
    Tracker(#[from] TrackSettingsError),
}

/// The controller.
pub struct Cycle {
    bearings: Bearings,
    limits: Limits,
    /// What they leave the law where the tissue is at rest.
    limits_at_rest: Limits,
    rates: RateSettings,
    insertion_speed: f64,
    entry: Entry,
    odometry: Odometry,
    estimator: Estimator,
    tissue: Tissue,
    /// Tissue now; nothing where it does not move.
    field: Option<TissueField>,
    springs: SpringsModel,
    straight: Box<dyn Law>,
    law: Box<dyn Law>,
    target: Option<Position<LeftCamera>>,
    shaft: Vec<(Point3<f64>, f64)>,
    sight: Option<Sight>,
    plausibility: Plausibility,
    trace: Trace,
    /// Since when the springs model has no equilibrium, and why.
    model_failure: Option<(Stamp, String)>,
    /// The newest measurement of the tip that was taken, with its exposure.
    measured: Option<(Stamp, SensedTip)>,
    telemetry: Telemetry,
}

impl Cycle {
    /// A controller for `config`, with the arm where `state` says and the tip at the surface.
    ///
    /// # Errors
    /// See [`CycleError`].
    pub fn new(config: &Config, bearings: Bearings, state: &ArmState) -> Result<Self, CycleError> {
        let world_from_base = base_pose(&bearings, state);
        let inward = config.inward();
        let entry = Entry {
            point: entry_point(config, &world_from_base),
            inward,
        };
        let needle = springs::needle(config).map_err(SpringsError::Needle)?;
        let start = Start {
            length: needle.length(),
            bending_stiffness: needle.bending_stiffness(),
            cutting_edge: springs::bevel_length(config),
            guide_gap: Guide::of(config).map(|guide| guide.gap),
            tip_sensor: bearings.tip_sensor,
            advance_by_tip: config.insertion.by == InsertionBy::Hand,
            entry,
            world_from_base,
        };
        let mut estimator = Estimator::new(&config.estimator, &start)?;
        let tip = estimator.predict(state.stamp, &world_from_base);
        let limits = within_speed(&config.limits, &bearings.chain);
        Ok(Self {
            limits_at_rest: limits.clone(),
            limits,
            rates: RateSettings::default(),
            insertion_speed: config.run.insertion_speed_mm_s * 1e-3,
            entry,
            odometry: Odometry::new(ODOMETRY),
            estimator,
            tissue: Tissue::of(config, &entry),
            field: None,
            springs: SpringsModel::new(config, &world_from_base)?,
            straight: law_by_name("none", &config.law)?,
            law: law_by_name(&config.run.law, &config.law)?,
            target: None,
            shaft: Vec::with_capacity(128),
            sight: Sight::of(config, &bearings)?,
            plausibility: Plausibility::new(config.needle.length_mm * 1e-3),
            trace: Trace::default(),
            model_failure: None,
            measured: None,
            telemetry: first_telemetry(state, &world_from_base, &tip.world_from_tip),
            bearings,
        })
    }

    /// Steers with `law` instead of the configuration's.
    pub fn set_law(&mut self, law: Box<dyn Law>) {
        self.law = law;
    }

    /// The name of the law that steers.
    pub fn law_name(&self) -> &str {
        self.law.name()
    }

    /// Sets the target, in the stereo frame, and prepares the law for it. Where the target is a
    /// marker the cycle goes on following that.
    pub fn set_target(&mut self, target: Position<LeftCamera>) {
        self.target = Some(target);
        self.law.reset();
    }

    /// The newest telemetry.
    pub fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }

    /// The newest telemetry, for what joins it behind the cycle: truth, limits of the arm.
    pub fn telemetry_mut(&mut self) -> &mut Telemetry {
        &mut self.telemetry
    }

    /// The estimator, for checks before the start.
    pub fn estimator(&self) -> &Estimator {
        &self.estimator
    }

    /// What the tracker made of the newest pair; nothing where no images close the loop.
    pub fn sight(&self) -> Option<&Sight> {
        self.sight.as_ref()
    }

    /// Why the newest measurement was not taken, if it cannot be of this needle.
    pub fn implausible(&self) -> Option<&Implausible> {
        self.plausibility.problem()
    }

    /// Since when the springs model has no equilibrium, and why.
    pub fn model_failure(&self) -> Option<&(Stamp, String)> {
        self.model_failure.as_ref()
    }

    /// The newest measurement of the tip that was taken, and its exposure.
    pub fn measured(&self) -> Option<&(Stamp, SensedTip)> {
        self.measured.as_ref()
    }

    /// Pose of the base at `stamp`, by the encoders, in World.
    pub fn base_at(&self, stamp: Stamp) -> Option<Isometry3<f64>> {
        self.odometry.at(stamp)
    }

    /// Whether the tissue is known, or suspected, to move.
    pub fn tissue_moves(&self) -> bool {
        self.field.is_some() || self.tissue.is_learning()
    }

    /// Where a place of World lies while the tissue is at rest.
    pub fn at_rest_point(&self, place: &Point3<f64>) -> Point3<f64> {
        self.tissue.target_at_rest(place)
    }

    /// The limits of the laws.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// One step; the answer's `joint_rates` are the command.
    pub fn step(&mut self, snapshot: &Snapshot<'_>) -> &Telemetry {
        let base = self.base(snapshot);
        let base = self.at_rest(snapshot, &base);
        let measured = match snapshot.shape {
            Some(shape) => self.measure(shape),
            None => snapshot.pair.and_then(|pair| self.track(pair)),
        };
        let tip = self.estimator.predict(snapshot.now, &base);
        let springs = self.model(snapshot.now, &base, &tip);
        let target = self.target_in_world(&tip);
        let decision = self.decide(snapshot, &base, &tip, springs.as_ref(), target);
        let decision = self.follow_tissue(&base, decision);
        self.show();
        let rates = joint_rates(&self.bearings, snapshot.arm, &decision.twist, &self.rates);
        self.report(snapshot, &base, &tip, target, measured, decision, rates);
        &self.telemetry
    }

    /// Base pose from the encoders, kept for the measurements to come.
    fn base(&mut self, snapshot: &Snapshot<'_>) -> Isometry3<f64> {
        let base = base_pose(&self.bearings, snapshot.arm);
        self.odometry.push(snapshot.arm.stamp, base);
        base
    }

    /// The base where the tissue is at rest: estimator, model and law work there.
    fn at_rest(&mut self, snapshot: &Snapshot<'_>, base: &Isometry3<f64>) -> Isometry3<f64> {
        if let Some(seen) = snapshot.marker {
            let place = self.bearings.world_from_left_camera * seen.position;
            self.tissue
                .see_marker(seen.stamp, place.point(), seen.sigma);
        }
        self.field = self.tissue.field_to_follow(snapshot.now);
        let at_rest = self.field.map_or(*base, |field| field.pose_to_rest(base));
        narrow(&mut self.limits_at_rest, &self.limits, base, &at_rest);
        at_rest
    }

    /// Adds the tissue's own motion to what the law wants of the base at rest.
    fn follow_tissue(&self, base: &Isometry3<f64>, mut decision: Decision) -> Decision {
        if let Some(field) = &self.field {
            decision.twist = field.twist_within(base, &decision.twist, &self.limits);
        }
        decision
    }

    /// Springs model at the present base, its springs born at the filtered tip. While it has no
    /// equilibrium nothing is reported of it: the last good state is not the present one.
    fn model(&mut self, now: Stamp, base: &Isometry3<f64>, tip: &Tip) -> Option<Springs> {
        let measured = tip
            .age
            .is_finite()
            .then(|| self.estimator.tip_beside_base().coords);
        let (stiffness, sigma) = self.estimator.stiffness();
        self.telemetry.model.stiffness = stiffness;
        self.telemetry.model.stiffness_sigma = sigma;
        let model = &mut self.telemetry.model;
        let updated = self.springs.update(base, measured, stiffness);
        let updated = updated
            .map_err(|error| error.to_string())
            .and_then(|springs| {
                // A needle without tissue has an equilibrium too, which says nothing of this one.
                let inserted = self.estimator.depth();
                if self.springs.depth() > 0.0 || inserted < INSIDE {
                    Ok(springs)
                } else {
                    Err(format!(
                        "its needle is outside of the tissue, the measured one {:.0} mm inside",
                        inserted * 1e3
                    ))
                }
            });
        match updated {
            Ok(springs) => {
                self.model_failure = None;
                self.springs.report(model);
                model.shaft_off = springs::shaft_off(&model.shape, &self.shaft);
                Some(springs)
            }
            Err(error) => {
                let since = self.model_failure.take().map_or(now, |(since, _)| since);
                self.model_failure = Some((since, error));
                springs::report_failure(model);
                None
            }
        }
    }

    /// The path that the law expects; all that was computed at rest is shown where it is now.
    fn show(&mut self) {
        let model = &mut self.telemetry.model;
        self.law
            .predicted_path(&self.estimator, &mut model.predicted_path);
        if let Some(field) = &self.field {
            let points = [
                &mut model.shape,
                &mut model.spring_points,
                &mut model.rest_points,
                &mut model.predicted_path,
            ];
            for point in points.into_iter().flatten() {
                *point = field.point_from_rest(&Point3::from(*point)).coords;
            }
        }
    }

    fn target_in_world(&self, tip: &Tip) -> Target {
        let position = match self.target {
            Some(target) => {
                let given = self.bearings.world_from_left_camera * target;
                self.tissue.target_at_rest(given.point())
            }
            // None set yet: far ahead on the tip axis.
            None => Point3::from(tip.world_from_tip.translation.vector + tip.axis()),
        };
        Target {
            position,
            velocity: Vector3::zeros(),
        }
    }

    fn decide(
        &mut self,
        snapshot: &Snapshot<'_>,
        base: &Isometry3<f64>,
        tip: &Tip,
        springs: Option<&Springs>,
        target: Target,
    ) -> Decision {
        let view = View {
            time: snapshot.now,
            dt: snapshot.dt,
            tip: *tip,
            target,
            entry: self.entry,
            depth: self.estimator.depth().max(0.0),
            world_from_base: *base,
            springs: springs.copied(),
            shape: if springs.is_some() {
                &self.telemetry.model.shape
            } else {
                &[]
            },
            estimator: &self.estimator,
            roll_travel: roll_travel(&self.bearings, snapshot.arm),
            freedom: freedom(&self.bearings, snapshot.arm),
            limits: &self.limits_at_rest,
            insertion_speed: self.tissue.speed(
                snapshot.now,
                self.telemetry.axial_distance,
                self.insertion_speed,
            ),
        };
        match snapshot.phase {
            Phase::PreInsertion => self.straight.decide(&view),
            Phase::Steering if self.tissue.is_learning() => Decision::hold(),
            Phase::Steering => self.law.decide(&view),
            _ => Decision::hold(),
        }
    }

    /// Prepares the law for steering again after a pause.
    pub fn resume(&mut self) {
        self.law.reset();
    }

    #[expect(clippy::too_many_arguments, reason = "one for each stage of the step")]
    fn report(
        &mut self,
        snapshot: &Snapshot<'_>,
        base: &Isometry3<f64>,
        tip: &Tip,
        target: Target,
        measured: Option<SensedTip>,
        decision: Decision,
        rates: TwistRates,
    ) {
        let t = &mut self.telemetry;
        t.step += 1;
        t.stamp = snapshot.now;
        t.phase = snapshot.phase;
        t.arm_mode = snapshot.arm.mode;
        t.joints = snapshot.arm.positions;
        t.joint_rates = rates.rates;
        let now = |pose: &Isometry3<f64>| self.field.map_or(*pose, |f| f.pose_from_rest(pose));
        let world_from_tip = now(&tip.world_from_tip);
        let carried = self.field.filter(|_| self.tissue.is_marked());
        let place = match (carried, self.target) {
            (None, Some(given)) => *(self.bearings.world_from_left_camera * given).point(),
            (None, None) => target.position,
            (Some(field), _) => field.point_from_rest(&target.position),
        };
        t.world_from_base = Transform::assume(now(base));
        t.world_from_tip = Transform::assume(world_from_tip);
        t.base_twist = decision.twist;
        if measured.is_some() {
            t.measured_tip = measured;
        } else if t.tracking == Tracking::Tracked {
            t.tracking = Tracking::Predicted;
        }
        if let Some(given) = self.target {
            t.target = if carried.is_some() {
                self.bearings.world_from_left_camera.inverse() * Position::new(place)
            } else {
                given
            };
            t.lateral_error = lateral_error(&world_from_tip, &place);
            t.axial_distance = target_ahead(&world_from_tip, &place);
        }
        t.depth = self.estimator.depth().max(0.0);
        t.law = decision.report;
        t.law.limits.extend(rates.limits);
        t.truth = None;
    }
}

impl core::fmt::Debug for Cycle {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Cycle")
            .field("law", &self.law.name())
            .field("step", &self.telemetry.step)
            .finish_non_exhaustive()
    }
}
