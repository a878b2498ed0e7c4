//! What a user may ask of a run while it goes on: stop, pause, retract, another target, and the
//! dead-man's switch.

use std::collections::VecDeque;
use std::io::Write;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Mutex, MutexGuard, PoisonError};

use hal::Position;
use hal::frame::LeftCamera;

use crate::aim::{Answer, TargetRefused};

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

/// A target that was given, and who wants to hear what becomes of it.
pub(crate) struct Aim {
    pub(crate) target: Position<LeftCamera>,
    answer: Box<dyn FnOnce(Answer) + Send>,
}

impl Aim {
    /// Answers who gave it.
    pub(crate) fn answer(self, answer: Answer) {
        (self.answer)(answer);
    }
}

impl std::fmt::Debug for Aim {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Aim").field(&self.target).finish()
    }
}

/// Shared between the run and whoever controls it; every method may be called from any thread.
#[derive(Debug, Default)]
pub struct Controls {
    interrupted: AtomicBool,
    why_interrupted: Mutex<Option<String>>,
    stopped: AtomicBool,
    aims: Mutex<VecDeque<Aim>>,
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

    /// Gives another target, in the stereo frame. The answer comes when the run looks at it: at its
    /// start, or within a period of the arm; a target that is refused leaves the run the one that
    /// it has. While there is no run nobody answers.
    pub fn aim(&self, target: Position<LeftCamera>) -> Receiver<Answer> {
        let (sender, receiver) = sync_channel(1);
        self.aim_then(target, move |answer| {
            // Who gave the target need not listen.
            let _ = sender.try_send(answer);
        });
        receiver
    }

    /// As [`Controls::aim`]; `answer` is called with the answer, on the run's thread.
    pub fn aim_then(
        &self,
        target: Position<LeftCamera>,
        answer: impl FnOnce(Answer) + Send + 'static,
    ) {
        let answer = Box::new(answer);
        lock(&self.aims).push_back(Aim { target, answer });
    }

    /// The next target that was given and not answered yet.
    pub(crate) fn next_aim(&self) -> Option<Aim> {
        lock(&self.aims).pop_front()
    }

    /// Refuses targets that came too late.
    pub(crate) fn refuse_aims(&self) {
        while let Some(aim) = self.next_aim() {
            aim.answer(Err(TargetRefused::Ended));
        }
    }

    /// Stops the arm and ends the program.
    pub fn interrupt(&self) {
        self.interrupted.store(true, Ordering::Release);
    }

    /// Stops the arm and ends the program for a reason other than the user's wish, which is said on
    /// standard error.
    pub fn interrupt_because(&self, reason: &dyn std::fmt::Display) {
        lock(&self.why_interrupted).get_or_insert_with(|| reason.to_string());
        self.interrupt();
        // Nothing can be done about a closed stderr.
        let _ = writeln!(std::io::stderr(), "the run ends: {reason}");
    }

    /// The reason for which the program is to end, other than the user's wish.
    pub fn why_interrupted(&self) -> Option<String> {
        lock(&self.why_interrupted).clone()
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

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
