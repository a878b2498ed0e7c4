//! Needle tracking: a pair of images to a curve in space.
//!
//! Per image: a polynomial curve through control points on the needle, in a Kalman filter that
//! odometry predicts; the shaft measured along normals, robustly; the tip from the fall of the
//! darkness along the axis, the bevel's silhouette at its present turn included. Both images
//! give one curve in space, through the container's windows, with its covariance
//! \[Chevrie2016, section IV.A\]. `docs/TRACKING.md` explains it.

mod answer;
mod background;
mod blur;
mod cholesky;
mod curve;
mod filter;
mod find;
mod frames;
mod geometry;
mod matching;
mod plane;
mod profile;
mod search;
mod section;
mod settings;
mod silhouette;
mod single;
mod space;
mod start;
mod taper;
mod tip;
mod turn;

pub use answer::{Context, Loss, Tracked};
pub use curve::Curve2;
pub use filter::Change;
pub use frames::FrameError;
pub use plane::{Plane, PlaneTracker};
pub use settings::{Appearance, Hints, TrackSettings, TrackSettingsError};
pub use single::{Flaw, ImageTracker, Look};

use hal::telemetry::Tracking;
use hal::{GrayImage, Position, SensedPoint, SensedTip, Stamp, StereoFrame};
use nalgebra::{Unit, Vector3};

use crate::camera::{DistortedPx, StereoRig, View};
use answer::{POINTS, unseen};
use geometry::{base_shifts, look, scene, turned};
use space::{Curve3, Lasting};
use turn::Turn;

/// Disagreement of the two tips along the needle beyond which they are not of one needle \[px\],
/// in images 640 wide; calibrations of careful laboratories stay below a pixel.
const EPIPOLAR: f64 = 2.5;
/// By how much more where the tip tapers in a way that is not known.
const TAPERING: f64 = 3.0;
/// Visible shaft from which on its axis is known well enough to tell to which side the bevel
/// leans \[px\], in images 640 wide.
const LEANING_SHAFT: f64 = 30.0;

/// Tracks a needle in pairs of images.
#[derive(Clone, Debug)]
pub struct StereoTracker {
    settings: TrackSettings,
    needle: Appearance,
    views: [View; 2],
    /// Where the cameras' axes meet, about.
    scene: Vector3<f64>,
    images: [ImageTracker; 2],
    curve: Option<Curve3>,
    turn: Turn,
    clicked: Option<[[DistortedPx; 2]; 2]>,
    last: Option<Stamp>,
    losses: u32,
    /// Diameter of the needle, as given or as found at the start \[m\].
    diameter: f64,
    tracked: Tracked,
}

impl StereoTracker {
    /// A tracker for `needle` in the images of `rig`.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(
        rig: &StereoRig,
        needle: Appearance,
        settings: &TrackSettings,
    ) -> Result<Self, TrackSettingsError> {
        settings.validate()?;
        needle.validate()?;
        let views = rig.views();
        let image =
            |view: &View| ImageTracker::new(view.camera.width, view.camera.height, settings);
        Ok(Self {
            settings: settings.clone(),
            needle,
            scene: scene(&views),
            images: [image(&views[0])?, image(&views[1])?],
            views,
            curve: None,
            turn: Turn::unknown(),
            clicked: None,
            last: None,
            losses: 0,
            diameter: needle.diameter,
            tracked: unseen(),
        })
    }

    /// Tells what is known of the images beforehand.
    pub fn set_hints(&mut self, hints: Hints) {
        for image in &mut self.images {
            image.set_hints(hints);
        }
    }

    /// Forgets needle and background.
    pub fn reset(&mut self) {
        for image in &mut self.images {
            image.reset();
        }
        self.curve = None;
        self.turn = Turn::unknown();
        self.clicked = None;
        self.last = None;
        self.losses = 0;
        self.diameter = self.needle.diameter;
        self.tracked = unseen();
    }

    /// Starts in the next pair from two points on the needle in each image, its tip second.
    pub fn start_at(&mut self, left: [DistortedPx; 2], right: [DistortedPx; 2]) {
        self.forget_needle();
        self.clicked = Some([left, right]);
    }

    /// The newest answer.
    pub const fn tracked(&self) -> &Tracked {
        &self.tracked
    }

    /// Takes a pair in. After an error the needle is carried on by prediction, and counts as
    /// lost after some pairs.
    ///
    /// # Errors
    /// The pair cannot be this rig's or shows nothing.
    pub fn track(
        &mut self,
        pair: &StereoFrame,
        context: &Context<'_>,
    ) -> Result<&Tracked, FrameError> {
        let stamp = pair.left.stamp;
        let dt = self
            .last
            .map_or(0.0, |last| stamp.secs_since(last).max(0.0));
        let checked = frames::fits(pair, &self.views);
        if !matches!(checked, Err(FrameError::Size { .. })) {
            self.last = Some(stamp);
        }
        if let Err(error) = checked {
            self.coast(dt, context);
            return Err(error);
        }
        let images = [pair.left.image.as_ref(), pair.right.image.as_ref()];
        let mut shows = Ok(());
        let known = self.curve.is_some();
        let outcome = if known {
            self.follow(images, dt, context)
        } else {
            Err(Loss::NotFound)
        };
        if outcome.is_ok() && self.images.iter().any(ImageTracker::leapt) {
            // A curve that was drawn out so far is a guess; where a search fails it stays.
            let _ = self.far(images, context);
        }
        let outcome = outcome.or_else(|loss| {
            shows = frames::shows(pair);
            let gone = !known || self.give_up();
            if !gone && shows.is_ok() && self.far(images, context).is_ok() {
                return Ok(());
            }
            if gone {
                self.forget_needle();
            }
            if gone && shows.is_ok() {
                // The same pair may show where the needle is now.
                let started = self.start(images, context);
                started.map_err(|why| if known { loss } else { why })
            } else {
                Err(loss)
            }
        });
        self.report(pair, context, known, outcome.err());
        shows.map(|()| &self.tracked)
    }

    fn give_up(&mut self) -> bool {
        self.losses += 1;
        self.losses >= self.settings.lost_after
    }

    /// Forgets the needle, not the background: it is sought again in the next pair.
    pub fn forget_needle(&mut self) {
        for image in &mut self.images {
            image.drop_needle();
        }
        self.curve = None;
    }

    /// Carries everything on without images.
    fn coast(&mut self, dt: f64, context: &Context<'_>) {
        if self.curve.is_some() {
            let changes = self.predict(dt, context);
            for (image, change) in self.images.iter_mut().zip(&changes) {
                image.coast(change);
            }
            if self.give_up() {
                self.forget_needle();
            }
        }
        self.tracked.status = self.status_without();
        self.tracked.loss = Some(Loss::NotFound);
    }

    fn status_without(&self) -> Tracking {
        match (&self.curve, self.tracked.status) {
            (Some(_), _) => Tracking::Predicted,
            (None, Tracking::None) => Tracking::None,
            (None, _) => Tracking::Lost,
        }
    }

    /// Moves the curve in space on, and tells what that means in each image.
    fn predict(&mut self, dt: f64, context: &Context<'_>) -> [Change; 2] {
        let mut changes = [Change {
            dt,
            walk: self.settings.shaft_walk_px * self.images[0].scale(),
            ..Change::default()
        }; 2];
        let Some(curve) = &mut self.curve else {
            return changes;
        };
        let shifts = base_shifts(curve, context.base_motion);
        let axis = curve.derivative(1.0).normalize();
        let mut px_per_metre = 1.0;
        for ((change, view), image) in changes.iter_mut().zip(&self.views).zip(&self.images) {
            for (i, point) in curve.control_points().iter().enumerate() {
                if let Some((_, jacobian)) = view.project_with_derivative(point) {
                    change.shifts[i] = jacobian * shifts[i];
                    px_per_metre = jacobian.norm() * core::f64::consts::FRAC_1_SQRT_2;
                    if let Some(insertion) = context.insertion {
                        let advance = (jacobian * axis * insertion).norm() * insertion.signum();
                        let sigma = self.settings.advance_sigma_px * image.scale();
                        change.advance = Some((advance, sigma + 0.2 * advance.abs()));
                    }
                }
            }
        }
        curve.shift(&shifts);
        let speed = curve.derivative(1.0).norm();
        let (advance, sigma) = match (context.insertion, self.images[0].filter()) {
            (Some(insertion), _) => (
                insertion,
                changes[0].advance.map_or(0.0, |(_, sigma)| sigma) / px_per_metre,
            ),
            // By the left image's estimate of the speed.
            (None, Some(filter)) => {
                let length = filter.curve().derivative(1.0).norm().max(1.0);
                let (rate, sigma) = filter.speed();
                (rate * dt / length * speed, sigma * dt / length * speed)
            }
            (None, None) => (0.0, 0.0),
        };
        let walk = changes[0].walk / px_per_metre;
        curve.grow(advance.clamp(-0.2 * speed, 0.2 * speed), sigma, walk);
        changes
    }

    /// Both images from the prediction.
    fn follow(
        &mut self,
        images: [&GrayImage; 2],
        dt: f64,
        context: &Context<'_>,
    ) -> Result<(), Loss> {
        let changes = self.predict(dt, context);
        let Some(mut curve) = self.curve.take() else {
            return Err(Loss::NotFound);
        };
        self.turn.predict();
        let tip = curve.at(1.0);
        let axis = curve.derivative(1.0).normalize();
        let mut flaw = None;
        let mut sides = [Vector3::zeros(); 2];
        for k in 0..2 {
            let (look, across) = self.look(k, &tip, Some(&axis), context);
            sides[k] = across;
            if let Err(wrong) = self.images[k].follow(images[k], &changes[k], &look) {
                flaw = flaw.or(Some(if k == 0 {
                    Loss::Left(wrong)
                } else {
                    Loss::Right(wrong)
                }));
            }
        }
        let outcome = match flaw {
            Some(loss) => Err(loss),
            None => self.fuse(&mut curve, 2),
        };
        if outcome.is_ok() {
            self.losses = 0;
            self.see_turn(&axis, &sides, context);
        }
        self.curve = Some(curve);
        outcome
    }

    /// Learns how the bevel is turned from the sides to which it leans.
    fn see_turn(&mut self, axis: &Vector3<f64>, sides: &[Vector3<f64>; 2], context: &Context<'_>) {
        let Some(bevel) = context.bevel else { return };
        let long = |image: &ImageTracker| {
            let length = image.curve().map_or(0.0, |curve| curve.length());
            length >= LEANING_SHAFT * image.scale()
        };
        if !self.images.iter().all(long) {
            return;
        }
        for (image, across) in self.images.iter().zip(sides) {
            if let Some(measured) = image.leaning() {
                self.turn
                    .observe(measured, |angle| turned(&bevel, axis, angle).dot(across));
            }
        }
    }

    /// The curve in space from both filters.
    fn fuse(&self, curve: &mut Curve3, rounds: usize) -> Result<(), Loss> {
        let [Some(left), Some(right)] = [self.images[0].filter(), self.images[1].filter()] else {
            return Err(Loss::NotFound);
        };
        let kept = curve.clone();
        let tapers = self.images.iter().any(ImageTracker::tapers);
        let lasting = Lasting {
            px: self.images[0].scale(),
            bevel: self.needle.bevel_length,
            taper: if tapers {
                taper::LASTING * self.diameter
            } else {
                0.0
            },
        };
        if !curve.fit(&self.views, [left, right], &lasting, rounds) {
            *curve = kept;
            return Err(Loss::NoCurve);
        }
        // Where a tip tapers its end is less sure.
        let taper = if tapers { TAPERING } else { 1.0 };
        if curve.epipolar > taper * EPIPOLAR * self.images[0].scale().max(1.0) {
            return Err(Loss::Disagreement { px: curve.epipolar });
        }
        Ok(())
    }

    /// How the needle appears in image `k` when its tip is at `tip`, and the direction across it
    /// and the line of sight along which the bevel's side counts.
    fn look(
        &self,
        k: usize,
        tip: &Vector3<f64>,
        axis: Option<&Vector3<f64>>,
        context: &Context<'_>,
    ) -> (Look, Vector3<f64>) {
        let bevel = context
            .bevel
            .map(|bevel| axis.map_or(bevel, |axis| turned(&bevel, axis, self.turn.angle())));
        let needle = Appearance {
            diameter: self.diameter,
            ..self.needle
        };
        look(&self.views[k], &needle, tip, axis, bevel)
    }

    /// Fills the answer in.
    fn report(
        &mut self,
        pair: &StereoFrame,
        context: &Context<'_>,
        known: bool,
        loss: Option<Loss>,
    ) {
        self.tracked.status = match loss {
            None => Tracking::Tracked,
            Some(_) => self.status_without(),
        };
        self.tracked.loss = loss;
        if loss.is_none() && known {
            for considered in &mut self.tracked.considered {
                considered.clear();
            }
        }
        for (k, image) in self.images.iter().enumerate() {
            self.tracked.curves[k] = image.filter().map(filter::CurveFilter::curve);
        }
        let Some(curve) = &self.curve else {
            return;
        };
        let shape = &mut self.tracked.shape;
        shape.stamp = pair.left.stamp;
        shape.sequence = pair.left.sequence;
        shape.points.clear();
        // The points are correlated: a curve has so many lateral freedoms, not one a point.
        let shared = (POINTS as f64 / curve.control_points().len() as f64).sqrt();
        for k in 0..POINTS {
            let t = k as f64 / (POINTS - 1) as f64;
            let axis = curve.derivative(t).normalize();
            let covariance = curve.point_covariance(t);
            let along = axis.dot(&(covariance * axis));
            let across = (0.5 * (covariance.trace() - along)).max(0.0).sqrt();
            shape.points.push(SensedPoint {
                position: Position::new(curve.at(t).into()),
                sigma: across * shared,
            });
        }
        let slope = curve.derivative(1.0);
        let axis = Unit::new_normalize(slope);
        let bend = curve.slope_covariance(1.0) / slope.norm_squared();
        let turning = bend.trace() - axis.dot(&(bend * axis.into_inner()));
        // Errors that stay from image to image, such as of the surface's edge, turn a short
        // visible shaft by much.
        let visible = self.images.iter().filter_map(ImageTracker::filter);
        let shortest = visible
            .map(|filter| filter.curve().length())
            .fold(f64::INFINITY, f64::min);
        let common = self.settings.direction_floor_px * self.images[0].scale() / shortest.max(1.0);
        shape.tip = SensedTip {
            position: Position::new(curve.at(1.0).into()),
            covariance: curve.point_covariance(1.0),
            direction: axis,
            direction_sigma: (0.5 * turning).max(0.0).sqrt().hypot(common),
        };
        let point = curve.at(1.0)
            + context.bevel.map_or_else(Vector3::zeros, |bevel| {
                let bevel = turned(&bevel, &axis, self.turn.angle());
                axis.into_inner() * self.needle.bevel_length + bevel * (0.5 * self.needle.diameter)
            });
        self.tracked.point = Position::new(point.into());
    }
}
