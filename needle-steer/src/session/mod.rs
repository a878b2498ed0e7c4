//! A run that other programs watch, and what they ask of it.

mod idle;
mod readiness;

use std::io::Write;
use std::net::SocketAddr;
use std::sync::Arc;

use hal::frame::LeftCamera;
use hal::request::{Command, Request};
use hal::telemetry::{Phase, Telemetry, Tracking, TruthReport};
use hal::{ArmState, Overlay, Position, StereoFrame};
use nalgebra::Point3;
use rosbridge::motion::Hand;
use rosbridge::{NodeError, Severity};

use vision::camera::View;
use vision::track::Tracked;

use crate::config::Config;
use crate::controls::{Controls, Wish};
use crate::outcome::Ended;
use crate::remote::{Interface, igtl};
use crate::rig::Rig;
use crate::ros::{Door, Link};
use crate::run::{Insertion, Observer, RunError, check_target};
use crate::withdrawal::Verdict;

pub use idle::{Leave, show, wait};

/// Pieces of a curve that is drawn.
const CURVE_POINTS: u32 = 40;

/// A session that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The ROS master does not register topics and services.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// The address of OpenIGTLink cannot be served.
    #[error("OpenIGTLink: {0}")]
    Igtl(#[from] igtl::ServerError),
    /// The live view cannot be served.
    #[cfg(feature = "live")]
    #[error("live view: {0}")]
    Live(#[from] crate::remote::live::LiveError),
    /// There is no live view.
    #[cfg(not(feature = "live"))]
    #[error("live.serve = true: this program was built without its feature `live`")]
    NoLive,
}

/// A run's connections to other programs.
pub struct Session {
    interfaces: Vec<Box<dyn Interface>>,
    /// Where OpenIGTLink is served, and what is dropped there.
    igtl: Option<(SocketAddr, Arc<igtl::Counters>)>,
    /// Motion by hand, over ROS only.
    hand: Option<Hand>,
    controls: Arc<Controls>,
    /// Whether motion is allowed.
    allowed: bool,
    /// The target that was taken before the start.
    target: Option<Position<LeftCamera>>,
    shown: Option<Arc<Telemetry>>,
    view: Option<View>,
}

impl core::fmt::Debug for Session {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Session")
            .field("interfaces", &self.interfaces.len())
            .field("allowed", &self.allowed)
            .finish_non_exhaustive()
    }
}

impl Session {
    /// Opens all connections that `config` asks for; nothing where it asks for none.
    ///
    /// # Errors
    /// See [`SessionError`].
    pub fn open(
        config: &Config,
        link: Option<&Link>,
        rig: &Rig,
        controls: &Arc<Controls>,
    ) -> Result<Option<Self>, SessionError> {
        let bearings = &rig.bearings;
        let mut interfaces: Vec<Box<dyn Interface>> = Vec::new();
        let mut hand = None;
        if let (Some(link), true) = (link, config.ros.publish) {
            interfaces.push(Box::new(Door::open(config, link, bearings)?));
            hand = Some(link.hand(bearings.chain.names())?);
        }
        let mut served = None;
        if config.igtl.serve {
            let (tracker, now) = (rig.tracker.as_ref(), rig.clock.now());
            let server = igtl::Server::open(&config.igtl, bearings, controls, tracker, now)?;
            served = Some((server.address(), server.counters()));
            // Nothing can be done about a closed stderr.
            let _ = writeln!(std::io::stderr(), "OpenIGTLink: {}", server.address());
            interfaces.push(Box::new(server));
        }
        if config.live.serve {
            interfaces.push(live(config, rig, controls)?);
        }
        if interfaces.is_empty() {
            return Ok(None);
        }
        Ok(Some(Self {
            interfaces,
            igtl: served,
            hand,
            controls: Arc::clone(controls),
            allowed: true,
            target: None,
            shown: None,
            view: bearings.cameras.map(|pair| pair.left_view()),
        }))
    }

    /// Where OpenIGTLink is served, and what is dropped there; nothing where it is not.
    pub fn igtl(&self) -> Option<(SocketAddr, Arc<igtl::Counters>)> {
        self.igtl.clone()
    }

    /// Whether the session waits before an insertion: for a start where it is not to start by itself,
    /// and for another target where that which it has is refused. The reason is said.
    pub fn waits(&mut self, config: &Config, rig: &mut Rig) -> bool {
        if !config.autostarts() {
            self.tell(Severity::Info, "waiting for a start");
            return true;
        }
        match check_target(config, rig, self.target) {
            Err(refused @ RunError::Target(_)) if config.stays() && !config.run.dry_run => {
                let text =
                    format!("{refused}; the insertion waits for another one, then for a start");
                self.say(Severity::Warning, &text);
                true
            }
            // The start itself says what else there is.
            _ => false,
        }
    }

    /// Keeps the connections up after an insertion, for requests and for who looks; until
    /// interrupted.
    ///
    /// # Errors
    /// The arm fails.
    pub fn stay(
        &mut self,
        config: &Config,
        insertion: &mut Insertion<'_>,
        controls: &Controls,
    ) -> Result<(), RunError> {
        loop {
            let (rig, path) = (&mut *insertion.rig, &mut insertion.path);
            if idle::linger(config, rig, self, controls, path)? == Leave::Quit {
                return Ok(());
            }
            controls.renew();
            controls.ask(Wish::Retract);
            let summary = insertion.withdraw(config, self, controls);
            self.show_withdrawn(&summary.ended);
        }
    }

    /// Shows a snapshot. Before a target is set, none is shown.
    fn show(&mut self, telemetry: &Telemetry) {
        let mut telemetry = telemetry.clone();
        if !telemetry.axial_distance.is_finite() {
            telemetry.target = Position::<LeftCamera>::new(Point3::from([f64::NAN; 3]));
        }
        let telemetry = Arc::new(telemetry);
        for interface in &mut self.interfaces {
            interface.show(&telemetry);
        }
        self.shown = Some(telemetry);
    }

    /// Shows the last snapshot with a newer truth.
    fn show_truth(&mut self, truth: Option<TruthReport>) {
        if let (Some(last), Some(_)) = (&self.shown, &truth) {
            let mut telemetry = (**last).clone();
            telemetry.truth = truth;
            self.show(&telemetry);
        }
    }

    /// Shows the arm.
    fn show_arm(&mut self, state: &ArmState) {
        for interface in &mut self.interfaces {
            interface.show_arm(state);
        }
    }

    /// Says something to all, and on standard error.
    fn say(&mut self, severity: Severity, text: &str) {
        if !self.tell(severity, text) {
            // Nothing can be done about a closed stderr.
            let _ = writeln!(std::io::stderr(), "{text}");
        }
    }

    /// Says something to all; whether that is on standard error, too.
    fn tell(&mut self, severity: Severity, text: &str) -> bool {
        let mut said = false;
        for interface in &mut self.interfaces {
            said |= interface.say(severity, text);
        }
        said
    }

    /// What is asked next.
    fn poll(&mut self) -> Option<Request> {
        self.interfaces.iter_mut().find_map(|from| from.poll())
    }

    /// Ends motion by hand.
    fn drop_motion(&mut self) {
        if let Some(hand) = &mut self.hand {
            hand.drop_all();
        }
    }

    /// Shows that the insertion has ended.
    pub fn show_end(&mut self, ended: &Ended) {
        if let Some(last) = &self.shown {
            let mut last = (**last).clone();
            last.phase = match ended {
                Ended::Stopped(_) | Ended::Device(_) | Ended::NotRetracted(_) => Phase::Faulted,
                _ => Phase::Ended,
            };
            self.show(&last);
        }
        self.tell(of_end(ended.is_success()), &ended.to_string());
    }

    /// Shows how a withdrawal ended.
    fn show_withdrawn(&mut self, verdict: &Verdict) {
        if let Some(last) = &self.shown {
            let mut last = (**last).clone();
            last.phase = match verdict {
                Verdict::Stopped(_) => Phase::Faulted,
                _ => Phase::Ended,
            };
            self.show(&last);
        }
        self.say(of_end(verdict.is_success()), &verdict.to_string());
    }

    /// Answers what is asked of a running insertion.
    fn answer(&mut self) {
        while let Some(request) = self.poll() {
            self.obey(request);
        }
    }

    fn obey(&mut self, request: Request) {
        let moves = matches!(request.command, Command::Start | Command::Retract);
        if moves && !self.allowed {
            return request.refuse("motion is not enabled");
        }
        match request.command {
            Command::Start if self.controls.wish() == Wish::Retract => {
                request.refuse("the needle is being withdrawn; retract goes on with that");
            }
            Command::Start => {
                self.controls.ask(Wish::Proceed);
                request.accept("going on");
            }
            Command::Stop => {
                self.controls.stop();
                request.accept("stopping; what is under way ends, retract withdraws the needle");
            }
            Command::Pause => {
                self.controls.ask(Wish::Pause);
                request.accept("holding still");
            }
            Command::Retract => {
                self.controls.ask(Wish::Retract);
                request.accept("withdrawing the needle");
            }
            Command::Enable(allowed) => {
                self.allowed = allowed;
                if allowed {
                    request.accept("enabled; start goes on, or retract with a withdrawal");
                } else {
                    self.controls.ask(Wish::Pause);
                    request.accept("holding still, not enabled");
                }
            }
            Command::Target(_) if self.controls.wish() == Wish::Retract => {
                request.refuse("the needle is being withdrawn");
            }
            Command::Target(target) => self.controls.aim_then(target, move |answer| match answer {
                Ok(aimed) => request.accept(aimed.to_string()),
                Err(refused) => request.refuse(refused.to_string()),
            }),
            Command::Home => request.refuse("an insertion is under way"),
            Command::ClearFault => request.refuse("no fault: an insertion is under way"),
        }
    }
}

impl Session {
    /// Shows a pair, and the left image with the tracked curve and the target drawn in.
    fn show_pair(&mut self, pair: &StereoFrame, tracked: &Tracked) {
        let curve = tracked.curves[0].filter(|_| tracked.status != Tracking::Lost);
        let target = self.shown.as_ref().map(|last| last.target.coords());
        let overlay = Arc::new(Overlay {
            image: pair.left.clone(),
            curve_px: curve.map_or_else(Vec::new, |curve| {
                (0..=CURVE_POINTS)
                    .map(|i| curve.at(f64::from(i) / f64::from(CURVE_POINTS)).into())
                    .collect()
            }),
            target_px: target
                .filter(|target| target.iter().all(|x| x.is_finite()))
                .and_then(|target| self.view.as_ref()?.project(&target))
                .map(|px| [px.0.x, px.0.y]),
        });
        for interface in &mut self.interfaces {
            interface.show_images(pair, &overlay);
        }
    }
}

/// How much it matters that something has ended.
const fn of_end(success: bool) -> Severity {
    if success {
        Severity::Info
    } else {
        Severity::Error
    }
}

#[cfg(feature = "live")]
fn live(
    config: &Config,
    rig: &Rig,
    controls: &Arc<Controls>,
) -> Result<Box<dyn Interface>, SessionError> {
    let server = crate::remote::live::Server::open(config, &rig.bearings, controls)?;
    // Nothing can be done about a closed stderr.
    let _ = writeln!(std::io::stderr(), "live view: ws://{}", server.address());
    Ok(Box::new(server))
}

#[cfg(not(feature = "live"))]
fn live(_: &Config, _: &Rig, _: &Arc<Controls>) -> Result<Box<dyn Interface>, SessionError> {
    Err(SessionError::NoLive)
}

impl Observer for Session {
    fn images(&mut self, pair: &StereoFrame, tracked: &Tracked) {
        self.show_pair(pair, tracked);
    }

    fn step(&mut self, telemetry: &Telemetry) {
        self.show(telemetry);
    }

    fn arm(&mut self, state: &ArmState) {
        self.show_arm(state);
        self.answer();
    }
}
