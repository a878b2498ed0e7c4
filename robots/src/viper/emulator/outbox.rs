//! Bytes on their way to the client.

use std::collections::VecDeque;
use std::time::Duration;

use hal::Stamp;

/// Pieces that may wait; a client that does not read loses the newest feedback.
const MOST: usize = 1024;

/// Bytes in order, each with the time at which it arrives.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    pieces: VecDeque<(Stamp, Vec<u8>)>,
    noise: u64,
}

impl Outbox {
    pub(super) const fn new(seed: u64) -> Self {
        Self {
            pieces: VecDeque::new(),
            noise: seed,
        }
    }

    pub(super) fn clear(&mut self) {
        self.pieces.clear();
    }

    /// A number in 0..1 (splitmix64).
    pub(super) fn chance(&mut self) -> f64 {
        self.noise = self.noise.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.noise;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(super) fn push(&mut self, now: Stamp, delay: Duration, jitter: Duration, bytes: &[u8]) {
        if self.pieces.len() == MOST {
            return;
        }
        let extra = if jitter.is_zero() {
            jitter
        } else {
            jitter.mul_f64(self.chance())
        };
        let due = now + delay + extra;
        // A stream keeps its order.
        let due = self.pieces.back().map_or(due, |(last, _)| due.max(*last));
        self.pieces.push_back((due, bytes.to_vec()));
    }

    /// The next piece that has arrived by `now`.
    pub(super) fn pop(&mut self, now: Stamp) -> Option<Vec<u8>> {
        let arrived = self.pieces.front().is_some_and(|(due, _)| *due <= now);
        arrived
            .then(|| self.pieces.pop_front())
            .flatten()
            .map(|(_, bytes)| bytes)
    }

    /// When the next piece arrives.
    pub(super) fn next_due(&self) -> Option<Stamp> {
        self.pieces.front().map(|(due, _)| *due)
    }
}
