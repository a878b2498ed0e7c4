//! When to connect, and when to give up.

use std::time::Duration;

use hal::Stamp;

use super::fault::LinkError;
use crate::viper::config::Timing;

/// The two connections of one controller, seen as one link.
#[derive(Debug)]
pub(super) struct Link {
    state: State,
    generation: u64,
    failures: u32,
    noise: u64,
    pub(super) last_error: LinkError,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    /// Waiting to connect again.
    Down { retry_at: Stamp },
    /// The transport connects.
    Connecting { since: Stamp },
    /// Connected; greeting, first feedback and first status are awaited.
    Greeting { since: Stamp },
    /// In use.
    Up,
    /// Closed for good.
    Closed,
}

impl Link {
    pub(super) const fn new(seed: u64) -> Self {
        Self {
            state: State::Down {
                retry_at: Stamp::ZERO,
            },
            generation: 0,
            failures: 0,
            noise: seed,
            last_error: LinkError::NotYet,
        }
    }

    /// The connection that the transport should have now; an other one is to be closed.
    pub(super) const fn wanted(&self) -> Option<u64> {
        match self.state {
            State::Down { .. } | State::Closed => None,
            _ => Some(self.generation),
        }
    }

    pub(super) const fn is_up(&self) -> bool {
        matches!(self.state, State::Up)
    }

    pub(super) const fn is_connecting(&self) -> bool {
        matches!(self.state, State::Connecting { .. })
    }

    pub(super) const fn is_greeting(&self) -> bool {
        matches!(self.state, State::Greeting { .. })
    }

    /// Starts an attempt when it is due; tells when waiting was too long.
    pub(super) fn tick(&mut self, now: Stamp, timing: &Timing) -> Result<(), LinkError> {
        match self.state {
            State::Down { retry_at } if now >= retry_at => {
                self.generation += 1;
                self.state = State::Connecting { since: now };
                Ok(())
            }
            State::Connecting { since } if now.since(since) > timing.connect => {
                Err(LinkError::ConnectTimeout)
            }
            State::Greeting { since } if now.since(since) > timing.silence => Err(LinkError::Mute),
            _ => Ok(()),
        }
    }

    /// Both connections stand.
    pub(super) fn connected(&mut self, now: Stamp, generation: u64) -> bool {
        let expected =
            matches!(self.state, State::Connecting { .. }) && generation == self.generation;
        if expected {
            self.state = State::Greeting { since: now };
        }
        expected
    }

    /// The controller has answered and reported.
    pub(super) const fn up(&mut self) {
        self.state = State::Up;
        self.failures = 0;
    }

    /// Ends the link; the next attempt waits for a doubling time with jitter.
    pub(super) fn lose(&mut self, now: Stamp, error: LinkError, timing: &Timing) {
        if self.state == State::Closed {
            return;
        }
        self.last_error = error;
        let doubled = timing
            .backoff_least
            .saturating_mul(1 << self.failures.min(16));
        self.failures = self.failures.saturating_add(1);
        // Uniform over the upper half, so that clients of one controller do not march in step.
        let wait = doubled
            .min(timing.backoff_most)
            .mul_f64(0.5 + 0.5 * self.uniform());
        self.state = State::Down {
            retry_at: now + wait.max(Duration::from_millis(1)),
        };
    }

    pub(super) const fn close(&mut self) {
        self.state = State::Closed;
    }

    /// A number in 0..1 (splitmix64).
    fn uniform(&mut self) -> f64 {
        self.noise = self.noise.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.noise;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_longest_and_restart_after_success() {
        let timing = Timing::default();
        let mut link = Link::new(7);
        let mut now = Stamp::ZERO;
        for failure in 0..12 {
            link.tick(now, &timing).unwrap();
            assert_eq!(link.wanted(), Some(failure + 1));
            link.lose(now, LinkError::ConnectTimeout, &timing);
            let full = (0.1 * f64::from(1 << failure)).min(5.0);
            let State::Down { retry_at } = link.state else {
                panic!("{link:?}")
            };
            let wait = retry_at.secs_since(now);
            assert!(
                (0.5 * full..=full).contains(&wait),
                "{failure}: {wait} s of {full} s"
            );
            now = retry_at;
        }
        link.tick(now, &timing).unwrap();
        assert!(link.connected(now, 13));
        link.up();
        link.lose(now, LinkError::Closed, &timing);
        let State::Down { retry_at } = link.state else {
            panic!("{link:?}")
        };
        assert!(retry_at.secs_since(now) <= 0.1);
    }
}
