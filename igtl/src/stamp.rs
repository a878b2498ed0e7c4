//! Time on the wire.

/// Nanoseconds in a second.
const SECOND: u128 = 1_000_000_000;

/// Seconds since the epoch in 32 bits, then a fraction of a second in 32 bits; zero where unused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Timestamp(pub u64);

impl Timestamp {
    /// From nanoseconds, rounded down to the resolution of 0.23 ns; seconds beyond 32 bits wrap.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "64 bits are what the wire has: seconds wrap in 2106"
    )]
    pub const fn from_nanos(nanos: u64) -> Self {
        Self((((nanos as u128) << 32) / SECOND) as u64)
    }

    /// To nanoseconds, rounded to the nearest.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "seconds of 32 bits make nanoseconds of 62"
    )]
    pub const fn as_nanos(self) -> u64 {
        ((self.0 as u128 * SECOND + (1 << 31)) >> 32) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_nanosecond_survives() {
        for nanos in [0, 1, 999_999_999, 1_700_000_000_123_456_789] {
            assert_eq!(Timestamp::from_nanos(nanos).as_nanos(), nanos);
        }
        assert_eq!(Timestamp::from_nanos(1_500_000_000).0, 0x1_8000_0000);
        assert_eq!(Timestamp(u64::MAX).as_nanos(), 4_294_967_296_000_000_000);
    }
}
