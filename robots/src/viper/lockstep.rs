//! Driver and emulator on one virtual clock, joined in memory or over TCP.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;

use hal::{Clock, Stamp};

use super::arm::{Shared, ViperArm};
use super::driver::{Core, LinkError};
use super::emulator::Server;
use super::tcp::{StartError, Transport};
use super::{Emulator, Port};

/// Driver and emulator advanced together. A command given at a tick acts from that tick on, as
/// with a simulated arm.
pub struct Lockstep {
    shared: Arc<Shared>,
    emulator: Emulator,
    wire: Wire,
    next_tick: Stamp,
    period: Duration,
    stalled_until: Stamp,
    ahead: Duration,
    dead: bool,
}

enum Wire {
    Memory(Cable),
    Tcp { _server: Server },
}

/// A cable in memory.
#[derive(Debug, Default)]
struct Cable {
    generation: Option<u64>,
    cut: bool,
    refuse: bool,
}

impl Lockstep {
    /// Driver and emulator joined in memory.
    ///
    pub fn in_memory(core: Core, emulator: Emulator) -> (ViperArm, Self) {
        let period = core.config().period;
        let shared = Shared::new(core, None);
        let arm = ViperArm::new(Arc::clone(&shared), None);
        (
            arm,
            Self::new(shared, emulator, Wire::Memory(Cable::default()), period),
        )
    }

    /// Driver and emulator joined by TCP on the loopback interface, at free ports. Time stands
    /// still while bytes are on their way, so that runs repeat exactly.
    ///
    /// # Errors
    /// No ports or no threads to be had.
    pub fn over_tcp(mut core: Core, emulator: Emulator) -> Result<(ViperArm, Self), StartError> {
        let loopback = IpAddr::V4(Ipv4Addr::LOCALHOST);
        let server = Server::start(emulator.clone(), loopback, [0, 0], None)?;
        core.set_peer(
            loopback.to_string(),
            server.motion.port(),
            server.state.port(),
        );
        let period = core.config().period;
        let shared = Shared::new(core, None);
        let transport = Transport::start(Arc::clone(&shared), false)?;
        let arm = ViperArm::new(Arc::clone(&shared), Some(transport));
        Ok((
            arm,
            Self::new(shared, emulator, Wire::Tcp { _server: server }, period),
        ))
    }

    fn new(shared: Arc<Shared>, emulator: Emulator, wire: Wire, period: Duration) -> Self {
        Self {
            shared,
            emulator,
            wire,
            next_tick: Stamp::ZERO,
            period,
            stalled_until: Stamp::ZERO,
            ahead: Duration::ZERO,
            dead: false,
        }
    }

    /// The emulated controller.
    pub const fn emulator(&self) -> &Emulator {
        &self.emulator
    }

    /// Lets time pass for both. The driver's period that begins at a tick is computed when time
    /// leaves that tick, with the command given there.
    pub fn advance_to(&mut self, now: Stamp) {
        if self.emulator.now() >= self.stalled_until {
            self.exchange(self.emulator.now());
        }
        while self.next_tick < now {
            let tick = self.next_tick;
            self.next_tick = tick + self.period;
            if tick < self.stalled_until {
                continue;
            }
            self.emulator.advance_to(tick);
            self.exchange(tick);
            if !self.dead {
                self.shared.core().tick(tick + self.ahead);
                self.exchange(tick);
            }
        }
        self.emulator.advance_to(now);
        if now >= self.stalled_until {
            self.exchange(now);
            self.shared.core().set_time(now + self.ahead);
        }
    }

    /// The driver's thread gets no time until then.
    pub const fn stall(&mut self, until: Stamp) {
        self.stalled_until = until;
    }

    /// The driver's clock jumps ahead of the controller's.
    pub fn jump(&mut self, by: Duration) {
        self.ahead += by;
    }

    /// The driver's process is killed: its connections close, nobody says goodbye.
    pub fn kill(&mut self) {
        self.dead = true;
        if let Wire::Memory(cable) = &mut self.wire {
            cable.cut = true;
        }
        for port in Port::ALL {
            self.emulator.disconnect(port);
        }
    }

    /// Cuts the cable, or mends it: bytes vanish, nobody is told.
    pub fn cut(&mut self, cut: bool) {
        if let Wire::Memory(cable) = &mut self.wire {
            cable.cut = cut;
            let wanted = self.shared.core().wanted();
            if !cut && cable.generation != wanted {
                // The controller's first byte to the connection of old is answered by a reset.
                for port in Port::ALL {
                    self.emulator.disconnect(port);
                }
                cable.generation = None;
            }
        }
    }

    /// Refuses connections, or takes them again.
    pub fn refuse(&mut self, refuse: bool) {
        if let Wire::Memory(cable) = &mut self.wire {
            cable.refuse = refuse;
        }
    }

    fn exchange(&mut self, now: Stamp) {
        match &mut self.wire {
            Wire::Memory(cable) => {
                cable.exchange(now, now + self.ahead, &self.shared, &self.emulator);
            }
            Wire::Tcp { .. } => settle(&self.shared, &self.emulator),
        }
    }
}

impl fmt::Debug for Lockstep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Lockstep")
            .field("next_tick", &self.next_tick)
            .field("emulator", &self.emulator)
            .finish_non_exhaustive()
    }
}

impl Cable {
    /// Carries bytes both ways until nobody has anything to say at this instant.
    /// `now` is the controller's time, `here` the driver's.
    fn exchange(&mut self, now: Stamp, here: Stamp, shared: &Shared, emulator: &Emulator) {
        loop {
            let mut core = shared.core();
            self.connect(here, &mut core, emulator);
            let Some(generation) = self.generation else {
                return;
            };
            let mut busy = false;
            while let Some(bytes) = core.transmit(generation) {
                busy = true;
                if !self.cut {
                    emulator.receive(now, Port::Motion, bytes.as_slice());
                }
            }
            for port in Port::ALL {
                while let Some(bytes) = emulator.transmit(port) {
                    busy = true;
                    if !self.cut {
                        core.received(here, generation, port, &bytes);
                    }
                }
            }
            if !self.cut && Port::ALL.iter().any(|port| emulator.is_closing(*port)) {
                core.lost(here, generation, LinkError::Closed);
                busy = true;
            }
            if !busy {
                return;
            }
        }
    }

    fn connect(&mut self, now: Stamp, core: &mut Core, emulator: &Emulator) {
        let wanted = core.wanted();
        if self.cut || self.generation == wanted {
            return;
        }
        if self.generation.take().is_some() {
            for port in Port::ALL {
                emulator.disconnect(port);
            }
        }
        let Some(generation) = wanted else { return };
        if self.refuse {
            let peer = core.config().host.clone();
            let error = LinkError::Connect {
                peer,
                detail: "connection refused".into(),
            };
            return core.lost(now, generation, error);
        }
        let taken = Port::ALL.map(|port| emulator.connect(port));
        if taken == [true, true] {
            self.generation = wanted;
            core.connected(now, generation);
            return;
        }
        for (port, taken) in Port::ALL.into_iter().zip(taken) {
            if taken {
                emulator.disconnect(port);
            }
        }
        core.lost(now, generation, LinkError::Closed);
    }
}

/// Patience with the sockets of a lockstep run: this many naps.
const NAPS: u32 = 200_000;
const NAP: Duration = Duration::from_micros(50);

/// Waits until no byte is on its way between driver and emulator.
fn settle(shared: &Shared, emulator: &Emulator) {
    shared.notify();
    for _ in 0..NAPS {
        let driver = shared.core().traffic();
        let controller = emulator.traffic();
        let quiet = driver.is_quiet && controller.is_quiet;
        // The system completes a connection before the controller's program has taken it.
        let agreed = driver.connections == controller.connections;
        let arrived = driver.sent == controller.received && driver.received == controller.sent;
        if quiet && agreed && (arrived || driver.connections == 0) {
            return;
        }
        nap();
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "virtual time stands still meanwhile"
)]
fn nap() {
    std::thread::sleep(NAP);
}

/// Bytes that passed one end of a link since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Traffic {
    pub(super) sent: u64,
    pub(super) received: u64,
    /// Connections that stand, as this end sees it.
    pub(super) connections: usize,
    /// Nothing waits to be sent or connected.
    pub(super) is_quiet: bool,
}

/// Waits on the rig's clock until the driver is connected.
///
/// # Errors
/// Why it was not, `within` that time.
pub fn await_link(
    arm: &ViperArm,
    clock: &mut dyn Clock,
    within: Duration,
) -> Result<(), LinkError> {
    let monitor = arm.monitor();
    let deadline = clock.now() + within;
    while monitor.mode() == hal::ArmMode::Disconnected {
        let now = clock.now();
        if now >= deadline {
            return Err(monitor.link_error());
        }
        clock.wait_until(now + Duration::from_millis(16));
    }
    Ok(())
}
