//! When an insertion ends, and whether a target can be reached at all.

use hal::telemetry::LawReport;
use hal::{Stamp, Twist};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::estimator::{Estimator, Rollout};
use crate::freedom::Freedom;
use crate::settings::Limits;

/// Distance of the target ahead of the tip along its axis \[m\]; negative: it has been passed.
pub fn target_ahead(world_from_tip: &Isometry3<f64>, target: &Point3<f64>) -> f64 {
    world_from_tip.inverse_transform_point(target).z
}

/// Distance of the target from the tip's axis \[m\].
pub fn lateral_error(world_from_tip: &Isometry3<f64>, target: &Point3<f64>) -> f64 {
    world_from_tip
        .inverse_transform_point(target)
        .coords
        .xy()
        .norm()
}

/// Detects a target that stays out of reach.
#[derive(Clone, Debug, PartialEq)]
pub struct ReachMonitor {
    tolerance: f64,
    /// When the target was first out of reach, and how far ahead it was then \[m\].
    since: Option<(Stamp, f64)>,
}

/// How long a shortfall must last \[s\].
const PATIENCE: f64 = 1.0;

/// Insertion over which it must last too, where as much is left \[m\]: errors of a prediction
/// change with the needle's path, not with time.
const WAY: f64 = 20e-3;

impl ReachMonitor {
    /// `tolerance`: shortfall that is accepted \[m\].
    pub fn new(tolerance: f64) -> Self {
        Self {
            tolerance,
            since: None,
        }
    }

    /// The shortfall \[m\] of a target that is `ahead` \[m\] of the tip, once it has lasted.
    pub fn update(&mut self, now: Stamp, ahead: f64, report: &LawReport) -> Option<f64> {
        // NaN: unknown, which is no shortfall.
        if report.shortfall.is_nan() || report.shortfall <= self.tolerance {
            self.since = None;
            return None;
        }
        let (since, from) = *self.since.get_or_insert((now, ahead));
        let lasted = now.secs_since(since) > PATIENCE && (ahead < WAY || from - ahead > WAY);
        lasted.then_some(report.shortfall)
    }
}

/// Why an insertion is refused before it starts.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unreachable {
    /// The target is not in front of the tip.
    #[error("the target is {behind_mm:.1} mm behind the tip")]
    Behind {
        /// How far \[mm\].
        behind_mm: f64,
    },
    /// The target is deeper than the needle is long.
    #[error("the needle is {missing_mm:.1} mm too short for the target")]
    TooDeep {
        /// What is missing \[mm\].
        missing_mm: f64,
    },
    /// The target is too far aside.
    #[error(
        "the target is {shortfall_mm:.1} mm out of reach: {miss_mm:.1} mm aside, {reach_mm:.1} mm can be steered"
    )]
    Aside {
        /// What is missing \[mm\].
        shortfall_mm: f64,
        /// Predicted miss without steering \[mm\].
        miss_mm: f64,
        /// What bevel and base can give together \[mm\].
        reach_mm: f64,
    },
    /// Neither bevel nor base can be moved as the law wants.
    #[error(
        "law {law} steers with what this device cannot do (needle-steer check says what it can)"
    )]
    NoMeans {
        /// The law.
        law: String,
    },
    /// The target is not a finite point.
    #[error("the target's coordinates are not finite")]
    NonFinite,
}

/// What steering has to give to a target, and can.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Predicted miss without steering \[m\].
    pub miss: f64,
    /// What bevel and base can give together \[m\]; nothing for a law without control.
    pub most: Option<f64>,
}

/// Which means a law steers with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Means {
    /// The bevel.
    pub bevel: bool,
    /// Pivots of the base about the entry.
    pub pivot: bool,
    /// Shifts of the base across the needle.
    pub shift: bool,
}

impl Means {
    /// Those of the law of that name; unknown names have both.
    pub fn of_law(name: &str) -> Self {
        match name {
            "none" => Self::NONE,
            "tip-only" => Self {
                bevel: true,
                ..Self::NONE
            },
            "base-only" | "broyden" => Self {
                pivot: true,
                ..Self::NONE
            },
            "paper" | "paper-verbatim" => Self {
                bevel: true,
                pivot: true,
                shift: false,
            },
            _ => Self {
                bevel: true,
                pivot: true,
                shift: true,
            },
        }
    }

    /// Nothing: straight on.
    pub const NONE: Self = Self {
        bevel: false,
        pivot: false,
        shift: false,
    };

    /// Whether the base steers.
    pub const fn base(self) -> bool {
        self.pivot || self.shift
    }

    /// What a device with `freedom` leaves of them, its base at `world_from_base`.
    #[must_use]
    pub fn within(
        self,
        freedom: &Freedom,
        world_from_base: &Isometry3<f64>,
        entry: &Point3<f64>,
    ) -> Self {
        if freedom.is_full() {
            return self;
        }
        let arm = world_from_base.translation.vector - entry.coords;
        let axes = [Vector3::x(), Vector3::y()].map(|axis| world_from_base.rotation * axis);
        let turn = |axis: Vector3<f64>, arm: Vector3<f64>| Twist {
            linear: axis.cross(&arm),
            angular: axis,
        };
        let slide = |axis| Twist {
            linear: axis,
            angular: Vector3::zeros(),
        };
        let any = |twists| freedom.within::<2>(&twists).trace() > 0.5;
        let along = world_from_base.rotation * Vector3::z();
        Self {
            bevel: self.bevel && freedom.gives(&turn(along, Vector3::zeros())),
            pivot: self.pivot && any(axes.map(|axis| turn(axis, arm))),
            shift: self.shift && any(axes.map(slide)),
        }
    }
}

/// Checks before the start whether a target (World) can be reached, by the predictive model
/// with base authority counted.
///
/// Half of what the base could do within its tilt is counted, or less where its offset ends the
/// pivot earlier: its authority fades while it moves. A base that only shifts may go so far that the
/// entry is stretched as far as a plan may stretch it. The bevel's reach is that of the prior cut angle.
///
/// # Errors
/// See [`Unreachable`].
pub fn reachable_at_start(
    estimator: &Estimator,
    target: &Point3<f64>,
    limits: &Limits,
    means: Means,
) -> Result<Reach, Unreachable> {
    if !target.iter().all(|x| x.is_finite()) {
        return Err(Unreachable::NonFinite);
    }
    let depth = estimator
        .world_from_insertion()
        .inverse_transform_point(target)
        .z;
    let ahead = depth - estimator.depth();
    if ahead <= 0.0 {
        return Err(Unreachable::Behind {
            behind_mm: -ahead * 1e3,
        });
    }
    let missing = depth - estimator.needle_length();
    if missing > 0.0 {
        return Err(Unreachable::TooDeep {
            missing_mm: missing * 1e3,
        });
    }
    let mut rollout = Rollout::new();
    estimator.rollout(target, &mut rollout);
    let miss = rollout.miss.norm();
    if means == Means::NONE {
        return Ok(Reach { miss, most: None });
    }
    // A pivot about the entry shifts the base: a narrow workspace may end it before the tilt does.
    let height = (estimator.needle_length() - estimator.depth()).max(1e-3);
    let tilt = (limits.tilt_deg.to_radians() * 0.5).min(limits.base_offset_mm * 1e-3 / height);
    let base = if means.pivot {
        rollout.pivot.max(0.0) * tilt
    } else if means.shift {
        let pressed = limits.entry_stretch_mm * 1e-3 / rollout.entry_per_shift.abs().max(1e-3);
        (-rollout.shift).max(0.0) * pressed.min(0.5 * limits.base_offset_mm * 1e-3)
    } else {
        0.0
    };
    let reach = base + if means.bevel { rollout.bevel } else { 0.0 };
    if miss > reach {
        return Err(Unreachable::Aside {
            shortfall_mm: (miss - reach) * 1e3,
            miss_mm: miss * 1e3,
            reach_mm: reach * 1e3,
        });
    }
    Ok(Reach {
        miss,
        most: Some(reach),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A straight needle of 126 mm with its tip at the surface.
    fn estimator() -> Estimator {
        let start = crate::Start {
            length: 0.126,
            bending_stiffness: 2e-2,
            cutting_edge: 1e-3,
            guide_gap: None,
            tip_sensor: None,
            advance_by_tip: false,
            entry: crate::view::Entry {
                point: Point3::origin(),
                inward: Vector3::z_axis(),
            },
            world_from_base: Isometry3::translation(0.0, 0.0, -0.126),
        };
        Estimator::new(&crate::EstimatorSettings::default(), &start).unwrap()
    }

    #[test]
    fn what_cannot_be_reached_is_refused_with_the_shortfall() {
        let (estimator, both) = (estimator(), Means::of_law("hybrid"));
        let limits = Limits::default();
        let check = |x: f64, z: f64, limits: &Limits| {
            reachable_at_start(&estimator, &Point3::new(x, 0.0, z), limits, both)
        };
        let reach = check(0.01, 0.08, &limits).unwrap();
        assert!((reach.miss - 0.01).abs() < 2e-3, "{reach:?}");
        assert!(reach.most.is_some_and(|most| most > 0.015), "{reach:?}");
        assert!(matches!(
            check(0.0, -0.01, &limits),
            Err(Unreachable::Behind { behind_mm }) if (behind_mm - 10.0).abs() < 1.5
        ));
        assert!(matches!(
            check(0.0, 0.2, &limits),
            Err(Unreachable::TooDeep { missing_mm }) if (missing_mm - 74.0).abs() < 1e-6
        ));
        let aside = |limits: &Limits| match check(0.05, 0.08, limits) {
            Err(Unreachable::Aside { reach_mm, .. }) => reach_mm,
            other => panic!("{other:?}"),
        };
        // A base that may hardly move aside cannot pivot either, though its tilt is free.
        let narrow = Limits {
            base_offset_mm: 1.0,
            ..Limits::default()
        };
        assert!(
            aside(&narrow) < 0.7 * aside(&limits),
            "{} mm",
            aside(&narrow)
        );
        assert_eq!(check(f64::NAN, 0.08, &limits), Err(Unreachable::NonFinite));
    }

    #[test]
    fn a_shortfall_must_last() {
        let mut monitor = ReachMonitor::new(0.5e-3);
        let report = |shortfall| LawReport {
            shortfall,
            ..LawReport::default()
        };
        let mut at = |seconds, ahead_mm: f64, shortfall| {
            monitor.update(
                Stamp::from_secs(seconds),
                ahead_mm * 1e-3,
                &report(shortfall),
            )
        };
        assert_eq!(at(0.0, 50.0, 1e-3), None);
        assert_eq!(at(0.9, 48.0, 1e-3), None);
        assert_eq!(at(0.95, 47.9, f64::NAN), None);
        assert_eq!(at(1.5, 46.0, 2e-3), None);
        assert_eq!(at(2.6, 43.0, 2e-3), None, "it may yet be wrong");
        assert_eq!(at(9.0, 25.9, 2e-3), Some(2e-3));
        assert_eq!(at(9.5, 25.0, 0.1e-3), None);
        assert_eq!(at(20.0, 4.0, 3e-3), None);
        assert_eq!(at(21.1, 3.9, 3e-3), Some(3e-3), "nothing more is to come");
    }
}
