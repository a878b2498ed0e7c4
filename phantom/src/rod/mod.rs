//! The needle's shaft: a discrete Kirchhoff rod.
//!
//! Nodes at equal arc length, clamped at the base in position and direction, free at the tip.
//! Bending acts on the difference of neighbouring edges, twist through the holonomy of the
//! centreline (discrete elastic rods, \[Bergou2008\], \[Bergou2010\]). The axial stiffness is that
//! of the steel itself, 4e4 N: the shaft is inextensible to 3 um over its length per newton,
//! and equations stay banded. Newton's method moves edges on the sphere of directions, so that
//! a finite rotation does not stretch them.

pub(crate) mod band;
mod solve;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Vector3};

use band::Band;
pub(crate) use solve::Solution;

/// Elasticity of a shaft of constant section.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Section {
    /// Bending stiffness E I \[N m2\].
    pub(crate) bending: f64,
    /// Torsional stiffness G J \[N m2\].
    pub(crate) torsion: f64,
    /// Axial stiffness E A \[N\].
    pub(crate) axial: f64,
}

impl Section {
    /// A tube of outer and inner diameter \[m\], Young's and shear modulus \[Pa\].
    pub(crate) fn tube(outer: f64, inner: f64, young: f64, shear: f64) -> Self {
        let second_moment = core::f64::consts::PI / 64.0 * (outer.powi(4) - inner.powi(4));
        let area = core::f64::consts::PI / 4.0 * (outer * outer - inner * inner);
        Self {
            bending: young * second_moment,
            torsion: shear * 2.0 * second_moment,
            axial: young * area,
        }
    }
}

/// Beyond this strain a shape is an artefact: steel yields at a tenth of it.
const LARGEST_STRAIN: f64 = 0.02;

/// Forces on the nodes and their stiffness, as functions of the nodes' positions.
pub(crate) trait Load {
    /// Adds the force on every node to `force`, and minus its derivative to `stiffness`
    /// (whose block i belongs to node i + 1: node 0 is clamped).
    fn add(&mut self, nodes: &[Vector3<f64>], force: &mut [Vector3<f64>], stiffness: &mut Band);

    /// Whether contacts keep the places they have, instead of being searched for every shape.
    fn keep_places(&mut self, _keep: bool) {}

    /// Whether the load also resists what the shaft does otherwise than predicted.
    fn resist(&mut self, _resist: bool) {}
}

/// A clamped rod and the memory its equilibria need.
#[derive(Clone, Debug)]
pub(crate) struct Rod {
    pub(crate) section: Section,
    /// Length of an edge \[m\].
    pub(crate) edge: f64,
    /// Positions \[m\]; node 0 is the clamped base.
    pub(crate) nodes: Vec<Vector3<f64>>,
    /// Direction of the clamp.
    pub(crate) clamp: Vector3<f64>,
    /// Torque in the shaft at node i, about the tangent, by the part towards the tip on the part
    /// towards the base \[N m\].
    pub(crate) torque: Vec<f64>,
    /// Force on every node at the last evaluation, without the rod's own \[N\].
    pub(crate) load: Vec<Vector3<f64>>,
    gradient: Vec<Vector3<f64>>,
    step: Vec<Vector3<f64>>,
    trial: Vec<Vector3<f64>>,
    start: Vec<Vector3<f64>>,
    bending_band: Band,
    band: Band,
}

impl Rod {
    /// A straight rod of `edges` edges from `base` along `direction`.
    pub(crate) fn straight(
        section: Section,
        length: f64,
        edges: usize,
        base: Vector3<f64>,
        direction: Vector3<f64>,
    ) -> Self {
        let edge = length / edges as f64;
        let nodes: Vec<_> = (0..=edges)
            .map(|i| base + direction * (edge * i as f64))
            .collect();
        Self {
            section,
            edge,
            clamp: direction,
            torque: vec![0.0; edges + 1],
            load: vec![Vector3::zeros(); edges + 1],
            gradient: vec![Vector3::zeros(); edges + 1],
            step: vec![Vector3::zeros(); edges],
            trial: nodes.clone(),
            start: nodes.clone(),
            bending_band: bending_band(section.bending / edge.powi(3), edges),
            band: Band::zeros(edges),
            nodes,
        }
    }

    /// Number of edges.
    pub(crate) fn edges(&self) -> usize {
        self.nodes.len() - 1
    }

    /// Whether all nodes are finite and no edge is stretched beyond what steel bears.
    pub(crate) fn is_sound(&self) -> bool {
        self.nodes.windows(2).all(|pair| {
            let strain = (pair[1] - pair[0]).norm() / self.edge - 1.0;
            strain.abs() < LARGEST_STRAIN
        })
    }

    /// Direction of edge `i`.
    pub(crate) fn direction(&self, i: usize) -> Vector3<f64> {
        (self.nodes[i + 1] - self.nodes[i]).normalize()
    }

    /// Bending moment vector at node `i` \[N m\], acting on what lies towards the tip.
    pub(crate) fn bending_moment(&self, i: usize) -> Vector3<f64> {
        let stiffness = self.section.bending / self.edge;
        if i == 0 {
            2.0 * stiffness * -self.clamp.cross(&self.direction(0))
        } else if i < self.edges() {
            -stiffness * self.direction(i - 1).cross(&self.direction(i))
        } else {
            Vector3::zeros()
        }
    }

    /// Force that the clamp exerts on the rod \[N\], from the last evaluation.
    pub(crate) fn clamp_force(&self) -> Vector3<f64> {
        -self.load.iter().sum::<Vector3<f64>>()
    }

    /// Elastic energy \[J\].
    pub(crate) fn energy(&self) -> f64 {
        let (ei, l) = (self.section.bending, self.edge);
        let first = self.direction(0) - self.clamp;
        let mut energy = ei / l * first.norm_squared();
        for i in 1..self.edges() {
            let turn = self.direction(i) - self.direction(i - 1);
            energy += 0.5 * ei / l * turn.norm_squared();
        }
        for pair in self.nodes.windows(2) {
            let stretch = (pair[1] - pair[0]).norm() - l;
            energy += 0.5 * self.section.axial / l * stretch * stretch;
        }
        energy + self.twist_energy()
    }

    fn twist_energy(&self) -> f64 {
        let sum: f64 = self.torque.iter().skip(1).map(|t| t * t).sum();
        0.5 * self.edge / self.section.torsion * sum
    }

    /// Unbalanced force on the nodes and the tangent stiffness at `self.nodes`.
    fn evaluate(&mut self, load: &mut impl Load) {
        self.band.copy_from(&self.bending_band);
        self.load.fill(Vector3::zeros());
        load.add(&self.nodes, &mut self.load, &mut self.band);
        self.gradient.copy_from_slice(&self.load);
        self.add_bending();
        self.add_tension();
        self.add_twist();
    }

    fn add_bending(&mut self) {
        let (l, edges) = (self.edge, self.edges());
        let stiffness = self.section.bending / l.powi(3);
        let (x, g) = (&self.nodes, &mut self.gradient);
        g[1] -= 2.0 * stiffness * (x[1] - x[0] - l * self.clamp);
        for i in 1..edges {
            let pull = stiffness * ((x[i + 1] - x[i]) - (x[i] - x[i - 1]));
            g[i - 1] -= pull;
            g[i] += 2.0 * pull;
            g[i + 1] -= pull;
        }
    }

    fn add_tension(&mut self) {
        let stiffness = self.section.axial / self.edge;
        for i in 0..self.edges() {
            let e = self.nodes[i + 1] - self.nodes[i];
            let length = e.norm();
            let t = e / length;
            let tension = stiffness * (length - self.edge);
            let pull = tension * t;
            self.gradient[i] += pull;
            self.gradient[i + 1] -= pull;
            let across = tension / length;
            let block =
                t * (t.transpose() * (stiffness - across)) + Matrix3::from_diagonal_element(across);
            self.band.add_diagonal(i, &block);
            if i > 0 {
                self.band.add_diagonal(i - 1, &block);
                self.band.add_first(i, &-block);
            }
        }
    }

    /// Holonomy: the torque times the turn of the material frame that bending causes.
    fn add_twist(&mut self) {
        let (l, edges) = (self.edge, self.edges());
        let binormal = |a: &Vector3<f64>, b: &Vector3<f64>| a.cross(b) * (2.0 / (1.0 + a.dot(b)));
        let mut before = self.clamp;
        for i in 0..edges {
            let t = (self.nodes[i + 1] - self.nodes[i]) / l;
            let torque = self.torque[i];
            if torque != 0.0 {
                let force = binormal(&before, &t) * (torque / (2.0 * l));
                self.gradient[i + 1] -= force;
                if i > 0 {
                    self.gradient[i - 1] += force;
                    let skew = t.cross_matrix() * (torque / (2.0 * l * l));
                    self.band.add_first(i, &-skew);
                    if i > 1 {
                        self.band.add_second(i, &skew);
                        self.band.add_first(i - 1, &-skew);
                    }
                }
            }
            before = t;
        }
    }
}

/// The constant tangent of bending, clamped at node 0.
fn bending_band(stiffness: f64, edges: usize) -> Band {
    let unit = Matrix3::from_diagonal_element(stiffness);
    let mut band = Band::zeros(edges);
    // Block i belongs to node i + 1.
    band.add_diagonal(0, &(2.0 * unit));
    for node in 1..edges {
        let block = node - 1;
        band.add_diagonal(block, &(4.0 * unit));
        band.add_diagonal(block + 1, &unit);
        band.add_first(block + 1, &(-2.0 * unit));
        if block > 0 {
            band.add_diagonal(block - 1, &unit);
            band.add_first(block, &(-2.0 * unit));
            band.add_second(block + 1, &unit);
        }
    }
    band
}
