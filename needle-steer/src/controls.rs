//! What a user may ask of a run while it goes on: stop, pause, retract, another target, and the
//! dead-man's switch.

use std::io::Write;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use hal::Position;
use hal::frame::LeftCamera;

/// What the user wants the run to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Go on.
    Proceed,
    /// Hold still.
    Pause,
    /// Withdraw along the path that the base came.
    Retract,
}

/// Codes of what is asked for; from [`RETRACT`] on it is a withdrawal.
const PROCEED: u8 = 0;
const PAUSE: u8 = 1;
const RETRACT: u8 = 2;
const RETRACT_PAUSED: u8 = 3;

/// Shared between the run and whoever controls it; every method may be called from any thread.
#[derive(Debug, Default)]
pub struct Controls {
    interrupted: AtomicBool,
    stopped: AtomicBool,
    target: Mutex<Option<Position<LeftCamera>>>,
    wish: AtomicU8,
    dead_man: AtomicU64,
}

impl Controls {
    /// Stops the arm and ends the run; a node that shows it stays.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Release);
    }

    /// Whether the run is to end: stopped or interrupted.
    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire) || self.is_interrupted()
    }

    /// Forgets a stop and a wish of the run that has ended.
    pub fn renew(&self) {
        self.stopped.store(false, Ordering::Release);
        self.wish.store(PROCEED, Ordering::Release);
    }

    /// Gives another target, in the stereo frame.
    pub fn aim(&self, target: Position<LeftCamera>) {
        *self.target.lock().unwrap_or_else(PoisonError::into_inner) = Some(target);
    }

    /// A target given since the last call.
    pub fn take_target(&self) -> Option<Position<LeftCamera>> {
        self.target
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
    }

    /// Stops the arm and ends the program.
    pub fn interrupt(&self) {
        self.interrupted.store(true, Ordering::Release);
    }

    /// Stops the arm and ends the program for a reason other than the user's wish, which is said on
    /// standard error.
    pub fn interrupt_because(&self, reason: &dyn std::fmt::Display) {
        self.interrupt();
        // Nothing can be done about a closed stderr.
        let _ = writeln!(std::io::stderr(), "the run ends: {reason}");
    }

    /// Whether the program is to end.
    pub fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Acquire)
    }

    /// Asks for something else. A withdrawal once asked for may be paused, and goes on when it is
    /// asked for again; it never goes over into steering.
    pub fn ask(&self, wish: Wish) {
        let change = |before| match wish {
            Wish::Retract => Some(RETRACT),
            Wish::Pause if before >= RETRACT => Some(RETRACT_PAUSED),
            Wish::Proceed if before >= RETRACT => None,
            Wish::Pause => Some(PAUSE),
            Wish::Proceed => Some(PROCEED),
        };
        // An error says that nothing was changed.
        let _ = self
            .wish
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, change);
    }

    /// What is asked for.
    pub fn wish(&self) -> Wish {
        match self.wish.load(Ordering::Acquire) {
            PROCEED => Wish::Proceed,
            PAUSE => Wish::Pause,
            _ => Wish::Retract,
        }
    }

    /// Whether the arm is to hold still, inserting or withdrawing.
    pub fn is_holding(&self) -> bool {
        matches!(self.wish.load(Ordering::Acquire), PAUSE | RETRACT_PAUSED)
    }

    /// Refreshes the dead-man's token: any call counts.
    pub fn refresh_dead_man(&self) {
        self.dead_man.fetch_add(1, Ordering::Release);
    }

    /// Number of refreshes so far.
    pub fn dead_man_count(&self) -> u64 {
        self.dead_man.load(Ordering::Acquire)
    }
}
