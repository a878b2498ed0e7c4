//! The estimator: where the tip is, what the bevel and the tissue do to it, and what will come.
//!
//! Measurements are taken in at the image's time stamp with the base pose of that moment, then
//! the state is predicted to the present. The filtered track of the tip is the cut path; the rod
//! on this path gives the tip's slope, which with the bevel vector and a slow disturbance is the
//! direction of growth.

mod input;
mod filter;
mod moment;
mod path;
mod rod;
mod rollout;
mod shown;
mod stiffness;
mod tip;
mod unseen;

use hal::Stamp;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use crate::settings::EstimatorSettings;
use crate::view::Tip;
pub use input::{EstimatorError, Health, Observation, Start, TipSensor};
use moment::{Moment, advance, azimuth_of, clamp_of, insertion_frame, tip_row};
use path::CutPath;
use rod::{Clamp, Rod, RodConstants, Row};
pub use rollout::Rollout;
use stiffness::StiffnessFit;
use tip::TipFilter;
use unseen::Unseen;

/// A tip farther than this behind the end of its path is no longer held by uncut tissue: where
/// it is then says nothing about the path \[m\].
const LOOSE: f64 = 0.15e-3;

/// Share by which a tip that is drawn back follows a measurement.
const FOLLOW: f64 = 0.2;

/// Way from the start over which a needle whose base goes straight on counts as straight \[m\].
const STRAIGHT: f64 = 6e-3;
/// How far its base may go aside meanwhile \[m\].
const ASIDE: f64 = 0.1e-3;

/// No measurement is taken for better than this \[m\].
const LEAST_SIGMA: f64 = 1e-6;

/// Load columns of the moment's rod.
const X: usize = 0;
const Y: usize = 1;
const PIVOT: usize = 2;
const SHIFT: usize = 3;
const TIP: usize = 4;

/// Filter over tip, path, bevel, disturbance and stiffness, with the predictive model.
#[derive(Clone, Debug)]
pub struct Estimator {
    settings: EstimatorSettings,
    /// Insertion frame: origin at the entry at rest, z into the tissue.
    world_from_insertion: Isometry3<f64>,
    /// From the base to the cutting edge, which is what the tissue holds \[m\].
    length: f64,
    /// From O to the cutting edge \[m\].
    reach: f64,
    constants: RodConstants,
    measured: Moment,
    present: Moment,
    present_base: Isometry3<f64>,
    stiffness: StiffnessFit,
    last_fit: Option<Stamp>,
    /// Measured minus modelled depth of the tip \[m\].
    depth_offset: f64,
    /// Measured minus modelled slope of the tip, slowly filtered.
    slope_offset: Vector2<f64>,
    /// Measured tip beside its hole while it is drawn back, filtered \[m\]: the tissue is stretched.
    beside_hole: Vector2<f64>,
    observations: u64,
    /// Way of the tip as far as the model moved it, without what measurements changed \[m, World\].
    way: Vector3<f64>,
    start: Start,
    /// Depth up to which it may be straight \[m\], and where its base started, across \[m\].
    straight: (f64, Vector2<f64>),
    /// Memory for a rod in stiffer tissue.
    stiffer: Rod,
}

fn positive(quantity: &'static str, value: f64) -> Result<(), EstimatorError> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(EstimatorError::NotPositive { quantity, value })
    }
}

fn planar(row: &Row) -> Vector2<f64> {
    Vector2::new(row[X], row[Y])
}

/// Where a tip that is drawn back would be in its hole, were the tissue not stretched.
fn in_hole(m: &Moment) -> Vector2<f64> {
    planar(&m.path.at((m.path.tip_depth() - m.retracted).max(0.0)))
}

impl Estimator {
    /// An estimator before its first measurement. Where the tip is already inside the tissue,
    /// its path so far is taken as straight from the entry.
    ///
    /// # Errors
    /// See [`EstimatorError`].
    pub fn new(settings: &EstimatorSettings, start: &Start) -> Result<Self, EstimatorError> {
        positive("needle length", start.length)?;
        positive("bending stiffness", start.bending_stiffness)?;
        positive("stiffness_n_m2", settings.stiffness_n_m2)?;
        positive("step_mm", settings.step_mm)?;
        positive("cut_angle_deg", settings.cut_angle_deg)?;
        if !(0.0..=0.02).contains(&start.cutting_edge) {
            return Err(EstimatorError::NotPositive {
                quantity: "cutting edge",
                value: start.cutting_edge,
            });
        }
        let axis = start.world_from_base.rotation * Vector3::z();
        let angle = axis.angle(&start.entry.inward);
        if angle.is_nan() || angle >= 60_f64.to_radians() {
            return Err(EstimatorError::Askew {
                angle_deg: angle.to_degrees(),
            });
        }
        let world_from_insertion = insertion_frame(start);
        let constants = RodConstants {
            bending: start.bending_stiffness,
            axial: settings.axial_load_n,
            bed: settings.stiffness_n_m2,
        };
        let base = world_from_insertion.inverse() * start.world_from_base;
        let clamp = clamp_of(&base, start.guide_gap, &StiffnessFit::new(settings));
        let reach = start.cutting_edge;
        let tip = base * Point3::new(0.0, 0.0, start.length + reach);
        let entry = planar(&clamp.w) - planar(&clamp.slope) * clamp.z;
        let mut path = CutPath::new(settings.step_mm * 1e-3);
        path.for_each(|_, row| *row = tip_row(&entry));
        path.extend_to(tip.z.max(0.0), &tip_row(&tip.coords.xy()));
        path.for_each(|_, row| row[TIP] = 0.0);
        path.set_tip(&tip_row(&tip.coords.xy()));
        let unseen = start
            .tip_sensor
            .map(|sensor| Unseen::new(&sensor, settings));
        let mut moment = Moment {
            stamp: None,
            filter: TipFilter::new(tip.coords.xy(), settings, unseen.as_ref()),
            path,
            rod: Rod::default(),
            base,
            clamp,
            azimuth: azimuth_of(&base),
            retracted: 0.0,
            straight: unseen.is_some(),
            slope_by_stiffness: Vector2::zeros(),
        };
        moment.rod.solve(&constants, &moment.clamp, &moment.path);
        Ok(Self {
            settings: settings.clone(),
            world_from_insertion,
            length: start.length + reach,
            reach,
            constants,
            present: moment.clone(),
            measured: moment,
            present_base: start.world_from_base,
            stiffness: StiffnessFit::new(settings),
            last_fit: None,
            depth_offset: 0.0,
            slope_offset: Vector2::zeros(),
            beside_hole: Vector2::zeros(),
            observations: 0,
            way: Vector3::zeros(),
            start: *start,
            straight: (tip.z.max(0.0) + STRAIGHT, base.translation.vector.xy()),
            stiffer: Rod::default(),
        })
    }

    /// Takes in a measurement, at its own time.
    pub fn observe(&mut self, o: &Observation<'_>) -> Health {
        let sane = o.position.iter().all(|x| x.is_finite())
            && o.direction.iter().all(|x| x.is_finite())
            && o.world_from_base
                .translation
                .vector
                .iter()
                .all(|x| x.is_finite())
            && o.position_sigma.is_finite()
            && o.direction_sigma.is_finite()
            && o.position_sigma >= 0.0
            && o.direction_sigma >= 0.0;
        if !sane {
            return Health::Rejected;
        }
        if self.measured.stamp.is_some_and(|last| o.stamp <= last) {
            return Health::Stale;
        }
        let elapsed = self
            .measured
            .stamp
            .map_or(0.0, |last| o.stamp.secs_since(last));
        let base = self.world_from_insertion.inverse() * o.world_from_base;
        self.measured.stamp = Some(o.stamp);
        self.advance_measured(&base);
        let axis = self
            .world_from_insertion
            .inverse_transform_vector(&o.direction);
        // The edge is seen through O and the axis: the model's, which is less noisy than the
        // measured one, once there is a path that it stands on.
        let slope = planar(&self.measured.rod.tip_slope()) + self.slope_offset;
        let lever = if self.observations == 0 {
            axis
        } else {
            Vector3::new(slope.x, slope.y, 1.0).normalize()
        };
        let position = self
            .world_from_insertion
            .inverse_transform_point(&o.position)
            + lever * self.reach;
        self.observations += 1;
        if self.observations == 1 && self.start.tip_sensor.is_none() {
            self.lay_first_path(&position.coords.xy(), &axis);
        }
        let m = &mut self.measured;
        let slope = planar(&m.rod.tip_slope());
        let slope_by = m.slope_by();
        let ahead = position.z - m.path.tip_depth();
        let gain = (1.0 / self.observations as f64).max(0.05);
        if !self.start.advance_by_tip {
            self.depth_offset += gain * (ahead + m.retracted);
        }
        if m.retracted > LOOSE {
            let beside = position.coords.xy() - m.filter.place_bias() - in_hole(m);
            self.beside_hole += (beside - self.beside_hole) * FOLLOW;
            return Health::Used;
        }
        // It cuts on from where it is.
        let beside = core::mem::take(&mut self.beside_hole);
        m.filter.shift(&beside);
        m.filter.measure_position(
            &(position.coords.xy() - slope * ahead),
            o.position_sigma.max(LEAST_SIGMA),
            o.carried,
        );
        if axis.z > 0.3 {
            let difference = Vector2::new(axis.x / axis.z, axis.y / axis.z) - slope;
            let sigma = o
                .direction_sigma
                .max(self.settings.direction_floor_deg.to_radians());
            let sigma = filter::alone(sigma, elapsed);
            m.filter.measure_slope(&difference, &slope_by, sigma);
            // About two seconds, or as long as the noise needs to fall below 0.1 degree.
            let time = (0.033 * (o.direction_sigma / 1.7e-3).powi(2)).max(1.5);
            let gain = (elapsed / time).clamp(gain.min(0.3), 1.0);
            self.slope_offset += (difference - self.slope_offset) * gain;
        }
        self.adopt_unseen(&base);
        let m = &mut self.measured;
        let tip = tip_row(&m.filter.position());
        m.path.set_tip(&tip);
        m.rod.solve(&self.constants, &m.clamp, &m.path);
        self.fit_stiffness(o);
        Health::Used
    }

    /// Predicts to the present with the base as it is now, and answers the tip.
    pub fn predict(&mut self, now: Stamp, world_from_base: &Isometry3<f64>) -> Tip {
        let base = self.world_from_insertion.inverse() * world_from_base;
        if base.translation.vector.iter().all(|x| x.is_finite()) {
            let Self {
                measured, present, ..
            } = self;
            present.stamp = measured.stamp;
            present.filter.clone_from(&measured.filter);
            present.path.copy_from(&measured.path);
            present.rod.clone_from(&measured.rod);
            present.base = measured.base;
            present.clamp = measured.clamp;
            present.azimuth = measured.azimuth;
            present.retracted = measured.retracted;
            present.straight = measured.straight;
            present.slope_by_stiffness = measured.slope_by_stiffness;
            if self.settings.compensate_latency {
                advance(
                    present,
                    &base,
                    (self.length, &self.start),
                    self.depth_offset,
                    &self.constants,
                    &self.stiffness,
                    &self.settings,
                );
            }
            self.present_base = *world_from_base;
        }
        let age = self
            .measured
            .stamp
            .map_or(f64::INFINITY, |last| now.secs_since(last).max(0.0));
        self.tip(age)
    }

    /// Stiffness per length \[N/m2\] and the standard deviation of its logarithm.
    pub fn stiffness(&self) -> (f64, f64) {
        (self.constants.bed, self.stiffness.sigma())
    }

    /// Natural curvature at full bevel effect, 2 gamma / lambda \[1/m\].
    pub fn natural_curvature(&self) -> f64 {
        2.0 * self.present.filter.ruling().bevel().norm() / self.wave_length()
    }

    /// lambda = (4 E I / K)^(1/4) \[m\].
    pub fn wave_length(&self) -> f64 {
        (4.0 * self.constants.bending / self.constants.bed).powf(0.25)
    }

    /// Estimated angle from the nominal bevel direction (-y of the base) to the direction in
    /// which the bevel steers, positive about the needle's z \[rad\].
    pub fn bevel_azimuth(&self) -> f64 {
        let g = self.present.filter.ruling().bevel();
        g.y.atan2(g.x)
    }

    /// Direction of the bevel's effect now, azimuth in the insertion frame \[rad\].
    pub fn bevel_direction(&self) -> f64 {
        self.present.azimuth + self.bevel_azimuth()
    }

    /// Estimated slow disturbance of the direction of cutting \[rad\].
    pub fn disturbance(&self) -> Vector2<f64> {
        self.present.filter.ruling().disturbance()
    }

    /// Standard deviation of the predicted end of a way of `remaining` \[m\], by what is not known
    /// of the bevel, at its full reach `bevel` \[m\], and of the disturbance, now and to come.
    pub(crate) fn end_sigma(&self, remaining: f64, bevel: f64) -> f64 {
        let filter = self.present.filter.ruling();
        let (p, g) = (&filter.p, filter.bevel().norm());
        let by_bevel = bevel * (0.5 * (p[(4, 4)] + p[(5, 5)])).max(0.0).sqrt() / g.max(1e-6);
        let fade = self.settings.disturbance_fade_mm * 1e-3;
        let way = fade * (1.0 - (-remaining / fade).exp());
        let by_disturbance = way * (0.5 * (p[(2, 2)] + p[(3, 3)])).max(0.0).sqrt();
        let walk = self.settings.disturbance_walk_deg.to_radians();
        let to_come = remaining * walk * (remaining / 10e-3 / 3.0).sqrt();
        let by_sensor = filter
            .unseen()
            .map_or(0.0, |unseen| unseen.place_sigma(remaining));
        by_bevel
            .hypot(by_disturbance)
            .hypot(to_come)
            .hypot(by_sensor)
    }

    /// Free length of the needle \[m\].
    pub fn needle_length(&self) -> f64 {
        self.length - self.reach
    }

    /// Depth of O below the surface \[m\].
    pub fn depth(&self) -> f64 {
        self.present.path.tip_depth() - self.present.retracted - self.reach
    }

    /// Change of the tip's slope per pivot of the base about the entry \[rad/rad\], tip held:
    /// near 0 the base has lost its authority, below it acts the wrong way.
    pub fn pivot_authority(&self) -> f64 {
        self.present.rod.tip_slope()[PIVOT]
    }

    /// How far the tip is behind the end of its path \[m\].
    pub fn retracted(&self) -> f64 {
        self.present.retracted
    }

    /// Displacement of the needle from its path at the entry \[m\], in the insertion frame.
    pub fn entry_stretch(&self) -> Vector2<f64> {
        planar(&self.present.rod.entry()) - planar(self.present.path.value(0))
    }

    /// Shift of the base that would relieve the tissue most, in the sense of squared
    /// displacement along the needle \[m\], in the insertion frame.
    pub fn relief(&self) -> Vector2<f64> {
        let m = &self.present;
        Vector2::new(
            m.rod.relief(&m.path, X, SHIFT),
            m.rod.relief(&m.path, Y, SHIFT),
        )
    }

    /// Mean displacement of the needle from its path \[m\].
    pub fn mean_stretch(&self) -> f64 {
        self.present.rod.mean_stretch(&self.present.path, X, Y)
    }

    /// Lateral way of O since the start as the model alone explains it, at the newest measurement
    /// \[m, World\].
    pub fn explained_way(&self) -> Vector3<f64> {
        self.way - self.lateral(&(planar(&self.measured.rod.tip_slope()) * self.reach))
    }

    /// Forgets what was measured so far: the path is laid anew, straight, by the next measurement.
    /// A base from which nothing could start changes nothing.
    pub fn begin_anew(&mut self, world_from_base: &Isometry3<f64>) {
        let start = Start {
            world_from_base: *world_from_base,
            ..self.start
        };
        if let Ok(anew) = Self::new(&self.settings, &start) {
            let way = self.way;
            *self = Self { way, ..anew };
        }
    }

    /// Insertion frame: origin at the entry at rest, z into the tissue, in World.
    pub fn world_from_insertion(&self) -> &Isometry3<f64> {
        &self.world_from_insertion
    }

    /// Rotation vector in World of a pivot by the slope `pivot` (insertion frame) \[rad\].
    pub fn pivot_rotation(&self, pivot: &Vector2<f64>) -> Vector3<f64> {
        self.world_from_insertion.rotation * Vector3::new(-pivot.y, pivot.x, 0.0)
    }

    /// Vector in World of a lateral vector of the insertion frame.
    pub fn lateral(&self, vector: &Vector2<f64>) -> Vector3<f64> {
        self.world_from_insertion.rotation * Vector3::new(vector.x, vector.y, 0.0)
    }

    /// The path so far is straight, from where the first measurement says that it began: the
    /// base's own error must not look like stretched tissue.
    fn lay_first_path(&mut self, tip: &Vector2<f64>, axis: &Vector3<f64>) {
        if axis.z < 0.3 {
            return;
        }
        let m = &mut self.measured;
        let slope = Vector2::new(axis.x / axis.z, axis.y / axis.z);
        let depth = m.path.tip_depth();
        m.path.for_each(|z, row| {
            let c = tip - slope * (depth - z);
            row[X] = c.x;
            row[Y] = c.y;
        });
        m.filter.place(tip);
        m.rod.solve(&self.constants, &m.clamp, &m.path);
    }

    fn advance_measured(&mut self, base: &Isometry3<f64>) {
        let before = self.measured.filter.position();
        advance(
            &mut self.measured,
            base,
            (self.length, &self.start),
            self.depth_offset,
            &self.constants,
            &self.stiffness,
            &self.settings,
        );
        self.way += self.lateral(&(self.measured.filter.position() - before));
    }

    fn fit_stiffness(&mut self, o: &Observation<'_>) {
        let due = self
            .last_fit
            .is_none_or(|last| o.stamp.secs_since(last) >= self.settings.stiffness_period_s);
        // A sensor whose errors last errs along the shaft as at the tip.
        let lasting = self.start.tip_sensor.is_some();
        if !due || lasting || o.shaft.len() < 4 || self.measured.path.tip_depth() < 8e-3 {
            return;
        }
        self.last_fit = Some(o.stamp);
        let shaft = o
            .shaft
            .iter()
            .map(|(p, sigma)| (self.world_from_insertion.inverse_transform_point(p), *sigma));
        self.stiffness
            .fit(&mut self.constants, &self.measured, shaft);
        self.measured
            .rod
            .solve(&self.constants, &self.measured.clamp, &self.measured.path);
    }
}
