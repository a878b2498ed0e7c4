//! Frames as types, so that a transform cannot be applied the wrong way round.
//!
//! `a_from_b: Transform<A, B>` takes coordinates in `B` to coordinates in `A`; in a product
//! neighbours match: `world_from_camera * camera_from_board`.

use core::fmt;
use core::marker::PhantomData;
use core::ops::Mul;

use nalgebra::{Isometry3, Matrix4, Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

/// A coordinate frame; implemented by the marker types of this module.
pub trait Frame: Copy + Send + Sync + 'static {
    /// The frame's name in logs and on ROS's `/tf`.
    const NAME: &'static str;
}

macro_rules! frames {
    ($($(#[$doc:meta])* $name:ident = $tf:literal;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {}

        impl Frame for $name {
            const NAME: &'static str = $tf;
        }
    )*};
}

frames! {
    /// The laboratory; z up. All of the model and of the control law happens here.
    World = "world";
    /// The arm's base as its URDF has it.
    ArmBase = "base_link";
    /// The arm's flange; z out of the flange.
    Flange = "tool0";
    /// The needle's base: where it leaves its holder, z along the shaft towards the tip.
    NeedleBase = "needle_base";
    /// The shaft's centre O just before the bevel; z along the tip axis, y away from the side
    /// to which the bevel drives the needle (the bevel direction is -y).
    NeedleTip = "needle_tip";
    /// The left camera's optical frame (x right, y down, z forward): the stereo frame, in which
    /// targets and measurements are given.
    LeftCamera = "left_camera_optical_frame";
    /// The right camera's optical frame.
    RightCamera = "right_camera_optical_frame";
    /// The calibration board: x along its rows, y along its columns.
    Board = "board";
}

/// Rigid transform that takes coordinates in `B` to coordinates in `A`.
pub struct Transform<A, B> {
    isometry: Isometry3<f64>,
    frames: PhantomData<fn(B) -> A>,
}

impl<A: Frame, B: Frame> Transform<A, B> {
    /// Declares that `isometry` takes coordinates in `B` to coordinates in `A`: the one place
    /// where untyped geometry becomes typed.
    pub const fn assume(isometry: Isometry3<f64>) -> Self {
        Self {
            isometry,
            frames: PhantomData,
        }
    }

    /// The two frames coincide.
    pub fn identity() -> Self {
        Self::assume(Isometry3::identity())
    }

    /// The untyped isometry.
    pub const fn isometry(&self) -> &Isometry3<f64> {
        &self.isometry
    }

    /// The transform from `A` to `B`.
    #[must_use]
    pub fn inverse(&self) -> Transform<B, A> {
        Transform::assume(self.isometry.inverse())
    }

    /// Origin of `B` in `A` \[m\].
    pub fn origin(&self) -> Position<A> {
        Position::new(Point3::from(self.isometry.translation.vector))
    }

    /// Rotates a free vector from `B` to `A`.
    pub fn rotate(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.isometry.rotation * vector
    }

    /// Rotates a direction from `B` to `A`.
    pub fn rotate_direction(&self, direction: &Unit<Vector3<f64>>) -> Unit<Vector3<f64>> {
        self.isometry.rotation * direction
    }

    /// Homogeneous 4x4 matrix.
    pub fn to_homogeneous(&self) -> Matrix4<f64> {
        self.isometry.to_homogeneous()
    }
}

impl<A: Frame, B: Frame, C: Frame> Mul<Transform<B, C>> for Transform<A, B> {
    type Output = Transform<A, C>;

    fn mul(self, rhs: Transform<B, C>) -> Transform<A, C> {
        Transform::assume(self.isometry * rhs.isometry)
    }
}

impl<A: Frame, B: Frame> Mul<Position<B>> for Transform<A, B> {
    type Output = Position<A>;

    fn mul(self, rhs: Position<B>) -> Position<A> {
        Position::new(self.isometry * rhs.point)
    }
}

impl<A, B> Clone for Transform<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A, B> Copy for Transform<A, B> {}

impl<A, B> PartialEq for Transform<A, B> {
    fn eq(&self, other: &Self) -> bool {
        self.isometry == other.isometry
    }
}

impl<A: Frame, B: Frame> fmt::Debug for Transform<A, B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_from_{} {:?}", A::NAME, B::NAME, self.isometry)
    }
}

impl<A, B> Serialize for Transform<A, B> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.isometry.serialize(serializer)
    }
}

impl<'de, A, B> Deserialize<'de> for Transform<A, B> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self {
            isometry: Isometry3::deserialize(deserializer)?,
            frames: PhantomData,
        })
    }
}

/// A point given in frame `F` \[m\].
pub struct Position<F> {
    point: Point3<f64>,
    frame: PhantomData<fn() -> F>,
}

impl<F: Frame> Position<F> {
    /// Declares that `point` is given in `F` \[m\].
    pub const fn new(point: Point3<f64>) -> Self {
        Self {
            point,
            frame: PhantomData,
        }
    }

    /// The untyped point \[m\].
    pub const fn point(&self) -> &Point3<f64> {
        &self.point
    }

    /// The untyped coordinates \[m\].
    pub fn coords(&self) -> Vector3<f64> {
        self.point.coords
    }
}

impl<F> Clone for Position<F> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<F> Copy for Position<F> {}

impl<F> PartialEq for Position<F> {
    fn eq(&self, other: &Self) -> bool {
        self.point == other.point
    }
}

impl<F: Frame> fmt::Debug for Position<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let p = &self.point;
        write!(f, "[{}, {}, {}] m in {}", p.x, p.y, p.z, F::NAME)
    }
}

impl<F> Serialize for Position<F> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.point.serialize(serializer)
    }
}

impl<'de, F> Deserialize<'de> for Position<F> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self {
            point: Point3::deserialize(deserializer)?,
            frame: PhantomData,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn neighbours_match_and_inverse_undoes() {
        let world_from_base: Transform<World, ArmBase> =
            Transform::assume(Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::z()));
        let base_from_flange: Transform<ArmBase, Flange> =
            Transform::assume(Isometry3::new(Vector3::new(0.1, 0.0, 0.5), Vector3::x()));
        let world_from_flange = world_from_base * base_from_flange;
        let p: Position<Flange> = Position::new(Point3::new(0.3, -0.2, 0.1));
        let back = world_from_flange.inverse() * (world_from_base * (base_from_flange * p));
        assert!((back.coords() - p.coords()).norm() < 1e-15);
    }
}
