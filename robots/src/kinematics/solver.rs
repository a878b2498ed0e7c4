//! Which solver of the inverse kinematics fits an arm.

use hal::Joints;
use nalgebra::Isometry3;

use super::chain::Chain;
use super::numeric;
use super::opw::{Opw, OpwParameters};
use super::parallel::Parallel;

/// How well an arm fits the geometry that an analytic solution is for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Lines may miss each other, and angles be off, by this much \[m, rad\].
    pub(super) geometry: f64,
    /// How far out of reach a target may lie and be taken for the boundary \[1\].
    pub(super) stretch: f64,
}

impl Fit {
    /// What the rounding of a URDF's lengths and angles, and of a target, leaves.
    pub(super) const EXACT: Self = Self {
        geometry: 1e-11,
        stretch: 1e-12,
    };
    /// What calibration makes of an arm built to the geometry, or a URDF that rounds pi / 2.
    pub(super) const NEAR: Self = Self {
        geometry: 0.02,
        stretch: 0.02,
    };
}

/// An analytic solution.
#[derive(Clone, Debug)]
pub(super) enum Analytic {
    /// Orthogonal base and spherical wrist.
    Opw(Opw),
    /// Three parallel axes in the middle.
    Parallel(Parallel),
}

impl Analytic {
    fn detect(chain: &Chain, fit: &Fit) -> Option<Self> {
        Opw::detect(chain, fit)
            .map(Self::Opw)
            .or_else(|| Parallel::detect(chain, fit).map(Self::Parallel))
    }

    fn solve(&self, base_from_tip: &Isometry3<f64>, found: impl FnMut(Joints)) {
        match self {
            Self::Opw(opw) => opw.solve(base_from_tip, found),
            Self::Parallel(parallel) => parallel.solve(base_from_tip, found),
        }
    }
}

/// How the inverse kinematics of a chain is solved.
#[derive(Clone, Debug)]
pub(super) enum Solver {
    /// Analytically.
    Exact(Analytic),
    /// By iterations that start from the analytic solution for a geometry close by, and from
    /// elsewhere.
    Near(Analytic),
    /// By iterations from everywhere.
    Numerical,
}

impl Solver {
    pub(super) fn choose(chain: &Chain) -> Self {
        if let Some(analytic) = Analytic::detect(chain, &Fit::EXACT) {
            return Self::Exact(analytic);
        }
        Analytic::detect(chain, &Fit::NEAR).map_or(Self::Numerical, Self::Near)
    }

    /// Calls `found` with every solution, wherever in the circle.
    pub(super) fn solve(
        &self,
        chain: &Chain,
        base_from_tip: &Isometry3<f64>,
        mut found: impl FnMut(Joints),
    ) {
        let mut starts = Vec::new();
        match self {
            Self::Exact(analytic) => return analytic.solve(base_from_tip, found),
            Self::Near(analytic) => analytic.solve(base_from_tip, |q| starts.push(q)),
            Self::Numerical => {}
        }
        numeric::solve(chain, base_from_tip, &starts, &mut found);
    }

    /// Whether all solutions are found.
    pub(super) fn is_exact(&self) -> bool {
        matches!(self, Self::Exact(_))
    }

    pub(super) fn opw(&self) -> Option<&OpwParameters> {
        match self {
            Self::Exact(Analytic::Opw(opw)) => Some(opw.parameters()),
            _ => None,
        }
    }
}
