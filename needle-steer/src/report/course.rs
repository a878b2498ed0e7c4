//! A run as its log tells it, thinned out to what a page can show.

use std::path::Path;

use hal::telemetry::Telemetry;
use hal::{SensedShape, StereoFrame};
use nalgebra::{Point3, Vector3};
use rosbridge::log::{LogReader, Record, RunInfo};

use vision::StereoRig;

use super::ReportError;
use crate::config::{self, Config};
use crate::journal::CALIBRATION;
use crate::series::{Row, Series};

/// Shapes shown by the slider, about.
const FRAMES: f64 = 80.0;
/// Camera views shown at most.
const VIEWS: usize = 6;

/// A step in the three-dimensional view; lengths relative to the entry point \[mm\].
#[derive(Clone, Debug)]
pub(super) struct Frame {
    pub(super) time: f64,
    pub(super) model: Vec<Vector3<f64>>,
    pub(super) truth: Vec<Vector3<f64>>,
    pub(super) springs: Vec<[Vector3<f64>; 2]>,
    pub(super) tip: Vector3<f64>,
    pub(super) sensed_tip: Option<Vector3<f64>>,
}

/// What the course's charts need of a step.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub(super) row: Row,
    pub(super) stiffness_sigma: f64,
    pub(super) heading_error: f64,
    pub(super) bevel_error: f64,
    /// What the bevel alone can give at the target \[mm\]; NaN unknown.
    pub(super) bevel_authority_mm: f64,
    pub(super) image_age: Option<f64>,
    pub(super) interval: Option<f64>,
}

/// A pair of images with the needle's measured points in the left camera's frame.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub(super) time: f64,
    pub(super) pair: StereoFrame,
    /// Measured points in the stereo frame, tip last; none where the needle was not found.
    pub(super) points: Vec<Vector3<f64>>,
    /// The target in the stereo frame, once it is set.
    pub(super) target: Option<Vector3<f64>>,
}

/// A run.
#[derive(Debug)]
pub(super) struct Course {
    pub(super) info: RunInfo,
    pub(super) config: Config,
    pub(super) samples: Vec<Sample>,
    pub(super) frames: Vec<Frame>,
    pub(super) pairs: Vec<View>,
    /// The cameras, where the log knows them.
    pub(super) cameras: Option<StereoRig>,
    /// Target relative to the entry \[mm\]: as the controller believes, and in truth.
    pub(super) target: Option<Vector3<f64>>,
    pub(super) true_target: Option<Vector3<f64>>,
    result: Option<serde_json::Value>,
    complete: bool,
}

impl Course {
    /// Reads a log.
    pub(super) fn read(file: &Path) -> Result<Self, ReportError> {
        let duration = duration(file)?;
        let mut log = LogReader::open(file)?;
        let info = log.run().clone();
        let config = config::parse(&info.config, file, &[])?;
        let mut course = Self {
            info,
            config,
            samples: Vec::new(),
            frames: Vec::new(),
            pairs: Vec::new(),
            cameras: None,
            target: None,
            true_target: None,
            result: None,
            complete: false,
        };
        let mut series = Series::default();
        let mut next = f64::NEG_INFINITY;
        let mut next_view = f64::NEG_INFINITY;
        let mut shape: Option<SensedShape> = None;
        let mut target = None;
        for record in log.by_ref() {
            match record? {
                Record::Step(t) => {
                    let time = t.stamp.as_secs();
                    target = (*t.target.point() != Point3::origin()).then(|| t.target.coords());
                    let row = series.row(&t);
                    course.samples.push(sample(&t, row, course.samples.last()));
                    if time >= next {
                        next = time + duration / FRAMES;
                        course.frame(&t);
                    }
                }
                Record::Stereo(pair) => {
                    let time = pair.left.stamp.as_secs();
                    if time >= next_view && course.pairs.len() < VIEWS {
                        next_view = time + duration / VIEWS as f64;
                        let stamp = pair.left.stamp;
                        let points = shape.as_ref().filter(|s| s.stamp == stamp).map(points_of);
                        course.pairs.push(View {
                            time,
                            pair,
                            points: points.unwrap_or_default(),
                            target,
                        });
                    }
                }
                Record::Shape(measured) => shape = Some(measured),
                Record::Document { name, text } if name == CALIBRATION => {
                    course.cameras = serde_json::from_str(&text).ok();
                }
                Record::Document { name, text } if name == "summary.json" => {
                    course.result = serde_json::from_str(&text).ok();
                }
                _ => {}
            }
        }
        course.complete = log.is_complete();
        if course.samples.is_empty() {
            return Err(ReportError::Empty {
                file: file.to_owned(),
            });
        }
        Ok(course)
    }

    fn frame(&mut self, t: &Telemetry) {
        let entry = self.config.entry();
        let mm = |p: &Vector3<f64>| (p - entry.coords) * 1e3;
        let camera = &self.info.world_from_left_camera;
        let place = |p: hal::Position<hal::frame::LeftCamera>| mm(&(*camera * p).coords());
        if *t.target.point() != Point3::origin() {
            self.target = Some(place(t.target));
        }
        if let Some(truth) = &t.truth
            && truth.target.iter().all(|x| x.is_finite())
        {
            self.true_target = Some(mm(&truth.target));
        }
        self.frames.push(Frame {
            time: t.stamp.as_secs(),
            model: t.model.shape.iter().map(mm).collect(),
            truth: t
                .truth
                .as_ref()
                .map_or_else(Vec::new, |truth| truth.shape.iter().map(mm).collect()),
            springs: t
                .model
                .spring_points
                .iter()
                .zip(&t.model.rest_points)
                .map(|(point, rest)| [mm(point), mm(rest)])
                .collect(),
            tip: mm(&t.world_from_tip.origin().coords()),
            sensed_tip: t.measured_tip.map(|tip| place(tip.position)),
        });
    }

    /// One line that names the run.
    pub(super) fn title(&self) -> String {
        let run = &self.config.run;
        format!(
            "Needle insertion: law {}, phantom {}, seed {}",
            run.law, run.phantom, run.seed
        )
    }

    /// What the run came to.
    pub(super) fn facts(&self) -> Vec<(String, String)> {
        let mut facts = Vec::new();
        let mut add = |name: &str, value: String| facts.push((name.to_owned(), value));
        let result = |key: &str| self.result.as_ref().and_then(|r| r.get(key)).cloned();
        match result("ended") {
            Some(ended) => add("ended", ended.as_str().unwrap_or_default().to_owned()),
            None if self.complete => add("ended", "not said in the log".into()),
            None => add("ended", "the log breaks off: its run was killed".into()),
        }
        for (key, name, unit) in [
            (
                "true_error_mm",
                "true distance of the target from the tip axis",
                "mm",
            ),
            ("measured_error_mm", "measured distance", "mm"),
            (
                "axial_error_mm",
                "target ahead of the tip at the stop",
                "mm",
            ),
            ("max_stretch_mm", "largest true tissue displacement", "mm"),
            ("mean_stretch_mm", "mean true tissue displacement", "mm"),
            ("duration_s", "duration of steering", "s"),
        ] {
            if let Some(value) = result(key).and_then(|v| v.as_f64()) {
                add(name, format!("{value:.3} {unit}"));
            }
        }
        add("steps", format!("{} law steps", self.samples.len()));
        let t = &self.config.target;
        let target = match t.kind {
            config::TargetKind::Aligned => format!("aligned, {} mm ahead", t.depth_mm),
            config::TargetKind::Shifted => format!(
                "{} mm ahead, shifted {} mm at {} degrees from the bevel",
                t.depth_mm, t.offset_mm, t.angle_deg
            ),
            config::TargetKind::Marker => format!(
                "marker carried by the tissue, {} mm ahead, shifted {} mm at {} degrees from the bevel",
                t.depth_mm, t.offset_mm, t.angle_deg
            ),
            config::TargetKind::Stereo => format!("{:?} mm in the stereo frame", t.position_mm),
            config::TargetKind::World => format!("{:?} mm in World", t.position_mm),
        };
        add("target", target);
        for (name, version) in &self.info.versions {
            add(name, version.clone());
        }
        facts
    }
}

/// Time of a log's last step \[s\].
fn duration(file: &Path) -> Result<f64, ReportError> {
    let mut last = 0.0_f64;
    for record in LogReader::open(file)? {
        if let Record::Command(command) = record? {
            last = last.max(command.stamp.as_secs());
        }
    }
    Ok(last)
}

fn sample(t: &Telemetry, row: Row, before: Option<&Sample>) -> Sample {
    Sample {
        stiffness_sigma: t.model.stiffness_sigma,
        heading_error: t.law.heading_error.to_degrees(),
        bevel_authority_mm: t.law.bevel_authority * 1e3,
        bevel_error: t.law.bevel_error.to_degrees(),
        image_age: t.image_stamp.map(|seen| t.stamp.secs_since(seen) * 1e3),
        interval: before.map(|b| (row.t_s - b.row.t_s) * 1e3),
        row,
    }
}

/// Points of a measured shape, tip last \[m\].
fn points_of(shape: &SensedShape) -> Vec<Vector3<f64>> {
    let along = shape.points.iter().map(|point| point.position.coords());
    along.chain([shape.tip.position.coords()]).collect()
}
