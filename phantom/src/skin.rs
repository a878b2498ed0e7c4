//! Entry sliding: the hole in the surface's skin, which slides over the gel.

use nalgebra::{Matrix3, Vector3};

use crate::motion::Placement;
use crate::rod::band::Band;
use crate::settings::EntrySettings;

/// Depth of O below the skin from which on the hole holds it fully \[m\].
const LETTING_GO: f64 = 0.5e-3;

/// The hole through which the shaft enters. The skin around it pulls elastically at the shaft;
/// where the pull exceeds its hold on the gel, the hole slides along the surface for good.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skin {
    /// Stiffness along the surface \[N/m\].
    stiffness: f64,
    /// Pull beyond which the hole slides \[N\].
    slide: f64,
    /// Share of the gel's motion in which the skin takes part.
    follow: f64,
    /// Where the hole is while the tissue is at rest \[m\], from the first entry on.
    rest: Option<Vector3<f64>>,
    /// Present place of the hole in the phantom frame \[m\].
    hole: Vector3<f64>,
    /// From the hole to the shaft, along the surface, at the last evaluation \[m\].
    pub(crate) stretch: Vector3<f64>,
    crossing: Option<Crossing>,
}

/// Where a shaft crosses the skin: between node `after - 1` and node `after`.
#[derive(Clone, Copy, Debug)]
struct Crossing {
    after: usize,
    share: f64,
    tangent: Vector3<f64>,
    /// Share of the skin's stiffness: it lets go of the tip gradually.
    hold: f64,
}

impl Skin {
    pub(crate) fn new(settings: &EntrySettings) -> Self {
        Self {
            stiffness: settings.skin_n_m,
            slide: if settings.slide_n > 0.0 {
                settings.slide_n
            } else {
                f64::INFINITY
            },
            follow: settings.follow,
            rest: None,
            hole: Vector3::zeros(),
            stretch: Vector3::zeros(),
            crossing: None,
        }
    }

    /// Pierces the skin at `entry` (phantom frame), or is done with the hole.
    pub(crate) fn pierce(&mut self, entry: Option<&Vector3<f64>>, placement: &Placement) {
        self.rest = entry
            .filter(|_| self.stiffness > 0.0)
            .map(|entry| self.rest_of(entry, placement));
        self.stretch = Vector3::zeros();
        self.place(placement);
    }

    /// Moves the hole with the tissue.
    pub(crate) fn place(&mut self, placement: &Placement) {
        if let Some(rest) = &self.rest {
            let carried = placement.phantom_of(rest) - rest;
            self.hole = rest + self.follow * carried;
        }
    }

    fn rest_of(&self, place: &Vector3<f64>, placement: &Placement) -> Vector3<f64> {
        // At the surface the motion hardly differs over the way of a hole.
        let carried = place - placement.material_of(place);
        place - self.follow * carried
    }

    /// Present place of the hole in the phantom frame \[m\].
    pub(crate) fn hole(&self) -> Option<Vector3<f64>> {
        self.rest.map(|_| self.hole)
    }

    /// Stored energy \[J\].
    pub(crate) fn energy(&self) -> f64 {
        if self.rest.is_some() {
            0.5 * self.stiffness * self.stretch.norm_squared()
        } else {
            0.0
        }
    }

    /// Lets the hole slide where the shaft pulls too hard.
    pub(crate) fn yield_to_shaft(&mut self, placement: &Placement) {
        let pull = self.stiffness * self.stretch.norm();
        if self.rest.is_some() && pull > self.slide {
            let way = self.stretch * (1.0 - self.slide / pull);
            self.stretch -= way;
            self.rest = Some(self.rest_of(&(self.hole + way), placement));
            self.place(placement);
        }
    }

    fn find_crossing(&self, nodes: &[Vector3<f64>]) -> Option<Crossing> {
        let depth = |i: usize| nodes[i].z - self.hole.z;
        let last = nodes.len() - 1;
        if depth(last) <= 0.0 {
            return None;
        }
        let after = (1..=last).rev().find(|i| depth(i - 1) <= 0.0)?;
        let edge = nodes[after] - nodes[after - 1];
        let tangent = edge.normalize();
        // A shaft along the skin crosses it nowhere in particular.
        (tangent.z > 0.1).then(|| Crossing {
            after,
            share: -depth(after - 1) / edge.z,
            tangent,
            hold: (depth(last) / LETTING_GO).min(1.0),
        })
    }

    /// Adds the skin's force, across the shaft, and its stiffness; with `keep`, where the shaft
    /// crossed it at the last evaluation.
    pub(crate) fn add(
        &mut self,
        keep: bool,
        nodes: &[Vector3<f64>],
        force: &mut [Vector3<f64>],
        stiffness: &mut Band,
    ) {
        if self.rest.is_none() {
            return;
        }
        if !keep {
            self.crossing = self.find_crossing(nodes);
        }
        let Some(crossing) = self.crossing else {
            self.stretch = Vector3::zeros();
            return;
        };
        let Crossing {
            after: i,
            share,
            tangent,
            hold,
        } = crossing;
        let skin = self.stiffness * hold;
        let point = nodes[i - 1].lerp(&nodes[i], share);
        self.stretch = point - self.hole;
        // Along the surface, the crossing moves by this for a motion of the shaft's points.
        let slope = Matrix3::identity() - tangent * Vector3::z().transpose() / tangent.z;
        let pull = slope.tr_mul(&self.stretch) * -skin;
        let block = slope.tr_mul(&slope) * skin;
        force[i] += pull * share;
        stiffness.add_diagonal(i - 1, &(block * (share * share)));
        force[i - 1] += pull * (1.0 - share);
        if i > 1 {
            stiffness.add_diagonal(i - 2, &(block * (1.0 - share).powi(2)));
            stiffness.add_first(i - 1, &(block * (share * (1.0 - share))));
        }
    }
}
