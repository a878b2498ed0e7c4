//! Moving tissue: breathing and drift, known through a marker, and the way out of it.
//!
//! A marker that moves with the tissue is tracked ([`MarkerTrack`]); an affine field over depth
//! carries its motion to everything else ([`TissueField`]). Measurements, base pose and target
//! are taken into the tissue's rest frame, where nothing moves; estimator and law work there,
//! and the law's twist comes back with the field's own motion added to it. Eq. (25) thus points
//! at the moving target without a change.

mod field;
mod marker;
mod ratio;
mod sway;

pub use field::TissueField;
pub use marker::MarkerTrack;
pub use sway::TissueSway;

use hal::Stamp;
use nalgebra::{Point3, Unit, Vector3};
use ratio::SurfaceRatio;

use crate::settings::MotionSettings;
use crate::view::Entry;

/// Depth of a marker below which it tells nothing about how motion changes with depth \[m\].
const SHALLOW: f64 = 5e-3;

/// The tissue's motion as a marker tells it.
///
/// At rest is the tissue as it was when the marker was first seen.
#[derive(Clone, Debug)]
pub struct TissueMotion {
    surface: SurfaceRatio,
    lead: f64,
    entry: Entry,
    track: MarkerTrack,
    rest: Option<Point3<f64>>,
}

impl TissueMotion {
    /// Tissue that has not been seen to move yet.
    pub fn new(settings: &MotionSettings, entry: &Entry) -> Self {
        Self {
            surface: SurfaceRatio::new(settings.surface_ratio, settings.surface_sigma),
            lead: settings.lead_ms * 1e-3,
            entry: *entry,
            track: MarkerTrack::new(settings),
            rest: None,
        }
    }

    /// Takes in the marker's position in World \[m\] with its standard deviation per axis, at
    /// its own time. What is not finite, or not newer than the last, is passed over.
    pub fn observe(&mut self, stamp: Stamp, marker: &Point3<f64>, sigma: f64) {
        // An exact sensor is taken for nearly exact.
        let sigma = sigma.max(1e-6);
        if self.track.observe(stamp, marker, sigma) && self.rest.is_none() {
            self.rest = Some(*marker);
        }
    }

    /// Takes in the measured tip (World) and its axis: it moves with the tissue that holds it.
    pub fn observe_tip(
        &mut self,
        stamp: Stamp,
        tip: &Point3<f64>,
        axis: &Unit<Vector3<f64>>,
        sigma: f64,
    ) {
        if let Some(rest) = &self.rest {
            let moved = self.track.at(stamp, 0.0).0 - rest.coords;
            let depth = (rest - self.entry.point).dot(&self.entry.inward);
            if depth > SHALLOW {
                self.surface
                    .observe(&self.entry, (stamp, tip, axis), sigma, (&moved, depth));
            }
        }
    }

    /// Motion at the entry over motion at the marker, as estimated.
    pub fn surface_ratio(&self) -> f64 {
        self.surface.value()
    }

    /// Where the marker is at rest \[m\]; nothing before it was seen.
    pub fn rest(&self) -> Option<Point3<f64>> {
        self.rest
    }

    /// The field at `stamp`, past or near future.
    pub fn field(&self, stamp: Stamp) -> TissueField {
        self.rest.map_or_else(
            || TissueField::still(&self.entry),
            |rest| self.carried(&rest, stamp, 0.0),
        )
    }

    /// The field at `stamp` with the rates of the moment at which a command takes effect.
    pub fn field_to_follow(&self, stamp: Stamp) -> TissueField {
        let mut field = self.field(stamp);
        if let Some(rest) = &self.rest {
            let ahead = self.carried(rest, stamp, self.lead);
            field.take_rates(&ahead);
        }
        field
    }

    /// The marker's motion carried over depth: the surface's part of it at the entry, all of it at
    /// the marker, straight in between and beyond.
    fn carried(&self, rest: &Point3<f64>, stamp: Stamp, ahead: f64) -> TissueField {
        let depth = (rest - self.entry.point).dot(&self.entry.inward);
        let (place, rate) = self.track.at(stamp, ahead);
        // A marker at the surface says nothing about depth: the motion then counts as rigid.
        let ratio = if depth > SHALLOW {
            self.surface.value()
        } else {
            1.0
        };
        let slope = (1.0 - ratio) / depth.max(SHALLOW);
        let moved = place - rest.coords;
        TissueField::new(
            &self.entry,
            [moved * ratio, moved * slope],
            [rate * ratio, rate * slope],
        )
    }

    /// Estimated rate of breathing \[Hz\].
    pub fn rate_hz(&self) -> f64 {
        self.track.rate_hz()
    }
}

/// Every number finite.
pub(crate) fn finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|x| x.is_finite())
}
