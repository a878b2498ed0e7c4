//! The dead-man's switch over ROS: a topic and a service of one name.
//!
//! Both only ever keep an arm going. Where their messages stop, for whatever reason, it stops.

use std::sync::Arc;

use crate::msg::{std_msgs, std_srvs};
use crate::seam::{Inlet, Node, NodeError, Quality, Service};

/// Name of the topic (`std_msgs/Empty`) and of the service (`std_srvs/Trigger`).
pub const DEAD_MAN: &str = "~dead_man";

/// Calls `refresh` at every message and every call, on a thread of theirs.
///
/// # Errors
/// The master does not register topic or service.
pub fn listen(node: &Node, refresh: impl Fn() + Send + Sync + 'static) -> Result<(), NodeError> {
    let by_topic = Arc::new(refresh);
    let by_service = Arc::clone(&by_topic);
    Inlet::open::<std_msgs::Empty>(node, DEAD_MAN, Quality::Stream(1), move |_| by_topic())?;
    Service::open::<std_srvs::Trigger>(node, DEAD_MAN, move |_| {
        by_service();
        Ok(std_srvs::TriggerRes {
            success: true,
            message: "held".to_owned(),
        })
    })
}
