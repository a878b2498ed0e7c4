//! `relay`: the watchdog as a node.

use std::sync::Arc;
use std::time::Duration;

use rosbridge::TimeBase;
use rosbridge::relay::{Relay, RelayError, RelayOptions};

use super::Link;
use crate::config::Config;
use crate::controls::Controls;

/// How often the relay looks whether it is to end.
const PERIOD: Duration = Duration::from_millis(20);

/// Why there is no relay.
#[derive(Debug, thiserror::Error)]
pub enum RelayNodeError {
    /// No node.
    #[error("ROS: {0}")]
    Node(#[from] rosbridge::NodeError),
    /// No relay.
    #[error("relay: {0}")]
    Relay(#[from] RelayError),
}

/// Relays velocities until `controls` are interrupted or the node is asked to end; calls `ready`
/// when it does.
///
/// # Errors
/// See [`RelayNodeError`].
#[expect(clippy::disallowed_methods, reason = "waits for the end")]
pub fn relay(
    config: &Config,
    options: &RelayOptions,
    controls: &Arc<Controls>,
    ready: impl FnOnce(),
) -> Result<(), RelayNodeError> {
    let link = Link::named(config, "needle_steer_relay", TimeBase::Simulated)?;
    link.end_with_node(controls);
    let relay = Relay::start(&link.node, options)?;
    ready();
    while !controls.is_interrupted() {
        std::thread::sleep(PERIOD);
    }
    drop(relay);
    link.node.shutdown();
    Ok(())
}
