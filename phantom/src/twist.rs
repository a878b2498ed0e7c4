//! Twist of the shaft and friction between shaft and tissue.
//!
//! Every edge in the tissue drags a bristle with an axial and a circumferential deflection,
//! bounded in length (Coulomb friction with elastic presliding): sliding along the needle frees
//! its rotation, as on the real one. The material frame is the frame transported from the base
//! without twist, turned by the twist angle.

use nalgebra::Vector3;

use crate::rod::Rod;
use crate::settings::FrictionSettings;

const MOST_ITERATIONS: u32 = 30;
/// Twist is solved to this angle \[rad\].
const ANGLE_TOLERANCE: f64 = 1e-9;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Bristle {
    /// Deflection along the shaft and around it \[m\].
    axial: f64,
    around: f64,
    sliding: bool,
}

/// Twist angles, material frames and friction of the shaft's edges.
#[derive(Clone, Debug)]
pub(crate) struct Twist {
    /// Twist relative to the transported frame \[rad\].
    angles: Vec<f64>,
    /// Transported x axis of the base's frame, per edge.
    directors: Vec<Vector3<f64>>,
    tangents: Vec<Vector3<f64>>,
    bristles: Vec<Bristle>,
    turned: Vec<f64>,
    /// Solver's memory.
    trial: Vec<f64>,
    diagonal: Vec<f64>,
    rhs: Vec<f64>,
}

/// `v`, perpendicular to the unit vector `from`, carried to `to` by the smallest rotation.
#[inline]
pub(crate) fn transport(v: &Vector3<f64>, from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    v - (from + to) * (to.dot(v) / (1.0 + from.dot(to)))
}

/// What slides, and how much, in one step.
pub(crate) struct Sliding<'a> {
    /// Axial slide of every edge relative to the tissue \[m\].
    pub(crate) axial: &'a [f64],
    /// Length of every edge that touches tissue \[m\].
    pub(crate) contact: &'a [f64],
    /// Radius of the shaft \[m\].
    pub(crate) radius: f64,
}

impl Twist {
    pub(crate) fn straight(rod: &Rod, director: Vector3<f64>) -> Self {
        let edges = rod.edges();
        Self {
            angles: vec![0.0; edges],
            directors: vec![director; edges],
            tangents: vec![rod.clamp; edges],
            bristles: vec![Bristle::default(); edges],
            turned: vec![0.0; edges],
            trial: vec![0.0; edges],
            diagonal: vec![0.0; edges],
            rhs: vec![0.0; edges],
        }
    }

    /// Whether all angles are finite.
    pub(crate) fn is_finite(&self) -> bool {
        self.angles.iter().all(|angle| angle.is_finite())
    }

    /// Takes over the state of another twist of the same rod.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.angles.copy_from_slice(&other.angles);
        self.directors.copy_from_slice(&other.directors);
        self.tangents.copy_from_slice(&other.tangents);
        self.bristles.copy_from_slice(&other.bristles);
    }

    /// Twist angle at the tip \[rad\].
    pub(crate) fn tip_angle(&self) -> f64 {
        self.angles.last().copied().unwrap_or(0.0)
    }

    /// Moves the frames to the rod's present shape, with the base's x axis at `director`, and
    /// lets friction turn the shaft back. Fills the rod's torque and adds the axial friction
    /// to `force`.
    pub(crate) fn advance(
        &mut self,
        rod: &mut Rod,
        director: Vector3<f64>,
        sliding: &Sliding,
        settings: &FrictionSettings,
        force: &mut [Vector3<f64>],
    ) {
        self.transport_frames(rod, director);
        if settings.shaft_n_m > 0.0 {
            self.solve(rod, sliding, settings);
        } else {
            self.angles.fill(0.0);
        }
        let stiffness = rod.section.torsion / rod.edge;
        rod.torque[0] = 2.0 * stiffness * self.angles[0];
        for i in 1..self.angles.len() {
            rod.torque[i] = stiffness * (self.angles[i] - self.angles[i - 1]);
        }
        self.add_friction(sliding, settings, force);
    }

    fn transport_frames(&mut self, rod: &Rod, director: Vector3<f64>) {
        let mut tangent = rod.clamp;
        let mut carried = director;
        for i in 0..self.directors.len() {
            let t = rod.direction(i);
            carried = transport(&carried, &tangent, &t);
            let old = transport(&self.directors[i], &self.tangents[i], &t);
            self.turned[i] = t.dot(&old.cross(&carried)).atan2(old.dot(&carried));
            tangent = t;
            self.tangents[i] = t;
            self.directors[i] = carried;
        }
    }

    /// The bristle of edge `i` after a slide, and the derivative of its circumferential
    /// deflection by the slide around.
    fn slide(
        &self,
        i: usize,
        axial: f64,
        around: f64,
        settings: &FrictionSettings,
    ) -> (Bristle, f64) {
        let limit = settings.presliding_um * 1e-6;
        let old = self.bristles[i];
        let breakaway = if old.sliding {
            limit
        } else {
            limit * settings.static_ratio
        };
        let (a, c) = (old.axial + axial, old.around + around);
        let size = a.hypot(c);
        if size <= breakaway {
            let bristle = Bristle {
                axial: a,
                around: c,
                sliding: false,
            };
            (bristle, 1.0)
        } else {
            let scale = limit / size;
            let bristle = Bristle {
                axial: a * scale,
                around: c * scale,
                sliding: true,
            };
            (bristle, scale * (a / size).powi(2))
        }
    }

    /// Energy of the trial angles, whose minimum is the balance of torques \[J\].
    fn objective(&self, rod: &Rod, sliding: &Sliding, settings: &FrictionSettings) -> f64 {
        let stiffness = rod.section.torsion / rod.edge;
        let limit = settings.presliding_um * 1e-6;
        let mut sum = 0.0;
        let mut below = 0.0;
        for i in 0..self.trial.len() {
            let twist = self.trial[i] - below;
            below = self.trial[i];
            sum += if i == 0 { stiffness } else { 0.5 * stiffness } * twist * twist;
            let contact = sliding.contact[i];
            if contact > 0.0 {
                let turn = self.turned[i] + self.trial[i] - self.angles[i];
                let old = self.bristles[i];
                let size = (old.axial + sliding.axial[i]).hypot(old.around + sliding.radius * turn);
                sum += settings.shaft_n_m
                    * contact
                    * if size <= limit {
                        0.5 * size * size / limit
                    } else {
                        size - 0.5 * limit
                    };
            }
        }
        sum
    }

    /// Newton's method on the tridiagonal balance of torques.
    fn solve(&mut self, rod: &Rod, sliding: &Sliding, settings: &FrictionSettings) {
        let n = self.angles.len();
        let stiffness = rod.section.torsion / rod.edge;
        let per_deflection = settings.shaft_n_m * sliding.radius / (settings.presliding_um * 1e-6);
        self.trial.copy_from_slice(&self.angles);
        let mut energy = self.objective(rod, sliding, settings);
        for _ in 0..MOST_ITERATIONS {
            for i in 0..n {
                let below = if i == 0 { 0.0 } else { self.trial[i - 1] };
                let lower = if i == 0 { 2.0 * stiffness } else { stiffness };
                let mut residual = lower * (below - self.trial[i]);
                let mut diagonal = lower;
                if i + 1 < n {
                    residual += stiffness * (self.trial[i + 1] - self.trial[i]);
                    diagonal += stiffness;
                }
                let contact = sliding.contact[i];
                if contact > 0.0 {
                    let turn = self.turned[i] + self.trial[i] - self.angles[i];
                    let (bristle, slope) =
                        self.slide(i, sliding.axial[i], sliding.radius * turn, settings);
                    residual -= per_deflection * contact * bristle.around;
                    diagonal += per_deflection * contact * sliding.radius * slope;
                }
                self.diagonal[i] = diagonal;
                self.rhs[i] = residual;
            }
            // Thomas' algorithm; the off-diagonal is -stiffness throughout.
            for i in 1..n {
                let factor = -stiffness / self.diagonal[i - 1];
                self.diagonal[i] += factor * stiffness;
                self.rhs[i] -= factor * self.rhs[i - 1];
            }
            let mut above = 0.0;
            let mut largest: f64 = 0.0;
            for i in (0..n).rev() {
                above = (self.rhs[i] + stiffness * above) / self.diagonal[i];
                self.rhs[i] = above;
                self.trial[i] += above;
                largest = largest.max(above.abs());
            }
            // The balance is the minimum of a convex energy with kinks in its slope, at which
            // full Newton steps may cycle.
            let mut fraction = 1.0;
            let mut new = self.objective(rod, sliding, settings);
            while new > energy && fraction > 1e-3 && largest > ANGLE_TOLERANCE {
                fraction *= 0.5;
                for (trial, step) in self.trial.iter_mut().zip(&self.rhs) {
                    *trial -= fraction * step;
                }
                new = self.objective(rod, sliding, settings);
            }
            energy = new;
            if largest < ANGLE_TOLERANCE {
                break;
            }
        }
        for i in 0..n {
            let turn = self.turned[i] + self.trial[i] - self.angles[i];
            self.bristles[i] = if sliding.contact[i] > 0.0 {
                self.slide(i, sliding.axial[i], sliding.radius * turn, settings)
                    .0
            } else {
                Bristle::default()
            };
        }
        self.angles.copy_from_slice(&self.trial);
    }

    fn add_friction(
        &self,
        sliding: &Sliding,
        settings: &FrictionSettings,
        force: &mut [Vector3<f64>],
    ) {
        let per_deflection = settings.shaft_n_m / (settings.presliding_um * 1e-6);
        for (i, bristle) in self.bristles.iter().enumerate() {
            let pull = per_deflection * sliding.contact[i] * bristle.axial;
            if pull != 0.0 {
                let half = self.tangents[i] * (0.5 * pull);
                force[i] -= half;
                force[i + 1] -= half;
            }
        }
    }

    /// Material x axis at the tip whose direction is `tangent`.
    pub(crate) fn tip_director(&self, tangent: &Vector3<f64>) -> Vector3<f64> {
        let last = self.directors.len() - 1;
        let carried = transport(&self.directors[last], &self.tangents[last], tangent);
        let (sin, cos) = self.angles[last].sin_cos();
        (carried * cos + tangent.cross(&carried) * sin).normalize()
    }
}
