//! What a topic's ends promise. ROS 1 has queues and latches only; ROS 2 has more.

/// A topic's kind, and how many messages are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Quality {
    /// The newest counts and what is lost is lost (in ROS 2 best effort): a reader of this kind hears
    /// every writer, a writer only readers of this kind.
    Stream(u16),
    /// What is sent arrives, as long as connections hold (in ROS 2 reliable).
    Event(u16),
    /// As [`Event`](Self::Event), and whoever comes late gets the last one (latched; in ROS 2 transient
    /// local).
    Latched(u16),
}

impl Quality {
    /// Messages that are kept.
    pub(super) fn queue(self) -> usize {
        let (Self::Stream(kept) | Self::Event(kept) | Self::Latched(kept)) = self;
        usize::from(kept)
    }

    pub(super) const fn is_latched(self) -> bool {
        matches!(self, Self::Latched(_))
    }
}
