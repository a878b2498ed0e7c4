//! A UR5e from its URDF: where its flange is, all postures that put it there, and the joint rates
//! that move it straight down.
//!
//! `cargo run --release -p robots --example ur5e`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use hal::{Joints, Twist};
use nalgebra::Vector3;
use robots::kinematics::{Chain, RateSettings, Turns};

const URDF: &str = include_str!("../urdf/ur5e.urdf");
/// What inverse kinematics leaves of a pose \[m\].
const EXACT: f64 = 1e-9;

fn degrees(q: &Joints) -> String {
    let each: Vec<String> = q
        .iter()
        .map(|x| format!("{:7.2}", x.to_degrees()))
        .collect();
    each.join(" ")
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let chain = Chain::from_urdf(URDF, "tool0")?;
    let q = Joints::from([0.3, -1.2, 1.6, -1.9, -1.5, 0.4]);
    let pose = chain.forward(&q);
    let at = pose.translation.vector * 1e3;
    println!("joints [deg]: {}", degrees(&q));
    println!(
        "tool0 in {} [mm]: {:.2} {:.2} {:.2}",
        chain.base(),
        at.x,
        at.y,
        at.z
    );

    let postures = chain.inverse(&pose, Turns::One);
    println!("{} postures [deg] put it there:", postures.len());
    for posture in &postures {
        let off = (chain.forward(posture).translation.vector - pose.translation.vector).norm();
        assert!(off < EXACT, "{off}");
        println!("  {}", degrees(posture));
    }
    let near = chain
        .inverse_near(&pose, &q)
        .ok_or("no posture near the first")?;
    assert!(near.zip(&q, |a, b| a - b).max_abs() < EXACT);

    let down = Twist {
        linear: -Vector3::z() * 5e-3,
        angular: Vector3::zeros(),
    };
    let step = chain.rates(&q, &down, &RateSettings::default());
    println!("5 mm/s straight down [deg/s]: {}", degrees(&step.rates));
    println!("dexterity {:.3}, limits {:?}", step.dexterity, step.limits);
    let (dt, left) = (1e-3, step.realised.linear - down.linear);
    let moved = chain
        .forward(&q.zip(&step.rates, |q, v| q + v * dt))
        .translation
        .vector;
    let speed = (moved - pose.translation.vector) / dt * 1e3;
    println!(
        "tool0 then moves at {:.3} {:.3} {:.3} mm/s",
        speed.x, speed.y, speed.z
    );
    assert!(left.norm() < EXACT && (speed.z + 5.0).abs() < 1e-3);
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}
