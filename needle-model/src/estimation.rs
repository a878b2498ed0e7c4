//! Stiffness of the tissue and scale of the tip load from the measured shape (section IV.B).
//!
//! Least squares on the distances of measured points to the needle, across it, with the springs'
//! rest points held. Unknown logarithms, so that both stay positive; Gauss-Newton with damping, from
//! the analytic derivatives. As errors of the tip law are absorbed by K_T when it is fitted alone,
//! both can be fitted together, with priors.

use nalgebra::{Matrix2, Vector2, Vector3};
use thiserror::Error;

use crate::equilibrium::Equilibrium;
use crate::equilibrium_error::EquilibriumError;
use crate::jacobian::TangentError;
use crate::sensitivity::{LOAD, STIFFNESS, Sensitivities};
use crate::spring::Spring;
use crate::tip_piece::TipLoad;

/// Largest change of a logarithm in one step.
const MAX_STEP: f64 = 1.0;
/// A fit whose residual exceeds this many sigma, or that ends on a bound, is tried again elsewhere.
const POOR_FIT: f64 = 2.0;
/// Starts tried then, spread evenly in the logarithm between the bounds of the stiffness.
const GRID: u32 = 9;

/// What is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknowns {
    /// K_T alone, as in the paper; the tip load is proportional to it (eq. 3).
    Stiffness,
    /// K_T, and a factor on the tip load beside it.
    StiffnessAndLoad,
}

/// How the fit is done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimationSettings {
    /// What is fitted.
    pub unknowns: Unknowns,
    /// Standard deviation of a measured point, per axis \[m\].
    pub point_sigma: f64,
    /// Standard deviations of the logarithms of stiffness and load factors about their values
    /// before the fit; infinite for no prior.
    pub prior_sigma: [f64; 2],
    /// Bounds of K_T \[N/m2\].
    pub stiffness_bounds: [f64; 2],
    /// Bounds of the tip-load factor of one fit.
    pub load_bounds: [f64; 2],
    /// A logarithm is called identified when its posterior deviation is below this.
    pub identified_sigma: f64,
    /// Iterations of one descent.
    pub iterations: usize,
}

impl EstimationSettings {
    /// The paper's fit: K_T alone, without prior; sigma is its pixel size, 0.25 mm.
    pub const fn paper() -> Self {
        Self {
            unknowns: Unknowns::Stiffness,
            point_sigma: 0.25e-3,
            prior_sigma: [f64::INFINITY; 2],
            stiffness_bounds: [5e2, 3e5],
            load_bounds: [0.02, 50.0],
            identified_sigma: 0.3,
            iterations: 30,
        }
    }

    /// K_T and the tip-load factor, priors of 0.7 and 1.0 (assumed).
    pub const fn joint() -> Self {
        Self {
            unknowns: Unknowns::StiffnessAndLoad,
            prior_sigma: [0.7, 1.0],
            ..Self::paper()
        }
    }
}

/// Result of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Factor on K_T.
    pub stiffness_factor: f64,
    /// Factor on the tip load beside the proportionality to K_T.
    pub load_factor: f64,
    /// Posterior covariance of the logarithms of both (zero for one that is not fitted).
    pub covariance: Matrix2<f64>,
    /// Information of the data alone on the logarithms of both.
    pub information: Matrix2<f64>,
    /// Part of the prior variance removed by the data, 0 to 1 (a prior of sigma 1 where there is
    /// none).
    pub observability: [f64; 2],
    /// Whether the posterior deviation is below the setting's and no bound is met.
    pub identified: [bool; 2],
    /// Root mean square distance of the points to the needle, per axis \[m\].
    pub rms: f64,
    /// Points used: those beside the needle, not beyond its ends.
    pub points: usize,
    /// Equilibria solved.
    pub solves: usize,
}

/// Why there is no estimate.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum EstimationError {
    /// A setting out of range.
    #[error("estimation setting {name} out of range, got {value}")]
    Setting {
        /// Its name.
        name: &'static str,
        /// Offending value.
        value: f64,
    },
    /// A measured point that is not finite.
    #[error("measured point {index} is not finite")]
    Point {
        /// Offending point.
        index: usize,
    },
    /// Too few points beside the needle.
    #[error("only {points} measured points lie beside the needle, 3 are needed")]
    TooFewPoints {
        /// Points beside the needle.
        points: usize,
    },
    /// No spring, so nothing to estimate.
    #[error("the needle is not in tissue")]
    OutsideTissue,
    /// No equilibrium at the start.
    #[error(transparent)]
    Equilibrium(#[from] EquilibriumError),
    /// No derivative.
    #[error(transparent)]
    Tangent(#[from] TangentError),
}

/// Workspace of the fit, kept between images.
#[derive(Debug, Clone)]
pub struct Estimator {
    settings: EstimationSettings,
    needle: Equilibrium,
    sensitivities: Sensitivities,
    springs: Vec<Spring>,
    scaled: Vec<Spring>,
    load: TipLoad,
    solves: usize,
}

/// Sums of the least squares at one state.
#[derive(Debug, Clone, Copy)]
struct Normal {
    information: Matrix2<f64>,
    gradient: Vector2<f64>,
    square: f64,
    points: usize,
}

/// A descent's end.
#[derive(Debug, Clone, Copy)]
struct Descent {
    logs: Vector2<f64>,
    cost: f64,
    normal: Normal,
}

impl Estimator {
    /// An estimator with `settings`; `needle` gives the kind of needle.
    ///
    /// # Errors
    /// [`EstimationError::Setting`] for a setting out of range.
    pub fn new(
        settings: EstimationSettings,
        needle: &Equilibrium,
    ) -> Result<Self, EstimationError> {
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let ordered = |[low, high]: [f64; 2]| positive(low) && positive(high) && low < high;
        let checks = [
            (
                "point_sigma",
                settings.point_sigma,
                positive(settings.point_sigma),
            ),
            (
                "prior_sigma[0]",
                settings.prior_sigma[0],
                settings.prior_sigma[0] > 0.0,
            ),
            (
                "prior_sigma[1]",
                settings.prior_sigma[1],
                settings.prior_sigma[1] > 0.0,
            ),
            (
                "stiffness_bounds",
                settings.stiffness_bounds[0],
                ordered(settings.stiffness_bounds),
            ),
            (
                "load_bounds",
                settings.load_bounds[0],
                ordered(settings.load_bounds),
            ),
            (
                "identified_sigma",
                settings.identified_sigma,
                positive(settings.identified_sigma),
            ),
        ];
        if let Some((name, value, _)) = checks.into_iter().find(|(.., good)| !good) {
            return Err(EstimationError::Setting { name, value });
        }
        Ok(Self {
            settings,
            needle: needle.clone(),
            sensitivities: Sensitivities::default(),
            springs: Vec::new(),
            scaled: Vec::new(),
            load: TipLoad::default(),
            solves: 0,
        })
    }

    /// Fits the state of `needle`, whose tissue now has the stiffness per length `k_t` \[N/m2\] (its
    /// layers scale together), to `points` in World \[m\]. `needle` itself is not changed.
    ///
    /// # Errors
    /// [`EstimationError`]. Data that do not identify the unknowns are no error: see
    /// [`Estimate::identified`].
    pub fn fit(
        &mut self,
        needle: &Equilibrium,
        k_t: f64,
        points: &[Vector3<f64>],
    ) -> Result<Estimate, EstimationError> {
        if let Some(index) = points.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
            return Err(EstimationError::Point { index });
        }
        if !(k_t.is_finite() && k_t > 0.0) {
            return Err(EstimationError::Setting {
                name: "k_t",
                value: k_t,
            });
        }
        if needle.springs().is_empty() {
            return Err(EstimationError::OutsideTissue);
        }
        self.springs.clear();
        self.springs.extend_from_slice(needle.springs());
        self.load = needle.load();
        self.needle.clone_from(needle);
        self.solves = 0;

        let [low, high] = self
            .settings
            .stiffness_bounds
            .map(|bound| (bound / k_t).ln());
        let bounds = [[low, high], self.settings.load_bounds.map(f64::ln)];
        let start = Vector2::new(0.0_f64.clamp(low, high), 0.0);
        let mut best = self.descend(start, &bounds, points)?;
        if self.poor(&best, &bounds) {
            let mut candidate: Option<(f64, Vector2<f64>)> = None;
            for i in 0..GRID {
                let x = low + (high - low) * (f64::from(i) + 0.5) / f64::from(GRID);
                let logs = Vector2::new(x, 0.0);
                // A start without equilibrium is no start.
                if let Ok(normal) = self.normal(&logs, points) {
                    let cost = self.cost(&logs, &normal);
                    if candidate.is_none_or(|(least, _)| cost < least) {
                        candidate = Some((cost, logs));
                    }
                }
            }
            if let Some((_, logs)) = candidate
                && let Ok(other) = self.descend(logs, &bounds, points)
                && other.cost < best.cost
            {
                best = other;
            }
        }
        Ok(self.report(&best, &bounds))
    }

    fn free(&self) -> usize {
        if self.settings.unknowns == Unknowns::Stiffness {
            1
        } else {
            2
        }
    }

    fn prior(&self) -> Vector2<f64> {
        Vector2::from(self.settings.prior_sigma.map(|sigma| sigma.powi(-2)))
    }

    fn cost(&self, logs: &Vector2<f64>, normal: &Normal) -> f64 {
        let missing = f64::from(u8::from(normal.points < 3)) * 1e12;
        normal.square + logs.component_mul(logs).dot(&self.prior()) + missing
    }

    fn poor(&self, end: &Descent, bounds: &[[f64; 2]; 2]) -> bool {
        let dof = (2 * end.normal.points).saturating_sub(self.free()).max(1) as f64;
        end.normal.square > POOR_FIT * POOR_FIT * dof || on_bound(end.logs.x, &bounds[0])
    }

    /// Damped Gauss-Newton from `logs`.
    fn descend(
        &mut self,
        start: Vector2<f64>,
        bounds: &[[f64; 2]; 2],
        points: &[Vector3<f64>],
    ) -> Result<Descent, EstimationError> {
        let mut normal = self.normal(&start, points)?;
        if normal.points < 3 {
            return Err(EstimationError::TooFewPoints {
                points: normal.points,
            });
        }
        let mut logs = start;
        let mut cost = self.cost(&logs, &normal);
        let mut damping = 1e-6;
        for _ in 0..self.settings.iterations {
            let prior = self.prior();
            let mut matrix = normal.information + Matrix2::from_diagonal(&prior);
            let gradient = normal.gradient + logs.component_mul(&prior);
            if self.free() == 1 {
                matrix = Matrix2::new(matrix[(0, 0)], 0.0, 0.0, 1.0);
            }
            let scale = matrix.diagonal();
            let damped = matrix + Matrix2::from_diagonal(&(scale * damping).add_scalar(1e-12));
            let Some(inverse) = damped.try_inverse() else {
                break;
            };
            let mut step = -inverse * gradient;
            if self.free() == 1 {
                step.y = 0.0;
            }
            step *= (MAX_STEP / step.amax().max(1e-300)).min(1.0);
            let mut next = logs + step;
            for k in 0..2 {
                next[k] = next[k].clamp(bounds[k][0], bounds[k][1]);
            }
            let moved = (next - logs).amax();
            if moved < 1e-7 {
                break;
            }
            match self.normal(&next, points) {
                Ok(trial) if self.cost(&next, &trial) <= cost => {
                    (logs, normal, cost) = (next, trial, self.cost(&next, &trial));
                    damping = (damping * 0.1).max(1e-9);
                    if moved < 1e-5 {
                        break;
                    }
                }
                _ => damping = (damping * 10.0).max(1e-2),
            }
            if damping > 1e9 {
                break;
            }
        }
        Ok(Descent { logs, cost, normal })
    }

    /// Least-squares sums at the logarithms of stiffness and load factor.
    fn normal(
        &mut self,
        logs: &Vector2<f64>,
        points: &[Vector3<f64>],
    ) -> Result<Normal, EstimationError> {
        let (k, load) = (logs.x.exp(), (logs.x + logs.y).exp());
        self.scaled.clear();
        self.scaled.extend(self.springs.iter().map(|s| Spring {
            stiffness: s.stiffness * k,
            ..*s
        }));
        let base = *self.needle.world_from_base();
        self.solves += 1;
        self.needle.solve(&base, &self.scaled, self.load * load)?;
        self.needle.sensitivities(&mut self.sensitivities)?;
        let weight = self.settings.point_sigma.powi(-2);
        let mut sums = Normal {
            information: Matrix2::zeros(),
            gradient: Vector2::zeros(),
            square: 0.0,
            points: 0,
        };
        let mut near = 0;
        for point in points {
            let Some((i, l)) = self.needle.foot(point, &mut near) else {
                continue;
            };
            let (at, tangent) = self.sensitivities.at_coordinate(&self.needle, i, l);
            let gap = self.needle.segment(i).position(l) - point;
            let t = tangent.normalize();
            let across = |v: Vector3<f64>| v - t * t.dot(&v);
            let (by_springs, by_load): (Vector3<f64>, Vector3<f64>) = (
                at.column(STIFFNESS).into_owned(),
                at.column(LOAD).into_owned(),
            );
            let (gap, a, b) = (across(gap), across(by_springs + by_load), across(by_load));
            sums.square += weight * gap.norm_squared();
            sums.gradient += Vector2::new(a.dot(&gap), b.dot(&gap)) * weight;
            sums.information += Matrix2::new(a.dot(&a), a.dot(&b), a.dot(&b), b.dot(&b)) * weight;
            sums.points += 1;
        }
        Ok(sums)
    }

    fn report(&self, end: &Descent, bounds: &[[f64; 2]; 2]) -> Estimate {
        let mut posterior = end.normal.information + Matrix2::from_diagonal(&self.prior());
        let single = self.free() == 1;
        if single {
            posterior = Matrix2::new(posterior[(0, 0)], 0.0, 0.0, 1.0);
        }
        let unknown = Matrix2::from_diagonal_element(f64::INFINITY);
        let mut covariance = posterior.try_inverse().unwrap_or(unknown);
        if single {
            covariance[(1, 1)] = 0.0;
        }
        let variance = |k: usize| self.settings.prior_sigma[k].powi(2);
        let mut observability = [0.0; 2];
        let mut identified = [false; 2];
        for k in 0..self.free() {
            let before = if variance(k).is_finite() {
                variance(k)
            } else {
                1.0
            };
            observability[k] = (1.0 - covariance[(k, k)] / before).clamp(0.0, 1.0);
            identified[k] = covariance[(k, k)].sqrt() < self.settings.identified_sigma
                && !on_bound(end.logs[k], &bounds[k]);
        }
        Estimate {
            stiffness_factor: end.logs.x.exp(),
            load_factor: end.logs.y.exp(),
            covariance,
            information: end.normal.information,
            observability,
            identified,
            rms: (end.normal.square / (2 * end.normal.points).max(1) as f64).sqrt()
                * self.settings.point_sigma,
            points: end.normal.points,
            solves: self.solves,
        }
    }
}

fn on_bound(value: f64, [low, high]: &[f64; 2]) -> bool {
    value <= low + 1e-6 || value >= high - 1e-6
}

impl Equilibrium {
    /// Segment and coordinate of the point of the needle nearest to `point`, searched from the
    /// segment `near` on; `None` beyond the ends.
    fn foot(&self, point: &Vector3<f64>, near: &mut usize) -> Option<(usize, f64)> {
        let n = self.springs.len();
        let beyond = |node: usize| {
            let node = &self.nodes[node];
            node.n.dot(&(point - node.p)) >= 0.0
        };
        let mut i = (*near).min(n);
        while i < n && beyond(i + 1) {
            i += 1;
        }
        while !beyond(i) {
            i = i.checked_sub(1)?;
        }
        *near = i;
        let segment = self.segment(i);
        // With the tip on a spring the last segment is shorter than nothing, by the tolerance.
        let end = segment.length.max(0.0);
        let mut l = segment
            .derivative(0.0)
            .dot(&(point - segment.position(0.0)));
        for _ in 0..8 {
            l = l.clamp(0.0, end);
            let (gap, d) = (segment.position(l) - point, segment.derivative(l));
            let curvature = d.norm_squared() + gap.dot(&segment.second_derivative(l));
            let step = gap.dot(&d) / curvature.max(0.1);
            l -= step;
            if step.abs() < 1e-10 {
                break;
            }
        }
        let ends = i == n && l > end + 1e-6;
        (!ends).then_some((i, l.clamp(0.0, end)))
    }
}
