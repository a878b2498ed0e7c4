//! The monitor of an insertion: it compares what was commanded with what was measured.
//!
//! It stands between the law and the arm, beside the [supervisor](crate::supervisor)'s bounds, and
//! knows neither law nor tissue model. Five questions, each with its own file: does the tip follow
//! the base ([`stall`]), does the shaft follow the tip ([`trace`]), do both move with the tissue
//! ([`sideways`]), are the measurements recent ([`freshness`]), can they be of this needle
//! ([`plausibility`]).

pub mod advance;
pub mod freshness;
pub mod plausibility;
pub mod sideways;
pub mod stall;
pub mod trace;

use hal::frame::LeftCamera;
use hal::{SensedTip, Stamp, Transform};
use nalgebra::Isometry3;

pub use advance::Advance;
pub use freshness::{Freshness, Stale};
pub use sideways::Sideways;
pub use stall::{Stall, Stalled};
pub use trace::Trace;

/// Advance of the base since the newest measurement from which the arm is slowed, and at which it
/// stands \[m\]. Half a second of latency at the nominal 1 mm/s stays below the first.
const BLIND: (f64, f64) = (0.6e-3, 1.0e-3);

/// Watches one insertion.
#[derive(Clone, Debug, Default)]
pub struct Monitor {
    advance: Advance,
    stall: Stall,
    sideways: Sideways,
    /// The base's advance at the newest measurement of the tip.
    measured_at: Option<f64>,
}

impl Monitor {
    /// Takes in the base as the encoders say.
    pub fn base(&mut self, stamp: Stamp, world_from_base: &Isometry3<f64>) {
        self.advance.push(stamp, world_from_base);
    }

    /// Takes in a measured tip of the instant `exposed`, with the base at that instant.
    pub fn tip(
        &mut self,
        exposed: Stamp,
        world_from_base: &Isometry3<f64>,
        tip: &SensedTip,
        world_from_left_camera: &Transform<hal::frame::World, LeftCamera>,
    ) {
        let Some(advance) = self.advance.at(exposed) else {
            return;
        };
        self.measured_at = Some(advance);
        let place = *world_from_left_camera * tip.position;
        let axis = world_from_left_camera.rotate_direction(&tip.direction);
        self.stall.observe(exposed, advance, place.point(), &axis);
        self.sideways
            .observe(exposed, world_from_base, place.point(), &axis);
    }

    /// Forgets what is behind: after a pause or a retraction.
    pub fn begin_anew(&mut self) {
        self.stall = Stall::default();
    }

    /// The tip stays behind the base.
    pub fn stalled(&self) -> Option<Stalled> {
        self.stall.finding()
    }

    /// The largest way of the tip within the last breath that only moving tissue explains \[m\].
    pub fn tissue_motion(&self, now: Stamp) -> Option<f64> {
        self.sideways.finding(now)
    }

    /// How far the tissue has been seen to move by itself so far \[m\].
    pub const fn largest_tissue_motion(&self) -> f64 {
        self.sideways.largest()
    }

    /// Share of the commanded speed, 0 to 1, that may go out: an insertion goes only as far ahead
    /// of its measurements as half a second of latency asks for.
    pub fn allowed_speed(&self) -> f64 {
        let Some(measured_at) = self.measured_at else {
            return 1.0;
        };
        let blind = self.advance.total() - measured_at;
        ((BLIND.1 - blind) / (BLIND.1 - BLIND.0)).clamp(0.0, 1.0)
    }
}
