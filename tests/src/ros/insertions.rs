//! Whole insertions in lockstep over ROS, beside the same insertions in one process.

use std::sync::Arc;
use std::sync::mpsc::channel;

use hal::telemetry::Telemetry;
use hal::{Joints, Stamp};
use needle_steer::config::{Backend, Config, RosClock, SensorKind};
use needle_steer::controls::Controls;
use needle_steer::outcome::{Ended, Summary};
use needle_steer::rig::Rig;
use needle_steer::ros::{Link, emulate};
use needle_steer::run::{Observer, run};

use super::is_parent_of;
use crate::devices::{placed, through_a_guide};

/// Joint positions and commanded rates of every law step.
#[derive(Default)]
struct Trace(Vec<(Stamp, Joints, Joints)>);

impl Observer for Trace {
    fn step(&mut self, telemetry: &Telemetry) {
        self.0
            .push((telemetry.stamp, telemetry.joints, telemetry.joint_rates));
    }
}

fn in_process(config: &Config) -> (Summary, Trace) {
    let mut trace = Trace::default();
    let mut rig = Rig::new(config).unwrap();
    let summary = run(config, &mut rig, &mut trace, &Controls::default()).unwrap();
    (summary, trace)
}

fn over_ros(config: &Config) -> (Summary, Trace) {
    let mut config = config.clone();
    config.run.backend = Backend::Ros;
    config.ros.clock = RosClock::Simulated;
    let controls = Arc::new(Controls::default());
    let (is_ready, ready) = channel();
    let laboratory = std::thread::spawn({
        let (config, controls) = (config.clone(), Arc::clone(&controls));
        move || emulate(&config, &controls, || is_ready.send(()).unwrap()).unwrap()
    });
    ready.recv().unwrap();
    let link = Link::new(&config).unwrap().unwrap();
    let mut trace = Trace::default();
    let mut rig = Rig::build(&config, Some(&link)).unwrap();
    let summary = run(&config, &mut rig, &mut trace, &Controls::default()).unwrap();
    drop(rig);
    link.node.shutdown();
    controls.interrupt();
    laboratory.join().unwrap();
    (summary, trace)
}

/// Largest distance between two joint vectors, in units of f32's rounding.
fn apart(a: &Joints, b: &Joints) -> f64 {
    a.iter()
        .zip(b.iter())
        .map(|(a, b)| (a - b).abs() / (f64::from(f32::EPSILON) * a.abs().max(1.0)))
        .fold(0.0, f64::max)
}

#[test]
fn ten_insertions_over_ros_are_those_of_one_process() {
    if is_parent_of("ros::insertions::ten_insertions_over_ros_are_those_of_one_process") {
        return;
    }
    let shapes = (1..=10).map(|seed| (seed, SensorKind::Shape));
    let images = (1..=2).map(|seed| (seed, SensorKind::Images));
    for (seed, sensor) in shapes.chain(images) {
        let mut config = Config::default();
        config.run.seed = seed;
        config.run.sensor = sensor;
        let (here, trace_here) = in_process(&config);
        let (there, trace_there) = over_ros(&config);
        assert_eq!(here.ended, there.ended, "seed {seed}");
        let kinds = |summary: &Summary| -> Vec<_> {
            summary.events.iter().map(|event| event.kind).collect()
        };
        assert_eq!(kinds(&here), kinds(&there), "seed {seed}");
        let (a, b) = (here.true_error_mm.unwrap(), there.true_error_mm.unwrap());
        let mut worst = 0.0_f64;
        if seed == 1 {
            // The whole trace, step by step.
            assert_eq!(trace_here.0.len(), trace_there.0.len());
            for (here, there) in trace_here.0.iter().zip(&trace_there.0) {
                assert_eq!(here.0, there.0, "stamps");
                worst = worst
                    .max(apart(&here.1, &there.1))
                    .max(apart(&here.2, &there.2));
            }
        }
        println!(
            "{sensor:?}, seed {seed}: {a:.6} mm, {b:.6} mm over ROS; trace {worst} f32 roundings apart"
        );
        assert!((a - b).abs() < 0.02, "seed {seed}: {a} mm, {b} mm");
        assert!(worst <= 1.0, "seed {seed}: {worst} roundings");
    }
}

/// Joints that slide are on the topics what they are in one process.
#[test]
fn devices_insert_over_ros_as_in_one_process() {
    if is_parent_of("ros::insertions::devices_insert_over_ros_as_in_one_process") {
        return;
    }
    for config in [
        placed("stage", &["target.kind=shifted"]),
        placed("insertion_spin", &["target.kind=aligned"]),
        through_a_guide(&["target.kind=aligned"]),
    ] {
        let device = &config.arm.urdf;
        let (here, _) = in_process(&config);
        let (there, _) = over_ros(&config);
        assert_eq!(here.ended, Ended::TargetPassed, "{device}");
        assert_eq!(there.ended, Ended::TargetPassed, "{device}");
        let (a, b) = (here.true_error_mm.unwrap(), there.true_error_mm.unwrap());
        println!("{device}: {a:.6} mm, {b:.6} mm over ROS");
        assert!((a - b).abs() < 0.02, "{device}: {a} mm, {b} mm");
    }
}
