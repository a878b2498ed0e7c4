//! What a campaign runs: its file, and the numbered runs that follow from it.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::config::{self, Config, ConfigError, Invalid, Target, TargetKind, with_suggestion};

/// Most runs of one campaign.
const MOST_RUNS: u64 = 10_000_000;

/// A campaign file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key or a value of the wrong type; the text shows the line.
    #[error("{}: {message}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// What the parser says, with the line.
        message: String,
    },
    /// A value that makes no campaign.
    #[error("{}: {problem}", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// What was found and what was expected.
        problem: String,
    },
    /// The configuration of a run.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// Consecutive seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seeds {
    /// The first.
    pub first: u64,
    /// How many.
    pub count: u64,
}

/// A named target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedTarget {
    /// Its name in the table; made from the values if missing.
    #[serde(default)]
    pub name: String,
    /// How the target is given.
    #[serde(default)]
    pub kind: TargetKind,
    /// Distance ahead of the tip \[mm\].
    #[serde(default = "default_depth")]
    pub depth_mm: f64,
    /// Distance across the axis \[mm\].
    #[serde(default)]
    pub offset_mm: f64,
    /// Direction of the offset from the bevel direction \[deg\].
    #[serde(default)]
    pub angle_deg: f64,
    /// Target in the stereo frame \[mm\], for `kind = "stereo"`.
    #[serde(default)]
    pub position_mm: [f64; 3],
}

fn default_depth() -> f64 {
    Target::default().depth_mm
}

/// Targets on a grid: every depth with every offset and angle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Distances ahead of the tip \[mm\].
    pub depth_mm: Vec<f64>,
    /// Distances across the axis \[mm\].
    pub offset_mm: Vec<f64>,
    /// Directions of the offset \[deg\].
    pub angle_deg: Vec<f64>,
}

/// A campaign file (TOML).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CampaignFile {
    laws: Vec<String>,
    #[serde(default)]
    reference: Option<String>,
    #[serde(default = "default_phantoms")]
    phantoms: Vec<String>,
    seeds: Seeds,
    #[serde(default = "default_success")]
    success_mm: f64,
    #[serde(default)]
    target: Vec<NamedTarget>,
    #[serde(default)]
    grid: Option<Grid>,
    #[serde(default)]
    config: toml::Table,
}

fn default_phantoms() -> Vec<String> {
    vec!["paper".into()]
}

fn default_success() -> f64 {
    1.0
}

/// A checked campaign. Its runs are numbered from 0; the number alone says what is run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// Steering laws.
    pub laws: Vec<String>,
    /// The law that the others are compared with.
    pub reference: String,
    /// Presets of the phantom.
    pub phantoms: Vec<String>,
    /// Targets.
    pub targets: Vec<NamedTarget>,
    /// Seeds.
    pub seeds: Seeds,
    /// Largest true error of a hit \[mm\].
    pub success_mm: f64,
    /// Everything else.
    pub base: Config,
}

/// One run of a campaign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Task<'a> {
    /// Its number.
    pub run: u64,
    /// Law.
    pub law: &'a str,
    /// Preset of the phantom.
    pub phantom: &'a str,
    /// Target.
    pub target: &'a NamedTarget,
    /// Seed.
    pub seed: u64,
}

impl Plan {
    /// Reads a campaign file.
    ///
    /// # Errors
    /// See [`PlanError`].
    pub fn load(file: &Path) -> Result<Self, PlanError> {
        let text = std::fs::read_to_string(file).map_err(|source| PlanError::Unreadable {
            file: file.to_owned(),
            source,
        })?;
        Self::parse(&text, file)
    }

    /// As [`load`](Self::load), from text; `name` is what errors call the file.
    ///
    /// # Errors
    /// See [`PlanError`].
    pub fn parse(text: &str, name: &Path) -> Result<Self, PlanError> {
        let file: CampaignFile = toml::from_str(text).map_err(|e| PlanError::Syntax {
            file: name.to_owned(),
            message: explained(&e),
        })?;
        let wrong = |problem: String| PlanError::Value {
            file: name.to_owned(),
            problem,
        };
        let targets = targets(&file).map_err(wrong)?;
        let reference = match &file.reference {
            Some(law) if !file.laws.contains(law) => {
                return Err(wrong(format!("reference: `{law}` is not among laws")));
            }
            Some(law) => law.clone(),
            None => file.laws.first().cloned().unwrap_or_default(),
        };
        for (key, names) in [("laws", &file.laws), ("phantoms", &file.phantoms)] {
            if names.is_empty() {
                return Err(wrong(format!("{key}: expected at least one")));
            }
            if let Some(twice) = repeated(names) {
                return Err(wrong(format!("{key}: `{twice}` stands twice")));
            }
        }
        if file.seeds.count == 0 || file.seeds.first.checked_add(file.seeds.count).is_none() {
            return Err(wrong("seeds: expected a count of at least 1".into()));
        }
        if file.success_mm.is_nan() || file.success_mm <= 0.0 {
            return Err(wrong(format!(
                "success_mm: expected a number above 0, found {}",
                file.success_mm
            )));
        }
        let plan = Self {
            base: base(text, &file, name)?,
            laws: file.laws,
            reference,
            phantoms: file.phantoms,
            targets,
            seeds: file.seeds,
            success_mm: file.success_mm,
        };
        if plan.len() > MOST_RUNS {
            return Err(wrong(format!(
                "{} runs; at most {MOST_RUNS} are possible",
                plan.len()
            )));
        }
        plan.check(name)?;
        Ok(plan)
    }

    /// Every law, phantom and target once, so that a typo is found before the first run.
    fn check(&self, name: &Path) -> Result<(), PlanError> {
        let wrong = |e: Invalid| PlanError::Value {
            file: name.to_owned(),
            problem: format!("{}: {}", e.key, e.problem),
        };
        self.base.check_unattended().map_err(wrong)?;
        for run in 0..self.len() / self.seeds.count {
            let task = self.task(run * self.seeds.count);
            self.config(&task).validate().map_err(wrong)?;
        }
        Ok(())
    }

    /// Number of runs.
    pub fn len(&self) -> u64 {
        let kinds = self.laws.len() * self.phantoms.len() * self.targets.len();
        (kinds as u64).saturating_mul(self.seeds.count)
    }

    /// Never: a plan has a run.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Run number `run`, which must be less than [`len`](Self::len).
    pub fn task(&self, run: u64) -> Task<'_> {
        let pick = |n: u64, len: usize| usize::try_from(n).unwrap_or(0) % len.max(1);
        let (kind, seed) = (run / self.seeds.count, run % self.seeds.count);
        let (targets, phantoms) = (self.targets.len() as u64, self.phantoms.len() as u64);
        Task {
            run,
            target: &self.targets[pick(kind, self.targets.len())],
            phantom: &self.phantoms[pick(kind / targets, self.phantoms.len())],
            law: &self.laws[pick(kind / targets / phantoms, self.laws.len())],
            seed: self.seeds.first + seed,
        }
    }

    /// Configuration of a run.
    pub fn config(&self, task: &Task<'_>) -> Config {
        let mut config = self.base.clone();
        task.law.clone_into(&mut config.run.law);
        task.phantom.clone_into(&mut config.run.phantom);
        config.run.seed = task.seed;
        let t = task.target;
        config.target = Target {
            goal_mm: config.target.goal_mm,
            kind: t.kind,
            depth_mm: t.depth_mm,
            offset_mm: t.offset_mm,
            angle_deg: t.angle_deg,
            position_mm: t.position_mm,
        };
        config
    }
}

/// The parser's words with the line, and the nearest key that there is.
fn explained(error: &toml::de::Error) -> String {
    let text = error.to_string().trim_end().to_owned();
    let (message, hinted) = (error.message(), with_suggestion("", error.message()));
    match hinted.strip_prefix(message) {
        Some(hint) if !hint.is_empty() => text.replace(message, &hinted),
        _ => text,
    }
}

fn repeated(names: &[String]) -> Option<&String> {
    names
        .iter()
        .enumerate()
        .find_map(|(k, name)| names[..k].contains(name).then_some(name))
}

fn targets(file: &CampaignFile) -> Result<Vec<NamedTarget>, String> {
    let mut targets = file.target.clone();
    if let Some(grid) = &file.grid {
        for &depth_mm in &grid.depth_mm {
            for &offset_mm in &grid.offset_mm {
                for &angle_deg in &grid.angle_deg {
                    targets.push(NamedTarget {
                        name: String::new(),
                        kind: TargetKind::Shifted,
                        depth_mm,
                        offset_mm,
                        angle_deg,
                        position_mm: [0.0; 3],
                    });
                    // Without an offset every angle is the same target.
                    if offset_mm == 0.0 {
                        break;
                    }
                }
            }
        }
    }
    for target in &mut targets {
        if target.name.is_empty() {
            target.name = match target.kind {
                TargetKind::Aligned => format!("aligned {}", target.depth_mm),
                TargetKind::Shifted => format!(
                    "{} mm at {} deg, {} deep",
                    target.offset_mm, target.angle_deg, target.depth_mm
                ),
                TargetKind::Marker => format!(
                    "marker {} mm at {} deg, {} deep",
                    target.offset_mm, target.angle_deg, target.depth_mm
                ),
                TargetKind::Stereo => format!("{:?}", target.position_mm),
                TargetKind::World => format!("{:?} in World", target.position_mm),
            };
        }
    }
    if targets.is_empty() {
        return Err("expected at least one [[target]] or a [grid]".into());
    }
    let names: Vec<String> = targets.iter().map(|t| t.name.clone()).collect();
    match repeated(&names) {
        Some(twice) => Err(format!("target: the name `{twice}` stands twice")),
        None => Ok(targets),
    }
}

/// The configuration under all runs. A law that cannot reach a target is measured all the same.
fn base(text: &str, file: &CampaignFile, name: &Path) -> Result<Config, PlanError> {
    let own = own_lines(text);
    // Errors then name the campaign file's lines; inline tables have no lines of their own.
    let same = own.parse::<toml::Table>().is_ok_and(|t| t == file.config);
    let written = if same { own } else { file.config.to_string() };
    let mut config = config::parse(&written, name, &[])?;
    config.run.check_reach = false;
    config.run.dry_run = false;
    Ok(config)
}

/// The lines of the tables `[config...]` as a configuration of their own, at their own places.
fn own_lines(text: &str) -> String {
    let mut inside = false;
    let mut own = String::new();
    for line in text.lines() {
        let header = line.trim_start();
        if header.starts_with('[') {
            inside = header.starts_with("[config]") || header.starts_with("[config.");
            if inside && header.starts_with("[config.") {
                own.push('[');
                own.push_str(&header["[config.".len()..]);
            }
        } else if inside {
            own.push_str(line);
        }
        own.push('\n');
    }
    own
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    const SMALL: &str = "laws = [\"paper\", \"hybrid\"]\nseeds = { first = 5, count = 3 }\n\
        [[target]]\nkind = \"aligned\"\n[grid]\ndepth_mm = [60.0, 80.0]\noffset_mm = [0.0, 5.0]\n\
        angle_deg = [0.0, 90.0]\n[config.run]\ninsertion_speed_mm_s = 2.0\n";

    fn parse(text: &str) -> Result<Plan, PlanError> {
        Plan::parse(text, Path::new("c.toml"))
    }

    #[test]
    fn every_combination_has_one_number() {
        let plan = parse(SMALL).unwrap();
        // One target, and per depth one without and two with an offset.
        assert_eq!(plan.targets.len(), 1 + 2 * 3);
        assert_eq!(plan.len(), 2 * 7 * 3);
        let seen: HashSet<String> = (0..plan.len())
            .map(|run| {
                let t = plan.task(run);
                assert!((plan.config(&t).run.insertion_speed_mm_s - 2.0).abs() < 1e-15);
                format!("{} {} {} {}", t.law, t.phantom, t.target.name, t.seed)
            })
            .collect();
        assert_eq!(seen.len() as u64, plan.len());
        assert_eq!(plan.task(0).seed, 5);
        assert_eq!(plan.task(plan.len() - 1).law, "hybrid");
    }

    #[test]
    fn typos_name_the_line() {
        let typo = SMALL.replace("seeds", "sedes");
        let message = parse(&typo).unwrap_err().to_string();
        assert!(
            message.contains("line 2") && message.contains("sedes"),
            "{message}"
        );
        assert!(message.ends_with("did you mean `seeds`?"), "{message}");
        let typo = SMALL.replace("offset_mm", "ofset_mm");
        let message = parse(&typo).unwrap_err().to_string();
        assert!(message.contains("did you mean `offset_mm`?"), "{message}");
        let typo = SMALL.replace("insertion_speed_mm_s", "insertion_sped_mm_s");
        let message = parse(&typo).unwrap_err().to_string();
        assert!(message.starts_with("c.toml:10: key"), "{message}");
        assert!(message.contains("did you mean"), "{message}");
        let typo = SMALL.replace("hybrid", "hybird");
        let message = parse(&typo).unwrap_err().to_string();
        assert!(
            message.contains("run.law") && message.contains("hybird"),
            "{message}"
        );
    }

    #[test]
    fn values_that_make_no_campaign_are_refused() {
        for (from, to, expected) in [
            ("count = 3", "count = 0", "at least 1"),
            ("\"hybrid\"", "\"paper\"", "stands twice"),
            (
                "laws = [\"paper\", \"hybrid\"]",
                "laws = []",
                "at least one",
            ),
            ("laws", "reference = \"none\"\nlaws", "not among laws"),
            ("laws", "success_mm = nan\nlaws", "above 0"),
        ] {
            let message = parse(&SMALL.replace(from, to)).unwrap_err().to_string();
            assert!(message.contains(expected), "{to}: {message}");
        }
    }
}
