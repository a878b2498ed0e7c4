//! The simulated world that a configuration means: the preset, the needle that the controller is
//! told, and what `[phantom]` says otherwise.

use phantom::{Settings, SettingsError};

use super::check::in_other_unit;
use super::{Config, Invalid, Needle, PlantKind};
use crate::guide::Guide;
use crate::monitor::plausibility::SLACK;

/// A key of `[phantom.needle]` and where `[needle]` has it.
struct Followed {
    key: &'static str,
    told: &'static str,
    value: fn(&Needle) -> f64,
}

const FOLLOWED: [Followed; 5] = [
    Followed {
        key: "length_mm",
        told: "length_mm",
        value: |needle| needle.length_mm,
    },
    Followed {
        key: "outer_diameter_mm",
        told: "outer_diameter_mm",
        value: |needle| needle.outer_diameter_mm,
    },
    Followed {
        key: "inner_diameter_mm",
        told: "inner_diameter_mm",
        value: |needle| needle.inner_diameter_mm,
    },
    Followed {
        key: "young_gpa",
        told: "young_modulus_gpa",
        value: |needle| needle.young_modulus_gpa,
    },
    Followed {
        key: "bevel_deg",
        told: "bevel_deg",
        value: |needle| needle.bevel_deg,
    },
];

/// Shear modulus over Young's: Poisson's ratio 0.3, of steel and near that of Nitinol.
const SHEAR_RATIO: f64 = 1.0 / 2.6;

impl Config {
    /// The phantom's settings: the preset's, with the keys of `[needle]` that are not the
    /// defaults, and with those of `[phantom]` before all others.
    ///
    /// # Errors
    /// No preset of the name; an unknown key, a wrong type or a value outside its range.
    pub fn phantom_settings(&self) -> Result<Settings, SettingsError> {
        let usual = Needle::default();
        let mut needle = toml::Table::new();
        for followed in &FOLLOWED {
            let value = (followed.value)(&self.needle);
            if value.to_bits() != (followed.value)(&usual).to_bits() {
                needle.insert(followed.key.to_owned(), value.into());
            }
        }
        if needle.contains_key("young_gpa") {
            let shear = self.needle.young_modulus_gpa * SHEAR_RATIO;
            needle.insert("shear_gpa".to_owned(), shear.into());
        }
        for (key, value) in self.apart() {
            needle.insert(key.clone(), value.clone());
        }
        let mut changes = self.phantom.clone();
        changes.insert("needle".to_owned(), needle.into());
        let mut settings = Settings::preset(&self.run.phantom)?.overridden(changes)?;
        // The preset, or `[phantom]`, may say where the guide truly is.
        let guide = Guide::of(self);
        if guide.is_none() || settings.guide.gap_mm == 0.0 {
            settings.guide.gap_mm = guide.map_or(0.0, |guide| guide.gap * 1e3);
        }
        settings.validate()?;
        Ok(settings)
    }

    /// What `[phantom.needle]` says.
    fn apart(&self) -> impl Iterator<Item = (&String, &toml::Value)> {
        let table = self.phantom.get("needle").and_then(toml::Value::as_table);
        table.into_iter().flatten()
    }

    /// In which properties the simulated needle is not the one that the controller is told: a line
    /// each.
    pub fn needle_differences(&self) -> Vec<String> {
        let Ok(settings) = self.phantom_settings() else {
            return Vec::new();
        };
        let simulated = toml::Table::try_from(settings.needle).unwrap_or_default();
        FOLLOWED
            .iter()
            .filter_map(|followed| {
                let told = (followed.value)(&self.needle);
                let simulated = simulated.get(followed.key)?.as_float()?;
                (simulated.to_bits() != told.to_bits()).then(|| {
                    format!(
                        "phantom.needle.{} = {simulated}, the controller is told needle.{} = {told}",
                        followed.key, followed.told
                    )
                })
            })
            .collect()
    }

    pub(super) fn validate_phantom(&self) -> Result<(), Invalid> {
        let error = match self.phantom_settings() {
            Err(error) => error,
            Ok(settings)
                if self.run.plant == PlantKind::Continuum && settings.guide.gap_mm > 0.0 =>
            {
                return Err(Invalid {
                    key: "run.plant".to_owned(),
                    problem: "the plant continuum has no guide: set needle.support = \"base\", or run.plant = \
                              \"phantom\""
                        .to_owned(),
                });
            }
            Ok(settings) => return self.validate_length(&settings),
        };
        let key = match &error {
            SettingsError::UnknownPreset { .. } => "run.phantom".to_owned(),
            SettingsError::OutOfRange { key, .. } | SettingsError::Inconsistent { key, .. } => {
                self.origin_of(key)
            }
            SettingsError::Pose { .. } | SettingsError::Syntax(_) => "phantom".to_owned(),
        };
        let problem = match error {
            SettingsError::OutOfRange {
                value,
                lowest,
                highest,
                ..
            } => {
                let unit = if key.ends_with("_mm") {
                    in_other_unit(value, lowest, highest)
                } else {
                    String::new()
                };
                format!("expected {lowest} to {highest}, found {value}{unit}")
            }
            SettingsError::Inconsistent { expected, .. } => expected.to_owned(),
            other => other.to_string(),
        };
        Err(Invalid { key, problem })
    }

    /// A needle of another length than the controller is told is not believed to be the same one: no run
    /// with it comes to an end.
    fn validate_length(&self, settings: &Settings) -> Result<(), Invalid> {
        let (simulated, told) = (settings.needle.length_mm, self.needle.length_mm);
        let stands_for_it = self.is_simulated() && self.run.plant != PlantKind::Springs;
        if !stands_for_it || self.run.dry_run_air || (simulated - told).abs() <= SLACK * 1e3 {
            return Ok(());
        }
        if self.apart().any(|(key, _)| key == "length_mm") {
            return Err(Invalid {
                key: "phantom.needle.length_mm".to_owned(),
                problem: format!(
                    "the simulated needle is {simulated} mm long, the controller is told needle.length_mm = {told}; \
                     make both the same within {:.0} mm",
                    SLACK * 1e3
                ),
            });
        }
        let preset = toml::Table::try_from(settings.needle.clone()).unwrap_or_default();
        let mut keys: Vec<String> = FOLLOWED
            .iter()
            .filter_map(|followed| {
                let simulated = preset.get(followed.key)?.as_float()?;
                let told = (followed.value)(&self.needle);
                (simulated.to_bits() != told.to_bits())
                    .then(|| format!("{} = {simulated}", followed.told))
            })
            .collect();
        let gap = Settings::preset(&self.run.phantom).map_or(0.0, |preset| preset.guide.gap_mm);
        let through = if gap > 0.0 {
            keys.insert(0, format!("support = \"guide\", guide_gap_mm = {gap}"));
            format!(" through a guide {gap} mm from the tissue")
        } else {
            String::new()
        };
        Err(Invalid {
            key: "run.phantom".to_owned(),
            problem: format!(
                "the preset {} simulates a needle of {simulated} mm{through}, the controller is told one of {told} mm: \
                 set [needle] {} (docs/REAL_NEEDLES.md has a whole file)",
                self.run.phantom,
                keys.join(", ")
            ),
        })
    }

    /// The key of the configuration that set a key of the phantom.
    fn origin_of(&self, key: &str) -> String {
        let told = FOLLOWED.iter().find_map(|followed| {
            let followed_here = key.strip_prefix("needle.") == Some(followed.key)
                && !self.apart().any(|(apart, _)| apart == followed.key);
            followed_here.then(|| format!("needle.{}", followed.told))
        });
        told.unwrap_or_else(|| format!("phantom.{key}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config;

    fn of(overrides: &[&str]) -> Config {
        let overrides: Vec<String> = overrides.iter().map(|&o| o.to_owned()).collect();
        config::load(None, &overrides).unwrap()
    }

    #[test]
    fn the_simulated_needle_is_the_told_one_unless_said_otherwise() {
        let default = of(&[]);
        let preset = Settings::preset("paper").unwrap();
        assert_eq!(default.phantom_settings().unwrap(), preset);
        assert!(default.needle_differences().is_empty());

        let nitinol = of(&["needle.young_modulus_gpa=60", "needle.bevel_deg=30"]);
        let needle = nitinol.phantom_settings().unwrap().needle;
        assert_eq!((needle.young_gpa, needle.bevel_deg), (60.0, 30.0));
        assert!((needle.shear_gpa - 23.08).abs() < 0.01, "{needle:?}");
        assert!(nitinol.needle_differences().is_empty());

        let wrong = of(&["needle.young_modulus_gpa=60", "phantom.needle.young_gpa=75"]);
        let young = wrong.phantom_settings().unwrap().needle.young_gpa;
        assert!((young - 75.0).abs() < 1e-12, "{young}");
        let differences = wrong.needle_differences();
        assert_eq!(differences.len(), 1);
        assert!(differences[0].contains("75") && differences[0].contains("60"));
    }

    #[test]
    fn a_preset_of_another_needle_says_which_one_to_tell() {
        let mut config = of(&[]);
        config.run.phantom = "gel-guide".to_owned();
        let refused = config.validate().unwrap_err();
        assert_eq!(refused.key, "run.phantom");
        for told in [
            "200 mm through a guide 25 mm",
            "support = \"guide\"",
            "length_mm = 200",
        ] {
            assert!(refused.problem.contains(told), "{refused:?}");
        }
        // What it says helps.
        let told = refused.problem.split_once("[needle] ").unwrap().1;
        let told = told.split_once(" (docs").unwrap().0.replace(", ", "\n");
        let text = format!("[run]\nphantom = \"gel-guide\"\n[needle]\n{told}\n");
        config::parse(&text, std::path::Path::new("told.toml"), &[]).unwrap();
        let mut longer = of(&["phantom.needle.length_mm=130.0"]);
        assert_eq!(longer.validate(), Ok(()));
        let needle = toml::toml! { length_mm = 150.0 };
        longer.phantom.insert("needle".into(), needle.into());
        assert_eq!(
            longer.validate().unwrap_err().key,
            "phantom.needle.length_mm"
        );
    }

    #[test]
    fn a_needle_that_cannot_be_simulated_is_refused_by_the_key_that_gave_it() {
        let mut config = of(&[]);
        config.needle.bevel_deg = 1.0;
        let refused = config.validate().unwrap_err();
        assert_eq!(refused.key, "needle.bevel_deg");
        assert!(refused.problem.contains("5 to 85"), "{refused:?}");
        let mut guided = of(&["needle.support=guide", "needle.guide_gap_mm=20"]);
        guided.run.plant = PlantKind::Continuum;
        assert_eq!(guided.validate().unwrap_err().key, "run.plant");
        config
            .phantom
            .insert("needle".into(), toml::toml! { bevel_deg = 2.0 }.into());
        assert_eq!(
            config.validate().unwrap_err().key,
            "phantom.needle.bevel_deg"
        );
    }
}
