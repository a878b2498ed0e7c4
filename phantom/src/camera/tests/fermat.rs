//! Projection against Fermat's principle: the path of least optical length, found by Newton's
//! method on the length itself, knowing nothing of Snell's law.

use nalgebra::{Matrix4, Point3, Vector3, Vector4};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::scene::{rig, world_from_phantom};
use crate::camera::{CameraSettings, RigParameters, Side, Through};

/// Optical length from the camera (origin) by `a` on the outer and `b` on the inner face.
struct Path {
    point: Vector3<f64>,
    outer: Vector3<f64>,
    inner: Vector3<f64>,
    u: Vector3<f64>,
    v: Vector3<f64>,
    wall_index: f64,
    index: f64,
}

impl Path {
    fn ends(&self, x: &Vector4<f64>) -> (Vector3<f64>, Vector3<f64>) {
        (
            self.outer + x[0] * self.u + x[1] * self.v,
            self.inner + x[2] * self.u + x[3] * self.v,
        )
    }

    fn gradient(&self, x: &Vector4<f64>) -> Vector4<f64> {
        let (a, b) = self.ends(x);
        let at_a = a.normalize() + self.wall_index * (a - b).normalize();
        let at_b =
            self.wall_index * (b - a).normalize() + self.index * (b - self.point).normalize();
        Vector4::new(
            at_a.dot(&self.u),
            at_a.dot(&self.v),
            at_b.dot(&self.u),
            at_b.dot(&self.v),
        )
    }

    /// The direction in air of the shortest path.
    fn shortest(&self) -> Vector3<f64> {
        let mut x = Vector4::zeros();
        for _ in 0..60 {
            let mut hessian = Matrix4::zeros();
            for k in 0..4 {
                let mut step = Vector4::zeros();
                step[k] = 1e-6;
                let d = (self.gradient(&(x + step)) - self.gradient(&(x - step))) / 2e-6;
                hessian.set_column(k, &d);
            }
            let step = hessian.lu().solve(&self.gradient(&x)).unwrap();
            x -= step * (0.05 / step.norm().max(0.05));
            if step.norm() < 1e-15 {
                break;
            }
        }
        self.ends(&x).0
    }
}

fn path(rig: &RigParameters, side: Side, world: &Point3<f64>, index: f64) -> Path {
    let camera_from_left = match side {
        Side::Left => nalgebra::Isometry3::identity(),
        Side::Right => *rig.right_from_left.isometry(),
    };
    let wall = match side {
        Side::Left => &rig.container.left_wall,
        Side::Right => &rig.container.right_wall,
    };
    let normal = camera_from_left.rotation * wall.normal.into_inner();
    let outer = (camera_from_left * wall.point.point()).coords;
    let u = normal.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
    Path {
        point: (camera_from_left * rig.left_from_world.isometry() * world).coords,
        outer,
        inner: outer - rig.container.wall_thickness * normal,
        u,
        v: normal.cross(&u),
        wall_index: rig.container.wall_index,
        index,
    }
}

#[test]
fn projection_is_the_path_of_least_time() {
    let mut generator = ChaCha8Rng::seed_from_u64(4);
    let mut settings = CameraSettings::paper();
    // A container believed askew by some degrees tilts the walls before the cameras.
    settings.calibration.container_deg = 3.0;
    settings.calibration.container_mm = 1.0;
    let mut worst: f64 = 0.0;
    for seed in 0..4 {
        let rig = rig(&settings, seed);
        for parameters in [rig.truth(), rig.given()] {
            for _ in 0..25 {
                let mut uniform = |a: f64, b: f64| generator.random_range(a..b);
                let place = Point3::new(
                    uniform(-0.02, 0.02),
                    uniform(-0.02, 0.02),
                    uniform(-0.02, 0.1),
                );
                let world = world_from_phantom() * place;
                for side in Side::BOTH {
                    let view = parameters.view(side);
                    for (through, index) in [
                        (Through::Gel, parameters.container.gel_index),
                        (Through::FreeWall, 1.0),
                    ] {
                        let d = path(parameters, side, &world, index).shortest();
                        let expected = view.lens().project([d.x / d.z, d.y / d.z]);
                        let pixel = view.project(&world, through).unwrap();
                        let e = (pixel[0] - expected[0]).hypot(pixel[1] - expected[1]);
                        worst = worst.max(e);
                    }
                }
            }
        }
    }
    println!("largest difference from Fermat's path: {worst:.1e} px");
    // 1e-9 of a radian is 2e-6 px; what is left is the peer's own rounding.
    assert!(worst < 1e-8, "{worst} px");
}

#[test]
fn rays_pass_through_the_points_that_project_to_them() {
    let rig = rig(&CameraSettings::paper(), 3);
    for side in Side::BOTH {
        let view = rig.truth().view(side);
        for k in 0..40 {
            let t = f64::from(k);
            let place = Point3::new(
                0.03 * (1.1 * t).sin(),
                0.03 * (0.7 * t).cos(),
                0.001 + 0.002 * t,
            );
            let world = world_from_phantom() * place;
            for through in [Through::Gel, Through::FreeWall, Through::OpenAir] {
                let pixel = view.project(&world, through).unwrap();
                let ray = view.ray(pixel, through).unwrap();
                let to = world - ray.origin;
                let miss = (to - ray.direction * ray.direction.dot(&to)).norm();
                assert!(miss < 1e-12, "{miss} m {through:?}");
            }
        }
    }
}

#[test]
fn unmodelled_refraction_biases_by_a_millimetre() {
    // The gel's back, 40 mm behind the axis, and 30 mm aside: seen through gel it appears nearer.
    let rig = rig(&CameraSettings::ideal(), 0);
    let view = rig.truth().view(Side::Left);
    let place = Point3::new(-0.03, -0.03, 0.08);
    let world = world_from_phantom() * place;
    let gel = view.project(&world, Through::Gel).unwrap();
    let air = view.project(&world, Through::OpenAir).unwrap();
    let shift = (gel[0] - air[0]).hypot(gel[1] - air[1]);
    // 0.2-1.3 mm at 4 px/mm.
    assert!((0.8..12.0).contains(&shift), "{shift} px");
}

#[test]
fn points_behind_the_camera_are_not_seen() {
    let rig = rig(&CameraSettings::ideal(), 0);
    let view = rig.truth().view(Side::Left);
    let behind = view.camera_from_world().inverse() * Point3::new(0.0, 0.0, -0.1);
    for through in [Through::Gel, Through::FreeWall, Through::OpenAir] {
        assert_eq!(view.project(&behind, through), None);
    }
    let nowhere = Point3::new(f64::NAN, 0.0, 0.0);
    assert_eq!(view.see(&nowhere), None);
}
