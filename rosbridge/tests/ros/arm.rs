//! An arm as one process and its controller as another.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use hal::{
    Arm, ArmDescription, ArmMode, ArmState, Error, ErrorKind, FaultReason, JointLimit, Joints,
    RateCommand, Stamp, StereoCamera,
};
use rosbridge::arm::{RosArm, RosArmOptions};
use rosbridge::cameras::{RosCameras, RosCamerasOptions};
use rosbridge::emulator::ArmNode;

use crate::child::{Player, input_closes, node, say};
use crate::master::Master;

const PERIOD: Duration = Duration::from_millis(16);

fn description() -> ArmDescription {
    let limit = JointLimit {
        lower: -3.0,
        upper: 3.0,
        velocity: 2.0,
        acceleration: 20.0,
        jerk: 2000.0,
    };
    ArmDescription {
        name: "ideal".to_owned(),
        joint_names: (1..=6).map(|i| format!("joint_{i}")).collect(),
        limits: vec![limit; 6],
        period: PERIOD,
    }
}

/// An arm that does exactly what it is told.
struct Ideal {
    description: ArmDescription,
    state: ArmState,
}

impl Ideal {
    fn advance(&mut self, now: Stamp) {
        let dt = now.secs_since(self.state.stamp);
        self.state.positions = self
            .state
            .positions
            .zip(&self.state.rates, |q, v| q + v * dt);
        self.state.stamp = now;
    }
}

impl Arm for Ideal {
    fn description(&self) -> &ArmDescription {
        &self.description
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        Ok(self.state)
    }

    fn enable(&mut self) -> Result<(), Error> {
        if self.state.mode != ArmMode::Connected {
            return Err(Error::new("ideal", ErrorKind::WrongMode));
        }
        self.state.mode = ArmMode::Enabled;
        Ok(())
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        self.state.mode = ArmMode::Moving;
        self.state.rates = command.rates;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Error> {
        self.state.rates = self.state.rates.zeroed();
        self.state.mode = ArmMode::Enabled;
        Ok(())
    }

    fn reset(&mut self) -> Result<(), Error> {
        Ok(())
    }
}

/// The arm's process; sends images, too.
pub(crate) fn play_arm() {
    let node = node("arm").unwrap();
    let description = description();
    let mut topics =
        ArmNode::new(&node, description.joint_names.clone(), Some([None, None])).unwrap();
    let state = ArmState {
        stamp: Stamp::ZERO,
        positions: Joints::from([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
        rates: Joints::from([0.0; 6]),
        mode: ArmMode::Connected,
    };
    let mut arm = Ideal { description, state };
    let closed = input_closes();
    let started = Instant::now();
    say("ready");
    for i in 0.. {
        let now = Stamp::ZERO + started.elapsed();
        arm.advance(now);
        topics.step(&mut arm, now).unwrap();
        if i % 4 == 0 {
            let image = hal::CameraFrame {
                stamp: now,
                sequence: i,
                image: hal::GrayImage::filled(32, 24, 9).into(),
            };
            topics.show_images(&hal::StereoFrame {
                left: image.clone(),
                right: image,
            });
        }
        if closed.load(Ordering::SeqCst) {
            break;
        }
        std::thread::sleep(Duration::from_millis(8));
    }
    node.shutdown();
}

/// The controller's process: moves joint 1, stops, moves again until the arm is gone.
pub(crate) fn play_controller() {
    let node = node("controller").unwrap();
    let mut cameras = RosCameras::new(&node, RosCamerasOptions::default()).unwrap();
    let mut arm = RosArm::new(&node, RosArmOptions::new(description())).unwrap();
    let started = Instant::now();
    while arm.state().is_err() {
        assert!(started.elapsed() < Duration::from_secs(10), "no feedback");
        std::thread::sleep(Duration::from_millis(5));
    }
    let clock = node.clone();
    let before = arm.state().unwrap();
    assert_eq!(before.mode, ArmMode::Connected);
    arm.enable().unwrap();
    let mut sequence = 0;
    let mut drive = |arm: &mut RosArm, seconds: f64| {
        let end = Instant::now() + Duration::from_secs_f64(seconds);
        while Instant::now() < end {
            sequence += 1;
            let mut rates = Joints::from([0.0; 6]);
            rates[0] = 0.2;
            let command = RateCommand {
                sequence,
                stamp: clock.now(),
                rates,
            };
            if let Err(error) = arm.command(&command) {
                return error.to_string();
            }
            std::thread::sleep(PERIOD);
        }
        String::new()
    };
    assert_eq!(drive(&mut arm, 1.5), "");
    arm.stop().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    let after = arm.state().unwrap();
    assert_eq!(after.mode, ArmMode::Enabled);
    let moved = after.positions.zip(&before.positions, |a, b| a - b);
    say(&format!("moved {:?}", moved.to_vec()));
    std::thread::sleep(Duration::from_millis(300));
    let rest = arm.state().unwrap();
    say(&format!(
        "rest {:?}",
        rest.positions.zip(&after.positions, |a, b| a - b).max_abs()
    ));
    let pair = cameras.poll().unwrap().unwrap();
    say(&format!(
        "pair {:?} {}",
        pair.left.image,
        pair.left == pair.right
    ));
    say("moving");
    let refused = drive(&mut arm, 30.0);
    say(&refused);
    let mode = ArmMode::Faulted(FaultReason::StaleFeedback);
    say(&format!(
        "{}",
        arm.state().is_err() && format!("{arm:?}").contains(&format!("{mode:?}"))
    ));
    drop(arm);
    drop(clock);
    node.shutdown();
}

#[test]
fn a_controller_moves_an_arm_over_ros_and_faults_when_it_is_gone() {
    let Some(master) = Master::start() else {
        return;
    };
    let arm = Player::start(&master, "arm");
    let mut controller = Player::launch("controller", |command| master.environment(command));
    let moved = controller.line();
    let numbers: Vec<f64> = moved
        .trim_start_matches("moved [")
        .trim_end_matches(']')
        .split(", ")
        .map(|number| number.parse().unwrap())
        .collect();
    // 0.2 rad/s for 1.5 s; ramps and the start-up of the stream cost a little.
    assert!((0.2..0.36).contains(&numbers[0]), "{moved}");
    assert!(numbers[1..].iter().all(|&x| x == 0.0), "{moved}");
    assert_eq!(controller.line(), "rest 0.0");
    assert_eq!(controller.line(), "pair GrayImage 32 x 24 true");
    assert_eq!(controller.line(), "moving");
    std::thread::sleep(Duration::from_millis(300));
    drop(arm);
    let refused = controller.line();
    assert!(refused.contains("faulted"), "{refused}");
    assert_eq!(controller.line(), "true");
    controller.end();
}

/// When the controller dies, the arm comes to rest by itself.
#[test]
fn an_arm_stops_when_its_controller_dies() {
    let Some(master) = Master::start() else {
        return;
    };
    let _arm = Player::start(&master, "arm");
    let mut controller = Player::launch("controller", |command| master.environment(command));
    loop {
        let line = controller.line();
        assert_ne!(line, "(ended)");
        if line == "moving" {
            break;
        }
    }
    std::thread::sleep(Duration::from_millis(500));
    drop(controller);
    std::thread::sleep(Duration::from_millis(500));
    let position = || {
        master.output(
            20,
            "rostopic",
            &["echo", "-n", "1", "/joint_states/position"],
        )
    };
    let (first, second) = (position(), position());
    assert!(
        first.starts_with("(0.") || first.starts_with("[0."),
        "{first}"
    );
    assert_eq!(first, second);
}
