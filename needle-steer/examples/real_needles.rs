//! Real needles: `estimate` on every pair of insertions of a condition, `validate` on the others.
//!
//! `NEEDLE_STEER_REFERENCE=... cargo run --release -p needle-steer --example real_needles -- [FOLDER [CONDITION]]`
//! reads `real/guide-em/steps.csv` and prints a table; with FOLDER, it also writes the recordings
//! there as tables for the command line, and with a CONDITION after it every pair of that one.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use needle_steer::config::{self, Config};
use needle_steer::identify::{Recording, identify_tip, validate};
use needle_steer::statistics::median;

type Row = BTreeMap<String, String>;

#[expect(
    clippy::disallowed_methods,
    reason = "a binary of its own: the recordings are outside the project"
)]
fn main() -> Result<(), Box<dyn Error>> {
    let reference = std::env::var("NEEDLE_STEER_REFERENCE")
        .map_err(|_| "NEEDLE_STEER_REFERENCE is not set: the recordings are not in the project")?;
    let file = Path::new(&reference).join("real/guide-em/steps.csv");
    let kept = std::env::args().nth(1).map(PathBuf::from);
    let only = std::env::args().nth(2);
    let scratch = std::env::temp_dir().join(format!("real-needles-{}", std::process::id()));
    let folder = kept.clone().unwrap_or_else(|| scratch.clone());
    std::fs::create_dir_all(&folder)?;
    // Distance of the guide from the skin: not published; the fit decides.
    let settings = [
        "needle.support=\"guide\"",
        "needle.length_mm=200.0",
        "needle.outer_diameter_mm=1.27",
        "needle.inner_diameter_mm=0.84",
        "needle.guide_gap_sigma_mm=8.0",
        "tissue.inward=[0.0, -1.0, 0.0]",
        "tissue.entry_mm=[0.0, 0.0, 0.0]",
    ];
    let config = config::load(None, &settings.map(str::to_owned))?;
    std::fs::write(folder.join("guide.toml"), toml::to_string(&config)?)?;
    let mut conditions: BTreeMap<String, Vec<Recording>> = BTreeMap::new();
    for (trial, rows) in trials(&file)? {
        let Some(condition) = condition(&trial) else {
            continue;
        };
        // The older sets are many pairs: by name only.
        let wanted = match &only {
            Some(only) => *only == condition,
            None => condition.starts_with("exp"),
        };
        if !wanted {
            continue;
        }
        let name = folder.join(format!("{trial}.csv"));
        std::fs::write(&name, table(&rows)?)?;
        let recording = Recording::from_csv(&name, &config)?;
        conditions.entry(condition).or_default().push(recording);
    }
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "condition | insertions | pairs | lambda of all mm (median of pairs) | covered | R2 of all pairs (least) | slope | tip mm | stays mm | Broyden mm | tip / stays"
    )?;
    let (mut ratios, mut better) = (Vec::new(), Vec::new());
    let mut pooled = [0.0; 4];
    let (mut covered, mut pairs) = (0, 0);
    for (name, recordings) in &conditions {
        let one = one(recordings, &config, only.is_some())?;
        writeln!(
            out,
            "{name} | {} | {} | {:.1} ({:.1}) | {}/{} | {:.3} ({:.3}) | {:.2} | {:.3} | {:.3} | {:.3} | {:.2}",
            recordings.len(),
            one.pairs,
            one.lambda,
            one.median_lambda,
            one.covered,
            one.pairs,
            1.0 - one.unexplained / one.spread,
            one.least,
            one.slope,
            one.tip[0],
            one.tip[1],
            one.tip[2],
            one.tip[0] / one.tip[1]
        )?;
        ratios.push(one.tip[0] / one.tip[1]);
        better.push(one.tip[0] / one.tip[2]);
        pooled[0] += one.unexplained;
        pooled[1] += one.spread;
        covered += one.covered;
        pairs += one.pairs;
    }
    writeln!(
        out,
        "all: R2 {:.3}, intervals cover {covered} of {pairs}, tip / stays in the median {:.2}, tip / Broyden {:.2}",
        1.0 - pooled[0] / pooled[1],
        median(&ratios),
        median(&better)
    )?;
    if kept.is_none() {
        std::fs::remove_dir_all(&scratch)?;
    }
    Ok(())
}

/// Means over all pairs of a condition.
#[derive(Default)]
struct One {
    pairs: usize,
    covered: usize,
    lambda: f64,
    median_lambda: f64,
    unexplained: f64,
    spread: f64,
    least: f64,
    slope: f64,
    /// Model, persistence, Broyden: root mean square \[mm\].
    tip: [f64; 3],
}

fn one(recordings: &[Recording], config: &Config, shown: bool) -> Result<One, Box<dyn Error>> {
    let lambda = |chosen: &[Recording]| -> Result<_, Box<dyn Error>> {
        let found = identify_tip(chosen)?;
        Ok((
            found.wave_length_mm.ok_or("wave length not identified")?,
            found.apply(config),
        ))
    };
    let mut one = One {
        lambda: lambda(recordings)?.0.value,
        least: 1.0,
        ..One::default()
    };
    let mut lambdas = Vec::new();
    let mut squares = [0.0; 3];
    let mut changes = 0.0;
    for a in 0..recordings.len() {
        for b in a + 1..recordings.len() {
            let (found, mine) = lambda(&[recordings[a].clone(), recordings[b].clone()])?;
            let others: Vec<Recording> = recordings
                .iter()
                .enumerate()
                .filter(|(k, _)| *k != a && *k != b)
                .map(|(_, r)| Recording {
                    config: mine.clone(),
                    ..r.clone()
                })
                .collect();
            let score = validate(&others, &mine)?;
            if shown {
                writeln!(
                    std::io::stdout(),
                    "{a} {b}: lambda {:.1}, gap {:.1} mm, setback {:.1} mm, drift {:.2?} rad/m {:.0?} mm/m: R2 {:.3}, slope {:.2}, tip / stays {:.2}",
                    found.value,
                    mine.needle.guide_gap_mm,
                    mine.needle.sensor_setback_mm,
                    mine.needle.axis_drift_rad_per_m,
                    mine.needle.tip_drift_mm_per_m,
                    score.axis.r2,
                    score.axis.slope,
                    score.tip.rms_mm / score.tip.persistence_mm
                )?;
            }
            one.pairs += 1;
            one.covered += usize::from((found.low..=found.high).contains(&one.lambda));
            lambdas.push(found.value);
            let n = score.changes as f64;
            one.unexplained += score.axis.unexplained_mrad.powi(2) * n;
            one.spread += score.axis.rms_mrad.powi(2) * n;
            one.least = one.least.min(score.axis.r2);
            one.slope += score.axis.slope;
            changes += n;
            let tip = [
                score.tip.rms_mm,
                score.tip.persistence_mm,
                score.tip.broyden_mm,
            ];
            for (sum, value) in squares.iter_mut().zip(tip) {
                *sum += value * value * n;
            }
        }
    }
    one.median_lambda = median(&lambdas);
    one.slope /= one.pairs as f64;
    one.tip = squares.map(|square| (square / changes).sqrt());
    Ok(one)
}

/// Insertions under a controller, by gel.
fn condition(trial: &str) -> Option<String> {
    let (head, number) = trial.rsplit_once('_')?;
    let controlled = number.len() == 2 && number != "00" && number.parse::<u32>().is_ok();
    let steps_of_5_mm = ["exp_a", "exp_b", "exp_c"]
        .iter()
        .any(|p| head.starts_with(p))
        || ["trialq", "trialr", "trials"].contains(&head);
    (controlled && steps_of_5_mm && trial != "exp_a2_02").then(|| head.to_owned())
}

fn trials(file: &Path) -> Result<BTreeMap<String, Vec<Row>>, Box<dyn Error>> {
    let mut trials: BTreeMap<String, Vec<Row>> = BTreeMap::new();
    let mut reader = csv::Reader::from_path(file)?;
    for row in reader.deserialize() {
        let row: Row = row?;
        if row["date"] != "jacobian" {
            trials.entry(row["trial"].clone()).or_default().push(row);
        }
    }
    Ok(trials)
}

/// The stage's frame as World: the guide's z along -y, its exit 25 mm before the start of the tip.
fn table(rows: &[Row]) -> Result<String, Box<dyn Error>> {
    let mut text = "t_s;guide_x_mm;guide_y_mm;guide_z_mm;guide_qx;guide_qy;guide_qz;guide_qw;tip_x_mm;tip_y_mm;tip_z_mm;axis_x;axis_y;axis_z;sigma_mm\n".to_owned();
    let start: f64 = rows[0]["tip_y_mm"].parse()?;
    for row in rows {
        let y: f64 = row["tip_y_mm"].parse()?;
        let turn = std::f64::consts::FRAC_1_SQRT_2;
        let cells = [
            row["t_settled_s"].clone(),
            row["guide_x_mm"].clone(),
            "25".into(),
            row["guide_z_mm"].clone(),
            turn.to_string(),
            "0".into(),
            "0".into(),
            turn.to_string(),
            row["tip_x_mm"].clone(),
            format!("{:.3}", y - start),
            row["tip_z_mm"].clone(),
            row["axis_x"].clone(),
            row["axis_y"].clone(),
            row["axis_z"].clone(),
            "0.1".into(),
        ];
        text += &(cells.join(";") + "\n");
    }
    Ok(text)
}
