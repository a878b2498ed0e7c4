//! A law of one's own in the closed loop: the base pivots about the entry towards the target, and
//! the bevel does nothing.
//!
//! `cargo run --release -p needle-steer --example own_law`

use std::io::Write as _;

use hal::telemetry::{LawReport, SteeringMode};
use hybrid_control::view::{Decision, Law, View};
use nalgebra::{Vector2, Vector3};
use needle_steer::config;
use needle_steer::controls::Controls;
use needle_steer::rig::Rig;
use needle_steer::run::{Unobserved, run, run_with_law};

/// Pivots the base in proportion to the target's distance from the tip axis.
struct Lean {
    /// Speed of the pivot for a distance \[rad/(m s)\].
    gain: f64,
}

impl Law for Lean {
    fn name(&self) -> &'static str {
        "lean"
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        // Where the target lies across the tip axis, in World.
        let target = view.tip.locate(&view.target.position);
        let aside = view.tip.world_from_tip.rotation * Vector3::new(target.x, target.y, 0.0);
        // Deep in the tissue the base turns the tip no more: then it had better rest.
        let authority = view.estimator.pivot_authority().clamp(0.0, 1.0);
        let fastest = view.limits.tilt_speed_deg_s.to_radians();
        let omega =
            (view.base_axis().cross(&aside) * (self.gain * authority)).cap_magnitude(fastest);
        let mut twist = view.screw(view.insertion_speed, 0.0);
        let pivot = view.pivot(&omega);
        twist.linear += pivot.linear;
        twist.angular += pivot.angular;
        let report = LawReport {
            mode: SteeringMode::Manipulation,
            duty_cycle: f64::NAN,
            predicted_miss: Vector2::from_element(f64::NAN),
            shortfall: f64::NAN,
            ..LawReport::default()
        };
        Decision { twist, report }
    }

    fn reset(&mut self) {}
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let settings = ["target.offset_mm=3", "run.check_reach=false"].map(str::to_owned);
    let mut out = std::io::stdout().lock();
    let mut config = config::load(None, &settings)?;
    let controls = Controls::default();
    for name in ["none", "hybrid"] {
        config.run.law = name.into();
        let summary = run(&config, &mut Rig::new(&config)?, &mut Unobserved, &controls)?;
        writeln!(
            out,
            "{name:<8} {:.2} mm",
            summary.true_error_mm.unwrap_or(f64::NAN)
        )?;
    }
    let law = Box::new(Lean { gain: 20.0 });
    let mut rig = Rig::new(&config)?;
    let summary = run_with_law(&config, &mut rig, law, &mut Unobserved, &controls)?;
    writeln!(
        out,
        "lean     {:.2} mm",
        summary.true_error_mm.unwrap_or(f64::NAN)
    )?;
    Ok(())
}
