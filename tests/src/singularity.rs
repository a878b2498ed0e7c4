//! Insertions that begin in a singularity of the arm, and away from it.

use hal::Joints;
use hal::telemetry::{Limit, Telemetry};
use needle_steer::config::{Config, SensorKind, TargetKind};
use needle_steer::controls::Controls;
use needle_steer::rig::{Misfit, Rig, RigBuildError};
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
fn a_start_in_a_singularity_is_refused_and_a_run_away_from_it_never_names_one() {
    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let threshold = RateSettings::default().threshold;
    let posture = |bend: f64| Joints::from([0.0, -1.2, 2.4, 0.0, bend, 0.0]);
    // The wrist, from both sides.
    for bend in [0.02, -0.02] {
        match Rig::new(&insertion_from(&chain, &posture(bend))) {
            Err(RigBuildError::Misfit(misfit @ Misfit::Singular { .. })) => {
                assert!(misfit.to_string().contains("check --suggest"), "{misfit}");
            }
            other => panic!("bend {bend}: {:?}", other.err()),
        }
    }
    let config = insertion_from(&chain, &posture(1.2));
    let mut rig = Rig::new(&config).unwrap();
    let mut steps = Steps::default();
    run(&config, &mut rig, &mut steps, &Controls::default()).unwrap();
    assert!(!steps.0.is_empty());
    for t in &steps.0 {
        assert!(!t.law.limits.contains(&Limit::Singularity));
        assert!(chain.dexterity(&t.joints, RateSettings::default().length) > threshold);
        for (rate, limit) in t.joint_rates.iter().zip(chain.limits()) {
            assert!(rate.is_finite() && rate.abs() <= limit.velocity);
        }
    }
}
