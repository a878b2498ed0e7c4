//! The newest that is known of the arm.

use std::time::Duration;

use hal::{Joints, Stamp};

use crate::viper::wire::Status;

/// One reading of the encoders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) stamp: Stamp,
    pub(super) positions: Joints,
    pub(super) rates: Joints,
}

/// Feedback of one link; made anew with every link, so that no speed outlives it.
#[derive(Debug, Default)]
pub(super) struct Tracker {
    pub(super) sample: Option<Sample>,
    pub(super) status: Option<Status>,
    pub(super) status_at: Stamp,
    tick: Option<i32>,
    map: Option<TickMap>,
}

impl Tracker {
    /// Takes the controller's state.
    pub(super) const fn status(&mut self, now: Stamp, status: Status) {
        self.status = Some(status);
        self.status_at = now;
    }

    /// Takes positions without a time of their own: stamped with their arrival.
    pub(super) fn positions(&mut self, now: Stamp, positions: Joints) {
        self.take(now, positions);
    }

    /// Takes positions read at a cycle of the controller; answers how many cycles were missed,
    /// or `None` when the reading is not newer than the last one.
    pub(super) fn cycle(
        &mut self,
        now: Stamp,
        tick: i32,
        cycle: Duration,
        positions: Joints,
    ) -> Option<u64> {
        let missed = match self.tick {
            Some(last) if tick <= last => return None,
            Some(last) => u64::from(tick.abs_diff(last)) - 1,
            None => 0,
        };
        self.tick = Some(tick);
        let map = self.map.get_or_insert(TickMap {
            seen: now,
            offset: i128::MAX,
        });
        let stamp = map.stamp(now, tick, cycle);
        self.take(stamp, positions);
        Some(missed)
    }

    fn take(&mut self, stamp: Stamp, positions: Joints) {
        let rates = match &self.sample {
            // Readings that arrive together give no speed of their own.
            Some(last) => match stamp.secs_since(last.stamp) {
                dt if dt > 1e-3 => positions.zip(&last.positions, |new, old| (new - old) / dt),
                _ => last.rates,
            },
            None => positions.zeroed(),
        };
        self.sample = Some(Sample {
            stamp,
            positions,
            rates,
        });
    }
}

/// From the controller's cycle count to the run's clock: the shortest delay seen so far is taken
/// for the true one. A delay that is there from the start cannot be distinguished from a clock offset.
#[derive(Clone, Copy, Debug)]
struct TickMap {
    seen: Stamp,
    offset: i128,
}

impl TickMap {
    /// Largest drift between the two clocks.
    const DRIFT: f64 = 1e-4;

    #[expect(clippy::cast_possible_truncation, reason = "nanoseconds of drift")]
    fn stamp(&mut self, now: Stamp, tick: i32, cycle: Duration) -> Stamp {
        let controller = i128::from(tick) * i128::try_from(cycle.as_nanos()).unwrap_or(0);
        let slack = (now.secs_since(self.seen) * 1e9 * Self::DRIFT) as i128;
        let offset = i128::from(now.as_nanos()) - controller;
        self.offset = offset.min(self.offset.saturating_add(slack));
        self.seen = now;
        let nanoseconds = (controller + self.offset).clamp(0, i128::from(now.as_nanos()));
        Stamp::from_nanos(u64::try_from(nanoseconds).unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delayed_cycles_keep_the_time_of_their_reading() {
        let cycle = Duration::from_millis(16);
        let mut tracker = Tracker::default();
        let q = |x: f64| Joints::from([x; 6]);
        let arrival = |tick: u64, late_ms: u64| {
            Stamp::from_nanos(5_000_000_000 + tick * 16_000_000 + late_ms * 1_000_000)
        };
        assert_eq!(tracker.cycle(arrival(100, 0), 100, cycle, q(0.0)), Some(0));
        assert_eq!(
            tracker.cycle(arrival(101, 40), 101, cycle, q(0.016)),
            Some(0)
        );
        assert_eq!(
            tracker.cycle(arrival(104, 1), 104, cycle, q(0.064)),
            Some(2)
        );
        assert_eq!(tracker.cycle(arrival(105, 0), 104, cycle, q(9.0)), None);
        let sample = tracker.sample.unwrap();
        // The drift allowed for 64 ms is 6.4 us.
        assert!(sample.stamp.secs_since(arrival(104, 0)).abs() < 1e-5);
        assert!((sample.rates[0] - 1.0).abs() < 1e-3, "{:?}", sample.rates);
    }
}
