//! What waits to be written to one connection, bounded in bytes.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Bytes that may wait for a connection.
const ROOM: usize = 4 << 20;

#[derive(Debug, Default)]
struct State {
    queue: VecDeque<Arc<[u8]>>,
    bytes: usize,
    closed: bool,
}

/// A bounded queue between who has news and who writes it.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    state: Mutex<State>,
    ready: Condvar,
}

impl Outbox {
    /// Puts messages at the end; false where there is no room, or nobody writes any more.
    pub(super) fn push(&self, messages: &Arc<[u8]>) -> bool {
        let mut state = self.lock();
        if state.closed || state.bytes + messages.len() > ROOM {
            return false;
        }
        state.bytes += messages.len();
        state.queue.push_back(Arc::clone(messages));
        drop(state);
        self.ready.notify_one();
        true
    }

    /// Takes nothing any more; what waits may still be written.
    pub(super) fn close(&self) {
        self.lock().closed = true;
        self.ready.notify_one();
    }

    /// The next messages; waits for them. Nothing where it is closed and empty.
    pub(super) fn next(&self) -> Option<Arc<[u8]>> {
        let mut state = self.lock();
        loop {
            if let Some(messages) = state.queue.pop_front() {
                state.bytes -= messages.len();
                return Some(messages);
            }
            if state.closed {
                return None;
            }
            state = self
                .ready
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_bounded_in_bytes_and_empties_after_it_is_closed() {
        let outbox = Outbox::default();
        let megabyte: Arc<[u8]> = vec![0; 1 << 20].into();
        let taken = (0..10).filter(|_| outbox.push(&megabyte)).count();
        assert_eq!(taken, ROOM >> 20);
        assert!(outbox.next().is_some());
        assert!(outbox.push(&megabyte));
        outbox.close();
        assert!(!outbox.push(&megabyte));
        assert_eq!(std::iter::from_fn(|| outbox.next()).count(), taken);
    }
}
