//! The clocks of a run.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

use hal::{Clock, Stamp};

/// Virtual time: waiting moves the simulated world.
pub struct LockstepClock {
    now: Stamp,
    tick: Duration,
    advance: Box<dyn FnMut(Stamp) + Send>,
}

impl LockstepClock {
    /// A clock at zero that calls `advance` at every multiple of `tick` it passes and at every
    /// deadline.
    pub fn new(tick: Duration, advance: impl FnMut(Stamp) + Send + 'static) -> Self {
        Self {
            now: Stamp::ZERO,
            tick,
            advance: Box::new(advance),
        }
    }
}

impl Clock for LockstepClock {
    fn now(&self) -> Stamp {
        self.now
    }

    fn wait_until(&mut self, deadline: Stamp) {
        while self.now < deadline {
            let tick = self.tick.as_nanos().max(1);
            let next = (u128::from(self.now.as_nanos()) / tick + 1) * tick;
            let next = Stamp::from_nanos(u64::try_from(next).unwrap_or(u64::MAX));
            self.now = next.min(deadline);
            (self.advance)(self.now);
        }
    }
}

impl fmt::Debug for LockstepClock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LockstepClock")
            .field("now", &self.now)
            .finish_non_exhaustive()
    }
}

/// Longest lag behind the wall clock that a paced clock catches up.
const CATCH_UP: Duration = Duration::from_millis(200);

/// Virtual time at the pace of the wall clock: the same run as in [`LockstepClock`], real-time
/// factor 1. On a machine that is too slow, it falls behind rather than skip, and all who read the
/// same [`WallTime`] with it.
#[derive(Debug)]
pub struct PacedClock {
    virtual_time: LockstepClock,
    wall: WallTime,
}

impl PacedClock {
    /// Paces `virtual_time`, both starting with `wall`.
    pub const fn new(virtual_time: LockstepClock, wall: WallTime) -> Self {
        Self { virtual_time, wall }
    }
}

impl Clock for PacedClock {
    fn now(&self) -> Stamp {
        self.virtual_time.now()
    }

    #[expect(clippy::disallowed_methods, reason = "this is the clock of the edge")]
    fn wait_until(&mut self, deadline: Stamp) {
        self.virtual_time.wait_until(deadline);
        let due = self.virtual_time.now();
        let wall = self.wall.now();
        std::thread::sleep(due.since(wall));
        let late = wall.since(due);
        if late > CATCH_UP {
            self.wall.fall_behind(late);
        }
    }
}

/// Wall-clock time since an origin, less what a [`PacedClock`] fell behind; may be read from any
/// thread. Clones are the same time.
#[derive(Clone, Debug)]
pub struct WallTime {
    origin: Instant,
    /// \[ns\]
    behind: Arc<AtomicU64>,
}

impl WallTime {
    /// Time that counts from now on.
    #[expect(clippy::disallowed_methods, reason = "this is the clock of the edge")]
    pub fn start() -> Self {
        Self {
            origin: Instant::now(),
            behind: Arc::default(),
        }
    }

    /// The present time.
    pub fn now(&self) -> Stamp {
        Stamp::ZERO + self.origin.elapsed().saturating_sub(self.behind())
    }

    /// How far it is behind the wall clock, for good.
    pub fn behind(&self) -> Duration {
        Duration::from_nanos(self.behind.load(Ordering::Acquire))
    }

    fn fall_behind(&self, by: Duration) {
        let by = u64::try_from(by.as_nanos()).unwrap_or(u64::MAX);
        self.behind.fetch_add(by, Ordering::AcqRel);
    }
}

/// Wall-clock time since the epoch when a run's time was zero, if it is `now`.
#[expect(
    clippy::disallowed_methods,
    reason = "messages and logs are laid beside those of others, by wall-clock time"
)]
pub fn began(now: Stamp) -> Duration {
    let since_epoch = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    since_epoch.saturating_sub(now.since(Stamp::ZERO))
}

/// Wall-clock time since the clock was made; drives a simulated world, if there is one, in step.
pub struct WallClock {
    origin: WallTime,
    tick: Duration,
    advance: Option<Box<dyn FnMut(Stamp) + Send>>,
}

impl WallClock {
    /// A clock that starts now.
    pub fn new() -> Self {
        Self::since(WallTime::start())
    }

    /// A clock of a time that others read too.
    pub fn since(origin: WallTime) -> Self {
        Self {
            origin,
            tick: Duration::from_millis(4),
            advance: None,
        }
    }

    /// A clock that started with `time` and moves a simulated world at least every `tick`.
    #[must_use]
    pub fn driving(
        time: WallTime,
        tick: Duration,
        advance: impl FnMut(Stamp) + Send + 'static,
    ) -> Self {
        Self {
            tick,
            advance: Some(Box::new(advance)),
            ..Self::since(time)
        }
    }
}

impl Default for WallClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for WallClock {
    fn now(&self) -> Stamp {
        self.origin.now()
    }

    #[expect(clippy::disallowed_methods, reason = "this is the clock of the edge")]
    fn wait_until(&mut self, deadline: Stamp) {
        loop {
            let now = self.now();
            if let Some(advance) = &mut self.advance {
                advance(now);
            }
            let left = deadline.since(now);
            if left.is_zero() {
                return;
            }
            let nap = if self.advance.is_some() {
                left.min(self.tick)
            } else {
                left
            };
            std::thread::sleep(nap);
        }
    }
}

impl fmt::Debug for WallClock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WallClock")
            .field("origin", &self.origin)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    #[test]
    fn lockstep_visits_every_tick_and_the_deadline_once() {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let log = Arc::clone(&seen);
        let mut clock = LockstepClock::new(Duration::from_millis(4), move |t| {
            log.lock().unwrap().push(t.as_nanos() / 1_000_000);
        });
        clock.wait_until(Stamp::from_secs(0.010));
        clock.wait_until(Stamp::from_secs(0.010));
        clock.wait_until(Stamp::from_secs(0.016));
        assert_eq!(*seen.lock().unwrap(), [4, 8, 10, 12, 16]);
        assert_eq!(clock.now(), Stamp::from_secs(0.016));
    }

    #[test]
    fn a_paced_clock_is_never_early_and_skips_nothing_when_late() {
        let wall = WallTime::start();
        let seen = Arc::new(Mutex::new(Vec::new()));
        let log = Arc::clone(&seen);
        let world = LockstepClock::new(Duration::from_millis(4), move |t| {
            log.lock().unwrap().push(t.as_nanos() / 1_000_000);
        });
        let mut clock = PacedClock::new(world, wall.clone());
        clock.wait_until(Stamp::from_secs(0.008));
        assert!(wall.now() >= Stamp::from_secs(0.008));
        assert_eq!(wall.behind(), Duration::ZERO);
        #[expect(clippy::disallowed_methods, reason = "a pause of the machine")]
        std::thread::sleep(Duration::from_millis(300));
        clock.wait_until(Stamp::from_secs(0.012));
        assert_eq!(clock.now(), Stamp::from_secs(0.012));
        // Who shares the time is in step again.
        assert!(wall.behind() >= Duration::from_millis(290));
        let before = wall.now();
        assert!(before.since(clock.now()) < CATCH_UP, "{before:?}");
        clock.wait_until(Stamp::from_secs(0.052));
        assert!(
            wall.now().since(before) >= Duration::from_millis(39),
            "no hurry after a slip"
        );
        assert_eq!(seen.lock().unwrap()[..3], [4, 8, 12]);
    }
}
