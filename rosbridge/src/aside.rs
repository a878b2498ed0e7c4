//! Work beside a run: a thread that is handed things over a bounded queue, and never waited for.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

/// The run's end of the queue. Dropping it ends the queue, and waits until the thread has done what is
/// in it.
pub struct Aside<T> {
    items: Option<SyncSender<T>>,
    dropped: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl<T: Send + 'static> Aside<T> {
    /// Starts a thread `name` that does `work` until the queue ends; up to `room` things wait in it.
    /// The second argument of `work` counts those that found no room.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn start(
        name: &str,
        room: usize,
        work: impl FnOnce(&Receiver<T>, &AtomicU64) + Send + 'static,
    ) -> std::io::Result<Self> {
        let (items, queue) = sync_channel(room);
        let dropped = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&dropped);
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || work(&queue, &counted))?;
        Ok(Self {
            items: Some(items),
            dropped,
            thread: Some(thread),
        })
    }

    /// Hands `item` over; where there is no room, it is dropped and counted.
    pub fn put(&self, item: T) {
        let sent = self
            .items
            .as_ref()
            .is_some_and(|items| items.try_send(item).is_ok());
        if !sent {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Things that found no room.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl<T> Drop for Aside<T> {
    fn drop(&mut self) {
        self.items = None;
        if let Some(thread) = self.thread.take() {
            // A panic has been reported where it happened.
            let _ = thread.join();
        }
    }
}

impl<T> std::fmt::Debug for Aside<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Aside")
            .field("dropped", &self.dropped)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn what_finds_no_room_is_counted_and_the_rest_is_done_before_the_end() {
        let (go, wait) = channel::<()>();
        let (out, done) = channel();
        let aside = Aside::start("aside", 4, move |items, dropped| {
            wait.recv().unwrap();
            for item in items {
                out.send(item).unwrap();
            }
            out.send(dropped.load(Ordering::Relaxed)).unwrap();
        })
        .unwrap();
        for item in 0..10 {
            aside.put(item);
        }
        assert_eq!(aside.dropped(), 6);
        go.send(()).unwrap();
        drop(aside);
        assert_eq!(done.iter().collect::<Vec<_>>(), [0, 1, 2, 3, 6]);
    }
}
