//! One decision of the law `hybrid`: the needle is 20 mm deep and the target lies 60 mm ahead of its
//! tip, 5 mm aside.
//!
//! `cargo run --release -p hybrid-control --example one_decision`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use core::f64::consts::PI;

use hal::Stamp;
use hybrid_control::{
    Entry, Estimator, EstimatorSettings, Freedom, LawSettings, Limits, Observation, RollTravel,
    Start, Target, View, law_by_name,
};
use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};

/// From base to tip \[m\].
const LENGTH: f64 = 0.126;
const DEPTH: f64 = 0.02;
const SPEED: f64 = 1e-3;
/// Between two images \[s\].
const DT: f64 = 1.0 / 30.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The needle straight down into a horizontal surface.
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let entry = Entry {
        point: Point3::new(0.40, 0.0, 0.25),
        inward: -Vector3::z_axis(),
    };
    let base_at = |depth: f64| {
        let origin = entry.point.coords + Vector3::z() * (LENGTH - depth);
        Isometry3::from_parts(origin.into(), down)
    };
    let start = Start {
        length: LENGTH,
        bending_stiffness: 1.836e-3,
        cutting_edge: 1.57e-3,
        guide_gap: None,
        tip_sensor: None,
        advance_by_tip: false,
        entry,
        world_from_base: base_at(0.0),
    };

    // The estimator follows a tip that goes straight ahead, image by image.
    let mut estimator = Estimator::new(&EstimatorSettings::default(), &start)?;
    let (mut now, mut depth) = (0.0, 0.0);
    while depth < DEPTH {
        now += DT;
        depth += SPEED * DT;
        estimator.observe(&Observation {
            stamp: Stamp::from_secs(now),
            world_from_base: base_at(depth),
            position: entry.point - Vector3::z() * depth,
            position_sigma: 5e-5,
            direction: Unit::new_normalize(-Vector3::z()),
            direction_sigma: 5e-3,
            shaft: &[],
            carried: false,
        });
    }
    let tip = estimator.predict(Stamp::from_secs(now), &base_at(depth));

    let limits = Limits::default();
    let target = Point3::new(0.405, 0.0, 0.25 - depth - 0.06);
    let view = View {
        time: Stamp::from_secs(now),
        dt: DT,
        tip,
        target: Target {
            position: target,
            velocity: Vector3::zeros(),
        },
        entry,
        depth,
        world_from_base: base_at(depth),
        springs: None, // `hybrid` predicts with the estimator's own model
        shape: &[],
        estimator: &estimator,
        roll_travel: RollTravel {
            positive: 2.0 * PI,
            negative: 2.0 * PI,
        },
        freedom: Freedom::full(),
        limits: &limits,
        insertion_speed: SPEED,
    };
    let mut law = law_by_name("hybrid", &LawSettings::default())?;
    let decision = law.decide(&view);

    let seen = tip.locate(&target) * 1e3;
    let (linear, angular) = (decision.twist.linear * 1e3, decision.twist.angular);
    let turned = angular.map(f64::to_degrees);
    println!("law:            {}", law.name());
    println!(
        "target, by tip: {:.1} {:.1} {:.1} mm",
        seen.x, seen.y, seen.z
    );
    println!(
        "base, linear:   {:.3} {:.3} {:.3} mm/s",
        linear.x, linear.y, linear.z
    );
    println!(
        "base, angular:  {:.3} {:.3} {:.3} degrees/s",
        turned.x, turned.y, turned.z
    );
    let miss = decision.report.predicted_miss * 1e3;
    println!("predicted miss: {:.2} {:.2} mm", miss.x, miss.y);
    println!(
        "steering:       {:?}, limits {:?}",
        decision.report.mode, decision.report.limits
    );

    assert!(decision.twist.is_finite() && decision.twist.linear.norm() > 0.0);
    let along = view.base_axis().dot(&decision.twist.linear);
    assert!(along <= limits.insertion_speed_mm_s * 1e-3 * (1.0 + 1e-9));
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}
