//! Law `hybrid`: steering by the predicted miss, base and bevel planned together in strict
//! priority, the bevel modulated by curvature debt.

mod plan;

use core::f64::consts::TAU;
use core::time::Duration;

use hal::telemetry::SteeringMode;
use hal::{Stamp, Twist};
use nalgebra::Vector3;

use crate::bevel::BevelModulator;
use crate::estimator::{Estimator, Rollout};
use crate::settings::HybridSettings;
use crate::tasks::target_velocity;
use crate::view::{Decision, Law, View, blank_report};
use plan::Plan;

/// Travel that turns of the bevel leave unused on either side, beyond the guard's \[rad\]: with
/// it they stay inside three quarters of a turn of an arm with one turn to either side. An arm
/// with less than a turn in all has nothing to leave.
const TURN_RESERVE: f64 = 1.2;

/// Part of the base's gain that noise takes away at most.
const CALM: f64 = 0.65;

pub(super) struct Hybrid {
    settings: HybridSettings,
    rollout: Rollout,
    modulator: BevelModulator,
    plan: Plan,
    planned_at: Option<Stamp>,
    last_base: Option<Vector3<f64>>,
    /// How calmly the base is led, 0 to 1: a base that chases the noise of the prediction tilts
    /// farther and farther, and insertion waits for it in vain.
    calm: f64,
    /// Time lost so far by slowing down \[s\].
    waited: f64,
}

impl Hybrid {
    pub(super) fn new(settings: &HybridSettings) -> Self {
        Self {
            settings: settings.clone(),
            rollout: Rollout::new(),
            modulator: BevelModulator::new(settings.debt_threshold_mm * 1e-3),
            plan: Plan::default(),
            planned_at: None,
            last_base: None,
            calm: 0.0,
            waited: 0.0,
        }
    }

    /// A new plan, where one is due. `false`: there is none to follow.
    fn refresh(&mut self, view: &View<'_>) -> bool {
        let period = Duration::from_secs_f64(1.0 / self.settings.plan_rate_hz);
        let due = self
            .planned_at
            .is_none_or(|at| view.time.since(at) >= period);
        if !due {
            return self.plan.valid;
        }
        self.planned_at = Some(view.time);
        view.estimator
            .rollout(&view.target.position, &mut self.rollout);
        let sigma = view.tip.position_sigma * 1e3;
        let s = &self.settings;
        self.calm =
            ((sigma - s.calm_from_mm) / (s.calm_to_mm - s.calm_from_mm).max(1e-9)).clamp(0.0, 1.0);
        self.plan = plan::make(view, &self.rollout, s, self.calm);
        self.plan.valid
    }

    /// Base motion of this cycle: the plan's pivot and shift approached exponentially, and the
    /// entry unloaded where the base steers no more.
    fn base(&mut self, view: &View<'_>) -> Twist {
        let s = &self.settings;
        let calmed = s.base_gain_per_s * (1.0 - CALM * self.calm);
        let gain = calmed.min(0.8 / view.dt.max(1e-3));
        let tilt_max = view.limits.tilt_speed_deg_s.to_radians();
        let lateral_max = view.limits.lateral_speed_mm_s * 1e-3;
        let height = (view.world_from_base.translation.vector - view.entry.point.coords).norm();
        let pivot = self.plan.pivot * gain;
        let shift = self.plan.shift * gain;
        // Pivot and shift may work against each other on the miss, to spare the entry: they go
        // in step, or the faster one would make the miss worse than either plan.
        let pivot_most = tilt_max.min(0.7 * lateral_max / height.max(1e-3));
        let over = (pivot.norm() / pivot_most)
            .max(shift.norm() / (0.2 * lateral_max))
            .max(1.0);
        let (pivot, shift) = (pivot / over, shift / over);
        self.plan.pivot -= pivot * view.dt;
        self.plan.shift -= shift * view.dt;
        let unload = (self.plan.unload * s.unload_gain_per_s).cap_magnitude(0.1 * lateral_max);
        self.plan.unload -= unload * view.dt;
        let across = view.estimator.lateral(&(shift + unload));
        let turn = view.pivot(&view.estimator.pivot_rotation(&pivot));
        Twist {
            linear: turn.linear + across,
            angular: turn.angular,
        }
    }
}

impl Law for Hybrid {
    fn name(&self) -> &'static str {
        "hybrid"
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        if !self.refresh(view) {
            return Decision::hold();
        }
        let s = &self.settings;
        let axis = view.base_axis();
        let here = view.world_from_base.translation.vector;
        let advanced = self.last_base.map_or(0.0, |last| axis.dot(&(here - last)));
        self.last_base = Some(here);
        let spin_deg_s = s.spin_deg_s.min(view.limits.spin_speed_deg_s);
        let azimuth = view.estimator.bevel_direction();
        let spin = self.modulator.step(
            &self.plan.curvature,
            azimuth,
            advanced,
            &view.roll_travel.within_spare(TURN_RESERVE, 0.0, TAU),
            spin_deg_s.to_radians(),
            view.dt,
        );
        // A joint that turns more slowly than is wished takes no longer way for it.
        let turning = if spin == 0.0 {
            1.0
        } else {
            spin_deg_s / s.spin_deg_s
        };
        let unfinished = self.plan.unfinished(&self.rollout);
        // Waiting has an end: a plan that never finishes must not hold up the insertion.
        let slow = if s.slow_down && self.waited < s.slow_most_s {
            let slow = (s.slow_mm * 1e-3 / unfinished.max(1e-9)).clamp(0.1, 1.0);
            slow + (1.0 - slow) * self.calm
        } else {
            1.0
        };
        self.waited += (1.0 - slow) * view.dt;
        // A tilting base draws the needle back: what has been lost is inserted again at once.
        let regain = view.estimator.retracted() * s.regain_gain_per_s;
        let speed = (view.insertion_speed * slow).max(regain) * turning;
        let base = self.base(view);
        let screw = view.screw(speed, spin);
        let mut report = blank_report();
        let desired = target_velocity(
            &view.tip.locate(&view.target.position),
            view.insertion_speed,
        );
        report.heading_error = crate::duty_cycle::heading_angle(&desired);
        let wanted = &self.plan.curvature;
        report.bevel_error = crate::tasks::wrap(azimuth - wanted.y.atan2(wanted.x));
        report.mode = if self.modulator.is_turning() {
            SteeringMode::BevelTurn
        } else {
            SteeringMode::BevelHold
        };
        report.predicted_miss = self.rollout.miss;
        report.shortfall = self.plan.shortfall;
        report.base_authority = self.rollout.pivot;
        report.bevel_authority = self.rollout.bevel;
        self.plan.report_limits(&mut report.limits);
        Decision {
            twist: Twist {
                linear: base.linear + screw.linear,
                angular: base.angular + screw.angular,
            },
            report,
        }
    }

    fn predicted_path(&self, estimator: &Estimator, path: &mut Vec<Vector3<f64>>) {
        path.clear();
        path.extend(self.rollout.path(estimator).map(|point| point.coords));
    }

    fn reset(&mut self) {
        self.modulator.reset();
        self.plan = Plan::default();
        self.planned_at = None;
        self.last_base = None;
        self.waited = 0.0;
    }
}
