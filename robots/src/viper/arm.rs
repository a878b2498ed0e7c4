//! The driver as a [`hal::Arm`], and the handles beside it.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hal::telemetry::Limit;
use hal::{Arm, ArmDescription, ArmMode, ArmState, Error, Joints, RateCommand, Stamp};

use super::driver::{Core, Fault, LinkError, Metrics, Refused, Unfit};
use super::tcp::Transport;

/// A function that tells the present time of the rig's clock.
pub type Now = Arc<dyn Fn() -> Stamp + Send + Sync>;

/// What the arm's handles and its transport share.
pub(super) struct Shared {
    core: Mutex<Core>,
    now: Option<Now>,
    wake: tokio::sync::Notify,
}

impl Shared {
    /// On a wall clock `now` tells the time; on a virtual one the core's own time counts.
    pub(super) fn new(core: Core, now: Option<Now>) -> Arc<Self> {
        Arc::new(Self {
            core: Mutex::new(core),
            now,
            wake: tokio::sync::Notify::new(),
        })
    }

    /// The core; held for computations only, never across I/O.
    pub(super) fn core(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The present time.
    pub(super) fn now(&self, core: &Core) -> Stamp {
        self.now.as_ref().map_or_else(|| core.time(), |now| now())
    }

    /// Tells the transport that there is something to send or to connect.
    pub(super) fn notify(&self) {
        self.wake.notify_one();
    }

    pub(super) async fn notified(&self) {
        self.wake.notified().await;
    }

    fn with<T>(&self, act: impl FnOnce(&mut Core, Stamp) -> T) -> T {
        let mut core = self.core();
        let now = self.now(&core);
        let outcome = act(&mut core, now);
        drop(core);
        self.notify();
        outcome
    }
}

impl fmt::Debug for Shared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared")
            .field("core", &self.core)
            .finish_non_exhaustive()
    }
}

/// A Viper S650, as an arm that executes joint rates. Dropping it stops the arm, also when a
/// panic unwinds, and ends its thread.
#[derive(Debug)]
pub struct ViperArm {
    shared: Arc<Shared>,
    description: ArmDescription,
    transport: Option<Transport>,
}

impl ViperArm {
    pub(super) fn new(shared: Arc<Shared>, transport: Option<Transport>) -> Self {
        let description = shared.core().description().clone();
        Self {
            shared,
            description,
            transport,
        }
    }

    /// A view of the driver that other threads may hold.
    pub fn monitor(&self) -> Monitor {
        Monitor {
            shared: Arc::clone(&self.shared),
        }
    }

    fn ask<T>(&self, act: impl FnOnce(&mut Core, Stamp) -> Result<T, Refused>) -> Result<T, Error> {
        self.shared.with(act).map_err(|refused| {
            Error::with_source(self.description.name.clone(), refused.kind(), refused)
        })
    }
}

impl Arm for ViperArm {
    fn description(&self) -> &ArmDescription {
        &self.description
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        self.ask(Core::state)
    }

    fn enable(&mut self) -> Result<(), Error> {
        self.ask(Core::enable)
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        self.ask(|core, now| core.command(now, command))
    }

    fn stop(&mut self) -> Result<(), Error> {
        self.ask(Core::stop)
    }

    fn reset(&mut self) -> Result<(), Error> {
        self.ask(Core::reset)
    }

    fn explanation(&self) -> Option<String> {
        self.shared.core().fault().map(ToString::to_string)
    }
}

impl Drop for ViperArm {
    fn drop(&mut self) {
        self.shared.with(Core::shut_down);
        if let Some(transport) = self.transport.take() {
            transport.end();
        }
    }
}

/// A view of the driver: mode, causes, health.
#[derive(Clone, Debug)]
pub struct Monitor {
    shared: Arc<Shared>,
}

impl Monitor {
    /// The driver's mode.
    pub fn mode(&self) -> ArmMode {
        self.shared.core().mode()
    }

    /// The latched fault with its numbers.
    pub fn fault(&self) -> Option<Fault> {
        self.shared.core().fault().cloned()
    }

    /// Why the link ended last, or was never made.
    pub fn link_error(&self) -> LinkError {
        self.shared.core().link_error().clone()
    }

    /// Why the arm behind the link is not the configured one, as far as it is known.
    pub fn unfit(&self) -> Option<Unfit> {
        self.shared.core().unfit()
    }

    /// The newest joint positions read \[rad\]; `None` before the first feedback.
    pub fn positions(&self) -> Option<Joints> {
        self.shared.core().positions()
    }

    /// Limits that slowed the last segment.
    pub fn limits_acted(&self) -> Vec<Limit> {
        self.shared.core().limits_acted().to_vec()
    }

    /// Where the arm is ordered to be \[rad\]; `None` before it was first enabled.
    pub fn set_point(&self) -> Option<Joints> {
        self.shared.core().set_point()
    }

    /// Health of link and timing.
    pub fn metrics(&self) -> Metrics {
        self.shared.core().metrics()
    }
}
