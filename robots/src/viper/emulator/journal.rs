//! Everything that passed, and where the arm truly was.

use std::collections::VecDeque;
use std::fmt;

use hal::{Joints, Stamp};

use crate::viper::Port;
use crate::viper::wire::steer::Refusal;

/// One line of the journal.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// When, on the emulator's clock.
    pub stamp: Stamp,
    /// What.
    pub record: Record,
}

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// Bytes from the client.
    Received(Port, Vec<u8>),
    /// Bytes to the client.
    Sent(Port, Vec<u8>),
    /// True positions \[rad\] at a controller cycle.
    Position(Joints),
    /// A client was taken.
    Connected(Port),
    /// A second client was turned away.
    TurnedAway(Port),
    /// The client left, or was thrown out.
    Closed(Port),
    /// A start point was accepted.
    Armed,
    /// The arm was braked.
    Braked,
    /// Motion ended for this reason.
    Disarmed(Option<Refusal>),
    /// A position outside the limits was ordered, and the program was aborted.
    Aborted,
}

/// The newest entries, up to a bound.
#[derive(Clone, Debug)]
pub struct Journal {
    entries: VecDeque<Entry>,
    capacity: usize,
    dropped: u64,
}

impl Journal {
    pub(super) const fn new(capacity: usize) -> Self {
        Self {
            entries: VecDeque::new(),
            capacity,
            dropped: 0,
        }
    }

    pub(super) fn push(&mut self, stamp: Stamp, record: Record) {
        if self.capacity == 0 {
            self.dropped += 1;
            return;
        }
        if self.entries.len() == self.capacity {
            self.entries.pop_front();
            self.dropped += 1;
        }
        self.entries.push_back(Entry { stamp, record });
    }

    /// Oldest first.
    pub fn entries(&self) -> impl ExactSizeIterator<Item = &Entry> {
        self.entries.iter()
    }

    /// Entries that gave way to newer ones.
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }
}

impl fmt::Display for Entry {
    /// One line of text: seconds, what, values; bytes in hexadecimal.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.6} ", self.stamp.as_secs())?;
        match &self.record {
            Record::Received(port, bytes) => {
                write!(f, "received {port:?} ")?;
                hex(f, bytes)
            }
            Record::Sent(port, bytes) => {
                write!(f, "sent {port:?} ")?;
                hex(f, bytes)
            }
            Record::Position(joints) => {
                f.write_str("position")?;
                joints.iter().try_for_each(|q| write!(f, " {q:.9}"))
            }
            record => write!(f, "{record:?}"),
        }
    }
}

fn hex(f: &mut fmt::Formatter<'_>, bytes: &[u8]) -> fmt::Result {
    bytes.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
}
