//! World as the other side of OpenIGTLink has it.
//!
//! World's axes are taken for right, anterior and superior (RAS), in millimetres on the wire; where
//! the other side has left, posterior and superior (LPS), x and y change their signs. What places
//! World in a patient is the other side's to know: it puts its registration above our transforms.
//! This is the only place that knows of either.

use hal::frame::World;
use hal::{Position, Transform};
use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3};

use crate::config::IgtlCoordinates;

/// Millimetres in a metre.
const MM: f64 = 1e3;
/// Farthest that a target may be from World's origin along an axis \[m\].
const FARTHEST: f64 = crate::config::FARTHEST_MM * 1e-3;
/// Largest error of a rotation's matrix that floats of 32 bits explain, with room.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// The other side's frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Space(pub(super) IgtlCoordinates);

/// Why a place is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Misplaced {
    #[error("a coordinate is not a number")]
    NotFinite,
    #[error("the axes are no rotation: the transform is of another frame, or scaled")]
    NoRotation,
    #[error("farther than 5 m from the origin: of another frame, or not in millimetres")]
    Far,
}

impl Misplaced {
    /// A word for counters.
    pub(super) const fn reason(self) -> &'static str {
        match self {
            Self::NotFinite => "not finite",
            Self::NoRotation => "no rotation",
            Self::Far => "far",
        }
    }
}

impl Space {
    /// From World's axes to the other side's, and back: half a turn about z is its own inverse.
    fn turn(self) -> UnitQuaternion<f64> {
        match self.0 {
            IgtlCoordinates::Ras => UnitQuaternion::identity(),
            IgtlCoordinates::Lps => {
                UnitQuaternion::new_unchecked(Quaternion::new(0.0, 0.0, 0.0, 1.0))
            }
        }
    }

    /// A point of World \[m\] on the wire \[mm\]; nothing where a coordinate is no number.
    pub(super) fn point(self, point: &Vector3<f64>) -> Option<[f32; 3]> {
        let point = self.turn() * point * MM;
        point.iter().all(|x| x.is_finite()).then(|| floats(&point))
    }

    /// A pose in World on the wire: its own axes stay what they are.
    pub(super) fn pose(self, pose: &Isometry3<f64>) -> Option<igtl::Transform> {
        let origin = self.point(&pose.translation.vector)?;
        let rotation = (self.turn() * pose.rotation).to_rotation_matrix();
        let axes = [0, 1, 2].map(|i| floats(&rotation.matrix().column(i).into_owned()));
        axes.as_flattened()
            .iter()
            .all(|x| x.is_finite())
            .then_some(igtl::Transform { axes, origin })
    }

    /// As [`Space::pose`], with a quaternion.
    pub(super) fn position(self, pose: &Isometry3<f64>) -> Option<igtl::Position> {
        let origin = self.point(&pose.translation.vector)?;
        let q = self.turn() * pose.rotation;
        let [i, j, k] = floats(&Vector3::new(q.i, q.j, q.k));
        let [w, ..] = floats(&Vector3::repeat(q.w));
        let orientation = [i, j, k, w];
        let finite = orientation.iter().all(|x| x.is_finite());
        finite.then_some(igtl::Position {
            origin,
            orientation,
        })
    }

    /// A direction in World, on the wire.
    pub(super) fn direction(self, direction: &Vector3<f64>) -> [f32; 3] {
        floats(&(self.turn() * direction))
    }

    /// A point from the wire \[mm\].
    ///
    /// # Errors
    /// It is none of World.
    pub(super) fn read_point(self, [x, y, z]: [f32; 3]) -> Result<Position<World>, Misplaced> {
        let point = Vector3::new(x, y, z).map(f64::from);
        if !point.iter().all(|x| x.is_finite()) {
            return Err(Misplaced::NotFinite);
        }
        let point = self.turn() * point / MM;
        if point.amax() > FARTHEST {
            return Err(Misplaced::Far);
        }
        Ok(Position::new(Point3::from(point)))
    }

    /// Origin of a transform from the wire.
    ///
    /// # Errors
    /// It is no rigid transform into World.
    pub(super) fn read_origin(
        self,
        transform: &igtl::Transform,
    ) -> Result<Position<World>, Misplaced> {
        let pose = self.read_pose(transform)?;
        Ok(Position::new(pose.translation.vector.into()))
    }

    /// A pose from the wire \[m\].
    ///
    /// # Errors
    /// It is no rigid transform, or far.
    pub(super) fn read_pose(
        self,
        transform: &igtl::Transform,
    ) -> Result<Isometry3<f64>, Misplaced> {
        let origin = self.read_point(transform.origin)?;
        let axes = nalgebra::Matrix3::from_columns(
            &transform
                .axes
                .map(|axis| Vector3::from(axis).map(f64::from)),
        );
        if !axes.iter().all(|x| x.is_finite()) {
            return Err(Misplaced::NotFinite);
        }
        let error = (axes.transpose() * axes - nalgebra::Matrix3::identity()).amax();
        if error > ROTATION_TOLERANCE || axes.determinant() < 0.0 {
            return Err(Misplaced::NoRotation);
        }
        let rotation = UnitQuaternion::from_matrix(&axes);
        Ok(Isometry3::from_parts(
            origin.coords().into(),
            self.turn() * rotation,
        ))
    }

    pub(super) const fn coordinates(self) -> igtl::Coordinates {
        match self.0 {
            IgtlCoordinates::Ras => igtl::Coordinates::Ras,
            IgtlCoordinates::Lps => igtl::Coordinates::Lps,
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the wire has floats of 32 bits: 0.03 um at half a metre"
)]
fn floats(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

/// Origin of a device in World, of any frame.
pub(super) fn pose_of<F: hal::frame::Frame>(pose: &Transform<World, F>) -> Isometry3<f64> {
    *pose.isometry()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RAS: Space = Space(IgtlCoordinates::Ras);
    const LPS: Space = Space(IgtlCoordinates::Lps);

    #[test]
    fn x_is_right_y_anterior_z_superior_and_lps_changes_the_signs_of_two() {
        let point = Vector3::new(0.1, 0.02, 0.3);
        assert_eq!(RAS.point(&point), Some([100.0, 20.0, 300.0]));
        assert_eq!(LPS.point(&point), Some([-100.0, -20.0, 300.0]));
        for space in [RAS, LPS] {
            let back = space.read_point(space.point(&point).unwrap()).unwrap();
            assert!((back.coords() - point).norm() < 1e-7);
        }
    }

    /// A point given in the device's own frame comes out at the same place of the patient.
    #[test]
    fn a_pose_takes_its_own_frame_to_the_other_sides() {
        let pose = Isometry3::new(Vector3::new(0.4, -0.1, 0.2), Vector3::new(0.3, -0.7, 1.1));
        let own = Vector3::new(0.01, 0.02, -0.03);
        let there = pose * Point3::from(own);
        for space in [RAS, LPS] {
            let sent = space.pose(&pose).unwrap();
            let axes = nalgebra::Matrix3::from_columns(
                &sent.axes.map(|axis| Vector3::from(axis).map(f64::from)),
            );
            let origin = Vector3::from(sent.origin).map(f64::from);
            let on_wire = axes * own * 1e3 + origin;
            let expected = Vector3::from(space.point(&there.coords).unwrap()).map(f64::from);
            assert!((on_wire - expected).norm() < 1e-3);
            assert!((axes.determinant() - 1.0).abs() < 1e-6);
            let [i, j, k, w] = space.position(&pose).unwrap().orientation.map(f64::from);
            let q = UnitQuaternion::new_normalize(Quaternion::new(w, i, j, k));
            assert!((q.to_rotation_matrix().matrix() - axes).amax() < 1e-6);
            let back = space.read_pose(&sent).unwrap();
            assert!((back.translation.vector - pose.translation.vector).norm() < 1e-7);
            assert!(back.rotation.angle_to(&pose.rotation) < 1e-6);
        }
    }

    #[test]
    fn what_is_no_place_is_told() {
        assert_eq!(
            RAS.read_point([f32::NAN, 0.0, 0.0]),
            Err(Misplaced::NotFinite)
        );
        assert_eq!(RAS.read_point([6000.0, 0.0, 0.0]), Err(Misplaced::Far));
        let mut transform = igtl::Transform::at([1.0, 2.0, 3.0]);
        assert!(RAS.read_origin(&transform).is_ok());
        transform.axes[0] = [2.0, 0.0, 0.0];
        assert_eq!(RAS.read_origin(&transform), Err(Misplaced::NoRotation));
        transform.axes[0] = [-1.0, 0.0, 0.0];
        assert_eq!(RAS.read_origin(&transform), Err(Misplaced::NoRotation));
        transform.axes[0] = [f32::INFINITY, 0.0, 0.0];
        assert_eq!(RAS.read_origin(&transform), Err(Misplaced::NotFinite));
    }
}
