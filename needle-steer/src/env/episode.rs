//! One insertion at a time, driven by a policy.

use std::sync::Arc;

use hal::{SensedShape, Twist};
use nalgebra::{Isometry3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::action::{Action, twist};
use super::hand::Hand;
use super::observation::Seen;
use super::settings::{EnvError, Reward, Settings};
use crate::score::Score;
use crate::world::place_target;

/// Longest duration, as a multiple of what the nominal speed takes to the target.
const PATIENCE: f64 = 1.5;
/// Longest wait for a first measurement \[exposures\].
const FIRST_SIGHT: u64 = 300;

/// What a step came to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// What was earned.
    pub reward: f64,
    /// Whether the insertion is over: passed, or needle or tissue damaged.
    pub terminated: bool,
    /// Whether its time is over.
    pub truncated: bool,
}

/// The truth of an episode, for whoever judges it; a policy never sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Distance of the target from the tip axis when O's plane passed it, or now \[m\].
    pub lateral: f64,
    /// Target ahead of O along the tip axis \[m\].
    pub axial: f64,
    /// Largest tissue displacement so far \[m\].
    pub max_stretch: f64,
    /// Whether O's plane has passed the target.
    pub passed: bool,
    /// Whether the shaft gave way or yielded, or the tissue tore.
    pub spoilt: bool,
    /// Number of the phantom's preset among the settings'.
    pub phantom: usize,
    /// Seed of the phantom.
    pub seed: u64,
}

/// An environment: episode after episode, drawn by a seed.
#[derive(Debug)]
pub struct Episode {
    settings: Arc<Settings>,
    worlds: Arc<Vec<phantom::Settings>>,
    entry_from_world: Isometry3<f64>,
    dice: ChaCha8Rng,
    hand: Hand,
    exposure: u64,
    /// Steps left.
    left: u64,
    /// Steps at the start.
    whole: u64,
    roll: f64,
    target: Vector3<f64>,
    seen: Option<SensedShape>,
    score: Score,
    outcome: Outcome,
}

impl Episode {
    /// An environment of `settings` in its first episode.
    ///
    /// # Errors
    /// A setting outside its range, or a phantom that cannot be made.
    pub fn new(
        settings: Arc<Settings>,
        worlds: Arc<Vec<phantom::Settings>>,
        seed: u64,
    ) -> Result<Self, EnvError> {
        let Some(first) = worlds.first() else {
            return Err(EnvError::Value {
                key: "phantoms",
                expected: "at least one preset".into(),
                found: "none".into(),
            });
        };
        let mut episode = Self {
            hand: Hand::new(&settings.config, first, seed)?,
            entry_from_world: settings.config.world_from_entry().inverse(),
            dice: ChaCha8Rng::seed_from_u64(seed),
            exposure: 0,
            left: 0,
            whole: 0,
            roll: 0.0,
            target: Vector3::zeros(),
            seen: None,
            score: Score::new(Vector3::zeros()),
            outcome: Outcome::default(),
            settings,
            worlds,
        };
        episode.reset(Some(seed))?;
        Ok(episode)
    }

    /// Begins the next episode, or with a seed the first of that seed: a phantom is drawn, pushed
    /// straight in as the protocol has it, and the target placed.
    ///
    /// # Errors
    /// A phantom that cannot be made.
    pub fn reset(&mut self, seed: Option<u64>) -> Result<(), EnvError> {
        if let Some(seed) = seed {
            self.dice = ChaCha8Rng::seed_from_u64(seed);
        }
        // The first episode of a seed has the phantom of that seed, as `run` has it.
        let phantom_seed = seed.unwrap_or_else(|| self.dice.next_u64() >> 1);
        let phantom = usize::try_from(self.dice.next_u64() % self.worlds.len() as u64).unwrap_or(0);
        let [depth, offset, angle] = {
            let s = &self.settings;
            [s.depth_mm, s.offset_mm, s.angle_deg].map(|range| self.dice.uniform(range))
        };
        let config = &self.settings.config;
        self.hand = Hand::new(config, &self.worlds[phantom], phantom_seed)?;
        self.outcome = Outcome {
            phantom,
            seed: phantom_seed,
            ..Outcome::default()
        };
        (self.exposure, self.roll, self.seen) = (0, 0.0, None);
        let start = *self.hand.base();
        let speed = config.run.insertion_speed_mm_s * 1e-3;
        let straight = Twist {
            linear: start.rotation * Vector3::z() * speed,
            angular: Vector3::zeros(),
        };
        let way = self.hand.draw().pre_insertion;
        while (self.hand.base().translation.vector - start.translation.vector).norm() < way {
            self.drive(&straight);
        }
        for _ in 0..FIRST_SIGHT {
            if self.seen.is_some() {
                break;
            }
            self.drive(&Twist::zero());
        }
        self.target = place_target(
            &self.hand.truth().tip(),
            &hal::Transform::assume(start),
            depth * 1e-3,
            offset * 1e-3,
            angle.to_radians(),
        );
        self.score = Score::new(self.target);
        let steps = PATIENCE * depth * 1e-3 / speed / self.hand.period();
        self.whole = whole(steps / f64::from(self.settings.repeat));
        self.left = self.whole;
        self.outcome.spoilt = false;
        self.judge();
        Ok(())
    }

    /// Acts for as long as an action lasts.
    pub fn step(&mut self, action: Action<'_>) -> Step {
        let (settings, before) = (Arc::clone(&self.settings), self.outcome);
        let entry = settings.entry();
        for _ in 0..settings.repeat {
            if self.is_over() {
                break;
            }
            let dt = self.hand.period();
            let wanted = twist(
                settings.actions,
                action,
                self.hand.base(),
                self.roll,
                &entry,
                &settings.config.limits,
                dt,
            );
            let axis = self.hand.base().rotation * Vector3::z();
            self.roll += axis.dot(&wanted.angular) * dt;
            self.drive(&wanted);
            self.judge();
        }
        self.left = self.left.saturating_sub(1);
        let terminated = self.is_over();
        let truncated = !terminated && self.left == 0;
        Step {
            reward: self.earned(&before, terminated || truncated),
            terminated,
            truncated,
        }
    }

    /// Writes what the policy sees.
    pub fn observe(&self, out: &mut [f32]) {
        let Some(shape) = &self.seen else {
            out.fill(0.0);
            return;
        };
        Seen {
            entry_from_world: &self.entry_from_world,
            base: self.hand.base(),
            roll: self.roll,
            shape,
            target: &self.target,
            now: self.hand.now(),
            left: self.left as f64 / self.whole as f64,
        }
        .write(out);
    }

    /// The truth.
    pub const fn outcome(&self) -> &Outcome {
        &self.outcome
    }

    const fn is_over(&self) -> bool {
        self.outcome.passed || self.outcome.spoilt
    }

    fn drive(&mut self, twist: &Twist) {
        self.exposure += 1;
        // Limited speeds over a period of the sensor lead nowhere that is refused.
        let _ = self.hand.drive(twist, self.exposure);
        if let Some(shape) = self.hand.sense() {
            self.seen = Some(shape);
        }
        let truth = self.hand.truth();
        let spoils = |event: &phantom::Event| crate::world::kind(event).spoils();
        self.outcome.spoilt |= truth.events.iter().any(spoils);
    }

    /// Takes note of the truth.
    fn judge(&mut self) {
        let truth = self.hand.truth();
        let (tip, axis) = (truth.tip(), truth.direction());
        let stretch = [truth.max_stretch, truth.mean_stretch];
        self.score.observe(truth.stamp, [&tip, &axis], stretch);
        let figures = self.score.figures(&tip, &axis);
        self.outcome.lateral = figures.lateral;
        self.outcome.axial = figures.axial;
        self.outcome.max_stretch = figures.max_stretch;
        self.outcome.passed = figures.axial <= 0.0;
    }

    fn earned(&self, before: &Outcome, ended: bool) -> f64 {
        let now = &self.outcome;
        let goal = self.settings.config.target.goal_mm * 1e-3;
        match self.settings.reward {
            Reward::Sparse => f64::from(u8::from(now.passed && now.lateral <= goal)),
            Reward::Dense => {
                let nearer = (before.lateral - now.lateral) * 1e3;
                let advance = (before.axial - now.axial) * 1e3;
                let end = match (ended, now.passed && !now.spoilt) {
                    (false, _) => 0.0,
                    (true, true) => Reward::PASSED,
                    (true, false) => Reward::FAILED,
                };
                nearer + Reward::ADVANCE * advance + end
            }
        }
    }
}

/// The number of actions of a duration, at least one.
fn whole(actions: f64) -> u64 {
    /// Longest episode \[actions\]: a year at 30 Hz.
    const MOST: f64 = 1e9;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within the range; what is no number counts as none"
    )]
    let count = actions.clamp(0.0, MOST) as u64;
    1 + count
}

/// Draws numbers.
trait Dice {
    /// Uniform in the range.
    fn uniform(&mut self, range: [f64; 2]) -> f64;
}

impl Dice for ChaCha8Rng {
    fn uniform(&mut self, [low, high]: [f64; 2]) -> f64 {
        let share = (self.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
        low + share * (high - low)
    }
}
