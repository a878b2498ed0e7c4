//! Geometry of needle, base and cameras that the tracker uses.

use nalgebra::{Isometry3, Matrix2x3, Point3, Rotation3, Unit, Vector3};

use super::curve::{MOST, normal};
use super::settings::Appearance;
use super::single::Look;
use super::space::Curve3;
use crate::camera::View;

/// Depth into the tissue over which a motion of the base fades \[m\].
const FADE: f64 = 0.03;

/// Whether a curve found near a guess can be the needle that was guessed: its tip, its direction
/// and most of its length.
pub(super) fn resembles(curve: &Curve3, guess: &[Point3<f64>]) -> bool {
    /// Distance of the tips \[m\].
    const TIP: f64 = 3e-3;
    /// Cosine of the angle between the axes, 14 deg.
    const AXIS: f64 = 0.97;
    /// Share of the guessed length.
    const SHARE: f64 = 0.6;
    let (Some(first), Some(last)) = (guess.first(), guess.last()) else {
        return false;
    };
    let (start, tip) = (curve.at(0.0), curve.at(1.0));
    let chord = last - first;
    let found = tip - start;
    let turned = curve.derivative(1.0).normalize();
    let end = guess.windows(2).last().map_or(chord, |w| match w {
        [a, b] => b - a,
        _ => chord,
    });
    (tip - last.coords).norm() < TIP
        && turned.dot(&end.normalize()) > AXIS
        && found.norm() > SHARE * chord.norm()
}

/// Displacement of each control point by the base's motion: across the needle, fading with the
/// depth into the tissue, which holds the needle.
pub(super) fn base_shifts(curve: &Curve3, motion: Option<Isometry3<f64>>) -> [Vector3<f64>; MOST] {
    let mut shifts = [Vector3::zeros(); MOST];
    let Some(motion) = motion else {
        return shifts;
    };
    let points = curve.control_points();
    let Some(first) = points.first() else {
        return shifts;
    };
    for (i, (shift, point)) in shifts.iter_mut().zip(points).enumerate() {
        let t = i as f64 / (points.len() - 1) as f64;
        let axis = curve.derivative(t).normalize();
        let moved = motion * Point3::from(*point) - Point3::from(*point);
        let across = moved - axis * axis.dot(&moved);
        *shift = across * (0.5 * (-(point - first).norm() / FADE).exp());
    }
    shifts
}

/// Where the two cameras' axes come nearest to each other; far ahead if they are parallel.
pub(super) fn scene(views: &[View; 2]) -> Vector3<f64> {
    let back = views[1].camera_from_left.inverse();
    let (a, b) = (Vector3::z(), back.rotation * Vector3::z());
    let offset = back.translation.vector;
    let parallel = a.cross(&b).norm_squared();
    if parallel < 0.03 {
        return a * (5.0 * offset.norm());
    }
    // Least distance between the lines s a and offset + r b.
    let along = a.dot(&b);
    let s = (offset.dot(&a) - along * offset.dot(&b)) / parallel;
    let r = (along * offset.dot(&a) - offset.dot(&b)) / parallel;
    0.5 * (a * s + offset + b * r)
}

/// The bevel's direction, turned about the needle's `axis`.
pub(super) fn turned(bevel: &Vector3<f64>, axis: &Vector3<f64>, angle: f64) -> Vector3<f64> {
    Rotation3::from_axis_angle(&Unit::new_normalize(*axis), angle) * bevel
}

/// How `needle` appears in a view when its tip is at `tip`, and the direction across it and the
/// line of sight along which the bevel's side counts.
pub(super) fn look(
    view: &View,
    needle: &Appearance,
    tip: &Vector3<f64>,
    axis: Option<&Vector3<f64>>,
    bevel: Option<Vector3<f64>>,
) -> (Look, Vector3<f64>) {
    let Some((px, jacobian)) = view.project_with_derivative(tip) else {
        let look = Look {
            width: 3.0,
            bevel_px: 0.0,
            side: None,
            rim_px: 0.0,
        };
        return (look, Vector3::x());
    };
    let sight = view.ray(px).map_or_else(Vector3::z, |ray| ray.direction);
    let across = axis
        .and_then(|axis| across(&jacobian, axis, &sight))
        .or_else(|| sight.cross(&Vector3::x()).try_normalize(1e-6))
        .unwrap_or_else(Vector3::y);
    let px_per_metre = (jacobian * across).norm();
    let width = px_per_metre * needle.diameter;
    let along = axis.map_or(px_per_metre, |axis| (jacobian * axis).norm());
    let look = Look {
        width,
        rim_px: axis.map_or(0.0, |axis| 0.5 * width * axis.dot(&sight).abs()),
        bevel_px: along * needle.bevel_length,
        side: bevel.map(|bevel| bevel.dot(&across).clamp(-1.0, 1.0)),
    };
    (look, across)
}

/// The unit direction across both needle and line of sight that appears in the image a quarter
/// turn from the needle's own, from x towards y.
fn across(
    jacobian: &Matrix2x3<f64>,
    axis: &Vector3<f64>,
    sight: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    let across = axis.cross(sight).try_normalize(1e-6)?;
    let seen = normal(&(jacobian * axis)).dot(&(jacobian * across));
    Some(if seen < 0.0 { -across } else { across })
}
