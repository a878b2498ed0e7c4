//! The run loop: the only code that moves an arm. Every way out of it stops the arm.

use std::time::Duration;

use hal::telemetry::{Phase, Telemetry};
use hal::{Arm, ArmMode, ArmState, Joints, Position, RateCommand, SensedShape, Stamp};

use crate::aim::{nominal_target, stereo_target};
use crate::config::{Config, TargetKind};
use crate::controls::{Controls, Wish};
use crate::cycle::{Cycle, CycleError, Snapshot, base_pose};
use crate::outcome::{Ended, Summary};
use crate::rig::{Rig, RigBuildError};
use crate::supervisor::{Bounds, StopReason, Supervisor, Verdict};
use crate::world::in_stereo_frame;
use hybrid_control::view::Law;
use hybrid_control::{Means, ReachMonitor, Unreachable, reachable_at_start};

/// Longest wait for a law step when no image comes \[s\]: then the law runs on prediction.
pub const PREDICTION: f64 = 0.05;
/// Straight start where no protocol gives one \[m\].
const PRE_INSERTION: f64 = 5e-3;
/// Longest wait for the arm to come to rest.
const REST: Duration = Duration::from_secs(1);
/// Shortfall of reach that does not end a run \[m\].
const REACH_TOLERANCE: f64 = 0.5e-3;

/// A run that could not be carried out; nothing moved, or the arm was stopped.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The rig.
    #[error(transparent)]
    Rig(#[from] RigBuildError),
    /// The controller.
    #[error(transparent)]
    Cycle(#[from] CycleError),
    /// The target is refused before anything moves.
    #[error("target refused: {0}")]
    Target(#[from] Unreachable),
    /// A device failed.
    #[error(transparent)]
    Device(#[from] hal::Error),
}

/// Takes note of a run while it goes on.
pub trait Observer {
    /// The arm where the controller starts from; called first.
    fn start(&mut self, arm: &ArmState) {
        let _ = arm;
    }

    /// A law step, with truth in simulation.
    fn step(&mut self, telemetry: &Telemetry);

    /// What the step read; called before [`Observer::step`].
    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        let _ = (arm, shape);
    }

    /// The arm's newest feedback, every arm period.
    fn arm(&mut self, state: &ArmState) {
        let _ = state;
    }

    /// A command that went out.
    fn command(&mut self, command: &RateCommand) {
        let _ = command;
    }
}

/// Takes note of nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn step(&mut self, _: &Telemetry) {}
}

/// Carries out one insertion on `rig`.
///
/// # Errors
/// See [`RunError`]; a run that ends early is no error but a verdict.
pub fn run(
    config: &Config,
    rig: &mut Rig,
    observer: &mut dyn Observer,
    controls: &Controls,
) -> Result<Summary, RunError> {
    Insertion::begin(config, rig)?.carry_out(config, observer, controls)
}

/// As [`run`], steering with a law that has no name in the configuration.
///
/// # Errors
/// See [`RunError`].
pub fn run_with_law(
    config: &Config,
    rig: &mut Rig,
    law: Box<dyn Law>,
    observer: &mut dyn Observer,
    controls: &Controls,
) -> Result<Summary, RunError> {
    let mut insertion = Insertion::begin(config, rig)?;
    insertion.cycle.set_law(law);
    insertion.carry_out(config, observer, controls)
}

/// One insertion in progress.
pub struct Insertion<'a> {
    /// Its devices.
    pub rig: &'a mut Rig,
    cycle: Cycle,
    supervisor: Supervisor,
    reach: ReachMonitor,
    phase: Phase,
    before_pause: Phase,
    straight: f64,
    first: ArmState,
    start: nalgebra::Isometry3<f64>,
    steering_since: Option<Stamp>,
    given_target: Option<Position<hal::frame::LeftCamera>>,
    rates: Joints,
    last_law: Option<Stamp>,
}

impl core::fmt::Debug for Insertion<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Insertion")
            .field("phase", &self.phase)
            .field("cycle", &self.cycle)
            .finish_non_exhaustive()
    }
}

impl<'a> Insertion<'a> {
    /// An insertion from where the arm stands; nothing moves yet.
    ///
    /// # Errors
    /// The arm does not report, or the configuration makes no controller.
    pub fn begin(config: &Config, rig: &'a mut Rig) -> Result<Self, RunError> {
        let state = rig.arm.state()?;
        let cycle = Cycle::new(config, rig.bearings.clone(), &state)?;
        Ok(Self::new(config, rig, cycle, &state))
    }

    /// Carries the insertion out.
    ///
    /// # Errors
    /// See [`RunError`]; a run that ends early is no error but a verdict.
    pub fn carry_out(
        &mut self,
        config: &Config,
        observer: &mut dyn Observer,
        controls: &Controls,
    ) -> Result<Summary, RunError> {
        observer.start(&self.first);
        self.given_target = controls.take_target();
        if config.run.check_reach {
            self.check_target(config)?;
        }
        if config.run.dry_run {
            return Ok(self.summary(config, Ended::DryRun));
        }
        self.rig.arm.enable()?;
        let ended = self.advance(config, observer, controls);
        let stopped = self.come_to_rest();
        let ended = ended?;
        stopped?;
        Ok(self.summary(config, ended))
    }

    /// Withdraws the needle after an insertion has ended, along the way it came.
    ///
    /// # Errors
    /// As [`Insertion::carry_out`].
    pub fn withdraw(
        &mut self,
        config: &Config,
        observer: &mut dyn Observer,
        controls: &Controls,
    ) -> Result<Ended, RunError> {
        self.supervisor = Supervisor::new(bounds(config), self.rig.clock.now());
        controls.ask(Wish::Retract);
        if self.rig.arm.state()?.mode == ArmMode::Connected {
            self.rig.arm.enable()?;
        }
        let ended = self.advance(config, observer, controls);
        let stopped = self.come_to_rest();
        let ended = ended?;
        stopped?;
        Ok(ended)
    }

    /// The newest telemetry.
    pub fn telemetry(&self) -> &Telemetry {
        self.cycle.telemetry()
    }

    fn new(config: &Config, rig: &'a mut Rig, cycle: Cycle, state: &ArmState) -> Self {
        let start = base_pose(&rig.bearings, state);
        let straight = rig
            .world
            .as_ref()
            .map_or(PRE_INSERTION, |world| world.pre_insertion());
        Self {
            supervisor: Supervisor::new(bounds(config), rig.clock.now()),
            cycle,
            reach: ReachMonitor::new(REACH_TOLERANCE),
            phase: Phase::PreInsertion,
            before_pause: Phase::PreInsertion,
            straight,
            first: *state,
            start,
            steering_since: None,
            given_target: None,
            rates: state.positions.zeroed(),
            last_law: None,
            rig,
        }
    }

    /// Refuses a target that cannot be reached, as far as it is known before the start.
    fn check_target(&self, config: &Config) -> Result<(), Unreachable> {
        let tip = (self.start * nalgebra::Point3::new(0.0, 0.0, config.needle.length_mm * 1e-3))
            .coords
            + self.start.rotation * nalgebra::Vector3::z() * self.straight;
        let target = match config.target.kind {
            _ if let Some(given) = self.given_target => {
                (self.rig.bearings.world_from_left_camera * given).coords()
            }
            TargetKind::Stereo => {
                (self.rig.bearings.world_from_left_camera * stereo_target(config)).coords()
            }
            _ => nominal_target(config, &tip, &self.start),
        };
        reachable_at_start(
            self.cycle.estimator(),
            &target.into(),
            self.cycle.limits(),
            Means::of_law(&config.run.law),
        )
    }

    fn advance(
        &mut self,
        config: &Config,
        observer: &mut dyn Observer,
        controls: &Controls,
    ) -> Result<Ended, RunError> {
        let period = self.rig.arm.description().period;
        let longest = Duration::from_secs_f64(config.run.max_duration_s);
        let begun = self.rig.clock.now();
        let mut deadline = begun;
        loop {
            let now = self.rig.clock.now();
            if controls.is_stopped() {
                return Ok(Ended::Interrupted);
            }
            if now.since(begun) > longest {
                return Ok(Ended::TimedOut);
            }
            let state = self.rig.arm.state()?;
            observer.arm(&state);
            if let Some(target) = controls.take_target() {
                self.aim(target);
            }
            self.supervisor.dead_man(now, controls.dead_man_count());
            self.follow(controls.wish());
            self.law_step(config, now, &state, observer)?;
            match self.supervisor.judge(now, &state, self.cycle.telemetry()) {
                Verdict::Go => {}
                Verdict::Hold => self.rates = self.rates.zeroed(),
                Verdict::Stop(reason) => return Ok(Ended::Stopped(reason)),
            }
            if let Some(ended) = self.verdict(now) {
                return Ok(ended);
            }
            let command = RateCommand {
                sequence: self.rig.next_sequence(),
                stamp: now,
                rates: self.rates,
            };
            if let Err(error) = self.rig.arm.command(&command) {
                return self.refused(error);
            }
            observer.command(&command);
            deadline = deadline + period;
            self.rig.clock.wait_until(deadline);
        }
    }

    /// A command was refused: by an arm that faulted meanwhile, or for another reason.
    fn refused(&mut self, error: hal::Error) -> Result<Ended, RunError> {
        match self.rig.arm.state().map(|state| state.mode) {
            Ok(ArmMode::Faulted(fault)) => Ok(Ended::Stopped(StopReason::ArmFault { fault })),
            _ => Err(error.into()),
        }
    }

    /// Runs the law when a measurement arrived, or on prediction when one is overdue.
    fn law_step(
        &mut self,
        config: &Config,
        now: Stamp,
        state: &ArmState,
        observer: &mut dyn Observer,
    ) -> Result<(), RunError> {
        let shape = self.rig.sensor.poll()?;
        let since = self
            .last_law
            .map_or(f64::INFINITY, |last| now.secs_since(last));
        if shape.is_none() && since < PREDICTION {
            return Ok(());
        }
        if let Some(shape) = &shape {
            self.supervisor.image(shape.stamp);
        }
        self.change_phase(config, now, state);
        observer.inputs(state, shape.as_ref());
        let dt = if since.is_finite() { since } else { PREDICTION };
        let telemetry = self.cycle.step(&Snapshot {
            now,
            dt,
            arm: state,
            shape: shape.as_ref(),
            phase: self.phase,
        });
        self.rates = telemetry.joint_rates;
        self.last_law = Some(now);
        let telemetry = self.cycle.telemetry_mut();
        telemetry
            .law
            .limits
            .extend_from_slice(self.rig.arm.inner().acted());
        telemetry.truth = self.rig.world.as_ref().map(|world| world.report());
        observer.step(telemetry);
        Ok(())
    }

    /// Pauses, retracts or resumes as the user asks.
    fn follow(&mut self, wish: Wish) {
        let wanted = match wish {
            Wish::Proceed if matches!(self.phase, Phase::Paused | Phase::Retracting) => {
                self.cycle.resume();
                self.before_pause
            }
            Wish::Proceed => self.phase,
            Wish::Pause => Phase::Paused,
            Wish::Retract => Phase::Retracting,
        };
        if wanted == self.phase {
            return;
        }
        if matches!(self.phase, Phase::PreInsertion | Phase::Steering) {
            self.before_pause = self.phase;
        }
        self.phase = wanted;
        // The change takes effect at once, not with the next image.
        self.last_law = None;
    }

    /// Straight start first; then the target is set and steering begins.
    fn change_phase(&mut self, config: &Config, now: Stamp, state: &ArmState) {
        if self.phase != Phase::PreInsertion {
            return;
        }
        let base = base_pose(&self.rig.bearings, state);
        let travelled = (base.translation.vector - self.start.translation.vector)
            .dot(&(self.start.rotation * nalgebra::Vector3::z()));
        if travelled < self.straight {
            return;
        }
        let target = self.place_target(config);
        self.cycle.set_target(target);
        self.phase = Phase::Steering;
        self.steering_since = Some(now);
    }

    /// The target in the stereo frame. In simulation the protocol places it by the true tip.
    fn place_target(&self, config: &Config) -> Position<hal::frame::LeftCamera> {
        let left_from_world = self.rig.left_from_world();
        let given = match config.target.kind {
            TargetKind::Stereo => Some(stereo_target(config)),
            _ => None,
        };
        if let Some(target) = self.given_target.or(given) {
            self.watch(target);
            return target;
        }
        let target = if let Some(world) = &self.rig.world {
            let target = nominal_target(config, &world.true_tip(), &self.start);
            world.watch(target);
            target
        } else {
            let tip = self.cycle.telemetry().world_from_tip.origin().coords();
            nominal_target(config, &tip, &self.start)
        };
        in_stereo_frame(&target, &left_from_world)
    }

    /// Another target, in the stereo frame.
    fn aim(&mut self, target: Position<hal::frame::LeftCamera>) {
        self.given_target = Some(target);
        if self.steering_since.is_some() {
            self.cycle.set_target(target);
            self.watch(target);
        }
    }

    /// Keeps the score against a target in the stereo frame.
    fn watch(&self, target: Position<hal::frame::LeftCamera>) {
        if let Some(world) = &self.rig.world {
            world.watch((self.rig.left_from_world().inverse() * target).coords());
        }
    }

    fn verdict(&mut self, now: Stamp) -> Option<Ended> {
        if self.phase == Phase::Retracting && self.cycle.is_withdrawn() {
            return Some(Ended::Retracted);
        }
        if self.phase != Phase::Steering {
            return None;
        }
        let telemetry = self.cycle.telemetry();
        if telemetry.axial_distance <= 0.0 {
            return Some(Ended::TargetPassed);
        }
        self.reach
            .update(now, &telemetry.law)
            .map(Ended::Unreachable)
    }

    /// Stops and waits until the arm is at rest.
    fn come_to_rest(&mut self) -> Result<(), RunError> {
        let stopped = self.rig.arm.stop();
        let patience = self.rig.clock.now() + REST;
        let period = self.rig.arm.description().period;
        while self.rig.clock.now() < patience {
            match self.rig.arm.state().map(|state| state.mode) {
                Ok(ArmMode::Moving | ArmMode::Stopping) => {
                    let next = self.rig.clock.now() + period;
                    self.rig.clock.wait_until(next);
                }
                _ => break,
            }
        }
        Ok(stopped?)
    }

    fn summary(&self, config: &Config, ended: Ended) -> Summary {
        let telemetry = self.cycle.telemetry();
        let figures = self.rig.world.as_ref().and_then(|world| world.figures());
        let mm = |value: f64| value.is_finite().then_some(value * 1e3);
        Summary {
            ended,
            law: config.run.law.clone(),
            phantom: config.run.phantom.clone(),
            seed: config.run.seed,
            true_error_mm: figures.and_then(|f| mm(f.lateral)),
            measured_error_mm: mm(telemetry.lateral_error),
            axial_error_mm: figures.and_then(|f| mm(f.axial)),
            max_stretch_mm: figures.map_or(0.0, |f| f.max_stretch * 1e3),
            mean_stretch_mm: figures.map_or(0.0, |f| f.mean_stretch * 1e3),
            duration_s: self
                .steering_since
                .map_or(0.0, |since| telemetry.stamp.secs_since(since)),
            steps: telemetry.step,
            out: None,
            log: None,
        }
    }
}

fn bounds(config: &Config) -> Bounds {
    let s = &config.supervisor;
    let ms = |value: f64| Duration::from_secs_f64(value * 1e-3);
    Bounds {
        tissue_stretch: s.tissue_stretch_mm * 1e-3,
        entry_force: s.entry_force_n,
        axis: (config.entry(), config.inward()),
        workspace_radius: s.workspace_radius_mm * 1e-3,
        image_hold: ms(s.image_hold_ms),
        image_stop: ms(s.image_stop_ms),
        encoder_stop: ms(s.encoder_stop_ms),
        dead_man: (s.dead_man_ms > 0.0).then(|| ms(s.dead_man_ms)),
    }
}
