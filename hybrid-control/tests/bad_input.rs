//! Whatever a law is shown, it answers with finite speeds within the limits, and with standstill
//! where a number is not finite.

use hal::Stamp;
use hybrid_control::{
    Entry, Estimator, EstimatorSettings, LAW_NAMES, LawSettings, Limits, RollTravel, Springs,
    Start, Target, Tip, View, law_by_name,
};
use nalgebra::{Isometry3, Matrix6, Point3, RowVector6, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

fn start() -> (Start, Entry) {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI);
    let entry = Entry {
        point: Point3::new(0.4, 0.0, 0.25),
        inward: -Vector3::z_axis(),
    };
    let world_from_base = Isometry3::from_parts(Translation3::new(0.4, 0.0, 0.366), down);
    let start = Start {
        length: 0.126,
        bending_stiffness: 1.836e-3,
        cutting_edge: 1.57e-3,
        guide_gap: None,
        tip_sensor: None,
        advance_by_tip: false,
        entry,
        world_from_base,
    };
    (start, entry)
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn twists_stay_within_the_limits(
        law in 0..LAW_NAMES.len(), x in prop::collection::vec(-1.0_f64..1.0, 64),
        travel in 0.0_f64..7.0, poison in 0..12_usize,
    ) {
        let (start, entry) = start();
        let mut estimator = Estimator::new(&EstimatorSettings::default(), &start).unwrap();
        let mut base = start.world_from_base;
        base.rotation = UnitQuaternion::from_scaled_axis(Vector3::new(x[0], x[1], 3.0 * x[2]) * 0.2)
            * base.rotation;
        let tip = estimator.predict(Stamp::from_secs(1.0), &base);
        let mut target = entry.point + Vector3::new(0.02 * x[3], 0.02 * x[4], -0.09 + 0.03 * x[5]);
        let mut springs = Springs {
            world_from_tip: tip.world_from_tip,
            j_tip_base: Matrix6::from_iterator(x[6..42].iter().copied()),
            mean_stretch: x[42].abs() * 1e-3,
            j_mean_stretch: RowVector6::from_iterator(x[43..49].iter().copied()),
            entry_stretch: x[49].abs() * 1e-3,
            entry_force: 0.1,
        };
        let mut tip = Tip { position_sigma: 5e-5, ..tip };
        match poison {
            0 => target.x = f64::NAN,
            1 => springs.j_tip_base[(2, 3)] = f64::INFINITY,
            2 => tip.world_from_tip.translation.vector.y = f64::NAN,
            3 => base.translation.vector.z = f64::NEG_INFINITY,
            _ => {}
        }
        let limits = Limits::default();
        let view = View {
            time: Stamp::from_secs(1.0),
            dt: 1.0 / 30.0,
            tip,
            target: Target { position: target, velocity: Vector3::zeros() },
            entry,
            depth: 0.01,
            world_from_base: base,
            springs: Some(springs),
            shape: &[],
            estimator: &estimator,
            roll_travel: RollTravel { positive: travel, negative: 7.0 - travel },
            freedom: hybrid_control::Freedom::full(),
            limits: &limits,
            insertion_speed: 1e-3,
        };
        let mut law = law_by_name(LAW_NAMES[law], &LawSettings::default()).unwrap();
        let twist = law.decide(&view).twist;
        prop_assert!(twist.is_finite());
        if poison < 4 {
            prop_assert_eq!(twist, hal::Twist::zero());
            return Ok(());
        }
        let axis = base.rotation * Vector3::z();
        let (along, spin) = (axis.dot(&twist.linear), axis.dot(&twist.angular));
        let slack = 1.0 + 1e-6;
        prop_assert!(along.abs() <= limits.insertion_speed_mm_s * 1e-3 * slack);
        prop_assert!((twist.linear - axis * along).norm() <= limits.lateral_speed_mm_s * 1e-3 * slack);
        prop_assert!((twist.angular - axis * spin).norm() <= limits.tilt_speed_deg_s.to_radians() * slack);
        prop_assert!(spin.abs() <= limits.spin_speed_deg_s.to_radians() * slack);
        prop_assert!(view.roll_travel.allows(spin * view.dt));
    }
}
