//! Time is data: every measurement and command carries a [`Stamp`].

use core::ops::{Add, Sub};
use core::time::Duration;

use serde::{Deserialize, Serialize};

/// Nanoseconds since the origin of the run's clock.
///
/// All devices of one rig stamp with the same clock; a stamp says when the measured event
/// happened (exposure, encoder latch), not when its message arrived.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct Stamp(u64);

impl Stamp {
    /// The origin of the run's clock.
    pub const ZERO: Self = Self(0);

    /// Stamp at `nanoseconds` after the clock's origin.
    pub const fn from_nanos(nanoseconds: u64) -> Self {
        Self(nanoseconds)
    }

    /// Stamp at `seconds` after the clock's origin, rounded to the nanosecond; negative and
    /// non-finite values saturate.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a float-to-integer cast saturates, as documented"
    )]
    pub fn from_secs(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as u64)
    }

    /// Nanoseconds since the clock's origin.
    pub const fn as_nanos(self) -> u64 {
        self.0
    }

    /// Seconds since the clock's origin \[s\].
    pub fn as_secs(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Time from `earlier` to `self`; zero if `earlier` is the later one.
    pub const fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }

    /// Signed time from `other` to `self` \[s\].
    pub fn secs_since(self, other: Self) -> f64 {
        if self.0 >= other.0 {
            (self.0 - other.0) as f64 * 1e-9
        } else {
            -((other.0 - self.0) as f64 * 1e-9)
        }
    }
}

impl Add<Duration> for Stamp {
    type Output = Self;

    fn add(self, rhs: Duration) -> Self {
        let nanoseconds = u64::try_from(rhs.as_nanos()).unwrap_or(u64::MAX);
        Self(self.0.saturating_add(nanoseconds))
    }
}

impl Sub<Duration> for Stamp {
    type Output = Self;

    fn sub(self, rhs: Duration) -> Self {
        let nanoseconds = u64::try_from(rhs.as_nanos()).unwrap_or(u64::MAX);
        Self(self.0.saturating_sub(nanoseconds))
    }
}

/// The clock of a run.
///
/// Contract: `now` never goes back; `wait_until` returns with `now() >= deadline` and returns
/// at once when the deadline has passed. A virtual clock moves the simulated world while it
/// "waits"; a wall clock sleeps.
pub trait Clock: Send {
    /// The present time.
    fn now(&self) -> Stamp;

    /// Waits until `deadline`.
    fn wait_until(&mut self, deadline: Stamp);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arithmetic_saturates_and_signed_difference_is_antisymmetric() {
        let a = Stamp::from_secs(0.5);
        let b = a + Duration::from_millis(16);
        assert_eq!(b.since(a), Duration::from_millis(16));
        assert_eq!(a.since(b), Duration::ZERO);
        assert_eq!(a - Duration::from_secs(9), Stamp::ZERO);
        assert_eq!(a.secs_since(b), -b.secs_since(a));
        assert_eq!(Stamp::from_secs(-1.0), Stamp::ZERO);
        assert_eq!(Stamp::from_secs(f64::NAN), Stamp::ZERO);
    }
}
