//! One camera and a known plane: the needle lies in the plane, so one image places it in space.

use hal::telemetry::Tracking;
use hal::{CameraFrame, GrayImage, Position, SensedPoint, SensedTip, Stamp};
use nalgebra::{Isometry3, Matrix2, Matrix3, Matrix3x2, Unit, Vector2, Vector3};

use super::answer::{Loss, POINTS, Tracked, unseen};
use super::curve::{Curve2, weights};
use super::filter::Change;
use super::find::Candidate;
use super::frames::{self, FrameError};
use super::geometry::look;
use super::matching::on_line;
use super::settings::{Appearance, Hints, TrackSettings, TrackSettingsError};
use super::single::{ImageTracker, Seen};
use super::taper;
use crate::camera::{DistortedPx, View};

/// Error of a curve in an image that stays from image to image \[px\], in images 640 wide; see the
/// curve in space of two images.
const LASTING: f64 = 0.02;
/// Candidates that are tried.
const TRIED: usize = 6;
/// How far from a candidate's line the shaft is sought \[px\].
const AROUND: f64 = 3.0;
/// Ratios of the diameter found to the one given between which that is believed.
const DIAMETER: [f64; 2] = [0.75, 1.35];

/// A plane in the camera's frame in which the needle moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// A point of it \[m\].
    pub point: Vector3<f64>,
    /// Its normal.
    pub normal: Unit<Vector3<f64>>,
    /// How far off it the needle may be (1 sigma) \[m\].
    pub sigma: f64,
}

impl Plane {
    /// The plane of a board at `camera_from_board`.
    pub fn of_board(camera_from_board: &Isometry3<f64>, sigma: f64) -> Self {
        Self {
            point: camera_from_board.translation.vector,
            normal: Unit::new_normalize(camera_from_board.rotation * Vector3::z()),
            sigma,
        }
    }

    /// Where a pixel's line of sight meets the plane, and the line's direction; nothing where it
    /// runs along the plane or meets it behind the camera.
    fn meet(&self, view: &View, px: Vector2<f64>) -> Option<(Vector3<f64>, Vector3<f64>)> {
        /// Sine of the flattest angle to the plane: 3 degrees.
        const FLATTEST: f64 = 0.05;
        let ray = view.ray(DistortedPx(px.into()))?;
        let sine = ray.direction.dot(&self.normal);
        let along = (self.point - ray.origin).dot(&self.normal) / sine;
        let seen = sine.abs() > FLATTEST && along > 0.0;
        seen.then(|| (ray.origin + ray.direction * along, ray.direction))
    }
}

/// Tracks a needle that moves in a known plane in the images of one camera.
#[derive(Clone, Debug)]
pub struct PlaneTracker {
    settings: TrackSettings,
    needle: Appearance,
    view: View,
    plane: Plane,
    image: ImageTracker,
    diameter: f64,
    clicked: Option<[DistortedPx; 2]>,
    last: Option<Stamp>,
    losses: u32,
    tracked: Tracked,
}

impl PlaneTracker {
    /// A tracker for `needle` in `plane`, both in the frame of `view`'s camera.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(
        view: View,
        plane: Plane,
        needle: Appearance,
        settings: &TrackSettings,
    ) -> Result<Self, TrackSettingsError> {
        settings.validate()?;
        needle.validate()?;
        Ok(Self {
            settings: settings.clone(),
            needle,
            image: ImageTracker::new(view.camera.width, view.camera.height, settings)?,
            view,
            plane,
            diameter: needle.diameter,
            clicked: None,
            last: None,
            losses: 0,
            tracked: unseen(),
        })
    }

    /// Tells what is known of the images beforehand.
    pub fn set_hints(&mut self, hints: Hints) {
        self.image.set_hints(hints);
    }

    /// Starts in the next image from two points on the needle, its tip second.
    pub fn start_at(&mut self, points: [DistortedPx; 2]) {
        self.image.drop_needle();
        self.clicked = Some(points);
    }

    /// The newest answer; its right curve is never there.
    pub const fn tracked(&self) -> &Tracked {
        &self.tracked
    }

    /// Takes an image in; as [`super::StereoTracker::track`].
    ///
    /// # Errors
    /// The image cannot be this camera's or shows nothing.
    pub fn track(&mut self, frame: &CameraFrame) -> Result<&Tracked, FrameError> {
        frames::fits_camera(&frame.image, &self.view.camera, "left")?;
        let dt = self
            .last
            .map_or(0.0, |l| frame.stamp.secs_since(l).max(0.0));
        self.last = Some(frame.stamp);
        let shows = frames::blank(&frame.image, "left");
        self.tracked.considered[0].clear();
        let outcome = if shows.is_ok() {
            self.follow(&frame.image, dt)
        } else {
            if let Some(change) = self.change(dt) {
                self.image.coast(&change);
            }
            Err(Loss::NotFound)
        };
        let outcome = match outcome {
            Ok(()) => self.place(frame),
            Err(loss) => Err(loss),
        };
        if outcome.is_ok() {
            self.losses = 0;
        } else {
            self.losses += 1;
            if self.losses >= self.settings.lost_after {
                self.image.drop_needle();
            }
        }
        self.tracked.curves = [self.image.curve(), None];
        self.tracked.loss = outcome.err();
        self.tracked.status = match (outcome, self.tracked.status) {
            (Ok(()), _) => Tracking::Tracked,
            (Err(_), Tracking::None) => Tracking::None,
            (Err(_), _) if self.image.curve().is_none() => Tracking::Lost,
            (Err(_), _) => Tracking::Predicted,
        };
        shows.map(|()| &self.tracked)
    }

    fn change(&self, dt: f64) -> Option<Change> {
        self.image.curve().map(|_| Change {
            dt,
            walk: self.settings.shaft_walk_px * self.image.scale(),
            ..Change::default()
        })
    }

    fn follow(&mut self, image: &GrayImage, dt: f64) -> Result<(), Loss> {
        let Some(change) = self.change(dt) else {
            return self.start(image);
        };
        let place = self.image.curve().and_then(|curve| self.ends(&curve));
        let Some([start, tip]) = place else {
            return Err(Loss::NoCurve);
        };
        let before = self.image.curve();
        let look = self.look(&start, &tip);
        let followed = self.image.follow(image, &change, &look);
        followed.map_err(Loss::Left).or_else(|loss| {
            // Farther than the prediction allows for?
            let found = self.search(image, before.as_ref());
            found.map_err(|_| loss)
        })
    }

    fn start(&mut self, image: &GrayImage) -> Result<(), Loss> {
        let Some(points) = self.clicked.take() else {
            return self.search(image, None);
        };
        let line = points.map(|p| p.0.coords);
        let ends = line.map(|px| self.plane.meet(&self.view, px));
        let [Some((start, _)), Some((tip, _))] = ends else {
            return Err(Loss::NoCurve);
        };
        let look = self.look(&start, &tip);
        let reach = self.settings.search_px * self.image.scale();
        let begun = self.image.start(image, &line, reach, &look);
        begun.map_err(|flaw| Loss::Start { image: 0, flaw })
    }

    fn search(&mut self, image: &GrayImage, before: Option<&Curve2>) -> Result<(), Loss> {
        let mut found = self.image.candidates(image);
        self.tracked.considered[0] = found.iter().map(|c| c.line.clone()).collect();
        if found.is_empty() {
            self.image.learn(image);
            return Err(Loss::NoBand { image: 0 });
        }
        let size = (image.width() as f64, image.height() as f64);
        let mut turned: Vec<_> = found.iter().map(Candidate::reversed).collect();
        turned.append(&mut found);
        let worth = |c: &Candidate| {
            let [start, tip] = c.borders(size);
            c.evidence * if start <= tip { 1.0 } else { 0.5 }
        };
        if before.is_none() {
            let share = turned.iter().map(Candidate::plain).fold(0.0, f64::max);
            turned.retain(Candidate::stands_out);
            if turned.is_empty() {
                return Err(Loss::Faint { share });
            }
        }
        turned.retain(Candidate::ends);
        turned.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
        let goes_on = |c: &&Candidate| before.is_none_or(|before| c.continues(before));
        let mut loss = None;
        let kept = self.image.clone();
        for candidate in turned.iter().filter(goes_on).take(TRIED) {
            match self.attempt(image, candidate) {
                Ok(()) => return Ok(()),
                Err(why) => {
                    loss.get_or_insert(why);
                    self.image.clone_from(&kept);
                }
            }
        }
        Err(loss.unwrap_or(Loss::NoBand { image: 0 }))
    }

    fn attempt(&mut self, image: &GrayImage, candidate: &Candidate) -> Result<(), Loss> {
        let place = |share: f64| {
            let px = on_line(&candidate.line, share)?;
            self.plane.meet(&self.view, px).map(|(point, _)| point)
        };
        let [Some(start), Some(tip)] = [0.0, 1.0].map(place) else {
            return Err(Loss::NoCurve);
        };
        self.diameter = self.needle.diameter;
        let expected = self.look(&start, &tip).width;
        let ratio = candidate.width / expected.max(1e-6);
        if !(ratio > DIAMETER[0] && ratio < DIAMETER[1]) {
            self.diameter *= ratio;
        }
        let look = self.look(&start, &tip);
        let seen = Seen {
            bright: candidate.bright,
            contrast: candidate.contrast,
            points: self.settings.control_points,
        };
        let reach = AROUND * self.image.scale().max(1.0);
        let begun = self
            .image
            .begin(image, &candidate.line, reach, &look, Some(&seen));
        begun.map_err(|flaw| Loss::Start { image: 0, flaw })
    }

    fn ends(&self, curve: &Curve2) -> Option<[Vector3<f64>; 2]> {
        let at = |t: f64| self.plane.meet(&self.view, curve.at(t)).map(|(p, _)| p);
        Some([at(0.0)?, at(1.0)?])
    }

    fn look(&self, start: &Vector3<f64>, tip: &Vector3<f64>) -> super::Look {
        let needle = Appearance {
            diameter: self.diameter,
            ..self.needle
        };
        let axis = (tip - start).try_normalize(1e-9);
        look(&self.view, &needle, tip, axis.as_ref(), None).0
    }

    /// Places the image's curve in the plane.
    fn place(&mut self, frame: &CameraFrame) -> Result<(), Loss> {
        let Some(filter) = self.image.filter() else {
            return Err(Loss::NotFound);
        };
        let curve = filter.curve();
        let count = curve.control_points().len();
        let lasting = (LASTING * self.image.scale()).powi(2);
        let at = |t: f64| {
            let (point, sight) = self.plane.meet(&self.view, curve.at(t))?;
            let row = weights(count, t);
            let [x, y] = [Vector2::x(), Vector2::y()];
            let cov = |a: &Vector2<f64>, b: &Vector2<f64>| filter.covariance_of(&row, a, &row, b);
            let image = Matrix2::new(cov(&x, &x), cov(&x, &y), cov(&y, &x), cov(&y, &y))
                + Matrix2::identity() * lasting;
            let covariance = self.covariance(&point, &sight, &image)?;
            Some((point, covariance))
        };
        let samples: Option<Vec<_>> = (0..POINTS)
            .map(|k| at(k as f64 / (POINTS - 1) as f64))
            .collect();
        let samples = samples.ok_or(Loss::NoCurve)?;
        let [.., (before, _), (tip, covariance)] = samples.as_slice() else {
            return Err(Loss::NoCurve);
        };
        let axis = (tip - before).try_normalize(1e-12).ok_or(Loss::NoCurve)?;
        let taper = if self.image.tapers() {
            taper::LASTING * self.diameter
        } else {
            0.0
        };
        let covariance = covariance + axis * axis.transpose() * (taper * taper);
        let shape = &mut self.tracked.shape;
        shape.stamp = frame.stamp;
        shape.sequence = frame.sequence;
        shape.points.clear();
        // The points are correlated: a curve has so many lateral freedoms, not one a point.
        let shared = (POINTS as f64 / count as f64).sqrt();
        shape
            .points
            .extend(samples.iter().map(|(point, covariance)| SensedPoint {
                position: Position::new((*point).into()),
                sigma: (covariance.trace() / 3.0).sqrt() * shared,
            }));
        let length = curve.length().max(1.0);
        let floor = self.settings.direction_floor_px * self.image.scale() / length;
        let tilt = self.plane.sigma / (tip - samples[0].0).norm().max(1e-9);
        shape.tip = SensedTip {
            position: Position::new((*tip).into()),
            covariance,
            direction: Unit::new_unchecked(axis),
            direction_sigma: floor.hypot(tilt),
        };
        self.tracked.point = shape.tip.position;
        Ok(())
    }

    /// Of a point of the plane, from that of its pixel and of the plane itself.
    fn covariance(
        &self,
        point: &Vector3<f64>,
        sight: &Vector3<f64>,
        image: &Matrix2<f64>,
    ) -> Option<Matrix3<f64>> {
        let (_, jacobian) = self.view.project_with_derivative(point)?;
        let a = self.plane.normal.cross(sight);
        let a = a.try_normalize(1e-6).unwrap_or_else(|| {
            let any = if self.plane.normal.x.abs() < 0.8 {
                Vector3::x()
            } else {
                Vector3::y()
            };
            self.plane.normal.cross(&any).normalize()
        });
        let in_plane = Matrix3x2::from_columns(&[a, self.plane.normal.cross(&a)]);
        let by_pixel = in_plane * (jacobian * in_plane).try_inverse()?;
        let off = sight * (self.plane.sigma / sight.dot(&self.plane.normal));
        Some(by_pixel * image * by_pixel.transpose() + off * off.transpose())
    }
}
