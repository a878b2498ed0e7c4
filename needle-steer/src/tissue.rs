//! What is known of the tissue's motion: by a marker, by the needle alone, or nothing.

use hal::Stamp;
use hybrid_control::settings::Limits;
use hybrid_control::view::Entry;
use hybrid_control::{TissueField, TissueMotion, TissueSway};
use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::config::{Config, TargetKind};

/// What is left of a breath that is known from the needle alone, standard deviation per axis \[m\]: the
/// tests of [`TissueSway`] hold it to a third of a millimetre.
const SWAY_SIGMA: f64 = 0.25e-3;

/// Where the motion of the tissue is known from.
pub(crate) enum Tissue {
    /// A marker that it carries, which is the target.
    Marked(TissueMotion),
    /// The needle, which it carries along; the target stands still.
    Unmarked(TissueSway),
    /// Nowhere.
    Still,
}

impl Tissue {
    pub(crate) fn of(config: &Config, entry: &Entry) -> Self {
        if config.target.kind == TargetKind::Marker {
            Self::Marked(TissueMotion::new(&config.motion, entry))
        } else if config.motion.sway {
            Self::Unmarked(TissueSway::new(&config.motion, entry))
        } else {
            Self::Still
        }
    }

    /// Whether the target moves with the tissue.
    pub(crate) const fn is_marked(&self) -> bool {
        matches!(self, Self::Marked(_))
    }

    /// Takes in the marker, World.
    pub(crate) fn see_marker(&mut self, stamp: Stamp, place: &Point3<f64>, sigma: f64) {
        if let Self::Marked(motion) = self {
            motion.observe(stamp, place, sigma);
        }
    }

    /// Takes in the tip and its axis, World.
    pub(crate) fn see_tip(
        &mut self,
        stamp: Stamp,
        place: &Point3<f64>,
        axis: &Unit<Vector3<f64>>,
        sigma: f64,
    ) {
        if let Self::Marked(motion) = self {
            motion.observe_tip(stamp, place, axis, sigma);
        }
    }

    /// Takes in the part of the tip's place that steering does not explain, World. `true`: the
    /// tissue's breathing is known from now on.
    pub(crate) fn see_unexplained(
        &mut self,
        stamp: Stamp,
        unexplained: &Vector3<f64>,
        sigma: f64,
    ) -> bool {
        match self {
            Self::Unmarked(sway) => sway.observe(stamp, unexplained, sigma),
            Self::Marked(_) | Self::Still => false,
        }
    }

    /// The tissue at `stamp`; nothing where it does not move.
    pub(crate) fn field(&self, stamp: Stamp) -> Option<TissueField> {
        match self {
            Self::Marked(motion) => Some(motion.field(stamp)),
            Self::Unmarked(sway) => sway.field(stamp),
            Self::Still => None,
        }
    }

    /// How wrong what is taken to the tissue at rest may be by its motion, standard deviation per axis \[m\].
    pub(crate) fn sigma(&self, stamp: Stamp) -> f64 {
        match self {
            Self::Unmarked(sway) if sway.field(stamp).is_some() => SWAY_SIGMA,
            Self::Unmarked(_) | Self::Marked(_) | Self::Still => 0.0,
        }
    }

    /// The same with the rates that a command meets.
    pub(crate) fn field_to_follow(&self, stamp: Stamp) -> Option<TissueField> {
        match self {
            Self::Marked(motion) => Some(motion.field_to_follow(stamp)),
            Self::Unmarked(sway) => sway.field_to_follow(stamp),
            Self::Still => None,
        }
    }

    /// Where the tissue at rest has a target that was given in World.
    pub(crate) fn target_at_rest(&self, given: &Point3<f64>) -> Point3<f64> {
        match self {
            Self::Marked(motion) => motion.rest().unwrap_or(*given),
            Self::Unmarked(sway) => sway.target_at_rest(given),
            Self::Still => *given,
        }
    }

    /// Nominal speed of insertion with a target `ahead` \[m\].
    pub(crate) fn speed(&self, now: Stamp, ahead: f64, nominal: f64) -> f64 {
        match self {
            Self::Unmarked(sway) => sway.timed_speed(now, ahead, nominal),
            Self::Marked(_) | Self::Still => nominal,
        }
    }

    /// A breath is awaited standing still where the tissue turns out to breathe.
    pub(crate) const fn is_learning(&self) -> bool {
        matches!(self, Self::Unmarked(sway) if sway.is_learning())
    }
}

/// Takes from the workspace that a law may use at rest what the tissue carries the base: `narrowed`
/// then keeps `limits` where the base really is.
pub(crate) fn narrow(
    narrowed: &mut Limits,
    limits: &Limits,
    base: &Isometry3<f64>,
    at_rest: &Isometry3<f64>,
) {
    let carried_mm = (base.translation.vector - at_rest.translation.vector).norm() * 1e3;
    let axis = |pose: &Isometry3<f64>| pose.rotation * Vector3::z();
    let turned_deg = axis(base).angle(&axis(at_rest)).to_degrees();
    let left = |most: f64, taken: f64| (most - taken).max(0.0);
    narrowed.base_offset_mm = left(limits.base_offset_mm, carried_mm).min(narrowed.base_offset_mm);
    narrowed.tilt_deg = left(limits.tilt_deg, turned_deg).min(narrowed.tilt_deg);
}
