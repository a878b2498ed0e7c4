//! The two clocks of a run.

use std::fmt;
use std::time::{Duration, Instant};

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

/// Wall-clock time since an origin; may be read from any thread.
#[derive(Clone, Copy, Debug)]
pub struct WallTime(Instant);

impl WallTime {
    /// Time that counts from now on.
    #[expect(clippy::disallowed_methods, reason = "this is the clock of the edge")]
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// The present time.
    pub fn now(&self) -> Stamp {
        Stamp::ZERO + self.0.elapsed()
    }
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

    /// A clock that starts now and moves a simulated world at least every `tick`.
    #[must_use]
    pub fn driving(tick: Duration, advance: impl FnMut(Stamp) + Send + 'static) -> Self {
        Self::new().and_driving(tick, advance)
    }

    /// The same clock moving a simulated world at least every `tick`.
    #[must_use]
    pub fn and_driving(self, tick: Duration, advance: impl FnMut(Stamp) + Send + 'static) -> Self {
        Self {
            tick,
            advance: Some(Box::new(advance)),
            ..self
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
                advance(now.min(deadline));
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
}
