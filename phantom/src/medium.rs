//! The tissue's forces on the shaft and on the tip.

use nalgebra::{Matrix3, Vector3};

use crate::guide::Guide;
use crate::path::{CutPath, Foot};
use crate::resistance::Resistance;
use crate::rod::Load;
use crate::rod::band::Band;
use crate::skin::Skin;

/// The tissue's law beside the shaft, in SI units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LateralLaw {
    /// Stiffening per displacement squared \[1/m2\].
    pub(crate) stiffening: f64,
    /// Fraction of the stiffness that relaxes.
    pub(crate) relaxed: f64,
    /// Play in the slit \[m\].
    pub(crate) gap: f64,
}

impl LateralLaw {
    /// Secant stiffness over K at the displacement `size` \[m\], and its slope over the
    /// displacement \[1/m2\], so that the tangent is `secant P + slope u u^T`.
    #[inline]
    fn secant(&self, size: f64) -> (f64, f64) {
        let squared = size * size;
        let (mut secant, mut slope) = (1.0, 0.0);
        if self.gap > 0.0 {
            // f = K (sqrt(u^2 + g^2) - g): quadratic inside the gap, less by g K far outside.
            let root = (squared + self.gap * self.gap).sqrt();
            secant = size / (root + self.gap);
            slope = if size > 0.0 {
                (size / root - secant) / squared
            } else {
                0.0
            };
        }
        if self.stiffening > 0.0 {
            let factor = 1.0 + self.stiffening * squared;
            slope = slope * factor + secant * 2.0 * self.stiffening;
            secant *= factor;
        }
        (secant, slope)
    }

    /// Stored energy per length over K at the displacement `size` \[m2\], without relaxation.
    pub(crate) fn energy(&self, size: f64) -> f64 {
        let (u, g, a) = (size, self.gap, self.stiffening);
        let squared = u * u;
        if g <= 0.0 {
            return squared * (0.5 + 0.25 * a * squared);
        }
        let root = (squared + g * g).sqrt();
        let log = (u / g).asinh();
        let plain = 0.5 * (u * root + g * g * log) - g * u;
        let stiffened =
            (u * (2.0 * squared + g * g) * root - g.powi(4) * log) / 8.0 - g * u * squared / 3.0;
        plain + a * stiffened
    }

    /// The same with relaxation, for tissue that has crept to `crept` \[m2\].
    pub(crate) fn relaxing_energy(&self, u: &Vector3<f64>, crept: &Vector3<f64>) -> f64 {
        (1.0 - self.relaxed) * self.energy(u.norm())
            + 0.5 * self.relaxed * (u - crept).norm_squared()
    }
}

/// The uncut tissue that holds the tip on its path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hold {
    /// Lateral stiffness \[N/m\].
    pub(crate) stiffness: f64,
    /// Distance from O to the cutting edge \[m\].
    pub(crate) reach: f64,
    /// Distance behind the path's end over which the hold fades \[m\].
    pub(crate) fade: f64,
}

/// Contact of the shaft's nodes with the tissue at the last evaluation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Contact {
    pub(crate) feet: Vec<Foot>,
    /// Displacement of the tissue at every node, zero outside \[m\].
    pub(crate) displacement: Vec<Vector3<f64>>,
    /// Length of shaft that each node stands for in the tissue \[m\].
    pub(crate) weight: Vec<f64>,
    /// First node that may touch tissue.
    pub(crate) first: usize,
    /// Where the cutting edge is.
    pub(crate) edge: Foot,
    /// Share of the full hold that uncut tissue has of it.
    pub(crate) held: f64,
    /// Lateral force of the tissue on the tip \[N\].
    pub(crate) tip_force: Vector3<f64>,
}

/// Everything that loads the rod during one equilibrium.
pub(crate) struct Medium<'a> {
    pub(crate) path: Option<&'a CutPath>,
    pub(crate) law: LateralLaw,
    pub(crate) hold: Hold,
    pub(crate) contact: &'a mut Contact,
    /// Forces that do not depend on the shape: friction, cutting \[N\].
    pub(crate) fixed: &'a [Vector3<f64>],
    pub(crate) edge_length: f64,
    /// Whether the contacts keep their segments of the path.
    pub(crate) keep_places: bool,
    /// Resistance to slides other than the predicted one, and whether it acts.
    pub(crate) resistance: &'a Resistance,
    pub(crate) resists: bool,
    pub(crate) skin: &'a mut Skin,
    pub(crate) guide: Option<Guide>,
}

impl Load for Medium<'_> {
    fn add(&mut self, nodes: &[Vector3<f64>], force: &mut [Vector3<f64>], stiffness: &mut Band) {
        for (f, fixed) in force.iter_mut().zip(self.fixed) {
            *f += fixed;
        }
        if let Some(guide) = &self.guide {
            guide.add(self.edge_length, nodes, force, stiffness);
        }
        let Some(path) = self.path else {
            self.contact.clear(nodes.len());
            return;
        };
        self.add_shaft(path, nodes, force, stiffness);
        self.add_tip(path, nodes, force, stiffness);
        self.skin.add(self.keep_places, nodes, force, stiffness);
        if self.resists {
            for i in 1..nodes.len() {
                let along = self.resistance.along[i];
                let (pull, decline) = self.resistance.against(i, &nodes[i]);
                force[i] += along * pull;
                stiffness.add_diagonal(i - 1, &(along * along.transpose() * decline));
            }
        }
    }

    fn keep_places(&mut self, keep: bool) {
        self.keep_places = keep;
    }

    fn resist(&mut self, resist: bool) {
        self.resists = resist;
    }
}

impl Contact {
    pub(crate) fn new(nodes: usize) -> Self {
        Self {
            feet: vec![Foot::default(); nodes],
            displacement: vec![Vector3::zeros(); nodes],
            weight: vec![0.0; nodes],
            first: nodes,
            ..Self::default()
        }
    }

    /// Takes over the state of another contact of the same rod.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.feet.copy_from_slice(&other.feet);
        self.displacement.copy_from_slice(&other.displacement);
        self.weight.copy_from_slice(&other.weight);
        self.first = other.first;
        self.edge = other.edge;
        self.held = other.held;
        self.tip_force = other.tip_force;
    }

    /// Finds the nodes' places anew, beside a path that moved while they did not.
    pub(crate) fn follow(&mut self, path: &CutPath, nodes: &[Vector3<f64>]) {
        for i in (self.first..nodes.len()).rev() {
            self.feet[i] = path.locate(&nodes[i], self.feet[i].segment);
            self.displacement[i] = displacement(&nodes[i], &self.feet[i]);
        }
    }

    pub(crate) fn clear(&mut self, nodes: usize) {
        self.first = nodes;
        self.weight.fill(0.0);
        self.displacement.fill(Vector3::zeros());
        self.tip_force = Vector3::zeros();
    }
}

/// By how much a node pushes the tissue beside it aside \[m\].
fn displacement(node: &Vector3<f64>, foot: &Foot) -> Vector3<f64> {
    let offset = node - foot.point;
    offset - foot.tangent * foot.tangent.dot(&offset)
}

impl Medium<'_> {
    fn add_shaft(
        &mut self,
        path: &CutPath,
        nodes: &[Vector3<f64>],
        force: &mut [Vector3<f64>],
        stiffness: &mut Band,
    ) {
        let last = nodes.len() - 1;
        let half = 0.5 * self.edge_length;
        let contact = &mut *self.contact;
        let mut hint = contact.feet[last].segment;
        let first = if self.keep_places { contact.first } else { 1 };
        contact.first = first;
        for i in (first..=last).rev() {
            let covered_to = if i == last { 0.0 } else { half };
            let (foot, weight) = if self.keep_places {
                let segment = contact.feet[i].segment;
                (path.project(&nodes[i], segment), contact.weight[i])
            } else {
                let foot = path.locate(&nodes[i], hint);
                (foot, (foot.arc + covered_to).min(half + covered_to))
            };
            hint = foot.segment;
            contact.feet[i] = foot;
            if weight <= 0.0 {
                // Further nodes lie outside: the shaft does not re-enter.
                contact.first = i + 1;
                for j in 1..=i {
                    contact.weight[j] = 0.0;
                    contact.displacement[j] = Vector3::zeros();
                }
                break;
            }
            let t = foot.tangent;
            let u = displacement(&nodes[i], &foot);
            contact.weight[i] = weight;
            contact.displacement[i] = u;
            let bed = path.bed(&foot);
            let (secant, slope) = self.law.secant(u.norm());
            let stiff = weight * bed.stiffness;
            let lasting = stiff * (1.0 - self.law.relaxed) * secant;
            let relaxing = stiff * self.law.relaxed;
            force[i] -= u * (lasting + relaxing) - bed.crept * relaxing;
            let entering = weight < half + covered_to;
            if entering || bed.slope != 0.0 {
                // Sliding deeper, or into stiffer tissue, stores energy: an axial force.
                let energy = self.law.relaxing_energy(&u, &bed.crept);
                let growth = if entering { bed.stiffness } else { 0.0 } + weight * bed.slope;
                force[i] -= t * (energy * growth);
            }
            let across = lasting + relaxing;
            let mut block = t * (t.transpose() * -across) + Matrix3::from_diagonal_element(across);
            if slope != 0.0 {
                let rise = stiff * (1.0 - self.law.relaxed) * slope;
                block += u * (u.transpose() * rise);
            }
            stiffness.add_diagonal(i - 1, &block);
        }
    }

    fn add_tip(
        &mut self,
        path: &CutPath,
        nodes: &[Vector3<f64>],
        force: &mut [Vector3<f64>],
        stiffness: &mut Band,
    ) {
        let last = nodes.len() - 1;
        let lever = self.hold.reach / self.edge_length;
        let edge = nodes[last] + lever * (nodes[last] - nodes[last - 1]);
        let segment = self.contact.edge.segment;
        let foot = if self.keep_places {
            path.project(&edge, segment)
        } else {
            path.locate(&edge, segment)
        };
        self.contact.edge = foot;
        if !self.keep_places {
            let behind = (path.length() - foot.arc).max(0.0);
            let faded = (1.0 - behind / self.hold.fade).max(0.0);
            self.contact.held = if foot.arc > 0.0 { faded } else { 0.0 };
        }
        let hold = self.hold.stiffness * self.contact.held;
        if hold == 0.0 {
            self.contact.tip_force = Vector3::zeros();
            return;
        }
        let offset = edge - foot.point;
        let t = foot.tangent;
        let pull = (offset - t * t.dot(&offset)) * -hold;
        self.contact.tip_force = pull;
        force[last] += pull * (1.0 + lever);
        force[last - 1] -= pull * lever;
        let block = (Matrix3::identity() - t * t.transpose()) * hold;
        stiffness.add_diagonal(last - 1, &(block * (1.0 + lever).powi(2)));
        stiffness.add_diagonal(last - 2, &(block * lever.powi(2)));
        stiffness.add_first(last - 1, &(block * (-lever * (1.0 + lever))));
    }
}
