//! How well `estimate` recovers the phantom: errors and coverage over seeds.
//!
//! `cargo run --release -p needle-steer --example identification -- paper 1001 50`

use std::io::Write as _;

use needle_steer::config::{self, Config};
use needle_steer::controls::Controls;
use needle_steer::experiments::in_parallel;
use needle_steer::identify::{Identified, Recorder, identify};
use needle_steer::rig::Rig;
use needle_steer::run::run;
use phantom::{Draw, Settings};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let preset = arguments.next().unwrap_or_else(|| "paper".into());
    let first: u64 = arguments.next().unwrap_or_else(|| "1".into()).parse()?;
    let count: u64 = arguments.next().unwrap_or_else(|| "50".into()).parse()?;
    let settings = Settings::preset(&preset)?;
    let sensor = "run.sensor=\"shape\"".to_owned();
    let config = config::load(None, &[format!("run.phantom={preset}"), sensor])?;
    let bending = needle_steer::springs::needle(&config)?.bending_stiffness();
    let seeds: Vec<u64> = (first..first + count).collect();
    let found = in_parallel(&seeds, 2, |seed| one(&config, *seed));
    let mut out = std::io::stdout().lock();
    let (mut stiffness, mut angle, mut curvature) = (0, 0, 0);
    for (seed, found) in seeds.iter().zip(found) {
        let found = found?;
        let truth = Draw::new(&settings, *seed);
        let lambda = (4.0 * bending / truth.stiffness).powf(0.25);
        let k_nat = 2.0 * truth.cut_angle / lambda;
        let (k, g) = (&found.stiffness_n_m2, &found.cut_angle_deg);
        stiffness += u32::from(k.covers(truth.stiffness));
        angle += u32::from(g.covers(truth.cut_angle.to_degrees()));
        curvature += u32::from(found.natural_curvature_per_m.covers(k_nat));
        writeln!(
            out,
            "{seed} ln K error {:+.3} (sigma {:.3}) ln gamma error {:+.3} (sigma {:.3}) load {:.2} (sigma {:.2})",
            (k.value / truth.stiffness).ln(),
            k.log_sigma,
            (g.value / truth.cut_angle.to_degrees()).ln(),
            g.log_sigma,
            found.tip_load_scale.value,
            found.tip_load_scale.log_sigma,
        )?;
    }
    writeln!(
        out,
        "covered of {count}: stiffness {stiffness}, cut angle {angle}, natural curvature {curvature}"
    )?;
    Ok(())
}

fn one(config: &Config, seed: u64) -> Result<Identified, String> {
    let mut config = config.clone();
    config.run.seed = seed;
    let text = |e: &dyn std::error::Error| e.to_string();
    let mut rig = Rig::new(&config).map_err(|e| text(&e))?;
    let mut recorder = Recorder::new(&config, rig.bearings.clone());
    run(&config, &mut rig, &mut recorder, &Controls::default()).map_err(|e| text(&e))?;
    let recording = recorder.finish("run").map_err(|e| text(&e))?;
    identify(&[recording]).map_err(|e| text(&e))
}
