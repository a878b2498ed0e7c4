//! Bevel orientation and duty cycling, as the paper's laws and `tip-only` share them.

use core::f64::consts::TAU;

use hal::telemetry::{LawReport, SteeringMode};
use nalgebra::{Rotation3, Vector3};

use crate::duty_cycle::{Cycle, cycle_angle, duty_cycle, effective_curvature, heading_angle};
use crate::settings::PaperSettings;
use crate::tasks::{bevel_angle, sliding_mode, wrap};
use crate::view::{RollTravel, View};

/// What the tip-based part wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BevelCommand {
    pub(super) speed: f64,
    pub(super) spin: f64,
    pub(super) duty_cycling: bool,
}

#[derive(Debug)]
pub(super) struct BevelSteering {
    settings: PaperSettings,
    cycle: Option<Cycle>,
    duty_cycling: bool,
    sense: f64,
    /// Sense of a turn that goes the long way round because of the travel.
    detour: Option<f64>,
    filtered: Option<Vector3<f64>>,
}

impl BevelSteering {
    pub(super) fn new(settings: &PaperSettings) -> Self {
        Self {
            settings: settings.clone(),
            cycle: None,
            duty_cycling: false,
            sense: 1.0,
            detour: None,
            filtered: None,
        }
    }

    pub(super) fn reset(&mut self) {
        *self = Self::new(&self.settings);
    }

    /// Direction to the target in the tip frame, unit norm, with the tangent low-passed where
    /// the settings ask for it (P3).
    pub(super) fn heading(&mut self, view: &View<'_>) -> Vector3<f64> {
        let seen = view.tip.locate(&view.target.position);
        let time = self.settings.tangent_filter_s;
        if time <= 0.0 || view.tip.direction_sigma < 0.3_f64.to_radians() {
            self.filtered = None;
            return seen;
        }
        let axis = view.tip.axis();
        let gain = (view.dt / time).clamp(0.0, 1.0);
        let smooth = self
            .filtered
            .map_or(axis, |old| old + (axis - old) * gain)
            .normalize();
        self.filtered = Some(smooth);
        let correction = Rotation3::rotation_between(&smooth, &axis).unwrap_or_default();
        let away = view.target.position - view.tip.world_from_tip.translation.vector;
        view.tip
            .world_from_tip
            .inverse_transform_vector(&(correction * away.coords))
    }

    /// Insertion speed and spin for a desired tip velocity (tip frame).
    pub(super) fn step(
        &mut self,
        view: &View<'_>,
        desired: &Vector3<f64>,
        report: &mut LawReport,
    ) -> BevelCommand {
        let s = self.settings.clone();
        let length = s.cycle_length_mm * 1e-3;
        let natural = if s.estimate_curvature {
            view.estimator.natural_curvature().clamp(0.3, 6.0)
        } else {
            s.natural_curvature_per_m
        };
        let offset = if s.robust_bevel {
            view.estimator.bevel_azimuth()
        } else {
            0.0
        };
        let mut sigma = bevel_angle(desired) + offset;
        if s.robust_bevel {
            sigma = wrap(sigma);
        }
        let heading = heading_angle(desired);
        report.heading_error = heading;
        report.bevel_error = wrap(sigma);
        let omega_max = s
            .omega_z_max_deg_s
            .min(view.limits.spin_speed_deg_s)
            .to_radians();
        let speed = view.insertion_speed;
        let threshold = cycle_angle(natural, length);
        let leave = if s.steady_cycles { 1.5 } else { 1.0 } * threshold;
        let finished = self.cycle.is_none_or(|c| c.is_done());
        if finished || !s.steady_cycles {
            let limit = if self.duty_cycling { leave } else { threshold };
            self.duty_cycling = heading < limit;
            if !self.duty_cycling {
                self.cycle = None;
            } else if finished {
                self.start_cycle(view, heading, sigma, natural, length);
            }
        }
        if let Some(cycle) = &mut self.cycle {
            let phase = cycle.advance(speed, omega_max, view.dt);
            report.duty_cycle = cycle.duty();
            report.mode = if phase.spinning {
                SteeringMode::DutyCycleSpin
            } else {
                SteeringMode::DutyCycleInsert
            };
            return BevelCommand {
                speed: phase.speed,
                spin: phase.spin,
                duty_cycling: true,
            };
        }
        // A lateral direction inside the noise says nothing about where to turn.
        let lateral = desired.xy().norm();
        let noise = desired.norm() * view.tip.direction_sigma;
        let held = s.robust_bevel && lateral < noise;
        let spin = if held {
            0.0
        } else {
            self.turn(sigma, omega_max, &view.roll_travel)
        };
        report.mode = SteeringMode::Manipulation;
        BevelCommand {
            speed,
            spin,
            duty_cycling: false,
        }
    }

    fn start_cycle(
        &mut self,
        view: &View<'_>,
        heading: f64,
        sigma: f64,
        natural: f64,
        length: f64,
    ) {
        let duty = duty_cycle(effective_curvature(heading, length), natural);
        self.cycle = Cycle::plan(duty, length, sigma, self.sense, &view.roll_travel);
        if let (Some(cycle), true) = (&self.cycle, self.settings.steady_cycles) {
            self.sense = -cycle.sense();
        }
    }

    /// Eq. (15), the long way round where the travel does not allow the short one.
    fn turn(&mut self, sigma: f64, omega_max: f64, travel: &RollTravel) -> f64 {
        let short = -wrap(sigma);
        let long = short - short.signum() * TAU;
        let arrived = short.abs() < 0.1;
        // The wanted direction moves meanwhile: a detour may come to its end before it arrives.
        let blocked = |sense: f64| {
            let way = if short * sense > 0.0 { short } else { long };
            !travel.allows(way)
        };
        if arrived || self.detour.is_some_and(blocked) {
            self.detour = None;
        }
        if self.detour.is_none() && !travel.allows(short) && travel.allows(long) {
            self.detour = Some(long.signum());
        }
        match self.detour {
            Some(sense) => sense * omega_max,
            // The wanted direction lies between the ends of the travel.
            None if !travel.allows(short) && !travel.allows(long) => {
                sliding_mode(-travel.end_next_to(short), omega_max)
            }
            None => sliding_mode(wrap(sigma), omega_max),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crate::seeded())]

        /// Wherever the last joint is and however the wanted direction moved before, the bevel
        /// arrives in the time of a turn and a half, and the joint stays in its range.
        #[test]
        fn the_bevel_arrives_within_the_travel(
            start in -TAU..TAU, moves in prop::collection::vec((-PI..PI, 1_usize..60), 1..12),
        ) {
            let mut steering = BevelSteering::new(&PaperSettings::default());
            let (omega, dt) = (TAU, 1.0 / 60.0);
            let (mut joint, mut wanted) = (start, 0.0);
            let mut step = |wanted: f64| {
                let travel = RollTravel { positive: TAU - joint, negative: TAU + joint };
                let spin = steering.turn(wrap(joint - wanted), omega, &travel);
                joint = (joint + spin * dt).clamp(-TAU, TAU);
                wrap(joint - wanted).abs()
            };
            for (change, steps) in moves {
                wanted += change;
                for _ in 0..steps {
                    step(wanted);
                }
            }
            let least = (0..90).map(|_| step(wanted)).fold(PI, f64::min);
            prop_assert!(least < 0.1, "{least}");
        }
    }
}
