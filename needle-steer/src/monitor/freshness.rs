//! Are the measurements recent? Their age (exposure to now) and the gap since the last one came
//! are two things: a slow camera is late and regular, a broken one is neither.

use core::time::Duration;

use hal::Stamp;

/// A stamp farther ahead of the rig's clock is refused \[s\]: more than the clocks of two machines
/// in step differ by.
const AHEAD: f64 = 0.02;
/// Measurements in a row that are refused for their age or stamp before the run ends: one may be
/// late by chance.
const REFUSED: u32 = 5;

/// A measurement that is not taken for its stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stale {
    /// Exposed longer ago than is allowed.
    Late {
        /// Age at its arrival \[s\].
        age_s: f64,
    },
    /// Exposed in the future, by the rig's clock.
    Ahead {
        /// How far ahead \[s\].
        by_s: f64,
    },
}

/// Watches arrival and exposure of measurements.
#[derive(Clone, Debug)]
pub struct Freshness {
    oldest: Duration,
    refused: (u32, Option<Stale>),
}

impl Freshness {
    /// Measurements may be `oldest` at their arrival.
    pub const fn new(oldest: Duration) -> Self {
        Self {
            oldest,
            refused: (0, None),
        }
    }

    /// Whether a measurement exposed at `exposed` that arrives now is taken.
    pub fn admit(&mut self, now: Stamp, exposed: Stamp) -> bool {
        let age_s = now.secs_since(exposed);
        let stale = if age_s < -AHEAD {
            Stale::Ahead { by_s: -age_s }
        } else if age_s > self.oldest.as_secs_f64() {
            Stale::Late { age_s }
        } else {
            self.refused = (0, None);
            return true;
        };
        self.refused = (self.refused.0.saturating_add(1), Some(stale));
        false
    }

    /// Why measurements are refused, once it is no accident any more.
    pub fn finding(&self) -> Option<Stale> {
        self.refused.1.filter(|_| self.refused.0 >= REFUSED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_late_measurement_is_an_accident_and_five_are_none() {
        let mut freshness = Freshness::new(Duration::from_millis(550));
        let at = Stamp::from_secs;
        assert!(freshness.admit(at(1.0), at(0.46)) && freshness.admit(at(1.0), at(1.015)));
        for k in 0..4 {
            assert!(!freshness.admit(at(2.0 + 0.03 * f64::from(k)), at(1.0)));
            assert_eq!(freshness.finding(), None);
        }
        assert!(freshness.admit(at(2.2), at(2.1)));
        for _ in 0..5 {
            assert_eq!(freshness.finding(), None);
            assert!(!freshness.admit(at(3.0), at(13.0)));
        }
        assert!(
            matches!(freshness.finding(), Some(Stale::Ahead { by_s }) if (by_s - 10.0).abs() < 1e-9)
        );
    }
}
