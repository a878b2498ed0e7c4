//! The study plant: what the laws are judged on here. Two lateral planes, a linear rod on the
//! bed laid along its own path, a tip that cuts in a direction. Everything drawn from a seed.

use nalgebra::{Isometry3, Point3, Rotation2, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, StandardNormal, Uniform};

use crate::rod::{self, Bed, LENGTH, Shape};

/// Spacing of the stored path \[m\].
const MARK: f64 = 0.25e-3;

#[derive(Clone, Copy, Debug)]
pub(crate) struct World {
    /// Tip compliance \[rad/N\].
    pub(crate) tip_compliance: f64,
    /// Median cut angle \[rad\].
    pub(crate) cut_angle: f64,
    /// Multiplies sensor noise.
    pub(crate) noise: f64,
    pub(crate) latency: f64,
    pub(crate) drops: f64,
    pub(crate) seed: u64,
}

impl World {
    pub(crate) fn nominal(seed: u64) -> Self {
        Self {
            tip_compliance: 0.0,
            cut_angle: 1.5_f64.to_radians(),
            noise: 1.0,
            latency: 0.05,
            drops: 0.02,
            seed,
        }
    }

    pub(crate) fn compliant(seed: u64) -> Self {
        Self {
            tip_compliance: 10_f64.to_radians(),
            cut_angle: 2.4_f64.to_radians(),
            ..Self::nominal(seed)
        }
    }
}

pub(crate) struct Plant {
    pub(crate) world_from_phantom: Isometry3<f64>,
    stiffness_nodes: Vec<f64>,
    path: Vec<Vector2<f64>>,
    axial: f64,
    compliance: f64,
    cut: f64,
    azimuth: f64,
    wander: Vector2<f64>,
    base_error: Isometry3<f64>,
    /// Depth of the tip \[m\].
    pub(crate) depth: f64,
    pub(crate) tip: Vector2<f64>,
    pub(crate) tip_slope: Vector2<f64>,
    pub(crate) max_stretch: f64,
    stretch_sum: f64,
    stretch_count: f64,
    rng: ChaCha8Rng,
    pub(crate) last: Option<Shape>,
    pub(crate) last_stretch: f64,
}

fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    let x: f64 = StandardNormal.sample(rng);
    x * sigma
}

impl Plant {
    pub(crate) fn new(world: &World) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(world.seed);
        let k = 1e4 * (normal(&mut rng, 0.2)).exp();
        let field = Normal::new(0.0, 0.15).unwrap();
        let stiffness_nodes = (0..12)
            .map(|_| k * f64::exp(field.sample(&mut rng)))
            .collect();
        let cut = world.cut_angle * normal(&mut rng, 0.2).exp();
        let azimuth = normal(&mut rng, 10_f64.to_radians());
        let tilt = Vector3::new(
            normal(&mut rng, 0.5_f64.to_radians()),
            normal(&mut rng, 0.5_f64.to_radians()),
            0.0,
        );
        let shift = Vector3::new(normal(&mut rng, 2e-4), normal(&mut rng, 2e-4), 0.0);
        let axial = Uniform::new(0.2, 0.8).unwrap().sample(&mut rng);
        Self {
            // As the laboratory: entry at (0.40, 0, 0.25), z into the gel = world -z.
            world_from_phantom: Isometry3::from_parts(
                Translation3::new(0.40, 0.0, 0.25),
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI),
            ),
            stiffness_nodes,
            path: Vec::new(),
            axial,
            compliance: world.tip_compliance,
            cut,
            azimuth,
            wander: Vector2::zeros(),
            base_error: Isometry3::new(shift, tilt),
            depth: 0.0,
            tip: Vector2::zeros(),
            tip_slope: Vector2::zeros(),
            max_stretch: 0.0,
            stretch_sum: 0.0,
            stretch_count: 0.0,
            rng,
            last: None,
            last_stretch: 0.0,
        }
    }

    /// Nominal pose of the base at the start: straight above the entry, tip on the surface.
    pub(crate) fn start(&self) -> Isometry3<f64> {
        self.world_from_phantom * Isometry3::translation(0.0, 0.0, -LENGTH)
    }

    pub(crate) fn mean_stretch(&self) -> f64 {
        self.stretch_sum / self.stretch_count.max(1.0)
    }

    /// Entry of the needle in the phantom's plane \[m\].
    fn path_at(path: &[Vector2<f64>], tip: (f64, Vector2<f64>), z: f64) -> Vector2<f64> {
        let x = z / MARK;
        let i = x.floor().max(0.0) as usize;
        if i + 1 < path.len() {
            let t = x - i as f64;
            path[i] * (1.0 - t) + path[i + 1] * t
        } else if let Some(last) = path.last() {
            let z0 = (path.len() - 1) as f64 * MARK;
            let t = ((z - z0) / (tip.0 - z0).max(1e-9)).clamp(0.0, 1.0);
            last * (1.0 - t) + tip.1 * t
        } else {
            tip.1
        }
    }

    /// Advances to a nominal base pose, moved to in a straight step.
    pub(crate) fn step(&mut self, world_from_base: &Isometry3<f64>) {
        let base = self.world_from_phantom.inverse() * world_from_base * self.base_error;
        let axis = base.rotation * Vector3::z();
        let slope = Vector2::new(axis.x / axis.z, axis.y / axis.z);
        let bevel = base.rotation * -Vector3::y();
        let origin = base.translation.vector;
        let shortening = self.last.as_ref().map_or(0.0, Shape::shortening);
        let z1 = origin.z + LENGTH - shortening;
        if self.path.is_empty() {
            let at_surface = origin.xy() - slope * origin.z;
            self.path.push(at_surface);
            self.tip = at_surface;
        }
        let advance = (z1 - self.depth).max(0.0);
        let direction = self.tip_slope + Rotation2::new(self.azimuth) * bevel.xy() * self.cut
            - self.last.as_ref().map_or(Vector2::zeros(), |s| s.reaction) * self.compliance
            + self.wander;
        self.tip += direction * advance;
        self.depth += advance;
        // Direction noise of 0.1 degree over 5 mm.
        let decay = (-advance / 5e-3).exp();
        let kick = 0.1_f64.to_radians() * (1.0 - decay * decay).sqrt();
        self.wander = self.wander * decay
            + Vector2::new(normal(&mut self.rng, kick), normal(&mut self.rng, kick));
        while (self.path.len() as f64) * MARK <= self.depth {
            let z = self.path.len() as f64 * MARK;
            let p = Self::path_at(&self.path, (self.depth, self.tip), z);
            self.path.push(p);
        }
        let nodes = &self.stiffness_nodes;
        let stiffness = |z: f64| {
            let x = (z / 8e-3).clamp(0.0, 10.999);
            let i = x as usize;
            nodes[i] * (1.0 - x.fract()) + nodes[i + 1] * x.fract()
        };
        let tip = (self.depth, self.tip);
        let path = &self.path;
        let along = |z: f64| Self::path_at(path, tip, z);
        let bed = Bed {
            stiffness: &stiffness,
            path: &along,
            axial: self.axial,
            free_tip_force: None,
        };
        let shape = rod::equilibrium(origin.z, self.depth, origin.xy(), slope, &bed);
        self.tip_slope = shape.tip_slope();
        let (mut sum, mut count, mut most) = (0.0, 0.0, 0.0_f64);
        for (z, w) in shape.z.iter().zip(&shape.w) {
            if *z >= 0.0 {
                let d = (w - along(*z)).norm();
                sum += d;
                count += 1.0;
                most = most.max(d);
            }
        }
        self.last_stretch = most;
        self.max_stretch = self.max_stretch.max(most);
        if count > 0.0 && advance > 0.0 {
            self.stretch_sum += sum / count;
            self.stretch_count += 1.0;
        }
        self.last = Some(shape);
    }

    /// The path at a depth \[m\].
    pub(crate) fn path(&self, z: f64) -> Vector2<f64> {
        Self::path_at(&self.path, (self.depth, self.tip), z)
    }

    /// Points of the shaft inside the tissue, every 2.5 mm, in World.
    pub(crate) fn visible(&self) -> Vec<Point3<f64>> {
        let Some(shape) = &self.last else {
            return Vec::new();
        };
        let mut out = Vec::new();
        let mut next = 0.0;
        for (z, w) in shape.z.iter().zip(&shape.w) {
            if *z >= next {
                out.push(self.world_from_phantom * Point3::new(w.x, w.y, *z));
                next = z + 2.5e-3;
            }
        }
        out
    }

    /// True tip O and tip axis in World.
    pub(crate) fn true_tip(&self) -> (Point3<f64>, Vector3<f64>) {
        let p = self.world_from_phantom * Point3::new(self.tip.x, self.tip.y, self.depth);
        let d = self.world_from_phantom.rotation
            * Vector3::new(self.tip_slope.x, self.tip_slope.y, 1.0).normalize();
        (p, d)
    }
}
