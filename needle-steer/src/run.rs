//! The run loop: the only code that moves an arm. Every way out of it stops the arm.

mod by_hand;
mod target;
mod verdict;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use hal::telemetry::{Phase, Telemetry};
use hal::{Arm, ArmMode, ArmState, Joints, Position, RateCommand, SensedShape, Stamp};

use crate::aim::{TargetRefused, given_target};
use crate::config::Config;
use crate::controls::{Controls, Wish};
use crate::cycle::{Cycle, CycleError, Snapshot, base_pose};
use crate::hand::Prompter;
use crate::holds::Holds;
use crate::monitor::{Freshness, Monitor};
pub use crate::observer::{Both, Observer, Unobserved};
use crate::outcome::{Cause, Ended, Events, Summary};
use crate::passing::Passing;
use crate::progress::Progress;
use crate::rig::{Rig, RigBuildError, Sighting};
use crate::sight::Sight;
use crate::supervisor::{Bounds, StopReason, Supervisor, Verdict};
use crate::withdrawal::{self, BasePath};
use by_hand::travelled;
use hybrid_control::ReachMonitor;
use hybrid_control::view::Law;
pub use target::check_target;

/// Longest wait for a law step when no image comes \[s\]: then the law runs on prediction.
pub const PREDICTION: f64 = 0.05;
/// Straight start where no protocol gives one \[m\].
const PRE_INSERTION: f64 = 5e-3;
/// Straight insertion beyond the start by which the needle must have come into sight \[m\].
const IN_SIGHT: f64 = 8e-3;
/// Shortfall of reach that does not end a run \[m\].
const REACH_TOLERANCE: f64 = 1e-3;

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
    Target(#[from] TargetRefused),
    /// A device failed.
    #[error(transparent)]
    Device(#[from] hal::Error),
}

/// Builds the devices that `config` asks for and carries out one insertion on them, watched by
/// nobody.
///
/// # Errors
/// See [`RunError`].
pub fn simulate(config: &Config) -> Result<Summary, RunError> {
    let mut rig = Rig::new(config)?;
    run(config, &mut rig, &mut Unobserved, &Controls::default())
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
    insertion.set_law(law);
    insertion.carry_out(config, observer, controls)
}

/// One insertion in progress.
pub struct Insertion<'a> {
    /// Its devices.
    pub rig: &'a mut Rig,
    cycle: Cycle,
    supervisor: Supervisor,
    monitor: Monitor,
    freshness: Freshness,
    passing: Passing,
    reach: ReachMonitor,
    progress: Progress,
    holds: Holds,
    events: Events,
    /// Asks the hand, where one pushes the needle.
    prompter: Option<Prompter>,
    phase: Phase,
    before_pause: Phase,
    straight: f64,
    first: ArmState,
    start: nalgebra::Isometry3<f64>,
    aimed: bool,
    steering_since: Option<Stamp>,
    given_target: Option<Position<hal::frame::LeftCamera>>,
    rates: Joints,
    last_law: Option<Stamp>,
    /// The path that the base came.
    pub path: BasePath,
    /// Folder of the results, where withdrawals are logged too.
    pub folder: Option<PathBuf>,
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
        self.hear_targets(config, controls);
        self.check_target(config)?;
        if config.run.dry_run {
            return Ok(self.summary(config, Ended::DryRun));
        }
        self.rig.check_start(&self.first)?;
        self.attach_marker(config);
        self.rig.await_marker(config)?;
        self.rig.await_sight(controls)?;
        let ended = self.conduct(config, observer, controls)?;
        controls.refuse_aims();
        let ended = match ended {
            Ended::Retracted => self.withdraw(config, observer, controls).ended.into(),
            ended => ended,
        };
        Ok(self.summary(config, ended))
    }

    /// Withdraws the needle along the way it came. No insertion goes on after that.
    pub fn withdraw(
        &mut self,
        config: &Config,
        observer: &mut dyn Observer,
        controls: &Controls,
    ) -> withdrawal::Summary {
        let record = self.folder.as_ref().map(|folder| {
            let log = folder.join("run.mcap");
            withdrawal::Record::beside(folder, config, self.rig, Some(&log))
        });
        let request = withdrawal::Request::of_run(&mut self.path, self.cycle.telemetry().step);
        let record = record.unwrap_or_default();
        withdrawal::withdraw(config, self.rig, request, observer, controls, record)
    }

    /// Steers with `law` instead of the configuration's; the summary names it.
    pub fn set_law(&mut self, law: Box<dyn Law>) {
        self.cycle.set_law(law);
    }

    /// The newest telemetry.
    pub fn telemetry(&self) -> &Telemetry {
        self.cycle.telemetry()
    }

    fn new(config: &Config, rig: &'a mut Rig, cycle: Cycle, state: &ArmState) -> Self {
        let bounds = Bounds::of(config);
        let start = base_pose(&rig.bearings, state);
        let straight = rig
            .world
            .as_ref()
            .map_or(PRE_INSERTION, |world| world.pre_insertion());
        Self {
            monitor: Monitor::default(),
            freshness: Freshness::new(bounds.image_age),
            passing: Passing::default(),
            supervisor: Supervisor::new(bounds, rig.clock.now()),
            cycle,
            reach: ReachMonitor::new(REACH_TOLERANCE),
            progress: Progress::new(config.run.insertion_speed_mm_s * 1e-3),
            holds: Holds::default(),
            events: Events::default(),
            prompter: rig
                .slide
                .clone()
                .map(|slide| Prompter::new(slide, config.insertion.step_mm * 1e-3)),
            phase: Phase::PreInsertion,
            before_pause: Phase::PreInsertion,
            straight,
            first: *state,
            start,
            aimed: false,
            steering_since: None,
            given_target: given_target(config, &rig.left_from_world()),
            rates: state.positions.zeroed(),
            last_law: None,
            path: BasePath::default(),
            folder: None,
            rig,
        }
    }

    /// Goes on to the end, and stops the arm whatever the end is. A device that fails is an end.
    fn conduct(
        &mut self,
        config: &Config,
        observer: &mut dyn Observer,
        controls: &Controls,
    ) -> Result<Ended, RunError> {
        let ended = match self.advance(config, observer, controls) {
            Err(RunError::Device(error)) => Ended::device(&error),
            ended => ended?,
        };
        Ok(match self.rig.come_to_rest() {
            Err(error) if ended.is_success() => Ended::device(&error),
            _ => ended,
        })
    }

    fn advance(
        &mut self,
        config: &Config,
        observer: &mut dyn Observer,
        controls: &Controls,
    ) -> Result<Ended, RunError> {
        self.path.note(&self.start, &self.first.positions);
        self.rig.enable()?;
        let period = self.rig.arm.description().period;
        let longest = Duration::from_secs_f64(config.run.max_duration_s);
        let begun = self.rig.clock.now();
        let mut deadline = begun;
        loop {
            let now = self.rig.clock.now();
            if controls.is_stopped() {
                return Ok(controls
                    .why_interrupted()
                    .map_or(Ended::Interrupted, Ended::NodeEnded));
            }
            if now.since(begun) > longest {
                let cause = self.holds.cause_of_all(now.secs_since(begun));
                return Ok(Ended::TimedOut(cause.unwrap_or(Cause::Operator)));
            }
            let state = self.rig.arm.state()?;
            let base = base_pose(&self.rig.bearings, &state);
            self.path.note(&base, &state.positions);
            observer.arm(&state);
            self.monitor.base(state.stamp, &base);
            if controls.wish() == Wish::Retract {
                return Ok(Ended::Retracted);
            }
            self.hear_targets(config, controls);
            self.supervisor.dead_man(now, controls.dead_man_count());
            self.follow(controls.wish());
            self.law_step(config, now, &state, observer)?;
            let evidence = self.evidence(now);
            let telemetry = self.cycle.telemetry();
            let mut rates = self.rates;
            let verdict = self.supervisor.judge(now, &state, telemetry, &evidence);
            self.ask_hand(now, &base, verdict == Verdict::Go, observer);
            match verdict {
                Verdict::Go if self.passing.is_waiting() => rates = rates.zeroed(),
                Verdict::Go => rates = self.slowed(),
                Verdict::Hold(cause) => {
                    rates = rates.zeroed();
                    self.holds.note(cause, period.as_secs_f64());
                }
                Verdict::Stop(reason) => {
                    let by_arm = self.rig.arm.explanation();
                    let by_cameras = self.rig.eyes.hindrance();
                    return Ok(Ended::Stopped(reason.explained(by_arm, by_cameras)));
                }
            }
            if let Some(ended) = self.verdict(now) {
                return Ok(ended);
            }
            let command = RateCommand {
                sequence: self.rig.next_sequence(),
                stamp: now,
                rates,
            };
            if let Err(error) = self.rig.arm.command(&command) {
                return self.refused(error);
            }
            self.supervisor.at_box(now, self.rig.is_at_box());
            observer.command(&command);
            deadline = deadline + period;
            self.rig.clock.wait_until(deadline);
        }
    }

    /// A command was refused: by an arm that faulted meanwhile, or for another reason.
    fn refused(&mut self, error: hal::Error) -> Result<Ended, RunError> {
        match self.rig.arm.state().map(|state| state.mode) {
            Ok(ArmMode::Faulted(fault)) => Ok(Ended::Stopped(StopReason::ArmFault {
                fault,
                words: self.rig.arm.explanation(),
            })),
            _ => Err(error.into()),
        }
    }

    /// Runs the law when a measurement arrived, or on prediction when one is overdue.
    #[expect(
        clippy::disallowed_methods,
        reason = "how long a step takes is told to observers and enters no decision"
    )]
    fn law_step(
        &mut self,
        config: &Config,
        now: Stamp,
        state: &ArmState,
        observer: &mut dyn Observer,
    ) -> Result<(), RunError> {
        let mut sight = self.rig.eyes.poll()?;
        if sight
            .stamp()
            .is_some_and(|exposed| !self.freshness.admit(now, exposed))
        {
            sight = Sighting::Nothing;
        }
        let since = self
            .last_law
            .map_or(f64::INFINITY, |last| now.secs_since(last));
        if sight.is_none() && since < PREDICTION {
            return Ok(());
        }
        self.change_phase(config, now, state);
        let marker = self.rig.marker.poll()?;
        let dt = if since.is_finite() { since } else { PREDICTION };
        let begun = Instant::now();
        let telemetry = self.cycle.step(&Snapshot {
            now,
            dt,
            arm: state,
            shape: sight.shape(),
            pair: sight.pair(),
            marker,
            phase: self.phase,
        });
        self.rates = telemetry.joint_rates;
        observer.timed(begun.elapsed());
        self.last_law = Some(now);
        self.note_image(now, &sight);
        if let (false, Some((exposed, tip))) = (sight.is_none(), self.cycle.measured())
            && let Some(base) = self.cycle.base_at(*exposed)
        {
            let world_from_camera = &self.rig.bearings.world_from_left_camera;
            self.monitor.tip(*exposed, &base, tip, world_from_camera);
        }
        observer.inputs(state, sight.shape().or_else(|| self.tracked()));
        if let Some(marker) = &marker {
            observer.marker(marker);
        }
        if let (Some(pair), Some(sight)) = (sight.pair(), self.cycle.sight()) {
            observer.images(pair, sight.tracked());
        }
        let telemetry = self.cycle.telemetry_mut();
        telemetry
            .law
            .limits
            .extend_from_slice(self.rig.arm.inner().acted());
        telemetry.truth = self.rig.world.as_ref().map(|world| world.report());
        if let Some(truth) = &telemetry.truth {
            self.events.note(now, truth);
        }
        observer.step(telemetry);
        Ok(())
    }

    /// Tells the supervisor of an image. On its straight way in and out, and while it stands
    /// still, the needle may be out of the cameras' sight.
    fn note_image(&mut self, now: Stamp, sight: &Sighting) {
        if sight.is_none() {
            return;
        }
        let may_hide = self.phase != Phase::Steering;
        let problem = match self.cycle.sight() {
            Some(seen) if sight.pair().is_some() && !may_hide => seen.problem(),
            _ => None,
        };
        let problem = problem.or_else(|| self.cycle.implausible().map(ToString::to_string));
        self.supervisor.image(now, problem);
    }

    /// The shape that the tracker found in the newest pair.
    fn tracked(&self) -> Option<&SensedShape> {
        self.cycle.sight().and_then(Sight::shape)
    }

    /// Pauses or resumes as the user asks.
    fn follow(&mut self, wish: Wish) {
        let wanted = match wish {
            Wish::Proceed if self.phase == Phase::Paused => {
                self.cycle.resume();
                self.progress.reset();
                self.monitor.begin_anew();
                self.before_pause
            }
            Wish::Proceed | Wish::Retract => self.phase,
            Wish::Pause => Phase::Paused,
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
        let travelled = travelled(&self.start, &base);
        if travelled < self.straight {
            return;
        }
        if !self.aimed {
            let target = self.place_target(config);
            self.cycle.set_target(target);
            self.aimed = true;
        }
        // Steering begins when the needle is in the cameras' sight, a little deeper at most.
        let unseen = self.cycle.sight().is_some_and(|s| s.shape().is_none());
        if unseen && travelled < self.straight + IN_SIGHT {
            return;
        }
        self.phase = Phase::Steering;
        self.steering_since = Some(now);
    }
}
