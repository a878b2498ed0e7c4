//! A whole insertion with the arm in and near a singularity: what the telemetry says.

use hal::Joints;
use hal::telemetry::{Limit, Telemetry};
use needle_steer::config::{Config, SensorKind, TargetKind};
use needle_steer::controls::Controls;
use needle_steer::rig::Rig;
use needle_steer::run::{Observer, run};
use robots::arms::{NEEDLE_BASE, VIPER_S650};
use robots::kinematics::{Chain, RateSettings};

#[derive(Default)]
struct Steps(Vec<Telemetry>);

impl Observer for Steps {
    fn step(&mut self, telemetry: &Telemetry) {
        self.0.push(telemetry.clone());
    }
}

/// An uncontrolled insertion of 20 mm that begins with the joints at `q`: the arm's base stands
/// where it has to for that.
fn insertion_from(chain: &Chain, q: &Joints) -> Config {
    let mut config = Config::default();
    config.run.phantom = "ideal".into();
    config.run.law = "none".into();
    config.run.sensor = SensorKind::Shape;
    config.target.kind = TargetKind::Aligned;
    config.target.depth_mm = 20.0;
    let world_from_arm = config.world_from_start_base() * chain.forward(q).inverse();
    let (roll, pitch, yaw) = world_from_arm.rotation.euler_angles();
    config.arm.base_mm = (world_from_arm.translation.vector * 1e3).into();
    config.arm.base_rpy_deg = [roll, pitch, yaw].map(f64::to_degrees);
    config
}

#[test]
fn the_telemetry_of_a_run_names_the_singularity_and_only_it() {
    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let threshold = RateSettings::default().threshold;
    // The wrist, from both sides, and a posture away from everything.
    for (bend, singular) in [(0.02, true), (-0.02, true), (0.9, false)] {
        let q = Joints::from([0.0, -1.2, 2.4, 0.0, bend, 0.0]);
        let config = insertion_from(&chain, &q);
        let mut rig = Rig::new(&config).unwrap();
        let mut steps = Steps::default();
        let controls = Controls::default();
        let summary = run(&config, &mut rig, &mut steps, &controls).unwrap();
        let said = |t: &&Telemetry| t.law.limits.contains(&Limit::Singularity);
        let count = steps.0.iter().filter(said).count();
        let least = steps
            .0
            .iter()
            .map(|t| chain.dexterity(&t.joints, RateSettings::default().length))
            .fold(f64::INFINITY, f64::min);
        println!(
            "bend {bend}: {:?}, said {count} of {}, least dexterity {least:.1e}",
            summary.ended,
            steps.0.len()
        );
        for t in &steps.0 {
            let dexterity = chain.dexterity(&t.joints, RateSettings::default().length);
            assert_eq!(
                said(&t),
                dexterity < threshold,
                "{dexterity} {:?}",
                t.law.limits
            );
            for (rate, limit) in t.joint_rates.iter().zip(chain.limits()) {
                assert!(rate.is_finite() && rate.abs() <= limit.velocity);
            }
            // What a report or a log reads back says the same.
            let text = serde_json::to_string(&t.law.limits).unwrap();
            assert_eq!(text.contains("Singularity"), said(&t));
        }
        assert_eq!(count > 0, singular, "bend {bend}: {count}, {least:e}");
    }
}
