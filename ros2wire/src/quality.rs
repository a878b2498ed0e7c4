//! What the ends of a topic promise each other.

use rustdds::policy::{Durability, History, Reliability, ResourceLimits};
use rustdds::{Duration, QosPolicies, QosPolicyBuilder};

/// Samples that a reader which says nothing may leave unacknowledged before new ones are dropped for
/// all: at 100 Hz twenty seconds, after which such a reader has lost its lease.
const WINDOW: i32 = 2048;

/// A topic's quality of service, and how many samples are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// Best effort: the newest counts, what is lost is lost. A reader of this kind hears every writer.
    Stream(u16),
    /// Reliable.
    Event(u16),
    /// Reliable, and kept for readers that come later (transient local).
    Latched(u16),
}

impl Quality {
    /// As DDS has it. Writers never wait.
    pub(crate) fn policies(self) -> QosPolicies {
        let reliable = Reliability::Reliable {
            max_blocking_time: Duration::ZERO,
        };
        let (reliability, durability, depth) = match self {
            Self::Stream(depth) => (Reliability::BestEffort, Durability::Volatile, depth),
            Self::Event(depth) => (reliable, Durability::Volatile, depth),
            Self::Latched(depth) => (reliable, Durability::TransientLocal, depth),
        };
        QosPolicyBuilder::new()
            .reliability(reliability)
            .durability(durability)
            .history(History::KeepLast {
                depth: i32::from(depth.max(1)),
            })
            .resource_limits(ResourceLimits {
                max_samples: WINDOW,
                max_instances: 1,
                max_samples_per_instance: WINDOW,
            })
            .build()
    }
}
