//! The presets, and overriding single settings.

use toml::{Table, Value};

use super::{Settings, SettingsError};

/// Names of the presets.
pub const PRESETS: [&str; 7] = [
    "ideal",
    "paper",
    "paper-compliant",
    "harsh",
    "gel-guide",
    "ex-vivo-guide",
    "kinked",
];

/// The frozen population (see `examples/fit_population.rs`).
const PAPER: &str = include_str!("../../data/population.toml");
/// What the second family of tip laws changes.
const COMPLIANT: &str = include_str!("../../data/population-compliant.toml");
/// An electromagnetic sensor as it was measured; every preset but `ideal` has it.
const EM: &str = include_str!("../../data/em.toml");
/// Fibre Bragg gratings with their flaws; every preset but `ideal` has them.
const FBG: &str = include_str!("../../data/fbg.toml");
/// What the preset `harsh` changes.
const HARSH: &str = include_str!("../../data/harsh.toml");
/// What the presets after recordings of real needles change.
const GEL_GUIDE: &str = include_str!("../../data/gel-guide.toml");
const EX_VIVO_GUIDE: &str = include_str!("../../data/ex-vivo-guide.toml");
const KINKED: &str = include_str!("../../data/kinked.toml");

impl Settings {
    /// A preset: `ideal` (no flaw), `paper` (the frozen population), `paper-compliant` (the same
    /// on the second family of tip laws), `harsh` (breathing, sticky, layers, drops), or one after
    /// recordings of real needles: `gel-guide`, `ex-vivo-guide` (thick, through a guide) and `kinked`.
    ///
    /// # Errors
    /// No preset has this name.
    pub fn preset(name: &str) -> Result<Self, SettingsError> {
        let ideal = Self::default();
        let devices = |settings: Self| settings.overridden(EM.parse()?)?.overridden(FBG.parse()?);
        let paper = || devices(ideal.overridden(PAPER.parse()?)?);
        match name {
            "ideal" => Ok(ideal),
            "paper" => paper(),
            "paper-compliant" => paper()?.overridden(COMPLIANT.parse()?),
            "gel-guide" => paper()?.overridden(GEL_GUIDE.parse()?),
            "ex-vivo-guide" => Self::preset("gel-guide")?.overridden(EX_VIVO_GUIDE.parse()?),
            "kinked" => paper()?.overridden(KINKED.parse()?),
            "harsh" => paper()?.overridden(HARSH.parse()?),
            _ => Err(SettingsError::UnknownPreset {
                name: name.to_owned(),
            }),
        }
    }

    /// These settings with the keys of `changes` replaced; tables are merged, arrays replaced.
    /// The result is validated.
    ///
    /// # Errors
    /// An unknown key, a wrong type or a value outside its range.
    pub fn overridden(&self, changes: Table) -> Result<Self, SettingsError> {
        // Settings are plain numbers, so they always make a table.
        let mut table = Table::try_from(self).unwrap_or_default();
        merge(&mut table, changes);
        let settings: Self = table.try_into()?;
        settings.validate()?;
        Ok(settings)
    }
}

pub(crate) fn merge(into: &mut Table, changes: Table) {
    for (key, value) in changes {
        match (into.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(changes)) => merge(inner, changes),
            (_, value) => {
                into.insert(key, value);
            }
        }
    }
}
