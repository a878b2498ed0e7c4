//! What other programs ask of a run.

use crate::Position;
use crate::frame::LeftCamera;

/// What somebody outside wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Start the insertion, or go on after a pause.
    Start,
    /// Stop the arm and end the run.
    Stop,
    /// Hold still.
    Pause,
    /// Withdraw along the path.
    Retract,
    /// Move to the start pose.
    Home,
    /// Clear a latched fault.
    ClearFault,
    /// Allow or forbid motion.
    Enable(bool),
    /// A new target; finite.
    Target(Position<LeftCamera>),
}

/// What became of a request: in words, both ways.
pub type Verdict = Result<String, String>;

/// A request that is answered once.
pub struct Request {
    /// What is wanted.
    pub command: Command,
    answer: Box<dyn FnOnce(Verdict) + Send>,
}

impl Request {
    /// A request; `answer` is called on the run's thread and must not wait.
    pub fn new(command: Command, answer: impl FnOnce(Verdict) + Send + 'static) -> Self {
        let answer = Box::new(answer);
        Self { command, answer }
    }

    /// Tells the caller that it is done or under way.
    pub fn accept(self, text: impl Into<String>) {
        (self.answer)(Ok(text.into()));
    }

    /// Tells the caller why not.
    pub fn refuse(self, reason: impl Into<String>) {
        (self.answer)(Err(reason.into()));
    }
}

impl core::fmt::Debug for Request {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_tuple("Request").field(&self.command).finish()
    }
}
