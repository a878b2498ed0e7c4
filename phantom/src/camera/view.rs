//! Exact projection of one camera through the container.

use nalgebra::{Isometry3, Point3, Vector3};

use super::lens::{Lens, Pixel};
use super::parameters::{RigParameters, Side};
use super::refraction::{Sight, Window};

/// What lies between a camera and a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Through {
    /// Air, the container's wall, gel.
    Gel,
    /// Air, the free part of the wall above the gel, air.
    FreeWall,
    /// Air only: the container is removed.
    OpenAir,
}

/// A ray in World.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts: on the wall's inner face, or the camera's centre in open air \[m\].
    pub origin: Point3<f64>,
    /// Unit direction, away from the camera.
    pub direction: Vector3<f64>,
}

/// One camera of a rig, with the media before it. Copies of plain data; cheap to keep.
#[derive(Clone, Debug)]
pub struct View {
    lens: Lens,
    width: f64,
    height: f64,
    camera_from_world: Isometry3<f64>,
    window: Window,
    gel_index: f64,
    surface_normal: Vector3<f64>,
    surface_offset: f64,
}

impl View {
    pub(super) fn new(rig: &RigParameters, side: Side) -> Self {
        let left_from_world = *rig.left_from_world.isometry();
        let (lens, wall, camera_from_left) = match side {
            Side::Left => (rig.left, rig.container.left_wall, Isometry3::identity()),
            Side::Right => (
                rig.right,
                rig.container.right_wall,
                *rig.right_from_left.isometry(),
            ),
        };
        let axis = -(camera_from_left.rotation * wall.normal.into_inner());
        let surface = rig.container.surface;
        let surface_normal = camera_from_left.rotation * surface.normal.into_inner();
        Self {
            lens,
            width: rig.width_px as f64,
            height: rig.height_px as f64,
            camera_from_world: camera_from_left * left_from_world,
            window: Window {
                axis,
                air: axis.dot(&(camera_from_left * wall.point.point()).coords),
                wall: rig.container.wall_thickness,
                wall_index: rig.container.wall_index,
            },
            gel_index: rig.container.gel_index,
            surface_normal,
            surface_offset: surface_normal.dot(&(camera_from_left * surface.point.point()).coords),
        }
    }

    /// Intrinsics.
    pub const fn lens(&self) -> &Lens {
        &self.lens
    }

    /// Takes World coordinates to this camera's optical frame.
    pub const fn camera_from_world(&self) -> &Isometry3<f64> {
        &self.camera_from_world
    }

    /// Pixel of a World point \[m\] seen through given media, wherever the point is and whether
    /// or not it is inside the image; none for a point behind the camera.
    pub fn project(&self, world: &Point3<f64>, through: Through) -> Option<Pixel> {
        let point = (self.camera_from_world * world).coords;
        match through {
            Through::OpenAir => self.pixel(&point),
            _ => self.pixel(&self.sight(&point, through)?.in_air),
        }
    }

    /// Pixel at which a World point \[m\] is seen directly: in the gel through the wall, above
    /// the surface through the wall's free part. None when the surface hides it (total
    /// reflection), or when it falls outside the image.
    pub fn see(&self, world: &Point3<f64>) -> Option<Pixel> {
        let point = (self.camera_from_world * world).coords;
        let above = self.height_above_gel(&point) > 0.0;
        let through = if above {
            Through::FreeWall
        } else {
            Through::Gel
        };
        let sight = self.sight(&point, through)?;
        if (self.height_above_gel(&sight.inner) > 0.0) != above {
            return None;
        }
        let pixel = self.pixel(&sight.in_air)?;
        let inside = |v: f64, n: f64| (-0.5..n - 0.5).contains(&v);
        (inside(pixel[0], self.width) && inside(pixel[1], self.height)).then_some(pixel)
    }

    /// The ray behind the wall that a pixel sees; none where the camera looks past the wall.
    pub fn ray(&self, pixel: Pixel, through: Through) -> Option<Ray> {
        let [x, y] = self.lens.normalise(pixel);
        let direction = Vector3::new(x, y, 1.0);
        let (origin, direction) = match through {
            Through::OpenAir => (Vector3::zeros(), direction.normalize()),
            _ => self.window.follow(&direction, self.index_behind(through))?,
        };
        let world_from_camera = self.camera_from_world.inverse();
        Some(Ray {
            origin: world_from_camera * Point3::from(origin),
            direction: world_from_camera.rotation * direction,
        })
    }

    fn index_behind(&self, through: Through) -> f64 {
        match through {
            Through::Gel => self.gel_index,
            Through::FreeWall | Through::OpenAir => 1.0,
        }
    }

    /// How a point (camera frame) is seen through the wall.
    pub(super) fn sight(&self, point: &Vector3<f64>, through: Through) -> Option<Sight> {
        self.window.sight(point, self.index_behind(through))
    }

    /// Pixel of a direction in air (camera frame).
    pub(super) fn pixel(&self, direction: &Vector3<f64>) -> Option<Pixel> {
        (direction.z > 0.0).then(|| {
            self.lens
                .project([direction.x / direction.z, direction.y / direction.z])
        })
    }

    /// Signed height over the gel's surface of a point in the camera's frame \[m\].
    pub(super) fn height_above_gel(&self, point: &Vector3<f64>) -> f64 {
        self.surface_normal.dot(point) - self.surface_offset
    }

    /// Mirror image in the gel's surface of a point in the camera's frame.
    pub(super) fn mirrored(&self, point: &Vector3<f64>) -> Vector3<f64> {
        point - 2.0 * self.height_above_gel(point) * self.surface_normal
    }

    /// Width and height of the image \[px\].
    pub(super) const fn size(&self) -> (f64, f64) {
        (self.width, self.height)
    }
}
