//! The supervisor: bounds and watchdogs outside any law. It only ever holds or stops.

mod reason;

use std::time::Duration;

use hal::telemetry::Telemetry;
use hal::{ArmMode, ArmState, Stamp};
use nalgebra::{Point3, Unit, Vector3};

use crate::config::Config;
use crate::monitor::plausibility::Implausible;
use crate::monitor::{Stale, Stalled};
use crate::outcome::Cause;
pub use reason::StopReason;
pub(crate) use reason::in_words;

/// The tip has to follow within this time at rest, or the run ends: the longest breath, in which
/// tissue may draw the tip back.
const STALL_STOP: Duration = Duration::from_secs(5);
/// Motion of the tissue that draws a tip back as far as a stall \[m\]: a needle bent by `a` over its
/// free length of 60 mm is shorter by half the mean of its squared slope, 0.6 a^2/60 mm.
const DRAWN_BACK: f64 = 8e-3;
/// Tissue loaded beyond its bounds holds the arm; for longer it ends the run. One noisy image does
/// not.
const LOAD_STOP: Duration = Duration::from_millis(250);
/// Distance of the measured shaft from the model's from which the model's load is doubted \[m\]:
/// calibrated arms and cameras stay below, tissue of a tenth of the stiffness told does not.
const DOUBT: f64 = 0.5e-3;
/// Largest over root mean square distance of two bent shafts \[1\]: by so much the largest stretch
/// may be wrong.
const PEAK: f64 = 2.0;
/// Share of the bound that the model's stretch has to keep when that is taken from it \[1\].
const CERTAIN: f64 = 0.8;
/// A springs model without an equilibrium for longer holds the arm; its bounds are not read.
const MODEL_HOLD: Duration = Duration::from_millis(100);
/// The same for longer ends the run.
const MODEL_STOP: Duration = Duration::from_secs(2);

/// Longest wait for the operator to hold the dead-man's switch at the start.
const FIRST_TOKEN: Duration = Duration::from_secs(30);
/// How long the guard may hold the base at its box before the run ends.
const AT_BOX: Duration = Duration::from_secs(2);
/// Speed across the needle over that which laws and guard keep, beyond which a base swings.
const OVER_SPEED: f64 = 1.5;
/// Time over which the base's speed is taken \[s\]: long against the encoders' steps.
const SPEED_OVER: f64 = 0.1;

/// Bounds in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds {
    /// Largest tissue stretch \[m\].
    pub tissue_stretch: f64,
    /// Largest lateral force at the entry \[N\].
    pub entry_force: f64,
    /// Nominal axis: entry point and direction into the tissue, in World.
    pub axis: (Point3<f64>, Unit<Vector3<f64>>),
    /// Largest distance of the needle's base from the nominal axis \[m\].
    pub workspace_radius: f64,
    /// Highest speed of the needle's base across the nominal axis \[m/s\].
    pub base_speed: f64,
    /// Without an image for longer: hold still.
    pub image_hold: Duration,
    /// Without an image for longer: stop the run.
    pub image_stop: Duration,
    /// Measurements older than this at their arrival are not taken.
    pub image_age: Duration,
    /// Encoders read longer ago: stop the run.
    pub encoder_stop: Duration,
    /// Dead-man's token refreshed longer ago: stop the run; without, no token is asked for.
    pub dead_man: Option<Duration>,
}

impl Bounds {
    /// The bounds of a configuration.
    pub fn of(config: &Config) -> Self {
        let s = &config.supervisor;
        let ms = |value: f64| Duration::from_secs_f64(value * 1e-3);
        Self {
            tissue_stretch: s.tissue_stretch_mm * 1e-3,
            entry_force: s.entry_force_n,
            axis: (config.entry(), config.inward()),
            workspace_radius: s.workspace_radius_mm * 1e-3,
            base_speed: OVER_SPEED * config.limits.lateral_speed_mm_s * 1e-3,
            image_hold: ms(s.image_hold_ms),
            image_stop: ms(s.image_stop_ms),
            image_age: ms(s.image_age_ms),
            encoder_stop: ms(s.encoder_stop_ms),
            dead_man: (s.dead_man_ms > 0.0).then(|| ms(s.dead_man_ms)),
        }
    }
}

/// What the monitor found out before a command goes out.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// The tip stays behind the base.
    pub stalled: Option<Stalled>,
    /// Way of the tip that only moving tissue explains \[m\].
    pub tissue_motion: Option<f64>,
    /// How far the tissue has been seen to move by itself since the beginning \[m\].
    pub largest_tissue_motion: f64,
    /// Measurements are refused for their stamps.
    pub stale: Option<Stale>,
    /// The newest measurement cannot be of this needle.
    pub implausible: Option<Implausible>,
    /// Since when the springs model has no equilibrium, and why.
    pub model: Option<(Stamp, String)>,
}

/// Verdict on one arm period.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// The command may go out.
    Go,
    /// Zero velocity instead of the command, for this cause.
    Hold(Cause),
    /// Stop and end the run.
    Stop(StopReason),
}

/// Watches one run.
#[derive(Clone, Debug)]
pub struct Supervisor {
    bounds: Bounds,
    newest_image: Stamp,
    newest_sight: Stamp,
    problem: String,
    implausible: Option<Implausible>,
    stalled: Option<Stamp>,
    /// Since when the tissue is loaded beyond its bounds, and what that is put down to.
    overloaded: Option<(Stamp, StopReason)>,
    /// Number of the newest token and when it came, or when tokens were first looked for.
    dead_man: Option<(u64, Stamp)>,
    /// Whether a token has come.
    held: bool,
    /// Since when, and until when, the guard has kept the base in its box.
    at_box: Option<(Stamp, Stamp)>,
    /// Place of the base across its axis, and when it was there.
    base: Option<(Stamp, Vector3<f64>)>,
    latched: Option<StopReason>,
}

impl Supervisor {
    /// A supervisor for a run that starts at `start`.
    pub fn new(bounds: Bounds, start: Stamp) -> Self {
        Self {
            bounds,
            newest_image: start,
            newest_sight: start,
            problem: String::new(),
            implausible: None,
            stalled: None,
            overloaded: None,
            dead_man: None,
            held: false,
            at_box: None,
            base: None,
            latched: None,
        }
    }

    /// Notes an image that arrived at `now`, and why the needle was not found in it, if it was not.
    pub fn image(&mut self, now: Stamp, problem: Option<String>) {
        self.newest_image = now;
        match problem {
            None => self.newest_sight = now,
            Some(problem) => self.problem = problem,
        }
    }

    /// Notes the count of dead-man's tokens. Those given before the first call do not count:
    /// nothing moves before the next one.
    pub fn dead_man(&mut self, now: Stamp, count: u64) {
        match self.dead_man {
            Some((last, _)) if last == count => {}
            before => {
                self.held |= before.is_some();
                self.dead_man = Some((count, now));
            }
        }
    }

    /// Notes whether the guard kept the newest command from leading out of the workspace box.
    pub fn at_box(&mut self, now: Stamp, kept: bool) {
        self.at_box = kept.then(|| (self.at_box.map_or(now, |(since, _)| since), now));
    }

    /// The latched reason, if any.
    pub fn latched(&self) -> Option<&StopReason> {
        self.latched.as_ref()
    }

    /// Judges the state, the newest telemetry and the monitor's evidence before a command goes out.
    pub fn judge(
        &mut self,
        now: Stamp,
        arm: &ArmState,
        telemetry: &Telemetry,
        evidence: &Evidence,
    ) -> Verdict {
        // The time counts from when the arm was held, not from when the tip fell behind.
        self.stalled = evidence.stalled.and(self.stalled.or(Some(now)));
        self.implausible = evidence.implausible.or(self.implausible);
        let since = self.overloaded.take().map_or(now, |(since, _)| since);
        let load = self.load(telemetry, evidence);
        self.overloaded = load.map(|reason| (since, reason));
        if self.latched.is_none() {
            let swing = self.swing(telemetry);
            self.latched = self
                .device(now, arm, telemetry)
                .and(swing)
                .and_then(|()| self.measurements(now, evidence))
                .and_then(|()| self.needle(now, evidence))
                .err();
        }
        match &self.latched {
            Some(reason) => Verdict::Stop(reason.clone()),
            None => self.doubt(now, evidence).map_or(Verdict::Go, Verdict::Hold),
        }
    }

    /// Why the arm stands still for now.
    fn doubt(&self, now: Stamp, evidence: &Evidence) -> Option<Cause> {
        let model_fails = |(since, _): &(Stamp, String)| now.since(*since) > MODEL_HOLD;
        if self.bounds.dead_man.is_some() && !self.held {
            Some(Cause::Operator)
        } else if evidence.stalled.is_some() {
            Some(Cause::Stall)
        } else if evidence.implausible.is_some() {
            Some(Cause::NeedleLost)
        } else if now.since(self.newest_image) > self.bounds.image_hold || evidence.stale.is_some()
        {
            Some(Cause::MeasurementsLate)
        } else if now.since(self.newest_sight) > self.bounds.image_hold {
            Some(Cause::NeedleLost)
        } else if evidence.model.as_ref().is_some_and(model_fails) {
            Some(Cause::ModelFailed)
        } else {
            self.overloaded.as_ref().map(|(_, reason)| reason.cause())
        }
    }

    /// The arm, its operator, and numbers that are none.
    fn device(&self, now: Stamp, arm: &ArmState, t: &Telemetry) -> Result<(), StopReason> {
        let bounds = &self.bounds;
        match arm.mode {
            ArmMode::Enabled | ArmMode::Moving => {}
            ArmMode::Faulted(fault) => {
                return Err(StopReason::ArmFault { fault, words: None });
            }
            mode => return Err(StopReason::ArmNotEnabled { mode }),
        }
        if now.since(arm.stamp) > bounds.encoder_stop {
            return Err(StopReason::EncoderTimeout {
                age_s: now.secs_since(arm.stamp),
            });
        }
        if let (Some(longest), Some((_, newest))) = (bounds.dead_man, self.dead_man) {
            let longest = if self.held {
                longest
            } else {
                longest.max(FIRST_TOKEN)
            };
            if now.since(newest) > longest {
                return Err(StopReason::DeadMan {
                    age_s: now.secs_since(newest),
                });
            }
        }
        if let Some((since, until)) = self.at_box
            && until.since(since) > AT_BOX
        {
            return Err(StopReason::WorkspaceBox {
                held_s: until.secs_since(since),
            });
        }
        let tip = t.world_from_tip.origin().coords();
        for (finite, place) in [
            (arm.positions.is_finite(), "joint positions"),
            (t.joint_rates.is_finite(), "joint rates"),
            (tip.iter().all(|x| x.is_finite()), "the estimated tip"),
        ] {
            if !finite {
                return Err(StopReason::NonFinite { place });
            }
        }
        let offset = t.world_from_base.origin().point() - bounds.axis.0;
        let distance = (offset - bounds.axis.1.scale(offset.dot(&bounds.axis.1))).norm();
        if exceeds(distance, bounds.workspace_radius) {
            return Err(StopReason::Workspace {
                distance_m: distance,
                bound_m: bounds.workspace_radius,
            });
        }
        Ok(())
    }

    /// Whether the needle is seen.
    fn measurements(&self, now: Stamp, evidence: &Evidence) -> Result<(), StopReason> {
        let bounds = &self.bounds;
        match evidence.stale {
            Some(Stale::Late { age_s }) => {
                return Err(StopReason::MeasurementsLate {
                    age_s,
                    bound_s: bounds.image_age.as_secs_f64(),
                });
            }
            Some(Stale::Ahead { by_s }) => return Err(StopReason::MeasurementsAhead { by_s }),
            None => {}
        }
        if now.since(self.newest_image) > bounds.image_stop {
            return Err(StopReason::ImageTimeout {
                age_s: now.secs_since(self.newest_image),
                problem: None,
            });
        }
        if now.since(self.newest_sight) > bounds.image_stop {
            return Err(self.implausible.map_or_else(
                || StopReason::NeedleLost {
                    age_s: now.secs_since(self.newest_sight),
                    problem: self.problem.clone(),
                },
                |problem| StopReason::Implausible { problem },
            ));
        }
        Ok(())
    }

    /// Needle and tissue, by measurement and by a model that is not read while it fails.
    fn needle(&self, now: Stamp, evidence: &Evidence) -> Result<(), StopReason> {
        if let (Some(since), Some(stalled)) = (self.stalled, evidence.stalled)
            && now.since(since) > STALL_STOP
        {
            return Err(match evidence.tissue_motion {
                Some(by_m) if by_m > DRAWN_BACK => StopReason::TissueMotion { by_m },
                _ => StopReason::Stall { stalled },
            });
        }
        if let Some((since, reason)) = &self.overloaded
            && now.since(*since) > LOAD_STOP
        {
            return Err(reason.clone());
        }
        match &evidence.model {
            Some((since, problem)) if now.since(*since) > MODEL_STOP => Err(moved(evidence)
                .unwrap_or_else(|| StopReason::ModelFailed {
                    for_s: now.secs_since(*since),
                    problem: problem.clone(),
                })),
            _ => Ok(()),
        }
    }

    /// What the tissue's load is beyond its bounds: by the measured shaft, or by a model that is not read
    /// while it fails, and may have taken the tissue's motion for stretch where that was seen.
    fn load(&self, t: &Telemetry, evidence: &Evidence) -> Option<StopReason> {
        self.torn(t, evidence).or_else(|| {
            let known = evidence.model.is_none();
            let load = known.then(|| self.overload(t, evidence)).flatten()?;
            Some(moved(evidence).unwrap_or(load))
        })
    }

    /// What the measured shaft says, where there is one.
    fn torn(&self, t: &Telemetry, evidence: &Evidence) -> Option<StopReason> {
        let off_m = t.model.path_off - evidence.largest_tissue_motion;
        let bound_m = self.bounds.tissue_stretch;
        (off_m > bound_m).then_some(StopReason::ShaftAside { off_m, bound_m })
    }

    /// What the model says of the tissue's load, where that is beyond its bounds. What the tissue
    /// moves by itself stretches nothing, but the model may have taken it for stretch.
    fn overload(&self, t: &Telemetry, evidence: &Evidence) -> Option<StopReason> {
        let bounds = &self.bounds;
        let stretch = t.model.max_stretch - evidence.largest_tissue_motion;
        let off_m = t.model.shaft_off;
        let stretched = exceeds(stretch, bounds.tissue_stretch);
        if (stretched || exceeds(t.model.entry_force, bounds.entry_force))
            && off_m > DOUBT
            && stretch - PEAK * off_m < CERTAIN * bounds.tissue_stretch
        {
            return Some(StopReason::ModelContradicted {
                off_m,
                stretch_m: stretch,
            });
        }
        if stretched {
            return Some(StopReason::TissueStretch {
                value_m: stretch,
                bound_m: bounds.tissue_stretch,
            });
        }
        exceeds(t.model.entry_force, bounds.entry_force).then_some(StopReason::EntryForce {
            value_n: t.model.entry_force,
            bound_n: bounds.entry_force,
        })
    }
}

impl Supervisor {
    /// Stops a base that moves across its axis faster than anything may command, as joints that
    /// do not keep in step can make it.
    fn swing(&mut self, t: &Telemetry) -> Result<(), StopReason> {
        let axis = self.bounds.axis.1;
        let place = t.world_from_base.origin().coords();
        let across = place - axis.scale(place.dot(&axis));
        let (since, from) = *self.base.get_or_insert((t.stamp, across));
        let time = t.stamp.secs_since(since);
        if time < SPEED_OVER {
            return Ok(());
        }
        self.base = Some((t.stamp, across));
        let speed_m_s = (across - from).norm() / time;
        let bound_m_s = self.bounds.base_speed;
        if exceeds(speed_m_s, bound_m_s) {
            return Err(StopReason::BaseSpeed {
                speed_m_s,
                bound_m_s,
            });
        }
        Ok(())
    }
}

/// The tissue moves more than can be followed, by the monitor.
fn moved(evidence: &Evidence) -> Option<StopReason> {
    let by_m = evidence.tissue_motion?;
    Some(StopReason::TissueMotion { by_m })
}

/// Beyond the bound; a value that is not a number is.
fn exceeds(value: f64, bound: f64) -> bool {
    value.is_nan() || value > bound
}

#[cfg(test)]
mod tests;
