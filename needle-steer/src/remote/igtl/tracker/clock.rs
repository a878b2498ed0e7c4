//! A sender's stamps on the rig's clock.
//!
//! Nothing is known of the other clock but that no message arrives before it is sent. The message that
//! took the least time of those of the last seconds says how far the clocks are apart; what later ones
//! take longer is their age. A stretch of the network that stalls is seen so, and measurements that
//! waited in it are old when they come.

use std::time::Duration;

use hal::Stamp;
use igtl::Timestamp;

/// Time over which the quickest message counts; up to twice as long. A clock that is slow by 100 ppm
/// is followed to a millisecond.
const WINDOW: Duration = Duration::from_secs(5);
/// A step ahead of the sender's clock that is no message's delay \[ns\].
const STEP: i64 = 500_000_000;

/// What a stamp says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dated {
    /// A new measurement, of this time on the rig's clock.
    At(Stamp),
    /// The same stamp once more.
    Repeated,
    /// The sender's clock was set back, or a measurement overtaken.
    SetBack,
}

/// The clock of one sender.
#[derive(Clone, Debug, Default)]
pub(super) struct SenderClock {
    /// Newest stamp and arrival \[ns\].
    last: Option<(i64, i64)>,
    /// Least arrival less stamp, in this window and in the one before \[ns\].
    least: [Option<i64>; 2],
    /// When this window began.
    since: Stamp,
}

impl SenderClock {
    /// When a measurement that arrives at `arrived` was taken; without a stamp, as it arrives.
    pub(super) fn date(&mut self, sent: Timestamp, arrived: Stamp) -> Dated {
        if sent == Timestamp::default() {
            *self = Self::default();
            return Dated::At(arrived);
        }
        let (sent, came) = (nanos(sent.as_nanos()), nanos(arrived.as_nanos()));
        if let Some((last_sent, last_came)) = self.last {
            if sent == last_sent {
                return Dated::Repeated;
            }
            if sent < last_sent {
                *self = Self::default();
                self.last = Some((sent, came));
                return Dated::SetBack;
            }
            if sent - last_sent > came - last_came + STEP {
                *self = Self::default();
            }
        }
        self.last = Some((sent, came));
        if arrived.since(self.since) > WINDOW {
            self.least = [None, self.least[0]];
            self.since = arrived;
        }
        let apart = came - sent;
        let least = self.least[0].map_or(apart, |least| least.min(apart));
        self.least[0] = Some(least);
        let offset = self.least[1].map_or(least, |before| before.min(least));
        Dated::At(Stamp::from_nanos(u64::try_from(sent + offset).unwrap_or(0)))
    }
}

/// As a signed number; the largest stamp is 136 years.
fn nanos(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stamps since the epoch, ten days ahead of the rig's.
    fn sent(ms: u64) -> Timestamp {
        Timestamp::from_nanos(1_700_000_000_000_000_000 + ms * 1_000_000)
    }

    fn at(ms: u64) -> Stamp {
        Stamp::from_nanos(ms * 1_000_000)
    }

    /// Difference to a time in milliseconds \[ms\].
    fn off(dated: Dated, ms: u64) -> f64 {
        match dated {
            Dated::At(stamp) => (stamp.as_nanos() as f64 - at(ms).as_nanos() as f64) * 1e-6,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn what_a_message_takes_longer_than_the_quickest_is_its_age() {
        let mut clock = SenderClock::default();
        assert!(off(clock.date(sent(0), at(100)), 100).abs() < 1e-5);
        // The second is quicker by 30 ms, the third late by 400 ms, its burst behind it.
        assert!(off(clock.date(sent(50), at(120)), 120).abs() < 1e-5);
        assert!(off(clock.date(sent(75), at(545)), 145).abs() < 1e-5);
        assert!(off(clock.date(sent(100), at(546)), 170).abs() < 1e-5);
        assert_eq!(clock.date(sent(100), at(547)), Dated::Repeated);
        assert_eq!(clock.date(sent(90), at(548)), Dated::SetBack);
    }

    #[test]
    fn a_slow_clock_is_followed_and_a_step_is_taken() {
        let mut clock = SenderClock::default();
        let mut worst: f64 = 0.0;
        // 100 ppm slow, 25 ms apart, every fifth message 60 ms late.
        for k in 0..8000_u64 {
            let t = 25 * k;
            let late = if k % 5 == 0 { 60 } else { 0 };
            let stamp = Timestamp::from_nanos(1_700_000_000_000_000_000 + t * 1_000_000 - t * 100);
            let dated = clock.date(stamp, at(1000 + t + late));
            if k > 5 {
                worst = worst.max(off(dated, 1000 + t).abs());
            }
        }
        assert!(worst < 1.1, "{worst} ms");
        // An hour ahead: then on from there.
        assert!(off(clock.date(sent(3_800_000), at(202_000)), 202_000).abs() < 1e-5);
        assert!(off(clock.date(sent(3_800_025), at(202_055)), 202_025).abs() < 1e-5);
        // An hour back: one is lost.
        assert_eq!(clock.date(sent(300_000), at(202_100)), Dated::SetBack);
        assert!(off(clock.date(sent(300_025), at(202_125)), 202_125).abs() < 1e-5);
    }

    #[test]
    fn without_stamps_the_arrival_counts() {
        let mut clock = SenderClock::default();
        for ms in [10, 20, 20, 35] {
            assert_eq!(clock.date(Timestamp::default(), at(ms)), Dated::At(at(ms)));
        }
    }
}
