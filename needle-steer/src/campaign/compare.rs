//! What a campaign says: a distribution for every law, phantom and target, and every law against
//! the reference on the same phantoms, targets and seeds.

use std::collections::BTreeMap;

use serde::Serialize;

use super::interval;
use super::plan::Plan;
use super::table::Row;
use crate::statistics::percentile;

/// The runs of one law in one phantom at one target.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cell {
    /// Steering law.
    pub law: String,
    /// Preset of the phantom.
    pub phantom: String,
    /// Name of the target.
    pub target: String,
    /// Target ahead of the tip, across the axis \[mm\], direction across \[deg\].
    pub place: [f64; 3],
    /// Finished runs.
    pub runs: u64,
    /// Runs that passed the target.
    pub passed: u64,
    /// Runs that passed it within the campaign's `success_mm`.
    pub hits: u64,
    /// 95 % interval of the rate of hits.
    pub hit_rate_interval: [f64; 2],
    /// Median of the true error \[mm\].
    pub median_mm: f64,
    /// Its 95 % interval; null for fewer than six runs.
    pub median_interval_mm: Option<[f64; 2]>,
    /// 5th percentile \[mm\].
    pub p5_mm: f64,
    /// 95th percentile \[mm\].
    pub p95_mm: f64,
    /// Median of the largest tissue displacement \[mm\].
    pub median_max_stretch_mm: f64,
}

/// A law against the reference, paired by phantom, target and seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pair {
    /// Steering law.
    pub law: String,
    /// The reference.
    pub reference: String,
    /// Preset of the phantom.
    pub phantom: String,
    /// Name of the target.
    pub target: String,
    /// Pairs.
    pub pairs: usize,
    /// Median of error minus the reference's error \[mm\]; negative: the law is better.
    pub median_difference_mm: f64,
    /// Its 95 % interval; null for fewer than six pairs.
    pub interval_mm: Option<[f64; 2]>,
    /// Pairs in which the law is nearer to the target.
    pub better: usize,
    /// Pairs in which the reference is.
    pub worse: usize,
    /// Two-sided probability of so uneven a split between equals (sign test).
    pub p_value: f64,
}

/// Everything that a campaign's table says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Conclusions {
    /// Runs of the campaign.
    pub runs: u64,
    /// Of these, finished.
    pub finished: u64,
    /// Of these, those that could not be carried out.
    pub failed: u64,
    /// Distributions.
    pub cells: Vec<Cell>,
    /// Comparisons.
    pub pairs: Vec<Pair>,
}

/// Draws the conclusions from the finished rows of a plan, in order.
pub fn conclude(plan: &Plan, rows: &[Row]) -> Conclusions {
    let mut groups: BTreeMap<u64, Vec<&Row>> = BTreeMap::new();
    for row in rows {
        groups
            .entry(row.run / plan.seeds.count)
            .or_default()
            .push(row);
    }
    let cells = groups
        .values()
        .filter_map(|rows| cell(plan, rows))
        .collect();
    let kinds = (plan.phantoms.len() * plan.targets.len()) as u64;
    let at = plan.laws.iter().position(|law| *law == plan.reference);
    let first = at.unwrap_or(0) as u64 * kinds;
    let pairs = groups
        .iter()
        .filter(|(kind, _)| **kind / kinds != first / kinds)
        .filter_map(|(kind, rows)| pair(plan, rows, groups.get(&(first + kind % kinds))?))
        .collect();
    Conclusions {
        runs: plan.len(),
        finished: rows.len() as u64,
        failed: rows.iter().filter(|row| row.is_failed()).count() as u64,
        cells,
        pairs,
    }
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values
}

fn cell(plan: &Plan, rows: &[&Row]) -> Option<Cell> {
    let first = rows.first()?;
    let errors = sorted(rows.iter().filter_map(|row| row.true_error_mm));
    let stretches = sorted(
        rows.iter()
            .filter(|row| !row.is_failed())
            .map(|row| row.max_stretch_mm),
    );
    let count = |good: &dyn Fn(&Row) -> bool| rows.iter().filter(|row| good(row)).count() as u64;
    let hits = count(&|row| row.passed && row.true_error_mm.is_some_and(|e| e <= plan.success_mm));
    Some(Cell {
        law: first.law.clone(),
        phantom: first.phantom.clone(),
        target: first.target.clone(),
        place: [first.depth_mm, first.offset_mm, first.angle_deg],
        runs: rows.len() as u64,
        passed: count(&|row| row.passed),
        hits,
        hit_rate_interval: interval::proportion(hits, rows.len() as u64),
        median_mm: percentile(&errors, 0.5),
        median_interval_mm: interval::median(&errors),
        p5_mm: percentile(&errors, 0.05),
        p95_mm: percentile(&errors, 0.95),
        median_max_stretch_mm: percentile(&stretches, 0.5),
    })
}

fn pair(plan: &Plan, rows: &[&Row], reference: &[&Row]) -> Option<Pair> {
    let first = rows.first()?;
    let by_seed: BTreeMap<u64, f64> = reference
        .iter()
        .filter_map(|row| Some((row.seed, row.true_error_mm?)))
        .collect();
    let differences = sorted(
        rows.iter()
            .filter_map(|row| Some(row.true_error_mm? - by_seed.get(&row.seed)?)),
    );
    let better = differences.iter().filter(|d| **d < 0.0).count();
    let worse = differences.iter().filter(|d| **d > 0.0).count();
    Some(Pair {
        law: first.law.clone(),
        reference: plan.reference.clone(),
        phantom: first.phantom.clone(),
        target: first.target.clone(),
        pairs: differences.len(),
        median_difference_mm: percentile(&differences, 0.5),
        interval_mm: interval::median(&differences),
        better,
        worse,
        p_value: interval::sign_test(better, better + worse),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Pairs are by seed: a constant gain of 0.1 mm is seen through a spread of 20 mm.
    #[test]
    fn pairs_see_through_the_spread_of_the_seeds() {
        let plan = Plan::parse(
            "laws = [\"paper\", \"hybrid\"]\nseeds = { first = 1, count = 20 }\nsuccess_mm = 5.0\n\
             [[target]]\nkind = \"aligned\"\n",
            Path::new("c.toml"),
        )
        .unwrap();
        let rows: Vec<Row> = (0..plan.len())
            .map(|run| {
                let task = plan.task(run);
                let gain = if task.law == "hybrid" { 0.1 } else { 0.0 };
                Row {
                    passed: true,
                    ended: "target passed".into(),
                    true_error_mm: Some(task.seed as f64 - gain),
                    ..Row::failed(&task, "")
                }
            })
            .collect();
        let found = conclude(&plan, &rows);
        assert_eq!((found.cells.len(), found.pairs.len()), (2, 1));
        assert_eq!((found.cells[0].hits, found.cells[1].hits), (5, 5));
        let pair = &found.pairs[0];
        assert_eq!(
            (pair.law.as_str(), pair.better, pair.worse),
            ("hybrid", 20, 0)
        );
        assert!((pair.median_difference_mm + 0.1).abs() < 1e-12);
        let [low, high] = pair.interval_mm.unwrap();
        assert!((low + 0.1).abs() < 1e-12 && (high + 0.1).abs() < 1e-12);
        assert!(pair.p_value < 1e-5);
    }
}
