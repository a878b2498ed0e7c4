//! What the tissue does to a needle being inserted: stiffness of each spring from the length it
//! supports, load on the bevel from the path it has cut.

use nalgebra::Vector3;

use crate::bevel::{Bevel, cut_angle};
use crate::equilibrium::Equilibrium;
use crate::insertion::{InsertionSettings, RestPoint};
use crate::spring::{spring_stiffness, supported_lengths};
use crate::tip_piece::TipLoad;
use crate::tissue::Tissue;

/// What the tissue does at a given state: stiffnesses and tip load.
#[derive(Debug, Clone)]
pub(crate) struct Law {
    pub bevel: Bevel,
    pub tissue: Tissue,
    pub settings: InsertionSettings,
    /// Tip axis when the needle first touched the tissue.
    pub entry_axis: Vector3<f64>,
    /// Rest point of the next newborn relative to O, across the tip axis.
    pub offset: Vector3<f64>,
    /// Longest needle ever cut in \[m\].
    pub cut: f64,
    pub gaps: Vec<f64>,
    pub supported: Vec<f64>,
    /// Cut angle in use \[rad\].
    pub beta: f64,
    /// Change of the cut angle found with the one in use, through the tip load that it sets:
    /// negative, and large near the entry where the needle is soft, so that plain substitution
    /// would diverge there.
    pub response: f64,
}

impl Law {
    pub(crate) fn offset(&self, needle: &Equilibrium) -> Vector3<f64> {
        match self.settings.rest_point {
            RestPoint::Measured => self.offset,
            RestPoint::ModelCentre => Vector3::zeros(),
            RestPoint::CuttingEdge => needle.tip.y * (-needle.needle.outer_diameter() / 2.0),
        }
    }

    /// Eqs. (2) and (3) for the present state, before Newton step `round` (from 0).
    pub(crate) fn update(&mut self, needle: &mut Equilibrium, round: usize) {
        let n = needle.springs.len();
        if n == 0 {
            needle.load = TipLoad::default();
            return;
        }
        self.gaps.clear();
        self.gaps
            .extend(needle.nodes[2..].iter().map(|node| node.l));
        self.supported.resize(n, 0.0);
        let tip_gap = needle.tip_length.max(0.0);
        supported_lengths(
            &self.gaps,
            tip_gap,
            self.settings.pitch,
            &mut self.supported,
        );
        for (spring, length) in needle.springs.iter_mut().zip(&self.supported) {
            let k_t = self.tissue.stiffness_at(self.tissue.depth(&spring.rest));
            spring.stiffness = spring_stiffness(k_t, *length);
        }
        let (tip, axis, y) = (needle.tip_position(), needle.tip.t, needle.tip.y);
        let k_t = self.tissue.stiffness_at(self.tissue.depth(&tip));
        // Withdrawn from the bottom of its hole, the bevel unloads over the length of its edge.
        let withdrawn = self.cut - needle.inserted_length();
        let contact = (1.0 - withdrawn / self.bevel.bottom_edge()).clamp(0.0, 1.0);
        let grown = (needle.inserted_length() / self.settings.onset.max(1e-12)).clamp(0.0, 1.0);
        let scale = contact * grown * self.settings.load_scale;
        let load = |beta: f64| TipLoad::from(self.bevel.load(k_t, beta)) * scale;
        if round == 1 {
            let h = 1e-4;
            let (more, less) = (load(self.beta + h), load(self.beta - h));
            let change = TipLoad {
                force: (more.force - less.force) / (2.0 * h),
                bending: (more.bending - less.bending) / (2.0 * h),
            };
            let twist = needle.tip_response(change);
            let (v, w) = (
                twist.fixed_rows::<3>(0),
                twist.fixed_rows::<3>(3).into_owned(),
            );
            let response = y.dot(&w.cross(&axis)) - y.dot(&v) / self.settings.chord;
            self.response = response.min(0.0);
        }
        let found = cut_angle(&self.chord(needle, &tip), &axis, &y).clamp(0.0, self.bevel.angle());
        self.beta += (found - self.beta) / (1.0 - self.response);
        needle.load = load(self.beta);
    }

    /// Chord of the cut path that ends at the tip. Before the entry the path is straight.
    fn chord(&self, needle: &Equilibrium, tip: &Vector3<f64>) -> Vector3<f64> {
        let end = tip + self.offset(needle);
        let mut left = self.settings.chord;
        let (mut ahead, mut gap) = (end, needle.tip_length);
        for i in (0..needle.springs.len()).rev() {
            let rest = needle.springs[i].rest;
            if left <= gap {
                let fraction = if gap > 0.0 { left / gap } else { 0.0 };
                return end - (ahead + (rest - ahead) * fraction);
            }
            left -= gap;
            ahead = rest;
            gap = needle.nodes[i + 1].l;
        }
        end - (ahead - self.entry_axis * left)
    }
}
