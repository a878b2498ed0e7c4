//! Whether an arm stands still while it is told to.

use std::time::Duration;

use hal::{Joints, Stamp};

/// Time that an arm may take to stop after its last velocity.
const STOPPING: Duration = Duration::from_millis(500);
/// Part of the largest recent rate that is kept from one period to the next.
const FADING: f64 = 0.9;

/// Watches an arm whose commanded rates are zero.
#[derive(Clone, Debug)]
pub(super) struct Rest {
    tolerance: f64,
    /// The largest rates of late: an arm that stops still goes on for a moment.
    recent: Option<Joints>,
    standing: Option<Standing>,
}

/// Where the arm came to rest.
#[derive(Clone, Copy, Debug)]
struct Standing {
    positions: Joints,
    since: Stamp,
    /// How far each joint may be from there.
    room: Joints,
    settled: bool,
}

impl Rest {
    /// `tolerance`: how far a joint at rest may move \[rad\].
    pub(super) const fn new(tolerance: f64) -> Self {
        Self {
            tolerance,
            recent: None,
            standing: None,
        }
    }

    /// Starts anew from wherever the arm is.
    pub(super) fn restart(&mut self) {
        self.recent = None;
        self.standing = None;
    }

    /// One period of an arm at `measured` that was told to move at `rates`: the joint that moves
    /// without a command (from 0) and how far it came \[rad\].
    pub(super) fn moved(
        &mut self,
        now: Stamp,
        measured: &Joints,
        rates: &Joints,
    ) -> Option<(usize, f64)> {
        let faded = self
            .recent
            .map_or_else(|| rates.zeroed(), |recent| recent.map(|rate| FADING * rate));
        let recent = rates.zip(&faded, |rate, faded| rate.abs().max(faded));
        self.recent = Some(recent);
        if rates.max_abs() > 0.0 {
            self.standing = None;
            return None;
        }
        let tolerance = self.tolerance;
        let stopping = STOPPING.as_secs_f64();
        let standing = self.standing.get_or_insert_with(|| Standing {
            positions: *measured,
            since: now,
            room: recent.map(|rate| tolerance + stopping * rate),
            settled: false,
        });
        let off = measured.zip(&standing.positions, |q, stood| q - stood);
        let moved = (0..off.len()).find(|&i| off[i].abs() > standing.room[i]);
        if moved.is_none() && !standing.settled && now.since(standing.since) > STOPPING {
            *standing = Standing {
                positions: *measured,
                since: now,
                room: recent.zeroed().map(|_| tolerance),
                settled: true,
            };
        }
        moved.map(|joint| (joint, off[joint]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 0.016;

    fn joint(q: f64) -> Joints {
        Joints::from_slice(&[q]).unwrap()
    }

    #[test]
    fn a_creep_is_found_within_the_tolerance_and_a_stop_is_none() {
        let mut rest = Rest::new(3e-3);
        let (mut q, mut now) = (0.0, Stamp::ZERO);
        let mut step = |rest: &mut Rest, told: f64, does: f64| {
            now = now + Duration::from_secs_f64(PERIOD);
            q += does * PERIOD;
            rest.moved(now, &joint(q), &joint(told))
        };
        for _ in 0..50 {
            assert_eq!(step(&mut rest, 0.2, 0.2), None);
        }
        // It comes to rest late and slowly, and stands.
        for i in 0..300 {
            let slows = 0.2 * (1.0 - f64::from(i) / 25.0).max(0.0);
            assert_eq!(step(&mut rest, 0.0, slows), None, "{i}");
        }
        // 14 mm/s at half a metre.
        let found = (0..100).find_map(|_| step(&mut rest, 0.0, 0.028));
        let (joint, moved) = found.unwrap();
        assert_eq!(joint, 0);
        assert!(moved > 3e-3 && moved < 3.6e-3, "{moved}");
    }
}
