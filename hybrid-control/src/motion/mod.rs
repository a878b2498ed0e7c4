//! Moving tissue: breathing and drift, known through a marker, and the way out of it.
//!
//! A marker that moves with the tissue is tracked ([`MarkerTrack`]); an affine field over depth
//! carries its motion to everything else ([`TissueField`]). Measurements, base pose and target
//! are taken into the tissue's rest frame, where nothing moves; estimator and law work there,
//! and the law's twist comes back with the field's own motion added to it. Eq. (25) thus points
//! at the moving target without a change.

mod field;
mod marker;

pub use field::TissueField;
pub use marker::MarkerTrack;

use hal::Stamp;
use nalgebra::{Point3, Vector3};

use crate::settings::MotionSettings;
use crate::view::Entry;

/// The tissue's motion as a marker tells it.
///
/// At rest is the tissue as it was when the marker was first seen.
#[derive(Clone, Debug)]
pub struct TissueMotion {
    surface_ratio: f64,
    lead: f64,
    entry: Entry,
    track: MarkerTrack,
    rest: Option<Point3<f64>>,
}

impl TissueMotion {
    /// Tissue that has not been seen to move yet.
    pub fn new(settings: &MotionSettings, entry: &Entry) -> Self {
        Self {
            surface_ratio: settings.surface_ratio,
            lead: settings.lead_ms * 1e-3,
            entry: *entry,
            track: MarkerTrack::new(settings),
            rest: None,
        }
    }

    /// Takes in the marker's position in World \[m\] with its standard deviation per axis, at
    /// its own time. What is not finite, or not newer than the last, is passed over.
    pub fn observe(&mut self, stamp: Stamp, marker: &Point3<f64>, sigma: f64) {
        if self.track.observe(stamp, marker, sigma) && self.rest.is_none() {
            self.rest = Some(*marker);
        }
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

    /// The marker's motion carried over depth: `surface_ratio` of it at the entry, all of it at
    /// the marker, straight in between and beyond.
    fn carried(&self, rest: &Point3<f64>, stamp: Stamp, ahead: f64) -> TissueField {
        let depth = (rest - self.entry.point).dot(&self.entry.inward);
        let (place, rate) = self.track.at(stamp, ahead);
        // A marker at the surface says nothing about depth: the motion then counts as rigid.
        let ratio = if depth > 5e-3 { self.surface_ratio } else { 1.0 };
        let slope = (1.0 - ratio) / depth.max(5e-3);
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

/// Both vectors finite.
pub(crate) fn finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|x| x.is_finite())
}
