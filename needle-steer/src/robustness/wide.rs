//! Worlds far wider than the presets, drawn at random: what a laboratory's bad day brings.
//!
//! Every flaw takes part in some of the worlds only, so that each is met alone and with others.

use std::fmt::Write as _;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::confirm::{Truths, confirmed};
use super::watch::Watch;
use crate::config::{self, Config, ConfigError};
use crate::controls::Controls;
use crate::outcome::{Cause, Ended};
use crate::rig::Rig;
use crate::run::{RunError, run};
use hybrid_control::LAW_NAMES;

/// First seed: far from those of every other campaign.
const FIRST_SEED: u64 = 1_000_000;
/// Longest simulated insertion \[s\]: a nominal one takes 80.
const LONGEST_S: f64 = 240.0;
/// Edges of the phantom's rod: 1 mm each, a tenth of the shortest wave length of these worlds.
const ELEMENTS: u32 = 126;
/// Farthest that the tip may be from where a run that passed said it was \[m\].
const SAID: f64 = 1e-3;
/// Advance of the base, and growth of the cut path below it, that are blind pushing \[m\].
const BLIND: (f64, f64) = (3e-3, 0.2e-3);
/// Longest time over which figures of the model may stand still while the needle moves \[s\].
const FROZEN: f64 = 0.3;

/// One world, with the law that meets it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct World {
    /// Number in the campaign.
    pub index: u64,
    /// Changes to the configuration.
    pub overrides: Vec<String>,
}

/// Draws one world.
struct Dice(ChaCha8Rng);

impl Dice {
    fn share(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + self.share() * (high - low)
    }

    /// Uniform in the logarithm.
    fn log(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    fn one_in(&mut self, count: f64) -> bool {
        self.share() < 1.0 / count
    }

    /// A vector of that length, its last component smaller by `flat`.
    fn vector(&mut self, length: f64, flat: f64) -> [f64; 3] {
        let mut v = nalgebra::Vector3::from_fn(|_, _| self.uniform(-1.0, 1.0));
        v.z *= flat;
        (v * (length / v.norm().max(1e-9))).into()
    }
}

impl World {
    /// The world of that number. Neighbours differ in law; all else comes from its own generator.
    pub fn new(index: u64) -> Self {
        let seed = FIRST_SEED + index;
        let mut dice = Dice(ChaCha8Rng::seed_from_u64(seed));
        let law = usize::try_from(index % LAW_NAMES.len() as u64).unwrap_or_default();
        let preset = if dice.one_in(4.0) { "harsh" } else { "paper" };
        let mut text = format!(
            "run.law={}\nrun.phantom={preset}\nrun.seed={seed}\nrun.sensor=shape\n\
             run.check_reach=false\nrun.max_duration_s={LONGEST_S:?}\n\
             phantom.needle.elements={ELEMENTS}\n",
            LAW_NAMES[law]
        );
        let mut set = |key: &str, value: f64| {
            let _ = writeln!(text, "{key}={value:?}");
        };
        set("target.depth_mm", dice.uniform(40.0, 100.0));
        set("target.offset_mm", dice.uniform(0.0, 12.0));
        set("target.angle_deg", dice.uniform(0.0, 360.0));
        draw_tissue(&mut dice, &mut set);
        draw_needle(&mut dice, &mut set);
        draw_sensor(&mut dice, &mut set);
        draw_motion(&mut dice, &mut text);
        Self {
            index,
            overrides: text.lines().map(str::to_owned).collect(),
        }
    }

    /// Its configuration.
    ///
    /// # Errors
    /// Never, while the overrides agree with the configuration's keys; a test holds that.
    pub fn config(&self) -> Result<Config, ConfigError> {
        config::load(None, &self.overrides)
    }
}

fn draw_tissue(dice: &mut Dice, set: &mut impl FnMut(&str, f64)) {
    if !dice.one_in(3.0) {
        set("phantom.tissue.stiffness_n_m2", dice.log(1e3, 5e5));
    }
    if dice.one_in(3.0) {
        set("estimator.stiffness_n_m2", dice.log(1e3, 3e5));
    }
    if dice.one_in(2.0) {
        set("phantom.friction.shaft_n_m", dice.uniform(0.1, 150.0));
        set("phantom.friction.static_ratio", dice.uniform(1.0, 1.5));
    }
    if dice.one_in(2.5) {
        set("phantom.entry.skin_n_m", dice.log(50.0, 1500.0));
        set("phantom.entry.slide_n", dice.uniform(0.0, 1.0));
        set("phantom.entry.grip_n", dice.uniform(0.0, 0.5));
        set("phantom.entry.follow", dice.share());
    }
}

/// The controller is told the defaults, whatever the needle is.
fn draw_needle(dice: &mut Dice, set: &mut impl FnMut(&str, f64)) {
    // Apart from what is told below.
    set("phantom.needle.bevel_deg", 24.0);
    if dice.one_in(2.0) {
        set("phantom.needle.young_gpa", dice.log(40.0, 300.0));
    }
    if dice.one_in(4.0) {
        let outer = 0.7 * dice.log(0.6, 1.7);
        set("phantom.needle.outer_diameter_mm", outer);
        set("phantom.needle.inner_diameter_mm", outer * 0.48 / 0.7);
    }
    if dice.one_in(3.0) {
        set("phantom.needle.bevel_deg", dice.uniform(8.0, 70.0));
        set("phantom.tip.cut_angle_deg", dice.uniform(0.1, 5.0));
    }
    if dice.one_in(6.0) {
        set("needle.bevel_deg", dice.uniform(5.0, 70.0));
    }
    if dice.one_in(4.0) {
        set("phantom.spread.azimuth_deg", dice.uniform(10.0, 60.0));
    }
}

fn draw_sensor(dice: &mut Dice, set: &mut impl FnMut(&str, f64)) {
    if dice.one_in(2.0) {
        set("phantom.sensor.latency_ms", dice.uniform(0.0, 600.0));
    }
    if dice.one_in(4.0) {
        set("phantom.sensor.drop_fraction", dice.uniform(0.0, 0.9));
    }
    if dice.one_in(4.0) {
        set("phantom.sensor.noise_mm", dice.log(0.02, 0.5));
        set("phantom.sensor.direction_noise_deg", dice.log(0.1, 2.0));
    }
}

fn draw_motion(dice: &mut Dice, text: &mut String) {
    if dice.one_in(3.0) {
        text.push_str("target.kind=marker\n");
    }
    if dice.one_in(2.5) {
        let _ = writeln!(
            text,
            "phantom.motion.breathing_mm={:?}\nphantom.motion.breathing_hz={:?}\n\
             phantom.motion.breathing_direction={:?}\nphantom.motion.breathing_fade_1_m={:?}",
            dice.log(0.5, 15.0),
            dice.uniform(0.15, 0.35),
            dice.vector(1.0, 0.4),
            dice.uniform(-10.0, 10.0),
        );
    }
    if dice.one_in(4.0) {
        let speed = dice.log(0.2, 20.0);
        let _ = writeln!(
            text,
            "phantom.motion.drift_mm_min={:?}",
            dice.vector(speed, 0.5)
        );
    }
    if dice.one_in(4.0) {
        let turn = dice.log(0.2, 10.0) * if dice.one_in(2.0) { 1.0 } else { -1.0 };
        let _ = writeln!(text, "phantom.motion.rotation_deg_min={turn:?}");
    }
}

/// What a run in a wide world came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// The verdict.
    pub ended: Ended,
    /// The cause that it names.
    pub cause: Option<Cause>,
    /// Whether the truth confirms that cause; true where none is named because it passed.
    pub confirmed: bool,
    /// Whether needle, tissue or world were damaged.
    pub spoilt: bool,
    /// Whether the run was given up because the phantom found no balance for ten seconds.
    pub given_up: bool,
    /// Distance of the true tip from where the controller said it was, at the end \[mm\].
    pub said_off_mm: f64,
    /// Target ahead of the true tip at the end \[mm\].
    pub axial_mm: f64,
    /// Largest advance of the base, in World and in the tissue, while the cut path grew by less than
    /// 0.2 mm \[mm\].
    pub blind_mm: f64,
    /// The same in World alone: a base that follows the tissue is in it.
    pub blind_in_world_mm: f64,
    /// Longest time in which the model's figures stood still while the needle moved \[s\].
    pub frozen_s: f64,
    /// The truth at the end, for whoever looks into it.
    pub truths: Truths,
}

impl Verdict {
    /// A run that passed, its tip elsewhere.
    pub fn is_false_pass(&self) -> bool {
        self.ended.is_success() && (self.said_off_mm.is_nan() || self.said_off_mm > SAID * 1e3)
    }

    /// A base that went on without the tip.
    pub fn pushed_blind(&self) -> bool {
        self.blind_mm > BLIND.0 * 1e3
    }

    /// A bound that read a model which had failed.
    pub fn read_failed_model(&self) -> bool {
        self.frozen_s > FROZEN
    }
}

/// Carries out the run of one world and holds its verdict against the truth.
///
/// # Errors
/// The run could not be carried out.
pub fn judge(config: &Config) -> Result<Verdict, RunError> {
    let mut rig = Rig::new(config)?;
    let controls = Controls::default();
    let mut watch = Watch::new(&controls);
    let summary = run(config, &mut rig, &mut watch, &controls)?;
    let truly = rig.world.as_ref().map(|world| world.stereo_from_world());
    // Where the sensor truly sees what the controller places in World by its registration.
    let registered = rig.left_from_world();
    let place = |said: &nalgebra::Vector3<f64>| {
        let in_stereo = registered * hal::Position::new((*said).into());
        truly.map_or(*said, |truly| (truly.inverse() * in_stereo).coords())
    };
    let truths = Truths::of(config, &watch, place);
    let blind = watch.blind(BLIND.1);
    let cause = summary.cause;
    Ok(Verdict {
        confirmed: cause.is_none_or(|cause| confirmed(&summary.ended, cause, config, &truths)),
        cause,
        given_up: watch.has_no_truth(),
        spoilt: summary.spoilt,
        said_off_mm: truths.said_off * 1e3,
        axial_mm: summary.axial_error_mm.unwrap_or(f64::NAN),
        blind_mm: blind.in_tissue * 1e3,
        blind_in_world_mm: blind.in_world * 1e3,
        frozen_s: watch.frozen(),
        ended: summary.ended,
        truths,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_are_configurations_repeat_and_reach_the_ends_of_their_ranges() {
        let worlds: Vec<World> = (0..2000).map(World::new).collect();
        assert_eq!(worlds[7], World::new(7));
        let of = |world: &World, key: &str| -> Option<f64> {
            let line = world.overrides.iter().find(|line| line.starts_with(key))?;
            line.split_once('=')?.1.parse().ok()
        };
        for (key, low, high) in [
            ("phantom.tissue.stiffness_n_m2", 2e3, 2.5e5),
            ("phantom.friction.shaft_n_m", 10.0, 140.0),
            ("phantom.needle.young_gpa", 50.0, 280.0),
            ("phantom.sensor.latency_ms", 20.0, 580.0),
            ("phantom.motion.breathing_mm", 1.0, 12.0),
        ] {
            let values: Vec<f64> = worlds.iter().filter_map(|world| of(world, key)).collect();
            assert!(values.len() > 500, "{key}: {}", values.len());
            assert!(values.iter().any(|x| *x < low) && values.iter().any(|x| *x > high));
        }
        for world in &worlds {
            world.config().unwrap();
        }
    }
}
