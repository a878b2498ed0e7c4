//! What the robot's controller says of itself, and whether it still does.

use std::time::Duration;

use hal::{FaultReason, Stamp};

/// Reports that come at most so far apart come regularly: ROS-Industrial's drivers send them at
/// several hertz. One that is latched, or sent when something changes, says nothing by its absence.
const REGULAR: Duration = Duration::from_secs(1);
/// So many regular ones in a row ...
const ENOUGH: u32 = 10;
/// ... make a silence of this length tell that who reports has ended.
const SILENT: Duration = Duration::from_secs(2);

/// The reports so far.
#[derive(Debug, Default)]
pub(super) struct Reports {
    /// Why the controller cannot move the robot, where it says so.
    pub(super) hindrance: Option<FaultReason>,
    last: Option<Stamp>,
    regular: u32,
}

impl Reports {
    /// Takes in a report that arrived at `now`.
    pub(super) fn take(&mut self, now: Stamp, hindrance: Option<FaultReason>) {
        self.hindrance = hindrance;
        let regular = self.last.is_some_and(|last| now.since(last) <= REGULAR);
        self.regular = if regular {
            self.regular.saturating_add(1)
        } else {
            0
        };
        self.last = Some(now);
    }

    /// For how long there have been none, where they came regularly before.
    pub(super) fn silence(&self, now: Stamp) -> Option<Duration> {
        let silence = now.since(self.last?);
        (self.regular >= ENOUGH && silence > SILENT).then_some(silence)
    }

    /// Goes on without reports until they come regularly again.
    pub(super) fn forget(&mut self) {
        self.regular = 0;
        self.last = None;
    }
}

/// The silence in words.
pub(super) fn silent(silence: Duration) -> String {
    format!(
        "robot_status came regularly and has been silent for {:.1} s: what reports it has ended; \
         clearing the fault goes on without it",
        silence.as_secs_f64()
    )
}
