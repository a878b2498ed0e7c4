//! What is known of an insertion before each command, and when it ends.

use hal::telemetry::{Limit, Phase};
use hal::{Joints, Stamp};
use nalgebra::Vector3;

use super::Insertion;
use crate::config::Config;
use crate::outcome::{Cause, Ended, Summary};
use crate::passing::Answer;
use crate::supervisor::{Evidence, StopReason};

impl Insertion<'_> {
    /// What the monitor has to say while the needle is being inserted.
    pub(super) fn evidence(&self, now: Stamp) -> Evidence {
        if !matches!(self.phase, Phase::PreInsertion | Phase::Steering) {
            return Evidence::default();
        }
        Evidence {
            stalled: self.monitor.stalled(),
            tissue_motion: self.monitor.tissue_motion(now),
            largest_tissue_motion: self.monitor.largest_tissue_motion(),
            stale: self.freshness.finding(),
            implausible: self.cycle.implausible().copied(),
            model: self.cycle.model_failure().cloned(),
        }
    }

    /// The law's rates, slower where the base would get too far ahead of the measurements.
    pub(super) fn slowed(&self) -> Joints {
        let telemetry = self.cycle.telemetry();
        let axis = telemetry.world_from_base.rotate(&Vector3::z());
        if axis.dot(&telemetry.base_twist.linear) <= 0.0 {
            return self.rates;
        }
        let share = self.monitor.allowed_speed();
        self.rates.map(|rate| rate * share)
    }

    pub(super) fn verdict(&mut self, now: Stamp) -> Option<Ended> {
        if self.phase != Phase::Steering {
            return None;
        }
        let telemetry = self.cycle.telemetry();
        let ahead = telemetry.axial_distance;
        let measured = self.cycle.measured();
        let said = self.rig.left_from_world() * telemetry.world_from_tip.origin();
        self.passing.say(telemetry.stamp, &said);
        match self.passing.look(now, ahead, &telemetry.target, measured) {
            Answer::Ahead => {}
            Answer::Awaited => return None,
            Answer::Passed if telemetry.depth > 0.0 => return Some(Ended::TargetPassed),
            Answer::Passed => return Some(Ended::Stopped(StopReason::OutsideTissue)),
            Answer::Beyond(by) => return Some(Ended::Overrun(by)),
            Answer::Disagree(ahead_m) => {
                return Some(Ended::Stopped(StopReason::Disagreement { ahead_m }));
            }
            Answer::Carried(by_m) => {
                return Some(Ended::Stopped(StopReason::TissueMotion { by_m }));
            }
            Answer::Apart(off_m) => return Some(Ended::Stopped(StopReason::TipApart { off_m })),
        }
        if let Some(shortfall) = self.reach.update(now, ahead, &telemetry.law) {
            return Some(Ended::Unreachable(shortfall));
        }
        let late = self.progress.update(now, ahead);
        if self.progress.has_advanced(now) {
            self.holds.progress();
        }
        let for_s = late?;
        let cause = self.holds.cause_of(for_s);
        let cause = cause.unwrap_or_else(|| self.cause_of_standstill());
        Some(Ended::NoProgress { for_s, cause })
    }

    /// Why a law that is not held comes no nearer.
    pub(super) fn cause_of_standstill(&self) -> Cause {
        let at_an_end = |limit: &Limit| {
            matches!(
                limit,
                Limit::JointPosition(_) | Limit::RemainingTurns | Limit::Workspace
            )
        };
        if self.cycle.telemetry().law.limits.iter().any(at_an_end) {
            Cause::Device
        } else if self.cycle.tissue_moves() {
            Cause::TissueMotion
        } else {
            Cause::OutOfReach
        }
    }

    pub(super) fn summary(&self, config: &Config, ended: Ended) -> Summary {
        let telemetry = self.cycle.telemetry();
        let figures = self.rig.world.as_ref().and_then(|world| world.figures());
        let duration = self
            .steering_since
            .map_or(0.0, |since| telemetry.stamp.secs_since(since));
        Summary {
            law: self.cycle.law_name().to_owned(),
            ..Summary::new(config, ended, telemetry, figures, &self.events, duration)
        }
    }
}
