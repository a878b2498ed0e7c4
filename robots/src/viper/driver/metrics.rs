//! Figures of the driver's health.

use std::time::Duration;

const WINDOW: usize = 512;
const ANSWERS: usize = 100;

/// Health of the link and of the driver's timing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metrics {
    /// Share of the last 100 points and stops that were accepted in time; 1 before the first.
    pub success_rate: f64,
    /// Lateness of the driver's ticks \[s\]: median, 99th percentile, maximum of the last 512.
    pub tick_lateness: Percentiles,
    /// Time from point to answer \[s\]: the same.
    pub round_trip: Percentiles,
    /// Points accepted by the controller.
    pub points: u64,
    /// Ticks at which a point was held back because an answer was outstanding.
    pub held_back: u64,
    /// Commands refused as late, old, duplicate or malformed.
    pub refused_commands: u64,
    /// Feedback cycles that were never received (only where the dialect counts them).
    pub missed_feedback: u64,
    /// Links made.
    pub links: u64,
    /// Faults latched.
    pub faults: u64,
}

/// Median, 99th percentile, maximum; 0 without samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

/// Collects what [`Metrics`] shows, in constant memory.
#[derive(Debug, Default)]
pub(super) struct Collector {
    answers: Ring<bool, ANSWERS>,
    lateness: Ring<f64, WINDOW>,
    round_trip: Ring<f64, WINDOW>,
    pub(super) counts: Metrics,
}

impl Collector {
    pub(super) fn answer(&mut self, accepted: bool, round_trip: Duration) {
        self.answers.push(accepted);
        self.round_trip.push(round_trip.as_secs_f64());
        self.counts.points += u64::from(accepted);
    }

    pub(super) fn unanswered(&mut self) {
        self.answers.push(false);
    }

    pub(super) fn tick(&mut self, late: Duration) {
        self.lateness.push(late.as_secs_f64());
    }

    pub(super) fn snapshot(&self) -> Metrics {
        let answers = self.answers.values();
        let accepted = answers.iter().filter(|accepted| **accepted).count();
        Metrics {
            success_rate: if answers.is_empty() {
                1.0
            } else {
                accepted as f64 / answers.len() as f64
            },
            tick_lateness: percentiles(self.lateness.values()),
            round_trip: percentiles(self.round_trip.values()),
            ..self.counts.clone()
        }
    }
}

fn percentiles(samples: &[f64]) -> Percentiles {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at =
        |percent: usize| sorted.get((sorted.len() * percent / 100).min(sorted.len().max(1) - 1));
    Percentiles {
        p50: at(50).copied().unwrap_or(0.0),
        p99: at(99).copied().unwrap_or(0.0),
        max: sorted.last().copied().unwrap_or(0.0),
    }
}

#[derive(Debug)]
struct Ring<T, const N: usize> {
    values: [T; N],
    filled: usize,
    next: usize,
}

impl<T: Copy + Default, const N: usize> Default for Ring<T, N> {
    fn default() -> Self {
        Self {
            values: [T::default(); N],
            filled: 0,
            next: 0,
        }
    }
}

impl<T: Copy, const N: usize> Ring<T, N> {
    fn push(&mut self, value: T) {
        self.values[self.next] = value;
        self.next = (self.next + 1) % N;
        self.filled = (self.filled + 1).min(N);
    }

    fn values(&self) -> &[T] {
        &self.values[..self.filled]
    }
}
