//! From which worlds episodes are drawn.

use hybrid_control::Entry;

use super::action::Actions;
use crate::config::{Config, PlantKind};

/// What a policy earns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reward {
    /// At every step the decrease of the true distance of the target from the tip axis \[mm\] and a
    /// hundredth of the true advance towards its plane \[mm\]; at the end [`Reward::PASSED`], or
    /// [`Reward::FAILED`] if the target's plane was not reached.
    #[default]
    Dense,
    /// One where the target was passed within `target.goal_mm` in truth, else nothing.
    Sparse,
}

impl Reward {
    /// For reaching the target's plane.
    pub const PASSED: f64 = 1.0;
    /// For an end before it.
    pub const FAILED: f64 = -10.0;
    /// Of the advance.
    pub const ADVANCE: f64 = 0.01;

    /// Names of both.
    pub const NAMES: [&str; 2] = ["dense", "sparse"];

    /// The reward of that name.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "dense" => Self::Dense,
            "sparse" => Self::Sparse,
            _ => return None,
        })
    }
}

/// What cannot be an environment.
#[derive(Debug, thiserror::Error)]
pub enum EnvError {
    /// A value outside its range.
    #[error("{key}: expected {expected}, found {found}")]
    Value {
        /// Which.
        key: &'static str,
        /// What is expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// A phantom.
    #[error("phantom: {0}")]
    Phantom(#[from] phantom::SettingsError),
}

/// What environments are made of.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Limits, tissue, needle and goal; the depth, offset and angle of its target count where they
    /// are not drawn.
    pub config: Config,
    /// Presets of the phantom, each as likely; both families of tip laws are among them.
    pub phantoms: Vec<String>,
    /// Depth of the target, least and most \[mm\].
    pub depth_mm: [f64; 2],
    /// Offset of the target, least and most \[mm\].
    pub offset_mm: [f64; 2],
    /// Direction of the offset from the bevel direction, least and most \[deg\].
    pub angle_deg: [f64; 2],
    /// What a policy gives.
    pub actions: Actions,
    /// What it earns.
    pub reward: Reward,
    /// Control steps (exposures of the sensor, 30 Hz) that an action lasts.
    pub repeat: u32,
}

impl Settings {
    /// One world: phantom and target of `config`.
    pub fn new(config: Config) -> Self {
        let target = &config.target;
        Self {
            phantoms: vec![config.run.phantom.clone()],
            depth_mm: [target.depth_mm; 2],
            offset_mm: [target.offset_mm; 2],
            angle_deg: [target.angle_deg; 2],
            actions: Actions::default(),
            reward: Reward::default(),
            repeat: 1,
            config,
        }
    }

    /// The phantoms, in the order of their names; all values checked.
    ///
    /// # Errors
    /// See [`EnvError`].
    pub fn worlds(&self) -> Result<Vec<phantom::Settings>, EnvError> {
        /// Deepest target, as a part of the needle's length.
        const DEEPEST: f64 = 0.9;
        /// Most steps of an action: two seconds.
        const LONGEST: u32 = 60;
        let length = self.config.needle.length_mm;
        let ranges = [
            ("depth_mm", self.depth_mm, [1.0, length * DEEPEST]),
            ("offset_mm", self.offset_mm, [0.0, length]),
            ("angle_deg", self.angle_deg, [-360.0, 360.0]),
        ];
        for (key, [least, most], [low, high]) in ranges {
            if !(low <= least && least <= most && most <= high) {
                return Err(EnvError::Value {
                    key,
                    expected: format!("least and most, from {low} to {high}"),
                    found: format!("{least} and {most}"),
                });
            }
        }
        if !(1..=LONGEST).contains(&self.repeat) {
            return Err(EnvError::Value {
                key: "repeat",
                expected: format!("1 to {LONGEST} steps"),
                found: self.repeat.to_string(),
            });
        }
        if self.config.run.plant == PlantKind::Springs {
            return Err(EnvError::Value {
                key: "run.plant",
                expected: "phantom or continuum".into(),
                found: "springs".into(),
            });
        }
        if self.phantoms.is_empty() {
            return Err(EnvError::Value {
                key: "phantoms",
                expected: "at least one preset".into(),
                found: "none".into(),
            });
        }
        self.phantoms
            .iter()
            .map(|name| {
                let mut config = self.config.clone();
                config.run.phantom.clone_from(name);
                Ok(config.phantom_settings()?)
            })
            .collect()
    }

    /// Where the needle enters.
    pub(super) fn entry(&self) -> Entry {
        Entry {
            point: self.config.entry(),
            inward: self.config.inward(),
        }
    }
}
