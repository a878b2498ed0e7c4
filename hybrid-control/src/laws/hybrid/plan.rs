//! One plan of law `hybrid`: levels over pivot, shift and bevel curvature.

use core::f64::consts::TAU;

use hal::Twist;
use hal::telemetry::Limit;
use nalgebra::{Matrix2, Matrix4, SMatrix, SVector, Vector2, Vector3};

use crate::estimator::Rollout;
use crate::levels::{Levels, padded};
use crate::qp::{Constraint, QpError};
use crate::settings::HybridSettings;
use crate::view::View;

/// Unknowns: pivot (2), shift (2), curvature (2), entry stretch beyond its bound (2), all scaled
/// to order one.
const N: usize = 8;
const PIVOT: usize = 0;
const SHIFT: usize = 2;
const CURVATURE: usize = 4;
const EXCESS: usize = 6;

/// Sides of the polygons that stand for discs.
const SIDES: usize = 8;

/// Standard deviations of the prediction by which a shortfall must exceed it: every plan of an
/// insertion is judged, and their errors last for centimetres.
const DOUBT: f64 = 3.0;

/// Length that counts as one in the levels \[m\].
const MILLIMETRE: f64 = 1e-3;

/// What the law carries out until the next plan, in the insertion frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Plan {
    pub(super) valid: bool,
    /// Pivot about the entry still to be made \[rad, as slope\].
    pub(super) pivot: Vector2<f64>,
    /// Shift still to be made \[m\].
    pub(super) shift: Vector2<f64>,
    /// Shift that only relieves the tissue, still to be made \[m\].
    pub(super) unload: Vector2<f64>,
    /// Mean curvature wanted of the bevel, as a fraction of the full one.
    pub(super) curvature: Vector2<f64>,
    /// What stays out of reach \[m\]; negative: what is left of the reach.
    pub(super) shortfall: f64,
    bound: [bool; 4],
}

impl Plan {
    /// Base motion still to be made, as displacement at the target \[m\].
    pub(super) fn unfinished(&self, rollout: &Rollout) -> f64 {
        (self.pivot * rollout.pivot).norm() + (self.shift * rollout.shift).norm()
    }

    pub(super) fn report_limits(&self, limits: &mut Vec<Limit>) {
        let names = [
            Limit::TiltSpeed,
            Limit::Workspace,
            Limit::BevelCurvature,
            Limit::EntryStretch,
        ];
        for (bound, limit) in self.bound.iter().zip(names) {
            if *bound {
                limits.push(limit);
            }
        }
    }
}

/// Fraction of an authority's use: all at `full`, none at zero or on the wrong side.
fn fade(authority: f64, full: f64) -> f64 {
    (authority / full.max(1e-9)).clamp(0.0, 1.0)
}

/// Rows that keep a pair of unknowns inside a regular polygon around `centre`.
fn disc(rows: &mut Vec<Constraint<N>>, at: usize, centre: &Vector2<f64>, radius: f64) {
    for side in 0..SIDES {
        let angle = TAU * side as f64 / SIDES as f64;
        let out = Vector2::new(angle.cos(), angle.sin());
        let mut normal = SVector::zeros();
        normal[at] = -out.x;
        normal[at + 1] = -out.y;
        rows.push(Constraint {
            normal,
            bound: -(radius + out.dot(centre)),
        });
    }
}

/// Solves the levels. A solver without success gives an invalid plan.
pub(super) fn make(view: &View<'_>, r: &Rollout, s: &HybridSettings, calm: f64) -> Plan {
    solve(view, r, s, calm).unwrap_or_default()
}

/// Tilt and offset that the workspace still leaves.
fn room(view: &View<'_>) -> (f64, f64) {
    let tilt = view.base_axis().angle(&view.entry.inward);
    let out = view.world_from_base.translation.vector - view.entry.point.coords;
    let inward: Vector3<f64> = view.entry.inward.into_inner();
    let across = (out - inward * inward.dot(&out)).norm();
    (
        (view.limits.tilt_deg.to_radians() - tilt).max(0.0),
        (view.limits.base_offset_mm * 1e-3 - across).max(0.0),
    )
}

/// Tilt of the base as slopes of the insertion frame \[rad\], and the largest that a plan may lead
/// to: inside the workspace by what a polygon stands out of its disc, but never less than now.
fn tilt(view: &View<'_>) -> (Vector2<f64>, f64) {
    let axis = view
        .estimator
        .world_from_insertion()
        .inverse_transform_vector(&view.base_axis());
    let across = axis.xy();
    let tilted = across
        .try_normalize(1e-9)
        .map_or_else(Vector2::zeros, |out| out * across.norm().atan2(axis.z));
    let inside = (core::f64::consts::PI / SIDES as f64).cos();
    let most = view.limits.tilt_deg.to_radians() * inside;
    (tilted, most.max(tilted.norm()))
}

/// Rows that bound the stretch at the entry to `bound` \[mm\] and what is beyond it.
fn entry(
    rows: &mut Vec<Constraint<N>>,
    r: &Rollout,
    (pivot_unit, shift_unit): (f64, f64),
    bound: f64,
) {
    let per_pivot = r.entry_per_pivot * pivot_unit / MILLIMETRE;
    let per_shift = r.entry_per_shift * shift_unit / MILLIMETRE;
    let stretch = r.entry_stretch / MILLIMETRE;
    for side in 0..SIDES {
        let angle = TAU * side as f64 / SIDES as f64;
        let out = Vector2::new(angle.cos(), angle.sin());
        let mut normal = SVector::<f64, N>::zeros();
        for i in 0..2 {
            normal[PIVOT + i] = -out[i] * per_pivot;
            normal[SHIFT + i] = -out[i] * per_shift;
            normal[EXCESS + i] = out[i];
        }
        rows.push(Constraint {
            normal,
            bound: out.dot(&stretch) - bound,
        });
    }
}

/// What the device leaves of the unknowns.
struct Given {
    pivots: bool,
    spins: bool,
    /// Projector onto the shifts that it gives.
    shift: Matrix2<f64>,
    /// Where the bevel faces.
    bevel: Vector2<f64>,
    /// Rows of a level above all others, where the device cannot do everything: the base's motion
    /// is one that it gives, and without spin the bevel faces where it faces.
    bounds: Option<(SMatrix<f64, N, N>, SVector<f64, N>)>,
}

impl Given {
    fn of(view: &View<'_>, s: &HybridSettings) -> Self {
        let azimuth = view.estimator.bevel_direction();
        let mut there = Self {
            pivots: true,
            spins: true,
            shift: Matrix2::identity(),
            bevel: Vector2::new(azimuth.cos(), azimuth.sin()),
            bounds: None,
        };
        if view.freedom.is_full() {
            return there;
        }
        let axes = [Vector2::x(), Vector2::y()];
        let pivots = axes.map(|axis| {
            let pivot = axis * s.pivot_weight_deg.to_radians();
            view.pivot(&view.estimator.pivot_rotation(&pivot))
        });
        let shifts = axes.map(|axis| Twist {
            linear: view.estimator.lateral(&axis) * (s.shift_weight_mm * MILLIMETRE),
            angular: Vector3::zeros(),
        });
        let given = view
            .freedom
            .within(&[pivots[0], pivots[1], shifts[0], shifts[1]]);
        there.pivots = given.fixed_view::<2, 2>(0, 0).trace() > 1e-3;
        there.spins = view.spins();
        there.shift = view.freedom.within(&shifts);
        let mut lost = SMatrix::<f64, N, N>::zeros();
        let mut stays = SVector::<f64, N>::zeros();
        lost.fixed_view_mut::<4, 4>(PIVOT, PIVOT)
            .copy_from(&(Matrix4::identity() - given));
        if !there.spins {
            for i in CURVATURE..EXCESS {
                lost[(i, i)] = 1.0;
                stays[i] = there.bevel[i - CURVATURE];
            }
        }
        there.bounds = Some((lost, stays));
        there
    }
}

fn solve(view: &View<'_>, r: &Rollout, s: &HybridSettings, calm: f64) -> Result<Plan, QpError> {
    let per_degree = 1_f64.to_radians();
    let pivot_fade = fade(r.pivot * per_degree, s.pivot_fade_mm_deg * MILLIMETRE);
    // A shift tilts the tip the other way as long as it steers at all.
    let shift_fade = fade(-r.shift, s.shift_fade);
    let (tilt_room, offset_room) = room(view);
    let there = Given::of(view, s);
    // Shifting back is always possible: the room counts outwards only.
    let pivot_unit = s.pivot_weight_deg.to_radians();
    let shift_unit = s.shift_weight_mm * MILLIMETRE;
    let pivot_use = if s.pivot && there.pivots {
        pivot_fade
    } else {
        0.0
    };
    let pivot_most = pivot_use * tilt_room.max(2_f64.to_radians());
    let shift_most = if s.shift {
        // It all but cancels a pivot, and noise is what such differences are made of.
        let calm = if there.pivots { calm } else { 0.0 };
        (1.0 - calm) * shift_fade * offset_room.max(2.0 * MILLIMETRE)
    } else {
        0.0
    };
    let early = ((r.remaining / MILLIMETRE - s.reserve_until_mm) / 20.0).clamp(0.0, 1.0);
    let curvature_most = if there.spins {
        1.0 - s.bevel_reserve * early
    } else {
        1.0
    };

    let mut rows: Vec<Constraint<N>> = Vec::with_capacity(crate::qp::MAX_CONSTRAINTS);
    let none = Vector2::zeros();
    let (tilted, tilt_most) = tilt(view);
    disc(
        &mut rows,
        PIVOT,
        &(-tilted * (pivot_use / pivot_unit)),
        pivot_use * tilt_most / pivot_unit,
    );
    disc(&mut rows, SHIFT, &none, shift_most / shift_unit);
    disc(&mut rows, CURVATURE, &none, curvature_most);
    entry(
        &mut rows,
        r,
        (pivot_unit, shift_unit),
        view.limits.entry_stretch_mm,
    );

    let mut levels = Levels::new(&rows);
    if let Some((lost, stays)) = &there.bounds {
        levels.level(lost, stays)?;
    }
    let mut miss = SMatrix::<f64, 2, N>::zeros();
    for i in 0..2 {
        miss[(i, PIVOT + i)] = r.pivot * pivot_unit / MILLIMETRE;
        miss[(i, SHIFT + i)] = r.shift * shift_unit / MILLIMETRE;
        miss[(i, CURVATURE + i)] = r.bevel / MILLIMETRE;
    }
    let (a, b) = padded(&miss, &(r.miss / MILLIMETRE));
    let first = levels.level(&a, &b)?;
    let mut excess = SMatrix::<f64, 2, N>::zeros();
    excess[(0, EXCESS)] = 1.0;
    excess[(1, EXCESS + 1)] = 1.0;
    if s.spare_entry {
        let (a, b) = padded(&excess, &Vector2::zeros());
        levels.level(&a, &b)?;
    }
    let mut effort = SMatrix::<f64, N, N>::zeros();
    for i in 0..4 {
        effort[(i, i)] = 1.0;
    }
    levels.level(&effort, &SVector::zeros())?;

    let x = levels.x();
    let two = |at: usize| Vector2::new(x[at], x[at + 1]);
    let residual = (r.miss / MILLIMETRE - miss * x).norm() * MILLIMETRE;
    let (left, steered) = if there.spins {
        (r.miss, r.bevel)
    } else {
        (r.miss - there.bevel * r.bevel, 0.0)
    };
    let reach = steered + r.pivot.max(0.0) * pivot_most + (-r.shift).max(0.0) * shift_most;
    let binds = |group: usize| (0..SIDES).any(|i| first.multipliers[group * SIDES + i] > 1e-6);
    let unload = if s.unload {
        there.shift * view.estimator.relief() * (1.0 - shift_fade)
    } else {
        Vector2::zeros()
    };
    let curvature = two(CURVATURE).cap_magnitude(1.0);
    // A shortfall within what the prediction may err is none yet: the target comes nearer, and
    // the prediction surer.
    let doubt = DOUBT * view.estimator.end_sigma(r.remaining, r.bevel);
    Ok(Plan {
        valid: x.iter().all(|v| v.is_finite()),
        pivot: two(PIVOT) * (pivot_unit * pivot_fade),
        shift: two(SHIFT) * (shift_unit * shift_fade),
        unload,
        // Without modulation the bevel faces where it is needed, and gives all it has.
        curvature: if s.modulate {
            curvature
        } else {
            curvature.try_normalize(1e-3).unwrap_or(curvature)
        },
        shortfall: if curvature_most >= 1.0 && residual > 1e-6 {
            residual - doubt
        } else {
            left.norm() - reach - doubt
        },
        bound: [binds(0), binds(1), binds(2), binds(3)],
    })
}
