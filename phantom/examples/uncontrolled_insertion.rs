//! A needle of the population is inserted straight, without control: how far its bevel carries it off.
//!
//! `cargo run --release -p phantom --example uncontrolled_insertion`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use hal::{Stamp, Transform};
use nalgebra::Isometry3;
use phantom::experiment::{default_setup, uncontrolled};
use phantom::{Bench, Settings};

const SEED: u64 = 7;
/// Of the insertion \[m/s\].
const SPEED: f64 = 5e-3;
/// Between two exposures \[s\].
const PERIOD: f64 = 1.0 / 30.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let settings = Settings::preset("paper")?;
    let setup = default_setup(&settings, SEED);
    let mut bench = Bench::new(&settings, &setup)?;
    let start = *setup.world_from_base.isometry();
    println!("depth [mm]  tip aside [mm]  tissue moved by [mm]  at the entry [N]");
    let mut aside = 0.0;
    for cm in 1..=8 {
        let inserted = f64::from(cm) * 0.01;
        let base = Transform::assume(start * Isometry3::translation(0.0, 0.0, inserted));
        bench.advance_to(Stamp::from_secs(inserted / SPEED), &base);
        let truth = bench.truth();
        let tip = setup
            .world_from_phantom
            .inverse_transform_point(&truth.tip().into());
        aside = tip.coords.xy().norm();
        println!(
            "{:10.1}  {:14.2}  {:20.2}  {:16.3}",
            truth.depth * 1e3,
            aside * 1e3,
            truth.max_stretch * 1e3,
            truth.entry_force.norm(),
        );
    }
    assert!(
        aside > 1e-3,
        "a bevel-tip needle does not go straight: {aside} m"
    );

    let score = uncontrolled(&settings, SEED, SPEED, PERIOD)?;
    println!(
        "a target 80 mm ahead is missed by {:.2} mm, one 10 mm beside it by {:.2} mm",
        score.aligned * 1e3,
        score.shifted * 1e3,
    );
    assert!(score.aligned.is_finite() && score.shifted.is_finite());
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}
