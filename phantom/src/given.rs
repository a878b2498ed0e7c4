//! A needle whose shape is computed elsewhere: another simulator, a learned model, a recording.

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::plant::Plant;
use crate::settings::{Settings, is_pose};
use crate::truth::{Event, Truth};

/// Pieces of equal length into which the centre line is divided, as the rod's are by default.
const PIECES: usize = 252;
/// Farthest that the first point may be from the base, and the whole from the needle's length,
/// as a part of that length.
const APART: f64 = 0.05;
/// Most points of a shape.
const MOST_POINTS: usize = 100_000;

/// What computes the shape.
pub trait ShapeSource: Send {
    /// Moves the base to `world_from_base`, reached at `stamp`, along the straight screw from its
    /// last pose.
    ///
    /// # Errors
    /// In words; the needle stays as it was, and the world reports that it refused.
    fn advance(&mut self, world_from_base: &Isometry3<f64>, stamp: Stamp) -> Result<(), String>;

    /// The centre line in World \[m\], from the base to the tip: `[x, y, z]` of two points or more;
    /// the finer, the truer the tip's direction.
    ///
    /// # Errors
    /// In words; as for `advance`.
    fn shape(&mut self) -> Result<Vec<[f64; 3]>, String>;

    /// Called for an invalid shape, with the reason in words. The needle stays as it was.
    fn refused(&mut self, why: &str) {
        let _ = why;
    }
}

/// A needle of somebody else's shape in this world: robot flaws, sensors and cameras look at it as
/// at the rod. The needle does not twist: its bevel goes with the base, carried along the centre
/// line without a turn about it. What only the rod knows (displacement of the tissue, forces, the
/// cut path) is zero or empty.
pub struct GivenPlant {
    source: Box<dyn ShapeSource>,
    world_from_entry: Isometry3<f64>,
    length: f64,
    truth: Truth,
}

impl core::fmt::Debug for GivenPlant {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("GivenPlant").finish_non_exhaustive()
    }
}

impl GivenPlant {
    /// The needle of `settings` with the shapes of `source`. `world_from_entry` has its origin on
    /// the surface and z into the tissue: where the shaft counts as inside.
    ///
    /// # Errors
    /// The source has no usable shape at the start.
    pub fn new(
        settings: &Settings,
        world_from_entry: &Isometry3<f64>,
        world_from_base: &Transform<World, NeedleBase>,
        source: Box<dyn ShapeSource>,
    ) -> Result<Self, String> {
        let needle = &settings.needle;
        let length = needle.length_mm * 1e-3;
        let mut plant = Self {
            source,
            world_from_entry: *world_from_entry,
            length,
            truth: Truth::straight(
                world_from_base,
                length,
                PIECES,
                needle.outer_diameter_mm * 1e-3,
                needle.bevel_deg.to_radians(),
            ),
        };
        plant.follow(world_from_base, Stamp::ZERO)?;
        Ok(plant)
    }

    fn follow(
        &mut self,
        world_from_base: &Transform<World, NeedleBase>,
        stamp: Stamp,
    ) -> Result<(), String> {
        let base = world_from_base.isometry();
        if !is_pose(base) {
            return Err("the base's pose is none".into());
        }
        self.source.advance(base, stamp)?;
        let shape = self.source.shape()?;
        let line = Line::new(&shape, base, self.length).inspect_err(|why| {
            self.source.refused(why);
        })?;
        let truth = &mut self.truth;
        truth.needle.centreline.clear();
        truth
            .needle
            .centreline
            .extend((0..=PIECES).map(|k| line.at(line.length() * k as f64 / PIECES as f64)));
        truth.needle.world_from_tip = Transform::assume(line.tip(base));
        truth.needle.entry_arc = line.enters(&self.world_from_entry);
        truth.depth = (line.length() - truth.needle.entry_arc).max(0.0);
        truth.world_from_base = *world_from_base;
        Ok(())
    }
}

impl Plant for GivenPlant {
    fn advance(&mut self, world_from_base: &Transform<World, NeedleBase>, stamp: Stamp) {
        let followed = self.follow(world_from_base, stamp);
        self.truth.events.clear();
        if followed.is_err() {
            self.truth.events.push(Event::Refused);
        }
        self.truth.stamp = stamp;
        self.truth.needle.stamp = stamp;
    }

    fn truth(&self) -> &Truth {
        &self.truth
    }

    fn reset(&mut self, world_from_base: &Transform<World, NeedleBase>) {
        self.advance(world_from_base, Stamp::ZERO);
    }
}

/// A centre line with the arc lengths of its points.
struct Line {
    points: Vec<Vector3<f64>>,
    arcs: Vec<f64>,
}

impl Line {
    fn new(shape: &[[f64; 3]], base: &Isometry3<f64>, length: f64) -> Result<Self, String> {
        if !(2..=MOST_POINTS).contains(&shape.len()) {
            let found = shape.len();
            return Err(format!(
                "a shape of {found} points; expected 2 to {MOST_POINTS}"
            ));
        }
        let points: Vec<Vector3<f64>> = shape.iter().map(|p| Vector3::from(*p)).collect();
        let mut arcs = vec![0.0];
        for ends in points.windows(2) {
            let step = (ends[1] - ends[0]).norm();
            // Written so that NaN is refused.
            if step > 0.0 && step.is_finite() {
                arcs.push(arcs[arcs.len() - 1] + step);
            } else {
                let at = arcs.len();
                return Err(format!(
                    "points {} and {at} of the shape: expected finite places apart from each other",
                    at - 1
                ));
            }
        }
        let line = Self { points, arcs };
        let off = (line.points[0] - base.translation.vector).norm();
        if off > APART * length {
            return Err(format!(
                "the shape begins {:.1} mm from the base; expected its points from the base to the tip, in World, \
                 metres",
                off * 1e3
            ));
        }
        if (line.length() - length).abs() > APART * length {
            return Err(format!(
                "a shape {:.1} mm long; the needle is {:.1} mm long (phantom.needle.length_mm)",
                line.length() * 1e3,
                length * 1e3
            ));
        }
        Ok(line)
    }

    fn length(&self) -> f64 {
        self.arcs[self.arcs.len() - 1]
    }

    /// The place at an arc length from the base.
    fn at(&self, arc: f64) -> Vector3<f64> {
        let last = self.points.len() - 2;
        let k = (self.arcs.partition_point(|a| *a <= arc).max(1) - 1).min(last);
        let share = (arc - self.arcs[k]) / (self.arcs[k + 1] - self.arcs[k]);
        self.points[k].lerp(&self.points[k + 1], share)
    }

    /// The tip frame: the base's frame, carried along without a turn about the line. At the tip the
    /// direction is that of the parabola through the last three points.
    fn tip(&self, base: &Isometry3<f64>) -> Isometry3<f64> {
        let mut rotation = base.rotation;
        let mut turn = |to: Vector3<f64>| {
            let z = rotation * Vector3::z();
            if let Some(step) = UnitQuaternion::rotation_between(&z, &to) {
                rotation = step * rotation;
            }
        };
        let directions: Vec<Vector3<f64>> = self
            .points
            .windows(2)
            .map(|ends| (ends[1] - ends[0]).normalize())
            .collect();
        for direction in &directions {
            turn(*direction);
        }
        let n = directions.len();
        if n >= 2 {
            let (before, last) = (directions[n - 2], directions[n - 1]);
            let steps = [
                self.arcs[n - 1] - self.arcs[n - 2],
                self.arcs[n] - self.arcs[n - 1],
            ];
            turn(last + (last - before) * (steps[1] / (steps[0] + steps[1])));
        }
        Isometry3::from_parts(self.points[n].into(), rotation)
    }

    /// Arc length at which the line goes below the surface for good; beyond the needle's end while
    /// it is outside.
    fn enters(&self, world_from_entry: &Isometry3<f64>) -> f64 {
        let depth = |p: &Vector3<f64>| world_from_entry.inverse_transform_point(&(*p).into()).z;
        let n = self.points.len();
        let mut below = depth(&self.points[n - 1]);
        if below <= 0.0 {
            return self.length() - below;
        }
        for k in (0..n - 1).rev() {
            let above = depth(&self.points[k]);
            if above <= 0.0 {
                let share = above / (above - below);
                return self.arcs[k] + share * (self.arcs[k + 1] - self.arcs[k]);
            }
            below = above;
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A straight needle, or an arc of `curvature` about the base's x.
    struct Arc {
        base: Isometry3<f64>,
        curvature: f64,
        points: u32,
        broken: bool,
    }

    impl ShapeSource for Arc {
        fn advance(&mut self, base: &Isometry3<f64>, _: Stamp) -> Result<(), String> {
            self.base = *base;
            Ok(())
        }

        fn shape(&mut self) -> Result<Vec<[f64; 3]>, String> {
            let k = self.curvature;
            Ok((0..=self.points)
                .map(|i| {
                    let s = 0.126 * f64::from(i) / f64::from(self.points);
                    let (y, z) = if k == 0.0 {
                        (0.0, s)
                    } else {
                        (-(1.0 - (k * s).cos()) / k, (k * s).sin() / k)
                    };
                    let z = if self.broken { f64::NAN } else { z };
                    (self.base * nalgebra::Point3::new(0.0, y, z)).coords.into()
                })
                .collect())
        }
    }

    fn start() -> Transform<World, NeedleBase> {
        Transform::assume(Isometry3::translation(0.0, 0.0, -0.1))
    }

    fn try_plant(curvature: f64, points: u32) -> Option<GivenPlant> {
        let source = Arc {
            base: Isometry3::identity(),
            curvature,
            points,
            broken: false,
        };
        let settings = Settings::default();
        GivenPlant::new(
            &settings,
            &Isometry3::identity(),
            &start(),
            Box::new(source),
        )
        .ok()
    }

    fn plant(curvature: f64, points: u32) -> (GivenPlant, Transform<World, NeedleBase>) {
        (try_plant(curvature, points).unwrap(), start())
    }

    #[test]
    fn an_arc_has_its_tip_depth_and_bevel() {
        let (curvature, angle) = (2.0, 2.0 * 0.126_f64);
        let (plant, _) = plant(curvature, 200);
        let truth = plant.truth();
        let expected = Vector3::new(0.0, -angle.sin(), angle.cos());
        assert!(
            (truth.direction() - expected).norm() < 1e-5,
            "{}",
            truth.direction()
        );
        let bevel = truth.needle.world_from_tip.rotate(&-Vector3::y());
        let expected = Vector3::new(0.0, -angle.cos(), -angle.sin());
        assert!((bevel - expected).norm() < 1e-5, "{bevel}");
        let enters = (0.1 * curvature).asin() / curvature;
        assert!((truth.needle.entry_arc - enters).abs() < 1e-6);
        let spacing = truth.needle.spacing();
        assert!((spacing * 252.0 - 0.126).abs() < 1e-6);
    }

    #[test]
    fn what_is_no_shape_is_an_event_and_changes_nothing() {
        for (curvature, points) in [(f64::NAN, 10), (0.0, 0)] {
            assert!(try_plant(curvature, points).is_none());
        }
        let (mut plant, start) = plant(0.0, 1);
        let before = plant.truth().needle.centreline.clone();
        plant.source = Box::new(Arc {
            base: Isometry3::identity(),
            curvature: 0.0,
            points: 10,
            broken: true,
        });
        plant.advance(&start, Stamp::from_secs(1.0));
        assert_eq!(plant.truth().events, [Event::Refused]);
        assert_eq!(plant.truth().needle.centreline, before);
        assert_eq!(plant.truth().stamp, Stamp::from_secs(1.0));
    }
}
