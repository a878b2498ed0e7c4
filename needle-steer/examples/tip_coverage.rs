//! How often the intervals of `estimate` cover the phantom, by an electromagnetic tip through a guide.
//!
//! `cargo run --release -p needle-steer --example tip_coverage -- FIRST COUNT [KEY=VALUE ...]` inserts with the
//! seeds FIRST and on, each in a tissue of its own (wave lengths of 22 to 35 mm, as in the recordings of
//! docs/REAL_NEEDLES.md) through a guide at a distance of its own (25 mm, give or take 6), and identifies each
//! run by itself.

use std::error::Error;
use std::io::Write as _;
use std::path::Path;

use needle_steer::config::{self, Config};
use needle_steer::controls::Controls;
use needle_steer::experiments::in_parallel;
use needle_steer::identify::{Interval, Recorder, TipIdentified, identify_tip};
use needle_steer::rig::{self, Rig};
use needle_steer::run::run;
use needle_steer::springs;
use phantom::Draw;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Wave lengths of the conditions \[m\].
const WAVE_LENGTHS: (f64, f64) = (22e-3, 35e-3);
/// Distance of the guide, as it is told, and the standard deviation of how far it truly is from that \[mm\].
const GAP_MM: (f64, f64) = (25.0, 6.0);

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [first, count, more @ ..] = args.as_slice() else {
        return Err("expected FIRST COUNT [KEY=VALUE ...]".into());
    };
    let (first, count): (u64, u64) = (first.parse()?, count.parse()?);
    let urdf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/urdf/guide.urdf");
    let mut sets = vec![format!("arm.urdf={urdf:?}")];
    let settings = [
        "arm.tip_link=needle_base",
        "arm.mechanism=true",
        "run.sensor=em",
        "run.phantom=gel-guide",
        "target.offset_mm=5",
        "needle.support=\"guide\"",
        "needle.guide_gap_mm=25.0",
        "needle.guide_gap_sigma_mm=6.0",
        "needle.length_mm=200.0",
        "needle.outer_diameter_mm=1.27",
        "needle.inner_diameter_mm=0.84",
        "estimator.stiffness_n_m2=1.5e5",
        "estimator.cut_angle_deg=0.36",
        "estimator.cut_angle_sigma=0.1",
        "estimator.tip_compliance_deg_n=0.1",
        "supervisor.tissue_stretch_mm=5.5",
        "run.check_reach=false",
    ];
    sets.extend(settings.iter().map(ToString::to_string));
    sets.extend(more.iter().cloned());
    let config = rig::placed(&config::load(None, &sets)?)?;
    let seeds: Vec<u64> = (first..first + count).collect();
    let cores = std::thread::available_parallelism()?.get();
    let runs = in_parallel(&seeds, cores, |&seed| {
        one(&config, seed).map_err(|error| error.to_string())
    });
    let mut out = std::io::stdout().lock();
    let names = ["wave length", "guide's distance", "setback of the coil"];
    let (mut covered, mut told) = ([0_u32; 3], [0_u32; 3]);
    let (mut ratios, mut widths) = ([const { Vec::new() }; 3], [const { Vec::new() }; 3]);
    for (seed, found) in seeds.iter().zip(runs) {
        let One { found, truth } = match found {
            Ok(one) => one,
            Err(problem) => {
                writeln!(out, "{seed}: {problem}")?;
                continue;
            }
        };
        let intervals = [
            found.wave_length_mm,
            found.guide_gap_mm,
            Some(found.sensor_setback_mm),
        ];
        write!(out, "{seed}:")?;
        for (k, (interval, truth)) in intervals.into_iter().zip(truth).enumerate() {
            let Some(Interval { value, low, high }) = interval else {
                write!(out, " {} not identified;", names[k])?;
                continue;
            };
            told[k] += 1;
            covered[k] += u32::from((low..=high).contains(&truth));
            ratios[k].push(value - truth);
            widths[k].push((high - low) / 2.0);
            write!(
                out,
                " {} {value:.1} [{low:.1}, {high:.1}] of {truth:.1} mm;",
                names[k]
            )?;
        }
        writeln!(out)?;
    }
    for k in 0..3 {
        let n = f64::from(told[k].max(1));
        let mean = ratios[k].iter().sum::<f64>() / n;
        let rms = (ratios[k].iter().map(|x: &f64| x * x).sum::<f64>() / n).sqrt();
        writeln!(
            out,
            "{}: covered in {} of {} ({:.1} %); error {mean:+.2} mm in the mean, {rms:.2} mm rms; half width {:.2} mm",
            names[k],
            covered[k],
            told[k],
            100.0 * f64::from(covered[k]) / n,
            widths[k].iter().sum::<f64>() / n
        )?;
    }
    Ok(())
}

/// What a run says, and the truth: wave length, distance of the guide, setback of the coil \[mm\].
struct One {
    found: TipIdentified,
    truth: [f64; 3],
}

fn one(config: &Config, seed: u64) -> Result<One, Box<dyn Error>> {
    let mut draws = ChaCha8Rng::seed_from_u64(seed);
    let (least, most) = WAVE_LENGTHS;
    let wave_length = least * (most / least).powf(draws.random());
    let beyond: f64 = StandardNormal.sample(&mut draws);
    let gap_mm = (GAP_MM.0 + GAP_MM.1 * beyond).max(5.0);
    let bending = springs::needle(config)?.bending_stiffness();
    let stiffness = 4.0 * bending / wave_length.powi(4);
    let mut config = config.clone();
    config.run.seed = seed;
    for (table, key, value) in [
        ("tissue", "stiffness_n_m2", stiffness),
        ("guide", "gap_mm", gap_mm),
    ] {
        let table = config
            .phantom
            .entry(table)
            .or_insert_with(|| toml::Table::new().into());
        let table = table
            .as_table_mut()
            .ok_or("expected a table of the phantom")?;
        table.insert(key.to_owned(), value.into());
    }
    let settings = config.phantom_settings()?;
    let drawn = Draw::new(&settings, seed).stiffness;
    let mut rig = Rig::new(&config)?;
    let mut recorder = Recorder::new(&config, rig.bearings.clone());
    run(&config, &mut rig, &mut recorder, &Controls::default())?;
    Ok(One {
        found: identify_tip(&[recorder.finish("run")?])?,
        truth: [
            (4.0 * bending / drawn).powf(0.25) * 1e3,
            gap_mm,
            settings.em.setback_mm,
        ],
    })
}
