//! The predicted way to the target's depth, with its sensitivities.

use nalgebra::{Point3, Vector2};

use super::path::CutPath;
use super::rod::{COLUMNS, Rod, Row};
use super::{Estimator, PIVOT, SHIFT, TIP, X, Y, planar};

/// Column of unit bevel curvature in a rollout.
const BEVEL: usize = 4;

/// Prediction to the depth of a point, in the insertion frame.
#[derive(Clone, Debug, Default)]
pub struct Rollout {
    /// Where the tip will cross the point's depth with the base held in direction and the bevel
    /// spread evenly \[m\].
    pub end: Vector2<f64>,
    /// Miss there: point minus end \[m\].
    pub miss: Vector2<f64>,
    /// End per pivot of the base about the entry now \[m/rad\].
    pub pivot: f64,
    /// End per shift of the base across now \[m/m\].
    pub shift: f64,
    /// End at full bevel curvature in one direction \[m\].
    pub bevel: f64,
    /// Displacement at the entry now \[m\], and per pivot \[m/rad\] and shift \[m/m\].
    pub entry_stretch: Vector2<f64>,
    /// See `entry_stretch`.
    pub entry_per_pivot: f64,
    /// See `entry_stretch`.
    pub entry_per_shift: f64,
    /// Distance still to be inserted \[m\].
    pub remaining: f64,
    path: CutPath,
    rod: Rod,
}

impl Rollout {
    /// Memory for rollouts, used again and again.
    pub fn new() -> Self {
        Self {
            path: CutPath::new(1e-3),
            ..Self::default()
        }
    }

    /// The predicted path from the present tip on, in World \[m\].
    pub fn path<'a>(&'a self, estimator: &'a Estimator) -> impl Iterator<Item = Point3<f64>> + 'a {
        let start = estimator.depth();
        let frame = estimator.world_from_insertion();
        (0..self.path.len())
            .filter(move |&i| self.path.depth(i) >= start)
            .map(move |i| {
                let c = self.path.value(i);
                frame * Point3::new(c[X], c[Y], self.path.depth(i))
            })
    }
}

impl Estimator {
    /// Rolls the present state out to the depth of `target` (World). Beyond the target, or at a
    /// target that is not finite, nothing remains and every authority is zero.
    pub fn rollout(&self, target: &Point3<f64>, out: &mut Rollout) {
        let goal = self.world_from_insertion.inverse_transform_point(target);
        let m = &self.present;
        out.path.copy_from(&m.path);
        out.path.for_each(|_, row| row[2..].fill(0.0));
        let mut clamp = m.clamp;
        let entry = m.rod.entry();
        out.entry_stretch = self.entry_stretch();
        out.entry_per_pivot = entry[PIVOT];
        out.entry_per_shift = entry[SHIFT];
        let start = out.path.tip_depth();
        // O is at the goal when the edge is that much deeper.
        let end_depth = goal.z + self.reach;
        out.remaining = (end_depth - start).max(0.0);
        let filter = m.filter.ruling();
        let compliance = filter.compliance();
        let spacing = self.settings.step_mm * 1e-3;
        let fade = self.settings.disturbance_fade_mm * 1e-3;
        let b = filter.disturbance();
        let full = filter.bevel().norm() * filter.bevel_gain(self.constants.force_of_angle());
        // A tip that yields goes aside with the base, at once.
        let force = m.rod.reaction();
        let freed = -filter.yielding() / force[TIP].max(1.0);
        let mut at = *out.path.tip();
        at[PIVOT] = freed * force[PIVOT];
        at[SHIFT] = freed * force[SHIFT];
        out.path.set_tip(&at);
        let mut slope_before: Option<(f64, Row)> = None;
        let limit = if out.remaining.is_finite() { 400 } else { 0 };
        for _ in 0..limit {
            let tip = out.path.tip_depth();
            let left = end_depth - tip;
            if left <= 1e-6 {
                break;
            }
            out.rod.solve(&self.constants, &clamp, &out.path);
            let (slope, reaction) = (out.rod.tip_slope(), out.rod.reaction());
            let step = spacing.min(left);
            let decay = (-(tip + 0.5 * step - start) / fade).exp();
            let now: Row = core::array::from_fn(|c| slope[c] - compliance * reaction[c]);
            // Two-step Adams-Bashforth; on the first step a trial step gives the derivative.
            let middle = match slope_before {
                Some((h, before)) => {
                    core::array::from_fn(|c| now[c] + (now[c] - before[c]) * (0.5 * step / h))
                }
                None => self.trial(out, &clamp, &now, step, &b, full),
            };
            slope_before = Some((step, now));
            let next: Row = core::array::from_fn(|c| {
                let drive = match c {
                    X => b.x * decay,
                    Y => b.y * decay,
                    BEVEL => full,
                    _ => 0.0,
                };
                out.path.tip()[c] + step * (middle[c] + drive)
            });
            out.path.extend_to(tip + step, &next);
            self.push(&mut clamp, step);
        }
        out.rod.solve(&self.constants, &clamp, &out.path);
        let slope = out.rod.tip_slope();
        let edge = *out.path.tip();
        let end: Row = core::array::from_fn(|c| edge[c] - self.reach * slope[c]);
        // Where the sensor will show it.
        let lasts = filter
            .unseen()
            .map_or(0.0, |unseen| unseen.lasting(out.remaining));
        out.end = planar(&end) + m.filter.place_bias() * lasts;
        out.miss = goal.coords.xy() - out.end;
        out.pivot = end[PIVOT];
        out.shift = end[SHIFT];
        out.bevel = end[BEVEL];
    }

    /// The base advances along its axis by `step` \[m\]; a guide's exit stays.
    fn push(&self, clamp: &mut super::Clamp, step: f64) {
        if self.start.guide_gap.is_some() {
            return;
        }
        clamp.z += step;
        for c in 0..COLUMNS {
            clamp.w[c] += step * clamp.slope[c];
        }
    }

    /// Slope in the middle of the first step, by an explicit trial of the whole step.
    fn trial(
        &self,
        out: &mut Rollout,
        clamp: &super::Clamp,
        slope: &Row,
        step: f64,
        b: &Vector2<f64>,
        full: f64,
    ) -> Row {
        let drive = [b.x, b.y, 0.0, 0.0, full];
        let mut path = out.path.clone();
        let next: Row = core::array::from_fn(|c| path.tip()[c] + step * (slope[c] + drive[c]));
        path.extend_to(path.tip_depth() + step, &next);
        let mut moved = *clamp;
        self.push(&mut moved, step);
        out.rod.solve(&self.constants, &moved, &path);
        let (after, reaction) = (out.rod.tip_slope(), out.rod.reaction());
        let compliance = self.present.filter.ruling().compliance();
        core::array::from_fn(|c| 0.5 * (slope[c] + after[c] - compliance * reaction[c]))
    }
}
