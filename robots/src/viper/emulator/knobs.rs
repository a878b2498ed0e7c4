//! What can be made to go wrong.

use std::time::Duration;

use crate::viper::wire::{ByteOrder, steer};

/// Faults and flaws of the emulated controller; all off by default. They act from the moment
/// they are set.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of its own")]
pub struct Knobs {
    /// Emergency stop pressed. Releasing it gives no power back.
    pub e_stop: bool,
    /// Drives have power.
    pub powered: bool,
    /// Operating mode on the wire: 1 manual, 2 automatic.
    pub mode: i32,
    /// Error number; not 0 means in error.
    pub error_code: i32,
    /// The 2018 program aborts when it is to move without power, as it does on a motion error;
    /// else it acknowledges and does not move. Which of the two is true is not known: the
    /// second, which would go on by itself when power returns, is the harder one for a driver.
    pub abort_without_power: bool,
    /// No feedback is sent.
    pub freeze_feedback: bool,
    /// No answers are sent.
    pub freeze_answers: bool,
    /// Feedback arrives this much later.
    pub feedback_delay: Duration,
    /// Answers arrive this much later.
    pub answer_delay: Duration,
    /// Orders arrive this much later.
    pub order_delay: Duration,
    /// Every delay grows by up to this much, at random but in order.
    pub jitter: Duration,
    /// Share of feedback frames that are lost.
    pub feedback_loss: f64,
    /// How answers lie.
    pub answers: Answers,
    /// Encoders read this much more than the truth \[rad\].
    pub encoder_offset: [f64; steer::JOINTS],
    /// Byte order of everything sent.
    pub order: ByteOrder,
}

impl Default for Knobs {
    fn default() -> Self {
        Self {
            e_stop: false,
            powered: true,
            mode: 2,
            error_code: 0,
            abort_without_power: false,
            freeze_feedback: false,
            freeze_answers: false,
            feedback_delay: Duration::ZERO,
            answer_delay: Duration::ZERO,
            order_delay: Duration::ZERO,
            jitter: Duration::ZERO,
            feedback_loss: 0.0,
            answers: Answers::True,
            encoder_offset: [0.0; steer::JOINTS],
            order: ByteOrder::Big,
        }
    }
}

/// How answers lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Answers {
    /// They do not.
    #[default]
    True,
    /// Reply code FAILURE.
    Failure,
    /// Another sequence number.
    WrongSequence,
    /// Every answer twice.
    Twice,
}
