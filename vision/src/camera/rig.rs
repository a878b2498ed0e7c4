//! The stereo rig: two cameras, what lies between them, and the container they look into.

use hal::Transform;
use hal::frame::{LeftCamera, RightCamera};
use nalgebra::{Isometry3, Matrix2x3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::{Camera, DistortedPx, FlatWindow, Ray};

/// The windows through which the two cameras look into the gel, each in its camera's frame.
/// Both may be the same wall.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Container {
    /// The left camera's window, in the left camera's frame.
    pub left: FlatWindow,
    /// The right camera's window, in the right camera's frame.
    pub right: FlatWindow,
}

/// Two calibrated cameras.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StereoRig {
    /// The left camera.
    pub left: Camera,
    /// The right camera.
    pub right: Camera,
    /// Takes coordinates in the left camera's frame to the right camera's.
    pub right_from_left: Transform<RightCamera, LeftCamera>,
    /// The container, when the cameras look into gel; `None` for a scene in air.
    pub container: Option<Container>,
}

/// One camera of a rig as seen from the stereo frame (the left camera's).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// Takes coordinates in the left camera's frame to this camera's.
    pub camera_from_left: Isometry3<f64>,
    /// The window in front of this camera, in its frame.
    pub window: Option<FlatWindow>,
}

/// What a pixel shows: the half line in the gel (or in air), in the stereo frame.
pub type ViewRay = Ray;

impl StereoRig {
    /// The left camera's view.
    pub fn left_view(&self) -> View {
        View {
            camera: self.left,
            camera_from_left: Isometry3::identity(),
            window: self.container.map(|c| c.left),
        }
    }

    /// The right camera's view.
    pub fn right_view(&self) -> View {
        View {
            camera: self.right,
            camera_from_left: *self.right_from_left.isometry(),
            window: self.container.map(|c| c.right),
        }
    }

    /// Both views, left first.
    pub fn views(&self) -> [View; 2] {
        [self.left_view(), self.right_view()]
    }

    /// The same rig looking into `container`, or into air.
    #[must_use]
    pub fn with_container(self, container: Option<Container>) -> Self {
        Self { container, ..self }
    }

    /// Distance of the two pinholes \[m\].
    pub fn baseline(&self) -> f64 {
        self.right_from_left.isometry().translation.vector.norm()
    }
}

impl View {
    /// Projects a point of the stereo frame \[m\]; `None` where the camera cannot see it.
    pub fn project(&self, point: &Vector3<f64>) -> Option<DistortedPx> {
        let p = self.in_camera(point);
        match &self.window {
            None => self.camera.project(&p),
            Some(w) => self.camera.project(&w.direction_to(&p)?.direction),
        }
    }

    /// Projects a point of the stereo frame \[m\], with the derivative by it \[px/m\]; `None`
    /// where the camera cannot see it.
    pub fn project_with_derivative(
        &self,
        point: &Vector3<f64>,
    ) -> Option<(DistortedPx, Matrix2x3<f64>)> {
        let rotation = self.camera_from_left.rotation.to_rotation_matrix();
        let p = self.in_camera(point);
        let (px, j) = match &self.window {
            None => self.camera.project_with_derivative(&p)?,
            Some(w) => {
                let seen = w.direction_to(&p)?;
                let (px, j) = self.camera.project_with_derivative(&seen.direction)?;
                (px, j * seen.by_point)
            }
        };
        Some((px, j * rotation.matrix()))
    }

    /// What a pixel shows, as a half line in the stereo frame: from the wall's inner face on
    /// with a window, from the pinhole on without. `None` where the distortion cannot be
    /// inverted or the ray misses the window.
    pub fn ray(&self, px: DistortedPx) -> Option<ViewRay> {
        let direction = self.camera.direction(px)?;
        let ray = match &self.window {
            None => Ray {
                origin: Vector3::zeros(),
                direction: direction.normalize(),
            },
            Some(w) => w.ray_in_gel(&direction)?,
        };
        let back = self.camera_from_left.inverse();
        Some(Ray {
            origin: (back * Point3::from(ray.origin)).coords,
            direction: back.rotation * ray.direction,
        })
    }

    fn in_camera(&self, point: &Vector3<f64>) -> Vector3<f64> {
        (self.camera_from_left * Point3::from(*point)).coords
    }
}
