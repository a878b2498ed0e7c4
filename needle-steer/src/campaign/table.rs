//! One line for each run: the columns of a campaign's table.

use serde::{Deserialize, Serialize};

use super::plan::Task;
use crate::outcome::{Ended, Happened, Summary};

/// One finished run, in the order of the table's columns. Units stand in the names; an empty
/// field is not known. `docs/LOGS.md` describes the columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Number of the run in its campaign, from 0.
    pub run: u64,
    /// Steering law.
    pub law: String,
    /// Preset of the phantom.
    pub phantom: String,
    /// Name of the target.
    pub target: String,
    /// Target ahead of the tip \[mm\].
    pub depth_mm: f64,
    /// Target across the axis \[mm\].
    pub offset_mm: f64,
    /// Direction of the offset from the bevel direction \[deg\].
    pub angle_deg: f64,
    /// Seed.
    pub seed: u64,
    /// Whether the tip passed the target; a run that ended early has missed.
    pub passed: bool,
    /// Verdict in words.
    pub ended: String,
    /// True distance of the target from the tip axis at the end \[mm\].
    pub true_error_mm: Option<f64>,
    /// The same by the sensor \[mm\].
    pub measured_error_mm: Option<f64>,
    /// Target ahead of the tip at the end \[mm\].
    pub axial_error_mm: Option<f64>,
    /// Largest true tissue displacement \[mm\].
    pub max_stretch_mm: f64,
    /// Mean true tissue displacement \[mm\].
    pub mean_stretch_mm: f64,
    /// Duration of steering \[s\].
    pub duration_s: f64,
    /// Law steps.
    pub steps: u64,
    /// Why the target was not passed; empty where it was.
    pub cause: String,
    /// What happened in the simulated world, each kind once, separated by spaces.
    pub events: String,
}

/// Names of the columns.
pub const COLUMNS: [&str; 19] = [
    "run",
    "law",
    "phantom",
    "target",
    "depth_mm",
    "offset_mm",
    "angle_deg",
    "seed",
    "passed",
    "ended",
    "true_error_mm",
    "measured_error_mm",
    "axial_error_mm",
    "max_stretch_mm",
    "mean_stretch_mm",
    "duration_s",
    "steps",
    "cause",
    "events",
];

/// A campaign's table: heading, then `lines` of rows in the order of their runs.
pub fn table<'a>(lines: impl IntoIterator<Item = &'a str>) -> String {
    let mut table = COLUMNS.join(",");
    table.push('\n');
    table.extend(lines);
    table
}

impl Row {
    /// The row of a run that ended with a verdict.
    pub fn new(task: &Task<'_>, summary: &Summary) -> Self {
        Self {
            passed: summary.ended == Ended::TargetPassed,
            ended: summary.ended.to_string(),
            true_error_mm: summary.true_error_mm,
            measured_error_mm: summary.measured_error_mm,
            axial_error_mm: summary.axial_error_mm,
            max_stretch_mm: summary.max_stretch_mm,
            mean_stretch_mm: summary.mean_stretch_mm,
            duration_s: summary.duration_s,
            steps: summary.steps,
            cause: summary
                .cause
                .map_or_else(String::new, |cause| cause.to_string()),
            events: kinds(&summary.events),
            ..Self::failed(task, "")
        }
    }

    /// The row of a run that could not be carried out.
    pub fn failed(task: &Task<'_>, why: &str) -> Self {
        Self {
            run: task.run,
            law: task.law.to_owned(),
            phantom: task.phantom.to_owned(),
            target: task.target.name.clone(),
            depth_mm: task.target.depth_mm,
            offset_mm: task.target.offset_mm,
            angle_deg: task.target.angle_deg,
            seed: task.seed,
            passed: false,
            ended: format!("failed: {why}"),
            true_error_mm: None,
            measured_error_mm: None,
            axial_error_mm: None,
            max_stretch_mm: 0.0,
            mean_stretch_mm: 0.0,
            duration_s: 0.0,
            steps: 0,
            cause: String::new(),
            events: String::new(),
        }
    }

    /// Whether the run could not be carried out.
    pub fn is_failed(&self) -> bool {
        self.ended.starts_with("failed: ")
    }

    /// The row as one line of CSV, with its newline.
    ///
    /// # Errors
    /// None that memory does not give.
    pub fn line(&self) -> Result<Vec<u8>, csv::Error> {
        let mut line = Vec::new();
        let mut writer = csv::WriterBuilder::new()
            .has_headers(false)
            .from_writer(&mut line);
        // A line break in a message would make two lines of one run.
        let ended = self.ended.replace(['\n', '\r'], " ");
        writer.serialize(Self {
            ended,
            ..self.clone()
        })?;
        writer.flush()?;
        drop(writer);
        Ok(line)
    }

    /// As [`Row::line`], as text.
    ///
    /// # Errors
    /// None that memory does not give.
    pub fn text(&self) -> Result<String, csv::Error> {
        String::from_utf8(self.line()?).map_err(|e| std::io::Error::other(e).into())
    }

    /// Reads one line of CSV.
    ///
    /// # Errors
    /// It is no row.
    pub fn parse(line: &str) -> Result<Self, csv::Error> {
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .from_reader(line.as_bytes());
        let mut record = csv::StringRecord::new();
        reader.read_record(&mut record)?;
        record.deserialize(Some(&csv::StringRecord::from(COLUMNS.to_vec())))
    }
}

/// The kinds of events, each once, in the order of their onset.
fn kinds(events: &[Happened]) -> String {
    let mut names: Vec<&str> = Vec::new();
    for event in events {
        if !names.contains(&event.kind.name()) {
            names.push(event.kind.name());
        }
    }
    names.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::plan::Plan;

    #[test]
    fn a_row_survives_its_line_and_a_torn_line_is_no_row() {
        let plan = Plan::parse(
            "laws = [\"paper\"]\nseeds = { first = 1, count = 1 }\n[[target]]\nname = 'a, \"b\"'\n",
            std::path::Path::new("c.toml"),
        )
        .unwrap();
        let mut row = Row::failed(&plan.task(0), "two\nlines, and a comma");
        row.true_error_mm = Some(0.1 + 0.2);
        let line = row.line().unwrap();
        let text = String::from_utf8(line.clone()).unwrap();
        assert_eq!(text.matches('\n').count(), 1);
        let read = Row::parse(&text).unwrap();
        assert_eq!(read.line().unwrap(), line);
        assert_eq!(
            read.true_error_mm.unwrap().to_bits(),
            (0.1 + 0.2_f64).to_bits()
        );
        let commas = text.len() - 3;
        assert!(Row::parse(&text[..text.len() / 2]).is_err());
        assert!(Row::parse(&text[..commas]).is_err());
    }
}
