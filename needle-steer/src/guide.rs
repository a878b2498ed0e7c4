//! A guide before the tissue: the needle bends from its exit on, not from its base.

use nalgebra::{Isometry3, Matrix6, Point3, Unit, Vector3};

use crate::config::{Config, NeedleSupport};

/// A guide that moves with the needle's base across the insertion, and stays along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Guide {
    entry: Point3<f64>,
    inward: Unit<Vector3<f64>>,
    /// Distance of the exit from the surface \[m\].
    pub(crate) gap: f64,
    /// Length of the needle \[m\].
    length: f64,
}

/// A guide that cannot be steered through.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GuideMisfit {
    /// It touches the tissue.
    #[error(
        "needle.guide_gap_mm is {gap_mm}; a run through a guide needs its exit's distance from the tissue, at least {least_mm}"
    )]
    Gap {
        /// Distance \[mm\].
        gap_mm: f64,
        /// Least distance \[mm\].
        least_mm: f64,
    },
    /// The needle's base would come to its exit.
    #[error(
        "a needle of {length_mm} mm reaches {reach_mm:.0} mm deep through a guide {gap_mm} mm from the tissue, the target is {depth_mm} mm ahead; lengthen needle.length_mm or move the guide"
    )]
    Short {
        /// Length of the needle \[mm\].
        length_mm: f64,
        /// How deep its tip comes \[mm\].
        reach_mm: f64,
        /// Distance of the exit from the tissue \[mm\].
        gap_mm: f64,
        /// Distance of the target \[mm\].
        depth_mm: f64,
    },
}

/// Least distance of an exit from the tissue \[m\]: nearer, the tissue would have to bend a stub.
const LEAST_GAP: f64 = 2e-3;
/// Way of the base that is left before the exit at the target \[m\]: the straight start and more.
const SPARE: f64 = 15e-3;

/// A needle in its guide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Guided {
    /// The exit, in the orientation of the base.
    pub(crate) world_from_exit: Isometry3<f64>,
    /// Length of needle beyond it \[m\].
    pub(crate) length: f64,
    /// From the base to the exit \[m\].
    before: f64,
}

impl Guide {
    /// The guide of the configuration, where it has one.
    pub(crate) fn of(config: &Config) -> Option<Self> {
        (config.needle.support == NeedleSupport::Guide).then(|| Self {
            entry: config.entry(),
            inward: config.inward(),
            gap: config.needle.guide_gap_mm * 1e-3,
            length: config.needle.length_mm * 1e-3,
        })
    }

    /// Whether a run to the configuration's target can go through it.
    pub(crate) fn check(&self, config: &Config) -> Result<(), GuideMisfit> {
        if self.gap < LEAST_GAP {
            return Err(GuideMisfit::Gap {
                gap_mm: self.gap * 1e3,
                least_mm: LEAST_GAP * 1e3,
            });
        }
        let reach = self.length - self.gap - SPARE;
        let depth_mm = config.target.depth_mm;
        if depth_mm > reach * 1e3 {
            return Err(GuideMisfit::Short {
                length_mm: self.length * 1e3,
                reach_mm: reach * 1e3,
                gap_mm: self.gap * 1e3,
                depth_mm,
            });
        }
        Ok(())
    }

    /// The needle with its base at `world_from_base`; a base beyond the exit counts as the exit.
    pub(crate) fn at(&self, world_from_base: &Isometry3<f64>) -> Guided {
        let axis = world_from_base.rotation * Vector3::z();
        let height = (self.entry - world_from_base.translation.vector)
            .coords
            .dot(&self.inward);
        // A needle across the insertion has no exit ahead.
        let before = ((height - self.gap) / axis.dot(&self.inward).max(0.3)).max(0.0);
        let mut world_from_exit = *world_from_base;
        world_from_exit.translation.vector += axis * before;
        Guided {
            world_from_exit,
            length: (self.length - before).max(1e-3),
            before,
        }
    }
}

impl Guided {
    /// Twist of the exit by the twist of the base, in World; what the needle slides by counts as
    /// motion of the exit along it.
    pub(crate) fn exit_by_base(&self) -> Matrix6<f64> {
        let arm = self.world_from_exit.rotation * Vector3::z() * self.before;
        let mut by = Matrix6::identity();
        by.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&-arm.cross_matrix());
        by
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;

    #[test]
    fn the_exit_stays_along_the_insertion_and_goes_with_the_base_across() {
        let mut config = Config::default();
        config.needle.support = NeedleSupport::Guide;
        config.needle.guide_gap_mm = 25.0;
        let guide = Guide::of(&config).unwrap();
        let start = config.world_from_start_base();
        let first = guide.at(&start);
        assert!((first.length - 25e-3).abs() < 1e-12, "{first:?}");
        let deeper = start * Translation3::new(3e-3, 0.0, 40e-3);
        let moved = guide.at(&deeper);
        assert!((moved.length - 65e-3).abs() < 1e-12);
        let way = start.inverse_transform_vector(
            &(moved.world_from_exit.translation.vector - first.world_from_exit.translation.vector),
        );
        assert!((way - Vector3::new(3e-3, 0.0, 0.0)).norm() < 1e-12, "{way}");
    }

    #[test]
    fn a_guide_that_touches_or_stops_the_needle_is_refused() {
        let mut config = Config::default();
        config.needle.support = NeedleSupport::Guide;
        let check = |config: &Config| Guide::of(config).unwrap().check(config);
        let problem = check(&config).unwrap_err().to_string();
        assert!(problem.contains("needle.guide_gap_mm is 0"), "{problem}");
        config.needle.guide_gap_mm = 40.0;
        let problem = check(&config).unwrap_err().to_string();
        assert!(problem.contains("reaches 71 mm deep"), "{problem}");
        config.needle.length_mm = 200.0;
        assert_eq!(check(&config), Ok(()));
    }

    #[test]
    fn a_turn_of_the_base_moves_the_exit() {
        let mut config = Config::default();
        config.needle.support = NeedleSupport::Guide;
        config.needle.guide_gap_mm = 25.0;
        let guide = Guide::of(&config).unwrap();
        let base = config.world_from_start_base();
        let angle = 1e-6;
        let mut turned = base;
        turned.rotation = UnitQuaternion::from_scaled_axis(Vector3::y() * angle) * base.rotation;
        let (before, after) = (guide.at(&base), guide.at(&turned));
        let mut twist = nalgebra::Vector6::zeros();
        twist[4] = angle;
        let said = before.exit_by_base() * twist;
        let way =
            after.world_from_exit.translation.vector - before.world_from_exit.translation.vector;
        assert!(
            (said.fixed_rows::<3>(0) - way).norm() < 1e-9 * 0.1,
            "{said} {way}"
        );
    }
}
