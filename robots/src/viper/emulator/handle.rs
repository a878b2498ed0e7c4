//! A shared handle to the emulated controller.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hal::{Joints, Stamp};
use tokio::sync::Notify;

use super::controller::Controller;
use super::{EmulatorConfig, Journal, Knobs};
use crate::viper::Port;
use crate::viper::lockstep::Traffic;

/// The emulated controller and its arm; clones share it.
#[derive(Clone, Debug)]
pub struct Emulator {
    pub(super) shared: Arc<Shared>,
}

#[derive(Debug)]
pub(super) struct Shared {
    controller: Mutex<Controller>,
    pub(super) wake: [Notify; 2],
}

impl Emulator {
    /// A controller at time zero without clients.
    pub fn new(config: EmulatorConfig) -> Self {
        Self {
            shared: Arc::new(Shared {
                controller: Mutex::new(Controller::new(config)),
                wake: [Notify::new(), Notify::new()],
            }),
        }
    }

    pub(super) fn controller(&self) -> MutexGuard<'_, Controller> {
        self.shared
            .controller
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn with<T>(&self, act: impl FnOnce(&mut Controller) -> T) -> T {
        let outcome = act(&mut self.controller());
        self.shared.wake.iter().for_each(Notify::notify_one);
        outcome
    }

    /// Lets time pass.
    pub fn advance_to(&self, now: Stamp) {
        self.with(|controller| controller.advance(now));
    }

    /// The emulator's time.
    pub fn now(&self) -> Stamp {
        self.controller().now
    }

    /// True positions of the arm \[rad\], to couple a world to it.
    pub fn true_joints(&self) -> Joints {
        self.controller().true_positions()
    }

    /// True rates of the arm \[rad/s\].
    pub fn true_rates(&self) -> Joints {
        self.controller().true_rates()
    }

    /// Turns knobs.
    pub fn turn(&self, act: impl FnOnce(&mut Knobs)) {
        self.with(|controller| controller.turn(act));
    }

    /// Sends raw bytes to the client of a port.
    pub fn inject(&self, port: Port, bytes: &[u8]) {
        self.with(|controller| controller.inject(port, bytes));
    }

    /// Throws the client of a port out.
    pub fn throw_out(&self, port: Port) {
        self.with(|controller| controller.close(port));
    }

    /// A copy of the journal.
    pub fn journal(&self) -> Journal {
        self.controller().journal.clone()
    }

    /// Whether the port has a client.
    pub fn has_client(&self, port: Port) -> bool {
        self.controller().connections[port as usize].open
    }

    /// A client of a port arrives; false if it is turned away.
    pub(in crate::viper) fn connect(&self, port: Port) -> bool {
        self.with(|controller| controller.connect(port))
    }

    /// The client of a port left.
    pub(in crate::viper) fn disconnect(&self, port: Port) {
        self.with(|controller| controller.disconnect(port));
    }

    /// Bytes from the client of a port.
    pub(in crate::viper) fn receive(&self, now: Stamp, port: Port, bytes: &[u8]) {
        self.with(|controller| controller.receive(now, port, bytes));
    }

    /// Whether the client of a port is to be thrown out.
    pub(in crate::viper) fn is_closing(&self, port: Port) -> bool {
        self.controller().connections[port as usize].closing
    }

    /// The next bytes for the client of a port that have arrived by the emulator's time.
    pub(in crate::viper) fn transmit(&self, port: Port) -> Option<Vec<u8>> {
        let mut controller = self.controller();
        let now = controller.now;
        let connection = &mut controller.connections[port as usize];
        let bytes = connection.outbox.pop(now)?;
        connection.sent += bytes.len() as u64;
        Some(bytes)
    }

    pub(in crate::viper) fn traffic(&self) -> Traffic {
        let controller = self.controller();
        let mut traffic = Traffic {
            is_quiet: true,
            ..Traffic::default()
        };
        for connection in &controller.connections {
            traffic.connections += usize::from(connection.open);
            traffic.sent += connection.sent;
            traffic.received += connection.received;
            let due = connection
                .outbox
                .next_due()
                .is_some_and(|due| due <= controller.now);
            traffic.is_quiet &= !due && !connection.closing;
        }
        traffic
    }
}
