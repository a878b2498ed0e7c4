//! The state at one instant, and how it moves on with the base.

use hal::Stamp;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::filter::TipState;
use super::path::CutPath;
use super::rod::{COLUMNS, Clamp, Rod, RodConstants, Row};
use super::stiffness::StiffnessFit;
use super::tip::TipFilter;
use super::unseen::SlopeBy;
use super::{PIVOT, SHIFT, Start, TIP, X, Y, planar};
use crate::settings::EstimatorSettings;

const _: () = assert!(COLUMNS > TIP);

/// State at one instant.
#[derive(Clone, Debug)]
pub(super) struct Moment {
    pub(super) stamp: Option<Stamp>,
    pub(super) filter: TipFilter,
    pub(super) path: CutPath,
    pub(super) rod: Rod,
    /// Pose of the base in the insertion frame.
    pub(super) base: Isometry3<f64>,
    pub(super) clamp: Clamp,
    pub(super) azimuth: f64,
    /// How far the tip is behind the end of its path \[m\].
    pub(super) retracted: f64,
    /// Whether the needle is still straight: nothing has bent it since its start.
    pub(super) straight: bool,
    /// Derivative of the tip's slope by the logarithm of the stiffness.
    pub(super) slope_by_stiffness: Vector2<f64>,
}

impl Moment {
    /// Derivatives of the tip's slope.
    pub(super) fn slope_by(&self) -> SlopeBy {
        if self.straight {
            // It points from the support to the tip.
            let length = (self.path.tip_depth() - self.clamp.z).max(1e-3);
            return SlopeBy {
                position: 1.0 / length,
                shift: -1.0 / length,
                pivot: -self.clamp.z / length,
                stiffness: Vector2::zeros(),
            };
        }
        let slope = self.rod.tip_slope();
        SlopeBy {
            position: slope[TIP],
            shift: slope[SHIFT],
            pivot: slope[PIVOT],
            stiffness: self.slope_by_stiffness,
        }
    }

    /// Lays the path of a needle that is still straight.
    pub(super) fn lay_straight(&mut self) {
        let (w, tip) = (planar(&self.clamp.w), self.filter.position());
        let (z, length) = (self.clamp.z, self.path.tip_depth() - self.clamp.z);
        self.path.for_each(|depth, row| {
            let at = w + (tip - w) * ((depth - z) / length.max(1e-3));
            row[X] = at.x;
            row[Y] = at.y;
        });
    }
}

/// Origin at the entry, z along the inward normal, x nearest to the base's x.
pub(super) fn insertion_frame(start: &Start) -> Isometry3<f64> {
    let z = start.entry.inward.into_inner();
    let x = start.world_from_base.rotation * Vector3::x();
    let x = (x - z * z.dot(&x)).normalize();
    let rotation = nalgebra::Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    Isometry3::from_parts(
        Translation3::from(start.entry.point.coords),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

pub(super) fn azimuth_of(base: &Isometry3<f64>) -> f64 {
    let bevel = base.rotation * -Vector3::y();
    bevel.y.atan2(bevel.x)
}

/// A tip that can be moved by the unit column.
pub(super) fn tip_row(v: &Vector2<f64>) -> Row {
    let mut row = Row::default();
    row[X] = v.x;
    row[Y] = v.y;
    row[TIP] = 1.0;
    row
}

/// Clamp of a base pose in the insertion frame, with the columns of unit pivot and shift: the base
/// itself, or the exit of a guide at `gap` before the surface.
pub(super) fn clamp_of(base: &Isometry3<f64>, gap: Option<f64>, fit: &StiffnessFit) -> Clamp {
    let axis = base.rotation * Vector3::z();
    let mut origin = base.translation.vector;
    if let Some(gap) = gap {
        let to_exit = (-gap - origin.z) / axis.z.max(0.3);
        origin += axis * to_exit.max(0.0);
    }
    let pivot = fit.base_pivot();
    let slope = Vector2::new(axis.x, axis.y) / axis.z.max(0.3) + fit.base_tilt() + pivot;
    let w = origin.xy() + fit.base_shift() + pivot * origin.z;
    Clamp {
        z: origin.z,
        w: [w.x, w.y, origin.z, 1.0, 0.0],
        slope: [slope.x, slope.y, 1.0, 0.0, 0.0],
    }
}

/// The tip by a rod solved for the clamp `old`, whose base moves to `new`.
fn tip_state(m: &Moment, old: &Clamp, new: &Clamp, constants: &RodConstants) -> TipState {
    let (slope, force) = (m.rod.tip_slope(), m.rod.reaction());
    // Motion across: what insertion along the old axis does not explain, as pivot and shift.
    let turned = planar(&new.slope) - planar(&old.slope);
    let across = planar(&new.w) - planar(&old.w) - planar(&old.slope) * (new.z - old.z);
    TipState {
        slope: planar(&slope),
        slope_by: m.slope_by(),
        force: planar(&force),
        force_by_position: force[TIP],
        force_by_base: turned * force[PIVOT] + (across - turned * new.z) * force[SHIFT],
        force_of_angle: constants.force_of_angle(),
    }
}

/// Moves a moment to a base pose: the tip cuts on by what the base has inserted.
pub(super) fn advance(
    m: &mut Moment,
    base: &Isometry3<f64>,
    (length, start): (f64, &Start),
    depth_offset: f64,
    constants: &RodConstants,
    fit: &StiffnessFit,
    s: &EstimatorSettings,
) {
    let before = m.rod.tip_slope();
    // What the fit changes of the base is no motion.
    let old = clamp_of(&m.base, start.guide_gap, fit);
    m.base = *base;
    m.clamp = clamp_of(base, start.guide_gap, fit);
    let azimuth = azimuth_of(base);
    let middle = m.azimuth + 0.5 * crate::tasks::wrap(azimuth - m.azimuth);
    m.azimuth = azimuth;
    let shortening = if start.advance_by_tip {
        0.0
    } else {
        m.rod.shortening(X, Y)
    };
    let depth = (base.translation.vector.z + length - shortening + depth_offset).max(1e-6);
    let step = (depth - m.path.tip_depth()).max(0.0);
    m.retracted = (m.path.tip_depth() - depth).max(0.0);
    let tip = tip_state(m, &old, &m.clamp, constants);
    m.filter.propagate(step, &tip, middle, s);
    m.path
        .extend_to(m.path.tip_depth() + step, &tip_row(&m.filter.position()));
    m.path.for_each(|_, row| row[TIP] = 0.0);
    m.path.set_tip(&tip_row(&m.filter.position()));
    m.rod.solve(constants, &m.clamp, &m.path);
    // Half of the slope's change belongs to this step already.
    let change = (planar(&m.rod.tip_slope()) - planar(&before)) * (0.5 * step);
    m.filter.shift(&change);
    m.path.set_tip(&tip_row(&m.filter.position()));
}
