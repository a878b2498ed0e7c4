//! A published experiment again: what `hybrid` would have commanded on the recorded measurements, beside what
//! the recorded controller did, and where either would have ended.
//!
//! `NEEDLE_STEER_REFERENCE=... cargo run --release -p needle-steer --example recorded_controller` reads
//! `real/guide-em/steps.csv`: insertions by hand through a guide, 5 mm a step; the target lies 100 mm straight
//! below the entry. Wave length and distance of the guide are learnt by `estimate` from the other
//! insertions of a condition. At each step the estimator takes in the recorded guide and tip; `hybrid` then moves
//! the guide, without a push, until it rests. Its move is compared and dropped: the next step is the
//! recorded one.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write as _;
use std::path::Path;

use hal::{Stamp, Twist};
use hybrid_control::view::{Entry, RollTravel, Target, View};
use hybrid_control::{Estimator, Freedom, Observation, Rollout, Start, law_by_name};
use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector2, Vector3};
use needle_steer::config::{self, Config};
use needle_steer::identify::{Recording, Seen, Support, identify_tip};
use needle_steer::springs;
use needle_steer::statistics::median;

type Row = BTreeMap<String, String>;

/// Depth of the target below the entry \[m\].
const TARGET: f64 = 0.1;
/// Distance of the guide's exit from the tissue, where nothing was published \[m\].
const GAP: f64 = 25e-3;
/// Travel of the guide to both sides \[m\].
const TRAVEL: f64 = 6e-3;
/// Way between two looks of the estimator \[m\].
const STEP: f64 = 1e-3;
/// Time that `hybrid` has for a move, and between two of its decisions \[s\].
const MOVE: (f64, f64) = (4.0, 0.1);
/// Deviations of what was measured: of the place \[m\] and the axis \[rad\].
const MEASURED: (f64, f64) = (0.1e-3, 3e-3);
/// Deviation of a place that was not measured \[m\].
const UNSEEN: f64 = 1.0;

#[expect(
    clippy::disallowed_methods,
    reason = "a binary of its own: the recordings are outside the project"
)]
fn main() -> Result<(), Box<dyn Error>> {
    let reference = std::env::var("NEEDLE_STEER_REFERENCE")
        .map_err(|_| "NEEDLE_STEER_REFERENCE is not set: the recordings are not in the project")?;
    let file = Path::new(&reference).join("real/guide-em/steps.csv");
    let settings = [
        "needle.support=\"guide\"",
        "needle.length_mm=200.0",
        "needle.outer_diameter_mm=1.27",
        "needle.inner_diameter_mm=0.84",
        "needle.guide_gap_mm=25.0",
        "needle.guide_gap_sigma_mm=8.0",
        "tissue.inward=[0.0, -1.0, 0.0]",
        "tissue.entry_mm=[0.0, 0.0, 0.0]",
        "estimator.cut_angle_deg=0.36",
        "estimator.tip_compliance_deg_n=0.1",
        "limits.base_offset_mm=6.0",
        "run.law=hybrid",
    ];
    let config = config::load(None, &settings.map(str::to_owned))?;
    let mut conditions: BTreeMap<String, Vec<Recording>> = BTreeMap::new();
    for (trial, rows) in trials(&file)? {
        conditions
            .entry(trial[..trial.len() - 3].to_owned())
            .or_default()
            .push(recording(&trial, &rows, &config)?);
    }
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "condition | insertions | steps | recorded move mm | `hybrid`'s mm | same way | predicted end by the recorded moves mm | by `hybrid`'s mm | true end mm | error of the predicted end 40, 20, 10 mm ahead (straight on) mm"
    )?;
    for (name, recordings) in &conditions {
        let mut found = Found::default();
        for (k, one) in recordings.iter().enumerate() {
            let mut others = recordings.clone();
            others.remove(k);
            let mine = identify_tip(&others)?.apply(&config);
            again(one, &mine, &mut found)?;
        }
        found.report(&mut out, name, recordings.len())?;
    }
    Ok(())
}

/// What the steps of a condition came to; lengths in mm.
#[derive(Default)]
struct Found {
    recorded: Vec<f64>,
    ours: Vec<f64>,
    same_way: Vec<f64>,
    end_recorded: Vec<f64>,
    end_ours: Vec<f64>,
    end: Vec<f64>,
    /// By how far ahead the end is: errors of the prediction, and of a straight line.
    ahead: [(Vec<f64>, Vec<f64>); 3],
}

impl Found {
    fn report(
        &self,
        out: &mut impl std::io::Write,
        name: &str,
        count: usize,
    ) -> std::io::Result<()> {
        let same = self.same_way.iter().sum::<f64>() / self.same_way.len().max(1) as f64;
        write!(
            out,
            "{name} | {count} | {} | {:.2} | {:.2} | {same:+.2} | {:.2} | {:.2} | {:.2} |",
            self.recorded.len(),
            median(&self.recorded),
            median(&self.ours),
            median(&self.end_recorded),
            median(&self.end_ours),
            median(&self.end),
        )?;
        for (said, straight) in &self.ahead {
            write!(out, " {:.2} ({:.2})", median(said), median(straight))?;
        }
        writeln!(out)
    }
}

/// Steps a recording and asks `hybrid` at each step.
fn again(recording: &Recording, config: &Config, found: &mut Found) -> Result<(), Box<dyn Error>> {
    let seen = &recording.seen;
    let (Some(first), Some(last)) = (seen.first(), seen.last()) else {
        return Err(format!("{}: no steps", recording.name).into());
    };
    let inward = config.inward();
    let entry = config.entry();
    let target = entry + inward.scale(TARGET);
    let length = config.needle.length_mm * 1e-3;
    // The guide holds the needle's direction: only its shifts are told, and the axis less the first.
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &inward).unwrap_or_default();
    let base = |guide: &Isometry3<f64>, depth: f64| {
        let shift = guide.translation.vector - first.world_from_support.translation.vector;
        let across = shift - inward.scale(shift.dot(&inward));
        Isometry3::from_parts(
            (entry.coords + across + inward.scale(depth - length)).into(),
            turn,
        )
    };
    let off = UnitQuaternion::rotation_between(&first.direction, &inward).unwrap_or_default();
    let depth = |seen: &Seen| (seen.tip - entry).dot(&inward);
    let mut estimator = Estimator::new(
        &config.estimator,
        &Start {
            length,
            bending_stiffness: springs::needle(config)?.bending_stiffness(),
            cutting_edge: 0.0,
            guide_gap: Some(config.needle.guide_gap_mm * 1e-3),
            tip_sensor: Some(config.em.tip_sensor(None)),
            advance_by_tip: true,
            entry: Entry {
                point: entry,
                inward,
            },
            world_from_base: base(&first.world_from_support, 0.0),
        },
    )?;
    let mut time = 0.0;
    let mut look = |estimator: &mut Estimator, base: &Isometry3<f64>, seen: Option<&Seen>| {
        time += MOVE.1;
        let tip = base * Point3::new(0.0, 0.0, length);
        // An axis across the insertion is none.
        let (place, axis, sigmas) = match seen {
            Some(seen) => (seen.tip, off * seen.direction.into_inner(), MEASURED),
            None => (tip, turn * Vector3::x(), (UNSEEN, UNSEEN)),
        };
        estimator.observe(&Observation {
            stamp: Stamp::from_secs(time),
            world_from_base: *base,
            position: place,
            position_sigma: sigmas.0,
            direction: Unit::new_normalize(axis),
            direction_sigma: sigmas.1,
            shaft: &[],
            carried: false,
        });
    };
    let mut rollout = Rollout::new();
    let mut said: Vec<(f64, Vector2<f64>, Vector2<f64>)> = Vec::new();
    let mut shifts: Vec<Vector2<f64>> = Vec::new();
    let frame = *estimator.world_from_insertion();
    let across = |v: Vector3<f64>| frame.inverse_transform_vector(&v).xy();
    for (k, now) in seen.iter().enumerate() {
        let at = base(&now.world_from_support, depth(now));
        if let Some(before) = k.checked_sub(1).map(|k| &seen[k]) {
            // The guide moves, then the hand pushes.
            let (from, to) = (depth(before), depth(now).max(depth(before)));
            let mut deep = from;
            while deep < to - STEP {
                look(&mut estimator, &base(&now.world_from_support, deep), None);
                deep += STEP;
            }
        }
        look(&mut estimator, &at, Some(now));
        estimator.predict(Stamp::from_secs(k as f64), &at);
        estimator.rollout(&target, &mut rollout);
        let Some(next) = seen
            .get(k + 1)
            .filter(|_| rollout.remaining > STEP && k > 1)
        else {
            continue;
        };
        let way = TARGET - depth(now);
        let tip = across(now.tip - entry);
        let axis = off * now.direction.into_inner();
        let straight = tip + across(axis) / axis.dot(&inward).max(0.1) * way;
        said.push((way, rollout.end, straight));
        let moved = across(
            next.world_from_support.translation.vector - now.world_from_support.translation.vector,
        );
        shifts.push(moved * rollout.shift);
        let ours = asked(&mut estimator, config, &target, &at, depth(now))?;
        let by = across(ours);
        found.recorded.push(moved.norm() * 1e3);
        found.ours.push(by.norm() * 1e3);
        if moved.norm() > 0.3e-3 && by.norm() > 0.3e-3 {
            found
                .same_way
                .push(moved.dot(&by) / moved.norm() / by.norm());
        }
        // The goal is the entry's axis.
        found
            .end_recorded
            .push((rollout.end + moved * rollout.shift).norm() * 1e3);
        found
            .end_ours
            .push((rollout.end + by * rollout.shift).norm() * 1e3);
    }
    let end = across(last.tip - entry);
    found.end.push(end.norm() * 1e3);
    for (i, ahead) in [40e-3, 20e-3, 10e-3].into_iter().enumerate() {
        let near = |way: f64| (way - ahead).abs();
        let at = (0..said.len()).min_by(|a, b| near(said[*a].0).total_cmp(&near(said[*b].0)));
        let Some(at) = at else { continue };
        // With what the recorded guide did from there on.
        let by_moves: Vector2<f64> = shifts[at..].iter().sum();
        found.ahead[i]
            .0
            .push((said[at].1 + by_moves - end).norm() * 1e3);
        found.ahead[i].1.push((said[at].2 - end).norm() * 1e3);
    }
    Ok(())
}

/// Where `hybrid` moves the guide while nobody pushes.
fn asked(
    estimator: &mut Estimator,
    config: &Config,
    target: &Point3<f64>,
    from: &Isometry3<f64>,
    depth: f64,
) -> Result<Vector3<f64>, Box<dyn Error>> {
    let inward = config.inward();
    let mut law = law_by_name("hybrid", &config.law)?;
    let shift = |axis: Vector3<f64>| Twist {
        linear: axis,
        angular: Vector3::zeros(),
    };
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| from.rotation * axis);
    let freedom = Freedom::of(axes.map(|axis| shift(axis * 0.1)));
    let mut base = *from;
    let (duration, period) = MOVE;
    let mut time = 0.0;
    while time < duration {
        let tip = estimator.predict(Stamp::from_secs(time), &base);
        let decision = law.decide(&View {
            time: Stamp::from_secs(time),
            dt: period,
            tip,
            target: Target {
                position: *target,
                velocity: Vector3::zeros(),
            },
            entry: Entry {
                point: config.entry(),
                inward,
            },
            depth,
            world_from_base: base,
            springs: None,
            shape: &[],
            estimator,
            roll_travel: RollTravel {
                positive: 0.0,
                negative: 0.0,
            },
            freedom,
            limits: &config.limits,
            insertion_speed: config.run.insertion_speed_mm_s * 1e-3,
        });
        let step = decision.twist.linear * period;
        base.translation.vector += step - inward.scale(step.dot(&inward));
        time += period;
    }
    let mut moved = base.translation.vector - from.translation.vector;
    for axis in &axes[..2] {
        let place = (base.translation.vector - config.entry().coords).dot(axis);
        moved += axis * (place.clamp(-TRAVEL, TRAVEL) - place);
    }
    Ok(moved)
}

/// Insertions under the recorded controller, of the conditions of docs/REAL_NEEDLES.md.
fn trials(file: &Path) -> Result<BTreeMap<String, Vec<Row>>, Box<dyn Error>> {
    let mut trials: BTreeMap<String, Vec<Row>> = BTreeMap::new();
    let mut reader = csv::Reader::from_path(file)?;
    for row in reader.deserialize() {
        let row: Row = row?;
        let trial = row["trial"].clone();
        let wanted = ["exp_a", "exp_b", "exp_c"]
            .iter()
            .any(|p| trial.starts_with(p))
            && ["_01", "_02", "_03", "_04", "_05"]
                .iter()
                .any(|end| trial.ends_with(end))
            && trial.len() == "exp_a1_01".len()
            && trial != "exp_a2_02";
        if wanted && row["date"] != "jacobian" {
            trials.entry(trial).or_default().push(row);
        }
    }
    Ok(trials)
}

/// One insertion, its entry in World's origin.
fn recording(name: &str, rows: &[Row], config: &Config) -> Result<Recording, Box<dyn Error>> {
    let number = |row: &Row, key: &str| -> Result<f64, Box<dyn Error>> {
        let text = row
            .get(key)
            .ok_or_else(|| format!("{name}: no column {key}"))?;
        Ok(text.parse()?)
    };
    let first = rows.first().ok_or("no rows")?;
    let place = |row: &Row, of: &str| -> Result<Point3<f64>, Box<dyn Error>> {
        let key = |axis: &str| format!("{of}_{axis}_mm");
        Ok(Point3::new(
            number(row, &key("x"))?,
            number(row, &key("y"))?,
            number(row, &key("z"))?,
        ) * 1e-3)
    };
    let start = place(first, "tip")?;
    let turn =
        UnitQuaternion::rotation_between(&Vector3::z(), &config.inward()).unwrap_or_default();
    let mut seen = Vec::new();
    for row in rows {
        let guide =
            Vector3::new(number(row, "guide_x_mm")?, 0.0, number(row, "guide_z_mm")?) * 1e-3;
        let mut guide = guide - start.coords;
        guide.y = GAP;
        let axis = Vector3::new(
            number(row, "axis_x")?,
            number(row, "axis_y")?,
            number(row, "axis_z")?,
        );
        seen.push(Seen {
            stamp: Stamp::from_secs(number(row, "t_settled_s")?),
            world_from_support: Isometry3::from_parts(guide.into(), turn),
            tip: place(row, "tip")? - start.coords,
            tip_sigma: MEASURED.0,
            direction: Unit::new_normalize(axis),
            direction_sigma: MEASURED.1,
            shaft: Vec::new(),
            inserted: None,
            roll: None,
        });
    }
    Ok(Recording {
        name: name.to_owned(),
        config: config.clone(),
        support: Support::Guide,
        seen,
    })
}
