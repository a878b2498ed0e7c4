//! Whether an arm goes where its velocities lead.

use std::collections::VecDeque;
use std::time::Duration;

use hal::Joints;

use super::ArmTiming;

/// Part of its recent travel by which an arm may be off: ramps of its own, slower than those
/// commanded.
const SLIP: f64 = 0.15;

/// Compares an arm with the integral of what it was told.
#[derive(Clone, Debug)]
pub(super) struct Tracking {
    tolerance: f64,
    period: f64,
    /// Periods by which the arm may be late.
    window: f64,
    /// Part of a distance that is forgotten in a period.
    share: f64,
    state: Option<State>,
}

#[derive(Clone, Debug)]
struct State {
    /// Where the arm should be if it executes what was sent.
    reference: Joints,
    /// Where it should have been, as far back as it may be late.
    before: VecDeque<Joints>,
    /// How far each joint was told to go lately, there and back.
    travel: Joints,
}

impl Tracking {
    pub(super) fn new(timing: &ArmTiming, tolerance: f64, period: Duration) -> Self {
        let period = period.as_secs_f64();
        Self {
            tolerance,
            period,
            window: timing.delay.as_secs_f64() / period,
            share: period / timing.settling.as_secs_f64().max(period),
            state: None,
        }
    }

    /// Starts anew from where the arm is.
    pub(super) fn restart(&mut self, positions: Joints) {
        self.state = Some(State {
            reference: positions,
            before: VecDeque::new(),
            travel: positions.zeroed(),
        });
    }

    /// The arm is at `measured` and executes `rates` for the next period. What it loses and wins
    /// in ramps is forgotten slowly, or at a rest.
    pub(super) fn advance(&mut self, measured: &Joints, rates: &Joints) {
        let (window, share, period) = (self.window, self.share, self.period);
        let Some(state) = &mut self.state else { return };
        let resting = rates.max_abs() == 0.0
            && state.before.len() as f64 >= window
            && state.before.iter().all(|place| *place == state.reference);
        let correction = if resting {
            measured.zip(&state.reference, |q, r| q - r)
        } else {
            state.off(measured).map(|off| share * off)
        };
        for place in state.before.iter_mut().chain([&mut state.reference]) {
            *place = place.zip(&correction, |r, c| r + c);
        }
        while state.before.len() as f64 > window {
            state.before.pop_front();
        }
        state.before.push_back(state.reference);
        state.reference = state.reference.zip(rates, |r, rate| r + rate * period);
        state.travel = state.travel.zip(rates, |travel, rate| {
            travel * (1.0 - share) + rate.abs() * period
        });
    }

    /// A joint that is too far from where it should be, and how far \[rad\].
    pub(super) fn lost(&self, measured: &Joints) -> Option<(usize, f64)> {
        let state = self.state.as_ref()?;
        let off = state.off(measured);
        let mut joints = off.iter().zip(state.travel.iter());
        let joint = joints.position(|(off, travel)| off.abs() > self.tolerance + SLIP * travel)?;
        Some((joint, off[joint]))
    }
}

impl State {
    /// How far each joint is from where it should be, now or as long ago as it may be late.
    fn off(&self, measured: &Joints) -> Joints {
        let mut off = measured.zeroed();
        for (i, q) in measured.iter().enumerate() {
            let places = self.before.iter().chain([&self.reference]);
            let (low, high) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), r| {
                (a.min(r[i]), b.max(r[i]))
            });
            off[i] = q - q.clamp(low, high);
        }
        off
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(q: f64) -> Joints {
        Joints::from_slice(&[q]).unwrap()
    }

    /// Seconds until an arm that executes `obedience` of 0.3 rad/s is lost, 5 at most.
    fn lost_after(obedience: f64) -> f64 {
        let period = Duration::from_millis(16);
        let mut tracking = Tracking::new(&ArmTiming::default(), 0.02, period);
        let mut q = 0.0;
        tracking.restart(joint(q));
        for i in 0..312 {
            if tracking.lost(&joint(q)).is_some() {
                return 0.016 * f64::from(i);
            }
            tracking.advance(&joint(q), &joint(0.3));
            q += 0.3 * 0.016 * obedience;
        }
        5.0
    }

    #[test]
    fn slips_are_forgiven_and_a_jam_is_not() {
        assert!(lost_after(1.0) >= 5.0);
        assert!(lost_after(0.9) >= 5.0);
        assert!(lost_after(0.0) < 0.6, "{} s", lost_after(0.0));
        assert!(lost_after(-1.0) < 0.3, "{} s", lost_after(-1.0));
    }
}
