//! Does the truth confirm the cause that a run names? In words:
//!
//! * `stall`: within the last 15 s the base advanced by 1.5 mm while the cut path grew, or the true
//!   tip went along its axis, by less than half of that.
//! * `buckling`: the phantom's event within the last 10 s, or the true tip leapt by 2 mm within
//!   0.15 s while the tissue did not.
//! * `tear`: the tissue tore, or was stretched to 80 % of what tears it, or the true force at the entry
//!   came to 80 % of its bound, within the last 10 s.
//! * `out_of_reach`: the target lies beside the true tip's axis by more than 0.5 mm more than the true
//!   bevel, at its full curvature, and a base that stretches the true tissue as far as a plan
//!   may can make up over the way that is left.
//! * `needle_lost`: the true needle left its hole or leapt by 3 mm within 0.15 s, within the last 10 s.
//! * `measurements_late`: the sensor is truly late by half a second, or sees so seldom that two hundred
//!   milliseconds without a measurement are common.
//! * `tissue_motion`: the tissue at the tip truly moved by 1 mm within the last 15 s.
//! * `model_failed`: the true tip is more than 1 mm from the estimated one, the true shaft lies beside
//!   the model's by more than half of what the verdict says, the target is beyond or in
//!   front of the true tip as the verdict says, the model's stretch differs from the true one by 0.5 mm
//!   and a third of it, or the model knew no equilibrium for more than a second.
//! * `device`: base or joints stand at an end that limits or bounds give them.
//! * `operator`: the time that was allowed has passed.

use std::collections::BTreeMap;

use hal::telemetry::{Limit, TruthEvent};
use nalgebra::Vector3;

use super::watch::{Moment, Watch};
use crate::config::Config;
use crate::outcome::{Cause, Ended};
use crate::supervisor::StopReason;

/// Time before the end in which evidence of what was slow to be noticed counts \[s\].
const SLOW: f64 = 15.0;
/// The same for what happens at an instant \[s\].
const SUDDEN: f64 = 10.0;
/// Advance over which a stall is told \[m\], and the share of it that a path that stalls may grow \[1\].
const STALL: (f64, f64) = (1.5e-3, 0.5);
/// Share of what tears, or of a bound, that counts as near \[1\].
const NEAR: f64 = 0.8;
/// Least motion of the tissue that counts \[m\].
const MOVES: f64 = 1e-3;
/// Miss beyond what can be made up that is out of reach \[m\].
const SHORT: f64 = 0.5e-3;
/// Latency that is late \[s\]: the default bound of 550 ms less a period of arm and sensor.
const LATE: f64 = 0.5;
/// Mean time between measurements beyond which 200 ms without one are common \[s\].
const SELDOM: f64 = 0.06;
/// Distance between estimate and truth that is a failure \[m\].
const ASTRAY: f64 = 1e-3;
/// Error of the model's stretch that is a failure: \[m\], and relative to the true one \[1\].
const WRONG: (f64, f64) = (0.5e-3, 1.0 / 3.0);
/// Slack of ends that arms keep from: \[m\], \[rad\].
const ENDS: (f64, f64) = (2e-3, 0.02);

/// What was true at the end of a run. Lengths \[m\].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truths {
    /// Distance of the true tip from the estimated one.
    pub said_off: f64,
    /// Least growth of the cut path, or way of the tip, over the last millimetre and a half of advance, lately.
    pub growth: f64,
    /// Largest leap of the true tip within 0.15 s, lately, less the tissue's.
    pub leap: f64,
    /// Way of the tissue at the tip, lately.
    pub tissue_way: f64,
    /// Largest displacement of the tissue, lately.
    pub stretch: f64,
    /// The same by the model, largest of the last second in which it was known.
    pub model: f64,
    /// Distance of the measured and of the true shaft from the model's at the end, and what the first
    /// kept to for a second or two.
    pub shaft_off: [f64; 4],
    /// Largest lateral force at the entry, lately \[N\].
    pub entry_force: f64,
    /// Target ahead of the true tip.
    pub ahead: f64,
    /// Target beside the true tip's axis.
    pub aside: f64,
    /// What true bevel and base could still make up of that.
    pub reach: f64,
    /// For how long the model had had no equilibrium \[s\].
    pub model_fails_s: f64,
    /// Whether base or joints stand at an end.
    pub at_an_end: bool,
    /// Events lately, with the number of exposures at which they lasted.
    pub events: BTreeMap<&'static str, usize>,
    /// Age of measurements at their arrival, and mean time between them \[s\].
    pub measurements: (f64, f64),
    /// Largest distance of the measured shaft from where the measured tip went, at the end.
    pub path_off: f64,
    /// Time of the last step \[s\].
    pub t_s: f64,
}

impl Truths {
    /// What `watch` saw of the run of `config`; `place` corrects what is said in World by the
    /// controller's registration.
    pub(super) fn of(
        config: &Config,
        watch: &Watch<'_>,
        place: impl Fn(&Vector3<f64>) -> Vector3<f64>,
    ) -> Self {
        let Some(end) = watch.moments.last() else {
            return Self::default();
        };
        let sudden = watch.lately(SUDDEN);
        let most = |of: fn(&Moment) -> f64| sudden.iter().map(of).fold(0.0, f64::max);
        let since = end.t - SUDDEN;
        let mut events = BTreeMap::new();
        for (event, _) in watch.events.iter().filter(|(_, t)| *t >= since) {
            *events.entry(event.name()).or_default() += 1;
        }
        let settings = phantom_of(config);
        let sensor = &settings.sensor;
        Self {
            said_off: (place(&end.said) - true_tip_at(&watch.moments, end.t)).norm(),
            growth: least_growth(watch.lately(SLOW), &watch.moments),
            leap: largest_leap(sudden),
            tissue_way: way(watch.lately(SLOW)),
            stretch: most(|m| m.stretch),
            model: (watch.lately(1.0).iter().map(|m| m.model.0)).fold(0.0, f64::max),
            shaft_off: [
                end.shaft_off,
                watch.truly_off(config),
                watch.off_for(1.0),
                watch.off_for(2.0),
            ],
            entry_force: most(|m| m.entry_force),
            ahead: end.true_ahead,
            aside: end.true_aside,
            reach: reach(config, &settings, end),
            model_fails_s: end.t - last_equilibrium(&watch.moments),
            at_an_end: at_an_end(config, watch, end),
            events,
            measurements: (
                sensor.latency_ms * 1e-3,
                1.0 / (sensor.rate_hz * (1.0 - sensor.drop_fraction)),
            ),
            path_off: (watch.last.as_ref()).map_or(f64::NAN, |last| last.model.path_off),
            t_s: end.t,
        }
    }
}

/// Whether the truth confirms `cause`; the module says how.
pub(super) fn confirmed(ended: &Ended, cause: Cause, config: &Config, truths: &Truths) -> bool {
    let happened = |kind: TruthEvent| truths.events.contains_key(kind.name());
    let tears = phantom_of(config).tissue.tear_mm * 1e-3;
    match cause {
        Cause::Stall => truths.growth < STALL.1 * STALL.0,
        Cause::Buckling => happened(TruthEvent::Buckling) || truths.leap > 2e-3,
        Cause::Tear => {
            happened(TruthEvent::Tearing)
                || (tears > 0.0 && truths.stretch > NEAR * tears)
                || truths.entry_force > NEAR * config.supervisor.entry_force_n
        }
        Cause::OutOfReach => truths.aside > truths.reach + SHORT,
        Cause::NeedleLost => happened(TruthEvent::PulledOut) || truths.leap > 3e-3,
        Cause::MeasurementsLate => truths.measurements.0 > LATE || truths.measurements.1 > SELDOM,
        Cause::TissueMotion => truths.tissue_way > MOVES,
        Cause::ModelFailed => match ended {
            Ended::Overrun(_) => truths.ahead < -ASTRAY,
            Ended::Stopped(StopReason::Disagreement { ahead_m }) => {
                (truths.ahead - ahead_m).abs() < 0.5 * ASTRAY || truths.said_off > ASTRAY
            }
            Ended::Stopped(StopReason::TipApart { off_m }) => truths.said_off > 0.5 * off_m,
            Ended::Stopped(StopReason::ModelContradicted { off_m, .. })
                if truths.shaft_off[1] > 0.5 * off_m =>
            {
                true
            }
            _ if (truths.model - truths.stretch).abs() > WRONG.0
                && (truths.model / truths.stretch - 1.0).abs() > WRONG.1 =>
            {
                true
            }
            _ => truths.said_off > ASTRAY || truths.model_fails_s > 1.0,
        },
        Cause::Device => truths.at_an_end,
        Cause::Operator => truths.t_s > 0.98 * config.run.max_duration_s,
    }
}

/// The phantom's settings; a configuration that was run has some.
fn phantom_of(config: &Config) -> phantom::Settings {
    config.phantom_settings().unwrap_or_default()
}

/// The true tip at `t`, from the last two exposures.
fn true_tip_at(moments: &[Moment], t: f64) -> Vector3<f64> {
    let Some(last) = moments.last() else {
        return Vector3::zeros();
    };
    let before = moments.iter().rev().find(|m| m.exposed < last.exposed);
    before.map_or(last.tip, |before| {
        let share = (t - before.exposed) / (last.exposed - before.exposed);
        before.tip + (last.tip - before.tip) * share
    })
}

/// Least growth of the path over [`STALL`] of advance that ends at one of `lately`; infinite
/// where the base did not go so far.
fn least_growth(lately: &[Moment], all: &[Moment]) -> f64 {
    lately
        .iter()
        .filter_map(|now| {
            let then = all
                .iter()
                .rev()
                .skip_while(|m| m.t >= now.t)
                .find(|m| m.advance <= now.advance - STALL.0)?;
            Some((now.path - then.path).min(now.tip_way - then.tip_way))
        })
        .fold(f64::INFINITY, f64::min)
}

/// Largest change of the true tip within 0.15 s beyond that of the tissue.
fn largest_leap(lately: &[Moment]) -> f64 {
    let mut largest = 0.0_f64;
    for (k, now) in lately.iter().enumerate() {
        for then in lately[..k].iter().rev().take_while(|m| now.t - m.t < 0.15) {
            let by = ((now.tip - then.tip) - (now.tissue - then.tissue)).norm();
            largest = largest.max(by);
        }
    }
    largest
}

/// Farthest that the tissue at the tip was from where it was at the end of `lately`'s first step.
fn way(lately: &[Moment]) -> f64 {
    let mut extent = [
        Vector3::from_element(f64::INFINITY),
        Vector3::from_element(f64::NEG_INFINITY),
    ];
    for moment in lately {
        extent = [extent[0].inf(&moment.tissue), extent[1].sup(&moment.tissue)];
    }
    let size = extent[1] - extent[0];
    if size.x.is_finite() { size.norm() } else { 0.0 }
}

/// When the model last had an equilibrium \[s\].
fn last_equilibrium(moments: &[Moment]) -> f64 {
    moments
        .iter()
        .rev()
        .find(|m| m.model.0.is_finite())
        .map_or(0.0, |m| m.t)
}

/// What the true bevel and a base within its limits can still move the tip aside over the way that is
/// left: a beam on the true bed, in closed form.
fn reach(config: &Config, settings: &phantom::Settings, end: &Moment) -> f64 {
    let needle = &settings.needle;
    let [outer, inner] = [needle.outer_diameter_mm, needle.inner_diameter_mm].map(|d| d * 1e-3);
    let bending =
        needle.young_gpa * 1e9 * core::f64::consts::PI / 64.0 * (outer.powi(4) - inner.powi(4));
    let draw = phantom::Draw::new(settings, config.run.seed);
    let wave = (4.0 * bending / draw.stiffness).powf(0.25);
    let left = end.true_ahead.max(0.0);
    // The path turns by the cut angle over about half a wave length.
    let bevel = 2.0 * draw.cut_angle / wave * left * left / 2.0;
    let pressed = config.limits.entry_stretch_mm * 1e-3 * (-end.path / wave).exp();
    let means = hybrid_control::Means::of_law(&config.run.law);
    let base = pressed * (1.0 + 2.0 * left / wave);
    f64::from(u8::from(means.bevel)) * bevel + f64::from(u8::from(means.base())) * base
}

/// Whether base or joints stand at an end that limits or bounds give them. What moving tissue may
/// carry the base is kept from its workspace.
fn at_an_end(config: &Config, watch: &Watch<'_>, end: &Moment) -> bool {
    let inward = config.inward().into_inner();
    let offset = end.base - config.entry().coords;
    let aside = (offset - inward * inward.dot(&offset)).norm();
    let limits = &config.limits;
    let carried = (watch.moments.iter())
        .map(|m| m.tissue.norm())
        .fold(0.0, f64::max);
    let by_joint = watch.last.as_ref().is_some_and(|last| {
        let ends = |limit: &Limit| matches!(limit, Limit::JointPosition(_) | Limit::RemainingTurns);
        last.law.limits.iter().any(ends)
    });
    by_joint
        || aside > limits.base_offset_mm * 1e-3 - ENDS.0 - carried
        || end.axis.angle(&inward) > limits.tilt_deg.to_radians() - ENDS.1
}
