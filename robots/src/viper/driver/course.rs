//! Set points: what was ordered, and whether the arm is there.

use std::collections::VecDeque;
use std::time::Duration;

use hal::{Joints, Stamp};

use super::feedback::Sample;

/// Longest memory of set points; covers the slowest feedback at the shortest period.
const MEMORY: usize = 64;

/// The set point and its recent past.
#[derive(Debug)]
pub(super) struct Course {
    /// Where the arm is ordered to be \[rad\].
    pub(super) set_point: Joints,
    advanced_at: Option<Stamp>,
    /// No segment was sent since the last start point.
    pub(super) fresh: bool,
    history: VecDeque<(Stamp, Joints)>,
    strikes: u32,
    ends: VecDeque<Stamp>,
}

/// The next segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Segment {
    pub(super) to: Joints,
    pub(super) duration: Duration,
}

impl Course {
    /// At rest at `positions`.
    pub(super) fn at(positions: Joints) -> Self {
        Self {
            set_point: positions,
            advanced_at: None,
            fresh: true,
            history: VecDeque::with_capacity(MEMORY),
            strikes: 0,
            ends: VecDeque::new(),
        }
    }

    /// Before the first segment of a motion from the present set point.
    pub(super) const fn restart(&mut self) {
        self.advanced_at = None;
        self.fresh = true;
    }

    /// Time that the next segment covers: what has passed since the last one, so that a late
    /// tick does not slow the arm, but never more than two periods.
    pub(super) fn step(&self, now: Stamp, period: Duration) -> Duration {
        self.advanced_at
            .map_or(period, |at| now.since(at).clamp(period / 2, 2 * period))
    }

    /// Takes a segment at `rates` over `step`.
    pub(super) fn advance(&mut self, now: Stamp, step: Duration, rates: &Joints) -> Segment {
        if self.history.is_empty() {
            self.remember(now, self.set_point);
        }
        let seconds = step.as_secs_f64();
        self.set_point = self.set_point.zip(rates, |q, rate| q + rate * seconds);
        self.advanced_at = Some(now);
        self.fresh = false;
        self.remember(now + step, self.set_point);
        Segment {
            to: self.set_point,
            duration: step,
        }
    }

    /// Segments that a controller which runs each at full speed has not finished yet.
    pub(super) fn unfinished(&mut self, now: Stamp) -> usize {
        while self.ends.front().is_some_and(|end| *end <= now) {
            self.ends.pop_front();
        }
        self.ends.len()
    }

    /// Counts a segment of this length in seconds to be run after those before it.
    pub(super) fn will_take(&mut self, now: Stamp, seconds: f64) {
        let start = self.ends.back().map_or(now, |end| now.max(*end));
        self.ends
            .push_back(start + Duration::from_secs_f64(seconds));
    }

    fn remember(&mut self, at: Stamp, set_point: Joints) {
        if self.history.len() == MEMORY {
            self.history.pop_front();
        }
        self.history.push_back((at, set_point));
    }

    /// Largest distance of a reading from the set points of the `lag` before it: joint, \[rad\].
    pub(super) fn deviation(&self, sample: &Sample, lag: Duration) -> (usize, f64) {
        let since = sample.stamp - lag;
        let mut low = self.set_point;
        let mut high = self.set_point;
        let mut widen = |q: &Joints| {
            low = low.zip(q, f64::min);
            high = high.zip(q, f64::max);
        };
        let mut before = None;
        for (at, q) in &self.history {
            if *at < since {
                before = Some(q);
            } else {
                widen(q);
            }
        }
        // The segment under way when the window opens starts at the last older point.
        before.into_iter().for_each(&mut widen);
        let range = low.zip(&high, |_, _| 0.0);
        (0..range.len())
            .map(|joint| {
                let q = sample.positions[joint];
                (joint, (low[joint] - q).max(q - high[joint]).max(0.0))
            })
            .fold(
                (0, 0.0),
                |worst, next| if next.1 > worst.1 { next } else { worst },
            )
    }

    /// Counts a sample in or out of tolerance; true after `most` out of it in a row.
    pub(super) const fn strike(&mut self, outside: bool, most: u32) -> bool {
        self.strikes = if outside { self.strikes + 1 } else { 0 };
        self.strikes >= most
    }
}
