//! The tracker of a pair: both images' curves, the curve in space, and when the needle is lost.

use hal::frame::LeftCamera;
use hal::telemetry::Tracking;
use hal::{GrayImage, Position, SensedPoint, SensedShape, SensedTip, Stamp, StereoFrame};
use nalgebra::{Isometry3, Matrix2, Point2, Point3, Unit, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::find::{Candidate, Finder};
use super::planar::{Planar, TipState};
use super::settings::{TrackSettings, TrackSettingsError};
use super::solid::{Solid, sides};
use super::tip::FaceImage;
use crate::camera::{DistortedPx, StereoRig, View, triangulate};

/// Points of the shape handed out.
const POINTS: usize = 24;

/// Why a measurement is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum LossReason {
    /// Too few normals show the shaft in the left image.
    LeftShaft,
    /// Too few normals show the shaft in the right image.
    RightShaft,
    /// The tip was seen in neither image.
    Tip,
    /// The images disagree about the tip by more than 4 sigma.
    Epipolar,
    /// No needle was found in the whole images.
    NotFound,
    /// The two curves make no curve in space.
    Reconstruction,
}

/// A pair that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// An image of another size than the calibrated one.
    #[error(
        "{side} image of {width} x {height}, calibrated for {calibrated_width} x {calibrated_height}"
    )]
    Size {
        /// left or right.
        side: &'static str,
        /// Width \[px\].
        width: usize,
        /// Height \[px\].
        height: usize,
        /// Calibrated width \[px\].
        calibrated_width: usize,
        /// Calibrated height \[px\].
        calibrated_height: usize,
    },
    /// Exposures too far apart.
    #[error("the pair's exposures are {skew_s} s apart, at most {max_s} s allowed")]
    OutOfSync {
        /// Time between the exposures \[s\].
        skew_s: f64,
        /// Greatest allowed \[s\].
        max_s: f64,
    },
    /// A pair older than the last one.
    #[error("the pair was taken {late_s} s before the last one")]
    OutOfOrder {
        /// How much older \[s\].
        late_s: f64,
    },
    /// All pixels alike: covered, switched off or saturated.
    #[error("the {side} image shows nothing: every pixel is about {grey} grey")]
    Blank {
        /// left or right.
        side: &'static str,
        /// Grey value of its middle.
        grey: u8,
    },
}

/// What is known about the needle beside the images.
#[derive(Clone, Copy, Debug, Default)]
pub struct Context<'a> {
    /// Rigid motion of the needle's base since the previous pair, in the stereo frame; acts on
    /// the shaft, fading towards the tip.
    pub base_motion: Option<Isometry3<f64>>,
    /// Advance of the needle along itself since the previous pair \[m\]; positive: deeper.
    /// `None`: unknown, its speed is estimated.
    pub insertion: Option<f64>,
    /// Bevel direction (-y of the tip frame: the side of the sharp point) in the stereo frame.
    /// `None`: unknown, the tip's covariance grows accordingly.
    pub bevel_direction: Option<Unit<Vector3<f64>>>,
    /// Predicted centre line, from the gel's surface to O, in the stereo frame \[m\].
    pub guess: Option<&'a [Point3<f64>]>,
}

/// A curve in one image, for overlays and logs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve2 {
    /// Points of the curve, from the base to O.
    pub points: [DistortedPx; POINTS],
    /// O.
    pub tip: DistortedPx,
    /// Its covariance \[px2\].
    pub tip_covariance: Matrix2<f64>,
    /// Share of the normals that show the shaft.
    pub survivors: f64,
    /// Whether the tip was measured in this image.
    pub tip_measured: bool,
}

/// What the tracker makes of a pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracked {
    /// Confidence.
    pub status: Tracking,
    /// Why it is not [`Tracking::Tracked`].
    pub reason: Option<LossReason>,
    /// The needle; the last known or predicted one where it was not seen.
    pub shape: SensedShape,
    /// The sharp point in the stereo frame \[m\]; where the bevel's side is known.
    pub sharp_point: Option<Position<LeftCamera>>,
    /// Left image's curve.
    pub left: Curve2,
    /// Right image's curve.
    pub right: Curve2,
    /// Disagreement of the two tips along the needle: chi-square, 1 degree of freedom.
    pub misfit: f64,
}

/// Tracks a needle in the images of a calibrated pair.
#[derive(Clone, Debug)]
pub struct StereoTracker {
    views: [View; 2],
    settings: TrackSettings,
    images: [Planar; 2],
    solid: Option<Solid>,
    missed: u32,
    /// Images in a row in which the tips disagreed.
    apart: u32,
    clicks: Option<[[DistortedPx; 2]; 2]>,
    last: Option<Stamp>,
    finder: Finder,
    out: Tracked,
}

impl StereoTracker {
    /// A tracker that has not seen the needle yet.
    ///
    /// # Errors
    /// A setting is outside its range.
    pub fn new(rig: &StereoRig, settings: &TrackSettings) -> Result<Self, TrackSettingsError> {
        settings.validate()?;
        let nowhere = DistortedPx::new(0.0, 0.0);
        let curve = Curve2 {
            points: [nowhere; POINTS],
            tip: nowhere,
            tip_covariance: Matrix2::zeros(),
            survivors: 0.0,
            tip_measured: false,
        };
        Ok(Self {
            views: rig.views(),
            settings: *settings,
            images: [Planar::new(settings), Planar::new(settings)],
            solid: None,
            missed: 0,
            apart: 0,
            clicks: None,
            last: None,
            finder: Finder::default(),
            out: Tracked {
                status: Tracking::None,
                reason: None,
                shape: SensedShape {
                    stamp: Stamp::ZERO,
                    sequence: 0,
                    points: Vec::with_capacity(POINTS),
                    tip: SensedTip {
                        position: Position::new(Point3::origin()),
                        covariance: nalgebra::Matrix3::zeros(),
                        direction: Vector3::z_axis(),
                        direction_sigma: 0.0,
                    },
                },
                sharp_point: None,
                left: curve,
                right: curve,
                misfit: 0.0,
            },
        })
    }

    /// Forgets the needle.
    pub fn reset(&mut self) {
        self.solid = None;
        self.missed = 0;
        self.apart = 0;
        self.last = None;
        self.clicks = None;
        self.out.status = Tracking::None;
        self.out.reason = None;
    }

    /// Starts at the next pair from two points of the needle per image; the second is the tip.
    pub fn start_at(&mut self, left: [DistortedPx; 2], right: [DistortedPx; 2]) {
        self.reset();
        self.clicks = Some([left, right]);
    }

    /// One image's share of [`track`](Self::track), on the left image: prediction, normals,
    /// filter, tip; for benchmarks. True when the needle was seen.
    pub fn track_left_image(&mut self, pair: &StereoFrame, context: &Context<'_>) -> bool {
        self.images[0].predict(1.0 / 30.0, Some(0.0), &self.settings);
        let seen = self.images[0].update(&pair.left.image, &self.settings, 1.0);
        self.measure_tip(0, &pair.left.image, context, 1.0);
        seen && self.images[0].tip_state == TipState::Measured
    }

    /// The newest result.
    pub fn tracked(&self) -> &Tracked {
        &self.out
    }

    /// Follows the needle into a pair.
    ///
    /// # Errors
    /// The pair cannot be used; the needle counts as not seen then.
    pub fn track(
        &mut self,
        pair: &StereoFrame,
        context: &Context<'_>,
    ) -> Result<&Tracked, FrameError> {
        self.check(pair)?;
        let dt = self
            .last
            .map_or(1.0 / 30.0, |t| pair.left.stamp.secs_since(t));
        if dt < 0.0 {
            return Err(FrameError::OutOfOrder { late_s: -dt });
        }
        self.last = Some(pair.left.stamp);
        self.out.shape.stamp = pair.left.stamp;
        self.out.shape.sequence = pair.left.sequence;
        let images = [&*pair.left.image, &*pair.right.image];
        let known = self.solid.is_some() && self.out.status != Tracking::Lost;
        let seen = if known {
            self.predict(dt, context);
            self.follow(images, context, 1.0)
        } else {
            self.find(images, context)
        };
        match seen {
            Ok(()) => {
                self.missed = 0;
                self.out.status = Tracking::Tracked;
                self.out.reason = None;
            }
            Err(reason) => {
                self.missed += 1;
                self.out.reason = Some(reason);
                if !known || self.missed >= self.settings.lost_after {
                    self.out.status = if self.out.status == Tracking::None {
                        Tracking::None
                    } else {
                        Tracking::Lost
                    };
                } else {
                    self.out.status = Tracking::Predicted;
                }
                for (side, image) in ["left", "right"].into_iter().zip(images) {
                    if let Some(grey) = blank(image) {
                        return Err(FrameError::Blank { side, grey });
                    }
                }
            }
        }
        self.publish(context);
        Ok(&self.out)
    }

    fn check(&self, pair: &StereoFrame) -> Result<(), FrameError> {
        for (side, frame, view) in [
            ("left", &pair.left, &self.views[0]),
            ("right", &pair.right, &self.views[1]),
        ] {
            let (c, i) = (&view.camera, &frame.image);
            if (c.width, c.height) != (i.width(), i.height()) {
                return Err(FrameError::Size {
                    side,
                    width: i.width(),
                    height: i.height(),
                    calibrated_width: c.width,
                    calibrated_height: c.height,
                });
            }
        }
        let skew_s = pair.left.stamp.secs_since(pair.right.stamp).abs();
        if skew_s > self.settings.max_skew {
            return Err(FrameError::OutOfSync {
                skew_s,
                max_s: self.settings.max_skew,
            });
        }
        Ok(())
    }

    /// Time update of both images and of the curve in space.
    fn predict(&mut self, dt: f64, context: &Context<'_>) {
        let Some(solid) = &mut self.solid else { return };
        let tip = solid.point(1.0);
        for k in 0..2 {
            let advance = context.insertion.and_then(|d| {
                let (_, j) = self.views[k].project_with_derivative(&tip)?;
                Some(d * (j * solid.direction().as_ref()).dot(&self.images[k].graph.axis))
            });
            self.images[k].predict(dt, advance, &self.settings);
            let Some(motion) = context.base_motion else {
                continue;
            };
            let graph = &mut self.images[k].graph;
            let across = graph.across();
            for i in 0..graph.n {
                let t = i as f64 / (graph.n - 1) as f64;
                let p = solid.point(t);
                let moved = (motion * Point3::from(p)).coords - p;
                if let Some((_, j)) = self.views[k].project_with_derivative(&p) {
                    // The tissue holds the needle the more, the deeper it is.
                    let shift = across.dot(&(j * moved)) * (1.0 - t).powi(2);
                    graph.y[i] += shift;
                    graph.cov[(i, i)] += (0.3 * shift).powi(2);
                }
            }
        }
        if let Some(d) = context.insertion {
            let relative = (d / solid.length).clamp(-0.5, 0.5);
            solid.spread(0.0, 1.0 + relative);
        }
    }

    /// Measures both images and fits the curve in space.
    fn follow(
        &mut self,
        images: [&GrayImage; 2],
        context: &Context<'_>,
        wide: f64,
    ) -> Result<(), LossReason> {
        self.place_base(context);
        for k in 0..2 {
            if !self.images[k].update(images[k], &self.settings, wide) {
                return Err([LossReason::LeftShaft, LossReason::RightShaft][k]);
            }
            self.measure_tip(k, images[k], context, wide);
        }
        if self.images.iter().all(|i| i.tip_state == TipState::Unseen) {
            return Err(LossReason::Tip);
        }
        self.reconstruct(2)
    }

    fn reconstruct(&mut self, rounds: usize) -> Result<(), LossReason> {
        let [left, right] = &self.images;
        let solid = self.solid.as_mut().ok_or(LossReason::Reconstruction)?;
        let n = left.graph.n.max(right.graph.n);
        if n != solid.n {
            solid.set_points(n);
        }
        let tilt = (solid.values[0][n - 1] - solid.values[0][0])
            .hypot(solid.values[1][n - 1] - solid.values[1][0]);
        if tilt > 0.3 * solid.length
            && let Some(fresh) =
                Solid::from_chords(&self.views, [&left.graph, &right.graph], solid.point(1.0))
        {
            *solid = fresh;
        }
        if !solid.fit(
            &self.views,
            [left, right],
            self.settings.systematic_px,
            rounds,
        ) {
            return Err(LossReason::Reconstruction);
        }
        let misfit = solid.tip_misfit;
        self.out.misfit = misfit;
        let tip = solid.point(1.0);
        let covariance = solid.covariance(1.0);
        for k in 0..2 {
            if self.images[k].tip_state == TipState::Measured {
                continue;
            }
            if let Some((px, j)) = self.views[k].project_with_derivative(&tip) {
                let variance = (j * covariance * j.transpose()).trace();
                self.images[k].set_tip(px.0, variance);
            }
        }
        let both = self
            .images
            .iter()
            .all(|i| i.tip_state == TipState::Measured);
        self.apart = if both && misfit > 16.0 {
            self.apart + 1
        } else {
            0
        };
        // One outlier in thousands is chance and widens the covariance; two in a row are not.
        if self.apart >= 2 || misfit > 100.0 && both {
            return Err(LossReason::Epipolar);
        }
        Ok(())
    }

    fn measure_tip(&mut self, k: usize, image: &GrayImage, context: &Context<'_>, wide: f64) {
        let Some(solid) = &self.solid else { return };
        let Some((_, j)) = self.views[k].project_with_derivative(&solid.point(1.0)) else {
            return;
        };
        let tracker = &mut self.images[k];
        let axis = tracker.graph.tangent(tracker.graph.length);
        let normal = Vector2::new(-axis.y, axis.x);
        let direction = solid.direction();
        // The shaft's width: across the needle and across the line of sight.
        let radius = 0.5 * self.settings.needle_diameter;
        let (a, b) = sides(&direction);
        let scale = normal.dot(&(j * a)).hypot(normal.dot(&(j * b)));
        tracker.width = (2.0 * radius * scale).clamp(1.0, 40.0);
        let length = self.settings.bevel_length;
        let sharp = context.bevel_direction.map_or(a, |d| *d.as_ref());
        let sharp = (sharp - direction.as_ref() * sharp.dot(&direction))
            .try_normalize(1e-3)
            .unwrap_or(a);
        let beside = direction.cross(&sharp);
        let face = FaceImage {
            centre: j * direction.as_ref() * (0.5 * length),
            first: j * beside * radius,
            second: j * (sharp * radius + direction.as_ref() * (0.5 * length)),
        };
        tracker
            .model
            .build(&face, axis, tracker.width, tracker.blur);
        let search = self.settings.tip_search_widths * tracker.width * wide.min(2.0);
        let mut mark = tracker.look_for_tip(image, search);
        if context.bevel_direction.is_none()
            && let Some(m) = &mut mark
        {
            // Between a bevel seen edge-on and one seen face-on lies 0.4 of its length.
            m.sigma = m
                .sigma
                .hypot(0.13 * (j * direction.as_ref()).norm() * length);
        }
        tracker.take_tip(mark, self.settings.systematic_px, self.settings.lost_after);
    }

    /// Keeps the curves' beginning at the surface.
    fn place_base(&mut self, context: &Context<'_>) {
        let Some(solid) = &self.solid else { return };
        let entry = if let Some(s) = &self.settings.surface {
            let height = |p: Vector3<f64>| (p - s.point.coords).dot(&s.normal);
            let (base, tip) = (solid.point(0.0), solid.point(1.0));
            let (h0, h1) = (height(base), height(tip));
            (h1 < 0.0 && (h0 - h1).abs() > 1e-6).then(|| base + (tip - base) * (h0 / (h0 - h1)))
        } else {
            context.guess.and_then(|g| g.first()).map(|p| p.coords)
        };
        let Some(entry) = entry else { return };
        for k in 0..2 {
            let Some(px) = self.views[k].project(&entry) else {
                continue;
            };
            let graph = &mut self.images[k].graph;
            let (x, _) = graph.local(px.0);
            if x.abs() > 0.3 && graph.length - x > 4.0 * self.images[k].width {
                graph.spread(x, graph.length);
            }
        }
        if let Some(solid) = &mut self.solid {
            let s = (entry - solid.origin).dot(&solid.axis) / solid.length;
            if s.abs() > 1e-3 && s < 0.8 {
                solid.spread(s, 1.0);
            }
        }
    }

    /// The needle without a past: from clicks, from the guess, or from the whole images.
    fn find(&mut self, images: [&GrayImage; 2], context: &Context<'_>) -> Result<(), LossReason> {
        if let Some(clicks) = self.clicks.take() {
            let ends = clicks.map(|c| [c[0].0, c[1].0]);
            return self.settle(ends, images, context);
        }
        if let Some([first, .., last]) = context.guess {
            let ends = [0, 1].map(|k| {
                let p = |p: &Point3<f64>| self.views[k].project(&p.coords).map(|d| d.0);
                Some([p(first)?, p(last)?])
            });
            if let [Some(left), Some(right)] = ends
                && self.settle([left, right], images, context).is_ok()
            {
                return Ok(());
            }
        }
        let width = self.nominal_width();
        let found = images.map(|i| self.finder.find(i, width));
        let mut pairs: Vec<(f64, &Candidate, &Candidate)> = Vec::new();
        for l in &found[0] {
            for r in &found[1] {
                pairs.push((l.score + r.score, l, r));
            }
        }
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut reason = LossReason::NotFound;
        for (_, l, r) in pairs.into_iter().take(5) {
            let ends = [l, r].map(|c| {
                let last = c.points.len() - 1;
                [c.points[0], c.points[last]]
            });
            match self.settle(ends, images, context) {
                Ok(()) => return Ok(()),
                Err(e) => reason = e,
            }
        }
        self.solid = None;
        Err(reason)
    }

    /// Width of the needle where the cameras look \[px\].
    fn nominal_width(&self) -> f64 {
        let middle = self.views.each_ref().map(|v| {
            DistortedPx::new(
                0.5 * (v.camera.width as f64 - 1.0),
                0.5 * (v.camera.height as f64 - 1.0),
            )
        });
        let unit = [Matrix2::identity() * 1e4; 2];
        let scale = triangulate(&self.views, &middle, &unit)
            .ok()
            .and_then(|t| self.views[0].project_with_derivative(&t.position.coords()))
            .map_or(4000.0, |(_, j)| j.row(0).norm());
        (self.settings.needle_diameter * scale).clamp(1.0, 40.0)
    }

    /// Starts at given ends and measures until it holds.
    fn settle(
        &mut self,
        ends: [[Point2<f64>; 2]; 2],
        images: [&GrayImage; 2],
        context: &Context<'_>,
    ) -> Result<(), LossReason> {
        let width = self.nominal_width();
        let n = self.settings.control_points;
        for k in 0..2 {
            let image = &mut self.images[k];
            image.start(ends[k][0], ends[k][1], n, 3.0 * width);
            image.width = width;
            image.blur = (0.25 * width).clamp(0.5, 2.0);
            if image.graph.length < 4.0 * width {
                return Err(LossReason::NotFound);
            }
            for wide in [2.0, 1.0] {
                if !image.update(images[k], &self.settings, wide) {
                    return Err([LossReason::LeftShaft, LossReason::RightShaft][k]);
                }
            }
        }
        let px = [0, 1].map(|k| DistortedPx(self.images[k].tip()));
        let around = [Matrix2::identity() * 4.0; 2];
        let tip = triangulate(&self.views, &px, &around).map_err(|_| LossReason::Reconstruction)?;
        let [left, right] = &self.images;
        self.solid = Solid::from_chords(
            &self.views,
            [&left.graph, &right.graph],
            tip.position.coords(),
        );
        if self.solid.is_none() {
            return Err(LossReason::Reconstruction);
        }
        for _ in 0..2 {
            for k in 0..2 {
                // Nothing is known about the tip but what the image shows.
                self.images[k].tip_cov[(0, 0)] = (4.0 * width).powi(2);
                self.measure_tip(k, images[k], context, 2.0);
                if self.images[k].tip_state != TipState::Measured {
                    self.solid = None;
                    return Err(LossReason::Tip);
                }
                if !self.images[k].update(images[k], &self.settings, 1.0) {
                    self.solid = None;
                    return Err([LossReason::LeftShaft, LossReason::RightShaft][k]);
                }
            }
            let held = self.reconstruct(5);
            if held.is_err() {
                self.solid = None;
                return held;
            }
            self.place_base(context);
        }
        Ok(())
    }

    fn publish(&mut self, context: &Context<'_>) {
        for k in 0..2 {
            let image = &self.images[k];
            let mut points = [DistortedPx::new(0.0, 0.0); POINTS];
            for (i, p) in points.iter_mut().enumerate() {
                let x = image.graph.length * i as f64 / (POINTS - 1) as f64;
                *p = DistortedPx(image.graph.point(x));
            }
            let curve = Curve2 {
                points,
                tip: DistortedPx(image.tip()),
                tip_covariance: image.tip_covariance(self.settings.systematic_px),
                survivors: image.survivors,
                tip_measured: image.tip_state == TipState::Measured,
            };
            if k == 0 {
                self.out.left = curve;
            } else {
                self.out.right = curve;
            }
        }
        let Some(solid) = &self.solid else { return };
        let tip = solid.point(1.0);
        let direction = solid.direction();
        // What is common to a whole curve does not average out over its marks.
        let scale = self.views[0]
            .project_with_derivative(&tip)
            .map_or(4000.0, |(_, j)| j.norm() / core::f64::consts::SQRT_2);
        let bend = self.images[0].bend.max(self.images[1].bend);
        let common = (self.settings.systematic_px.powi(2) + bend) / (scale * scale);
        let disagreement = (self.out.misfit / 4.0).max(1.0);
        let sigma_tip =
            solid.covariance(1.0) * disagreement + nalgebra::Matrix3::identity() * common;
        let shape = &mut self.out.shape;
        shape.points.clear();
        for i in 0..POINTS {
            let s = i as f64 / (POINTS - 1) as f64;
            let lateral = 0.5 * solid.covariance(s.min(0.999)).trace() + common;
            shape.points.push(SensedPoint {
                position: Position::new(Point3::from(solid.point(s))),
                sigma: lateral.sqrt(),
            });
        }
        shape.tip = SensedTip {
            position: Position::new(Point3::from(tip)),
            covariance: sigma_tip,
            direction,
            direction_sigma: solid.direction_sigma(),
        };
        self.out.sharp_point = context.bevel_direction.map(|d| {
            let ahead = direction.as_ref() * self.settings.bevel_length;
            Position::new(Point3::from(
                tip + ahead + d.as_ref() * (0.5 * self.settings.needle_diameter),
            ))
        });
    }
}

/// The grey value of an image that shows nothing.
fn blank(image: &GrayImage) -> Option<u8> {
    let sampled = image.pixels().iter().step_by(97);
    let (mut low, mut high) = (u8::MAX, u8::MIN);
    for &p in sampled {
        low = low.min(p);
        high = high.max(p);
    }
    // Noise alone spreads a dark or saturated image over a few levels.
    (high.saturating_sub(low) < 12).then_some(low / 2 + high / 2)
}
