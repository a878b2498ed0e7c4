//! Nodes in processes of their own: this test binary, started again with a part to play.

use std::io::{BufRead, BufReader, Lines, Read};
use std::process::{ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use hal::telemetry::{LawReport, ModelReport, Phase, Telemetry, Tracking};
use hal::{
    ArmMode, CameraFrame, GrayImage, Joints, Overlay, Position, Stamp, StereoFrame, Transform,
    Twist,
};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rosbridge::bridge::{Bridge, BridgeOptions, CameraModel, Described, Frames, Rates};
use rosbridge::{Node, NodeError, NodeOptions, TimeBase};

use crate::master::{Master, Running};

const PART: &str = "ROSBRIDGE_TEST_PART";

/// A child that plays its part until its standard input closes.
pub(crate) struct Player {
    pub(crate) process: Running,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Player {
    /// Starts a part and waits until it says that it is ready.
    pub(crate) fn start(master: &Master, part: &str) -> Self {
        let mut player = Self::launch(part, |command| master.environment(command));
        assert_eq!(player.line(), "ready");
        player
    }

    pub(crate) fn launch(part: &str, prepare: impl FnOnce(&mut Command)) -> Self {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args([
                "--exact",
                "child::plays_its_part",
                "--nocapture",
                "--test-threads=1",
            ])
            .env(PART, part)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        prepare(&mut command);
        let mut child = command.spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        Self {
            process: Running(child),
            lines,
        }
    }

    /// The next line that the part says.
    pub(crate) fn line(&mut self) -> String {
        self.lines
            .by_ref()
            .map(Result::unwrap)
            .find_map(|line| line.strip_prefix("part: ").map(str::to_owned))
            .unwrap_or_else(|| "(ended)".to_owned())
    }

    /// Closes its standard input and waits for its end.
    pub(crate) fn end(mut self) {
        drop(self.process.0.stdin.take());
        assert!(self.process.0.wait().unwrap().success());
    }
}

pub(crate) fn say(text: &str) {
    println!("\npart: {text}");
}

pub(crate) fn node(name: &str) -> Result<Node, NodeError> {
    let origin = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap();
    let time = TimeBase::Wall { origin };
    Node::connect(&NodeOptions {
        name: name.to_owned(),
        network: false,
        time,
        domain: None,
    })
}

/// True once standard input has closed.
pub(crate) fn input_closes() -> Arc<std::sync::atomic::AtomicBool> {
    let closed = Arc::new(std::sync::atomic::AtomicBool::new(false));
    let seen = Arc::clone(&closed);
    std::thread::spawn(move || {
        let mut rest = Vec::new();
        let _ = std::io::stdin().read_to_end(&mut rest);
        seen.store(true, std::sync::atomic::Ordering::SeqCst);
    });
    closed
}

/// Does nothing in the parent; a child plays the part that its environment names.
#[test]
fn plays_its_part() {
    let Some(part) = std::env::var_os(PART) else {
        return;
    };
    match part.to_str().unwrap() {
        "bridge" => bridge(),
        "connect" => {
            let started = std::time::Instant::now();
            let error = node("lonely").map(drop).unwrap_err();
            say(&format!("{} s: {error}", started.elapsed().as_secs()));
        }
        "arm" => crate::arm::play_arm(),
        "controller" => crate::arm::play_controller(),
        other => panic!("no part {other}"),
    }
}

fn world_from_left_camera() -> Isometry3<f64> {
    let eye = Point3::new(0.75, 0.35, 0.2);
    // OpenCV's frame: z towards what is seen, y down.
    let forward = Point3::new(0.4, 0.0, 0.2) - eye;
    Isometry3::face_towards(&eye, &(eye + forward), &-Vector3::z())
}

fn frames() -> Frames {
    Frames {
        world_from_arm_base: Transform::identity(),
        described: Described::default(),
        world_from_left_camera: Transform::assume(world_from_left_camera()),
        left_from_right: None,
    }
}

/// Positions of the Viper's joints at which the needle points down, its tip at (0.4, 0, 0.25) m.
const JOINTS: [f64; 6] = [0.0, -1.462_349, 3.616_621, 0.0, 0.987_321, 0.0];

/// A straight needle above a target.
fn telemetry(step: u64, stamp: Stamp) -> Telemetry {
    let down = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
    let base = Isometry3::from_parts(Vector3::new(0.4, 0.0, 0.376).into(), down);
    let tip = base * Translation3::new(0.0, 0.0, 0.126);
    let needle = |i: u32| base * Point3::new(0.0, 0.0, 0.126 * f64::from(i) / 20.0);
    let target = world_from_left_camera().inverse() * Point3::new(0.41, 0.0, 0.17);
    Telemetry {
        step,
        stamp,
        image_stamp: Some(stamp),
        phase: Phase::Steering,
        tracking: Tracking::Tracked,
        arm_mode: ArmMode::Moving,
        joints: Joints::from(JOINTS),
        joint_rates: Joints::from([0.0; 6]),
        world_from_base: Transform::assume(base),
        world_from_tip: Transform::assume(tip),
        base_twist: Twist::zero(),
        measured_tip: None,
        target: Position::new(target),
        lateral_error: 0.00125,
        axial_distance: 0.08,
        depth: 0.0,
        law: LawReport::default(),
        model: ModelReport {
            shape: (0..=20).map(|i| needle(i).coords).collect(),
            stiffness: 22_200.0,
            ..ModelReport::default()
        },
        truth: None,
    }
}

fn images(sequence: u64, stamp: Stamp) -> StereoFrame {
    let frame = |shade| CameraFrame {
        stamp,
        sequence,
        image: GrayImage::filled(640, 480, shade).into(),
    };
    StereoFrame {
        left: frame(100),
        right: frame(200),
    }
}

/// A run on topics at 30 Hz with images; every request is accepted.
fn bridge() {
    let node = node("needle_steer").unwrap();
    let intrinsics = [1000.0, 1000.0, 319.5, 239.5];
    let model = CameraModel {
        width: 640,
        height: 480,
        intrinsics,
        distortion_model: "equidistant",
        distortion: vec![0.0; 4],
        shift: 0.0,
    };
    let options = BridgeOptions {
        joint_names: (1..=6).map(|i| format!("joint_{i}")).collect(),
        joint_states: true,
        frames: frames(),
        cameras: Some([model.clone(), model]),
        rates: Rates::default(),
    };
    let bridge = Bridge::new(&node, options).unwrap();
    let closed = input_closes();
    let started = std::time::Instant::now();
    say("ready");
    for step in 1.. {
        let stamp = Stamp::ZERO + started.elapsed();
        bridge.show(Arc::new(telemetry(step, stamp)));
        let pair = images(step, stamp);
        let curve_px = vec![[320.0, 20.0], [320.0, 240.0]];
        let target_px = Some([340.0, 380.0]);
        bridge.show_overlay(Overlay {
            image: pair.left.clone(),
            curve_px,
            target_px,
        });
        bridge.show_images(pair);
        while let Some(request) = bridge.poll() {
            say(&format!("{:?}", request.command));
            request.accept("as you wish");
        }
        if closed.load(std::sync::atomic::Ordering::SeqCst) {
            break;
        }
        std::thread::sleep(Duration::from_millis(33));
    }
    drop(bridge);
    node.shutdown();
}
