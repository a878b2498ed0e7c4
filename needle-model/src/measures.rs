//! What the law watches: tissue displacement, energies, the entry point, the holder's wrench; each
//! with its derivatives by the parameters of [`Sensitivities`].

use nalgebra::{Vector3, Vector6};

use crate::equilibrium::Equilibrium;
use crate::segment::Segment;
use crate::sensitivity::{Gradient, LOAD, STIFFNESS, Sensitivities, TwistRates, VectorRates};
use crate::spring::spring_force;

/// Mean tissue displacement d_m \[m\]: Eq. (16).
///
/// From each spring's supported length and stretch and the `inserted` length \[m\]; 0 when nothing
/// is inserted.
pub fn mean_tissue_displacement(
    supported_and_stretch: impl Iterator<Item = (f64, f64)>,
    inserted: f64,
) -> f64 {
    let sum: f64 = supported_and_stretch.map(|(l, stretch)| l * stretch).sum();
    if inserted > 0.0 { sum / inserted } else { 0.0 }
}

impl Equilibrium {
    /// Length supported by spring `i` and the weights of the gaps in it: (weight of the gap behind,
    /// of the gap ahead, of the tip's), as `supported_lengths` with the last gap for pitch.
    fn support(&self, i: usize) -> [(usize, f64); 3] {
        // Piece indices: piece k ends at node k + 1; the tip's is n.
        let n = self.springs.len();
        let tip = self.tip_length.max(0.0);
        let newborn = n > 1 && tip < self.nodes[n].l;
        let behind = if i > 0 { 0.5 } else { 0.0 };
        if i + 1 == n {
            return if newborn {
                [(i, 0.0), (i, 0.0), (n, 1.5)]
            } else {
                [(i, behind), (i, 0.0), (n, 1.0)]
            };
        }
        if i + 2 == n && newborn {
            return [(i, behind), (i + 1, 1.0), (n, -0.5)];
        }
        [(i, behind), (i + 1, 0.5), (n, 0.0)]
    }

    fn piece_length(&self, k: usize) -> f64 {
        self.nodes.get(k + 1).map_or(self.tip_length, |node| node.l)
    }

    fn supported(&self, i: usize) -> f64 {
        self.support(i)
            .iter()
            .map(|(k, weight)| weight * self.piece_length(*k))
            .sum()
    }

    /// Stretch of spring `i`: from its rest point to the needle \[m\].
    fn stretch(&self, i: usize) -> Vector3<f64> {
        self.nodes[i + 1].p - self.springs[i].rest
    }

    /// Mean tissue displacement d_m \[m\], eq. (16).
    pub fn mean_stretch(&self) -> f64 {
        let n = self.springs.len();
        let terms = (0..n).map(|i| (self.supported(i), self.stretch(i).norm()));
        mean_tissue_displacement(terms, (1..=n).map(|k| self.piece_length(k)).sum())
    }

    /// Largest stretch of a spring \[m\].
    pub fn max_stretch(&self) -> f64 {
        (0..self.springs.len())
            .map(|i| self.stretch(i).norm())
            .fold(0.0, f64::max)
    }

    /// Elastic energy of the springs \[J\].
    pub fn tissue_energy(&self) -> f64 {
        let term = |i: usize| self.springs[i].stiffness / 2.0 * self.stretch(i).norm_squared();
        (0..self.springs.len()).map(term).sum()
    }

    /// Elastic energy of the bent needle \[J\].
    pub fn bending_energy(&self) -> f64 {
        self.segments()
            .map(|segment| self.stiffness * bending(&segment))
            .sum()
    }

    /// Stretch at the entry point: from the first spring's rest point to the needle \[m\].
    pub fn entry_stretch(&self) -> Vector3<f64> {
        if self.springs.is_empty() {
            Vector3::zeros()
        } else {
            self.stretch(0)
        }
    }

    /// Force of the first spring on the needle \[N\].
    pub fn entry_force(&self) -> Vector3<f64> {
        self.springs.first().map_or_else(Vector3::zeros, |spring| {
            spring_force(spring.stiffness, &self.nodes[1].p, &spring.rest)
        })
    }

    /// Transverse force \[N\] and bending couple \[N m\] of the holder on the needle, at the base.
    /// The model has no friction, so no axial part.
    pub fn base_wrench(&self) -> Vector6<f64> {
        let segment = self.segment(0);
        let shear = segment.third_derivative() * self.stiffness;
        let z = self.nodes[0].d;
        let force = shear - z * z.dot(&shear);
        let couple = -z.cross(&(segment.second_derivative(0.0) * self.stiffness));
        Vector6::new(force.x, force.y, force.z, couple.x, couple.y, couple.z)
    }
}

/// Half the integral of the squared second derivative.
fn bending(segment: &Segment) -> f64 {
    let (l, third) = (segment.length, segment.third_derivative());
    let middle = segment.second_derivative(l / 2.0);
    l / 2.0 * (middle.norm_squared() + third.norm_squared() * l * l / 12.0)
}

impl Sensitivities {
    /// Gradient of [`Equilibrium::mean_stretch`].
    pub fn mean_stretch(&self, needle: &Equilibrium) -> Gradient {
        let n = needle.springs.len();
        let inserted: f64 = (1..=n).map(|k| needle.piece_length(k)).sum();
        if !(inserted > 0.0) {
            return Gradient::zeros();
        }
        let mut sum = Gradient::zeros();
        for i in 0..n {
            let stretch = needle.stretch(i);
            let norm = stretch.norm();
            for (k, weight) in needle.support(i) {
                sum += self.l[k] * (weight * norm);
            }
            if norm > 0.0 {
                sum += stretch.transpose() * self.p[i + 1] * (needle.supported(i) / norm);
            }
        }
        let grown: Gradient = self.l[1..].iter().sum();
        (sum - grown * needle.mean_stretch()) / inserted
    }

    /// Gradient of [`Equilibrium::tissue_energy`].
    pub fn tissue_energy(&self, needle: &Equilibrium) -> Gradient {
        let mut sum = Gradient::zeros();
        for (i, spring) in needle.springs.iter().enumerate() {
            sum += needle.stretch(i).transpose() * self.p[i + 1] * spring.stiffness;
        }
        sum[STIFFNESS] += needle.tissue_energy();
        sum
    }

    /// Gradient of [`Equilibrium::bending_energy`].
    pub fn bending_energy(&self, needle: &Equilibrium) -> Gradient {
        let mut sum = Gradient::zeros();
        for (i, piece) in needle.pieces.iter().enumerate() {
            let (a, b) = (&needle.nodes[i], &needle.nodes[i + 1]);
            let (l, turn, total) = (b.l, b.d - a.d, a.d + b.d);
            let bow = b.p - a.p - total * (l / 2.0);
            let by_l = -18.0 * bow.norm_squared() / l.powi(4)
                - 6.0 * bow.dot(&total) / l.powi(3)
                - turn.norm_squared() / (2.0 * l * l);
            sum += piece.shear.transpose() * (self.p[i + 1] - self.p[i])
                + piece.start.transpose() * self.d[i]
                + piece.end.transpose() * self.d[i + 1]
                + self.l[i] * (by_l * needle.stiffness);
        }
        let n = needle.springs.len();
        sum += self.l[n] * (needle.tip.moment.powi(2) / (2.0 * needle.stiffness));
        sum[LOAD] += 2.0 * needle.stiffness * bending(&needle.segment(n));
        sum
    }

    /// Derivatives of [`Equilibrium::entry_stretch`].
    pub fn entry_stretch(&self) -> VectorRates {
        self.p.get(1).copied().unwrap_or_else(VectorRates::zeros)
    }

    /// Derivatives of [`Equilibrium::entry_force`].
    pub fn entry_force(&self, needle: &Equilibrium) -> VectorRates {
        let Some(spring) = needle.springs.first() else {
            return VectorRates::zeros();
        };
        let mut rates = self.entry_stretch() * -spring.stiffness;
        let force = needle.entry_force();
        rates.set_column(STIFFNESS, &(rates.column(STIFFNESS) + force));
        rates
    }

    /// Derivatives of [`Equilibrium::base_wrench`].
    pub fn base_wrench(&self, needle: &Equilibrium) -> TwistRates {
        let z = needle.nodes[0].d;
        let (shear, bend) = self.base_rates(needle);
        let segment = needle.segment(0);
        let third = segment.third_derivative() * needle.stiffness;
        let second = segment.second_derivative(0.0) * needle.stiffness;
        let mut rates = TwistRates::zeros();
        for c in 0..crate::sensitivity::PARAMETERS {
            let dz = self.d[0].column(c).into_owned();
            let (ds, db) = (shear.column(c).into_owned(), bend.column(c).into_owned());
            let force = ds - z * z.dot(&ds) - dz * z.dot(&third) - z * dz.dot(&third);
            let couple = -dz.cross(&second) - z.cross(&db);
            rates.fixed_view_mut::<3, 1>(0, c).copy_from(&force);
            rates.fixed_view_mut::<3, 1>(3, c).copy_from(&couple);
        }
        rates
    }

    /// Derivatives of E I S''' and E I S'' at the base.
    fn base_rates(&self, needle: &Equilibrium) -> (VectorRates, VectorRates) {
        let Some(piece) = needle.pieces.first() else {
            let (tip, load) = (&needle.tip, needle.load);
            let mut shear = self.y * -load.force;
            let mut bend = self.y * tip.moment + tip.y * (self.l[0] * load.force);
            shear.set_column(LOAD, &(shear.column(LOAD) - tip.y * load.force));
            bend.set_column(LOAD, &(bend.column(LOAD) + tip.y * tip.moment));
            return (shear, bend);
        };
        let step = self.p[1] - self.p[0];
        let shear =
            step * piece.alpha - (self.d[0] + self.d[1]) * piece.beta + piece.shear_l * self.l[0];
        let start = step * -piece.beta
            + self.d[0] * piece.gamma
            + self.d[1] * (piece.gamma / 2.0)
            + piece.start_l * self.l[0];
        (-shear, -start)
    }
}
