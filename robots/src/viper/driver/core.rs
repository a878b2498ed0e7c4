//! The state machine: link, feedback, and the points of every period.

use std::time::Duration;

use hal::guarded::{Guard, Limiter, LimiterError, Motion, SpeedCaps, Tool, Workspace};
use hal::telemetry::Limit;
use hal::{ArmDescription, ArmMode, Joints, RateCommand, Stamp};

use super::course::Course;
use super::fault::{Fault, LinkError, Unfit};
use super::feedback::Tracker;
use super::link::Link;
use super::metrics::{Collector, Metrics};
use super::session::{Event, Session};
use crate::viper::Port;
use crate::viper::config::{Config, Dialect};
use crate::viper::lockstep::Traffic;
use crate::viper::wire::Bytes;

/// What the driver is allowed to do.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Mode {
    Disconnected,
    Connected,
    Enabled,
    Moving,
    Stopping { since: Stamp },
    Faulted(Fault),
}

/// The driver without sockets and clock. A transport
/// * opens the connection that [`wanted`](Self::wanted) names, and closes any other;
/// * tells of [`connected`](Self::connected), [`received`](Self::received) and
///   [`lost`](Self::lost);
/// * sends what [`transmit`](Self::transmit) hands out;
/// * calls [`tick`](Self::tick) every period.
#[derive(Debug)]
pub struct Core {
    pub(super) config: Config,
    description: ArmDescription,
    pub(super) guard: Guard,
    pub(super) now: Stamp,
    pub(super) mode: Mode,
    pub(super) link: Link,
    pub(super) session: Session,
    pub(super) tracker: Tracker,
    pub(super) unfit: Option<Unfit>,
    pub(super) course: Option<Course>,
    pub(super) command: Option<RateCommand>,
    pub(super) last_sequence: Option<(u64, Stamp)>,
    pub(super) acted: Vec<Limit>,
    pub(super) metrics: Collector,
    deadline: Option<Stamp>,
    traffic: Traffic,
}

impl Core {
    /// A driver at time zero, without a link.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn new(config: Config) -> Result<Self, SetupError> {
        config.validate()?;
        let hold = config.period * 2;
        let limiter = Limiter::new(&config.limits, config.tolerances.limit_margin, hold)?;
        Ok(Self {
            description: ArmDescription {
                name: config.name.clone(),
                joint_names: config.joint_names.clone(),
                limits: config.limits.clone(),
                period: config.period,
            },
            guard: Guard::new(limiter),
            now: Stamp::ZERO,
            mode: Mode::Disconnected,
            link: Link::new(config.seed),
            session: Session::new(&config),
            tracker: Tracker::default(),
            unfit: None,
            course: None,
            command: None,
            last_sequence: None,
            acted: Vec::new(),
            metrics: Collector::default(),
            deadline: None,
            traffic: Traffic::default(),
            config,
        })
    }

    /// Guards a tool too: its speed and, where given, its workspace.
    #[must_use]
    pub fn with_tool(mut self, limits: ToolLimits) -> Self {
        self.guard = self
            .guard
            .with_tool(limits.tool, limits.workspace, limits.caps);
        self
    }

    /// Points the driver at a controller.
    pub fn set_peer(&mut self, host: String, motion_port: u16, state_port: u16) {
        self.config.host = host;
        self.config.motion_port = motion_port;
        self.config.state_port = state_port;
    }

    /// Begins anew at rest at `positions`.
    pub(super) fn settle_at(&mut self, positions: Joints) {
        self.course = Some(Course::at(positions));
        self.guard.assume(Motion::steady(positions.zeroed()));
    }

    /// The settings.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// The latest time that the driver has seen.
    pub const fn time(&self) -> Stamp {
        self.now
    }

    /// What the arm is.
    pub const fn description(&self) -> &ArmDescription {
        &self.description
    }

    /// The driver's mode in hal's terms.
    pub const fn mode(&self) -> ArmMode {
        match &self.mode {
            Mode::Disconnected => ArmMode::Disconnected,
            Mode::Connected => ArmMode::Connected,
            Mode::Enabled => ArmMode::Enabled,
            Mode::Moving => ArmMode::Moving,
            Mode::Stopping { .. } => ArmMode::Stopping,
            Mode::Faulted(fault) => ArmMode::Faulted(fault.reason()),
        }
    }

    /// The latched fault.
    pub const fn fault(&self) -> Option<&Fault> {
        match &self.mode {
            Mode::Faulted(fault) => Some(fault),
            _ => None,
        }
    }

    /// Why the link ended last.
    pub const fn link_error(&self) -> &LinkError {
        &self.link.last_error
    }

    /// Why the arm behind the link is not the configured one, as far as it is known.
    pub const fn unfit(&self) -> Option<Unfit> {
        self.unfit
    }

    /// The newest positions read \[rad\].
    pub fn positions(&self) -> Option<Joints> {
        self.tracker.sample.map(|sample| sample.positions)
    }

    /// Limits that slowed the last segment.
    pub fn limits_acted(&self) -> &[Limit] {
        &self.acted
    }

    /// Where the arm is ordered to be \[rad\]; `None` before it was first enabled.
    pub fn set_point(&self) -> Option<Joints> {
        self.course.as_ref().map(|course| course.set_point)
    }

    /// Health.
    pub fn metrics(&self) -> Metrics {
        self.metrics.snapshot()
    }

    /// The connection that should stand now, by number; none or another one is to be closed.
    pub const fn wanted(&self) -> Option<u64> {
        self.link.wanted()
    }

    /// Both ports of connection `generation` stand.
    pub fn connected(&mut self, now: Stamp, generation: u64) {
        let now = self.at(now);
        if self.link.connected(now, generation) {
            self.traffic = Traffic::default();
            self.session = Session::new(&self.config);
            self.tracker = Tracker::default();
            self.unfit = None;
            self.session.greet(now, &self.config);
        }
    }

    /// Connection `generation` failed or ended.
    pub fn lost(&mut self, now: Stamp, generation: u64, error: LinkError) {
        let now = self.at(now);
        if self.link.wanted() == Some(generation) {
            self.drop_link(now, error);
        }
    }

    /// Bytes arrived on a port of connection `generation`.
    pub fn received(&mut self, now: Stamp, generation: u64, port: Port, bytes: &[u8]) {
        let now = self.at(now);
        if self.link.wanted() != Some(generation) {
            return;
        }
        self.traffic.received += bytes.len() as u64;
        let mut events = Vec::new();
        let outcome = self
            .session
            .receive(now, port, bytes, &self.config, |_, event| {
                events.push(event);
            });
        for event in events {
            self.handle(now, event);
        }
        if let Err(error) = outcome {
            self.latch(now, Fault::Protocol(error));
            self.drop_link(now, LinkError::Protocol(error));
        }
    }

    /// The next frame for the motion port of connection `generation`.
    pub fn transmit(&mut self, generation: u64) -> Option<Bytes> {
        if self.link.wanted() != Some(generation) {
            return None;
        }
        let bytes = self.session.transmit()?;
        self.traffic.sent += bytes.as_slice().len() as u64;
        Some(bytes)
    }

    /// Whether a stop awaits its answer.
    pub const fn is_stopping(&self) -> bool {
        self.session.is_stopping()
    }

    pub(in crate::viper) fn traffic(&self) -> Traffic {
        let is_quiet = !self.link.is_connecting() && !self.session.has_output();
        let is_linked = self.link.is_greeting() || self.link.is_up();
        Traffic {
            connections: if is_linked { Port::ALL.len() } else { 0 },
            is_quiet,
            ..self.traffic
        }
    }

    /// Advances the driver's time without acting; for commands on a virtual clock.
    pub fn set_time(&mut self, now: Stamp) {
        self.at(now);
    }

    /// One period: watches, then sends the next point.
    pub fn tick(&mut self, now: Stamp) {
        let now = self.at(now);
        let late = self
            .deadline
            .map_or(Duration::ZERO, |deadline| now.since(deadline));
        self.metrics.tick(late);
        self.deadline = Some(now + self.config.period);
        if let Err(error) = self.link.tick(now, &self.config.timing) {
            self.drop_link(now, error);
        }
        if !self.link.is_up() {
            return;
        }
        self.watch(now);
        if late > self.config.timing.command_fault && self.mode == Mode::Moving {
            // The driver itself got no time; the arm went without commands for as long.
            self.latch(
                now,
                Fault::StaleCommand {
                    age_s: late.as_secs_f64(),
                },
            );
        }
        if self.link.is_up() {
            self.move_on(now);
        }
    }

    /// Ends the driver: a last stop is ready for [`transmit`](Self::transmit).
    pub fn shut_down(&mut self, now: Stamp) {
        let now = self.at(now);
        self.halt(now);
        if !matches!(self.mode, Mode::Faulted(_)) {
            self.mode = Mode::Disconnected;
        }
    }

    /// Closes the link for good.
    pub fn close(&mut self) {
        self.link.close();
    }

    /// Time never goes back, whatever the transport says.
    pub(super) fn at(&mut self, now: Stamp) -> Stamp {
        self.now = self.now.max(now);
        self.now
    }

    fn handle(&mut self, now: Stamp, event: Event) {
        match event {
            Event::Greeted(unfit) => self.unfit = self.unfit.or(unfit),
            Event::Accepted(round_trip) => {
                self.metrics.answer(true, round_trip);
                // After a start point the first segment follows at once.
                self.follow_start(now);
            }
            Event::Refused(sequence, refusal) => {
                self.metrics.answer(false, Duration::ZERO);
                self.refused(now, sequence, refusal);
            }
            Event::StopRefused => {
                self.metrics.answer(false, Duration::ZERO);
                // A new connection begins with a stop, and closing this one brakes `steer`.
                self.drop_link(now, LinkError::Refused);
            }
            Event::Stopped(round_trip) => self.metrics.answer(true, round_trip),
            Event::Positions(positions, unfit) => {
                self.unfit = self.unfit.or(unfit);
                self.tracker.positions(now, positions);
                self.check_sample(now);
            }
            Event::Status(status) => {
                self.tracker.status(now, status);
                self.check_status(now);
            }
            Event::Cycle {
                tick,
                cycle,
                positions,
                status,
                disarmed,
                disarmed_by,
            } => {
                let Some(missed) = self.tracker.cycle(now, tick, cycle, positions) else {
                    return;
                };
                self.metrics.counts.missed_feedback += missed;
                self.tracker.status(now, status);
                self.check_status(now);
                if disarmed && self.is_active() {
                    self.latch(now, Fault::Disarmed(disarmed_by));
                }
                self.check_sample(now);
            }
        }
        self.check_link_up();
    }

    fn check_link_up(&mut self) {
        let reported = self.tracker.sample.is_some() && self.tracker.status.is_some();
        if self.link.is_greeting() && reported && self.session.is_clear() {
            self.link.up();
            self.metrics.counts.links += 1;
            if self.mode == Mode::Disconnected {
                self.mode = Mode::Connected;
            }
        }
    }

    pub(super) fn drop_link(&mut self, now: Stamp, error: LinkError) {
        match self.mode {
            Mode::Connected => self.mode = Mode::Disconnected,
            Mode::Enabled | Mode::Moving | Mode::Stopping { .. } => {
                self.latch(now, Fault::ConnectionLost(error.clone()));
            }
            Mode::Disconnected | Mode::Faulted(_) => {}
        }
        self.course = None;
        self.link.lose(now, error, &self.config.timing);
    }

    /// How far back the arm may lag behind its set points.
    pub(super) fn lag(&self) -> Duration {
        match self.config.dialect {
            // One segment under way, one waiting, one feedback interval, one to be acknowledged.
            Dialect::Adept2018 => Duration::from_millis(300),
            Dialect::Steer => self.config.period * 4,
        }
    }
}

/// Limits of the guarded tool.
pub struct ToolLimits {
    /// Its kinematics.
    pub tool: Box<dyn Tool>,
    /// The box that it must not leave, where there is one.
    pub workspace: Option<Workspace>,
    /// Its highest speeds.
    pub caps: SpeedCaps,
}

impl core::fmt::Debug for ToolLimits {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("ToolLimits")
            .field("workspace", &self.workspace)
            .field("caps", &self.caps)
            .finish_non_exhaustive()
    }
}

/// Settings that make no driver.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// A setting out of range.
    #[error(transparent)]
    Config(#[from] crate::viper::ConfigError),
    /// Joint limits that cannot be kept.
    #[error(transparent)]
    Limits(#[from] LimiterError),
}
