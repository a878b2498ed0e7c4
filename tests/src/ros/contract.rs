//! An arm behind ROS topics keeps the contract of an arm.

use core::time::Duration;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use hal::{Arm, Clock, Joints, Stamp};
use robots::arms::{NEEDLE_BASE, VIPER_S650};
use robots::kinematics::Chain;
use robots::sim::{Fault, SimSettings, SimulatedArm};
use rosbridge::arm::{RosArm, RosArmOptions};
use rosbridge::emulator::{ArmNode, LabNode, Seen};
use rosbridge::lockstep::Lockstep;
use rosbridge::{Node, NodeOptions, TimeBase};

use super::is_parent_of;
use crate::arm_contract::{Harness, keeps_the_contract, start};

fn node(name: &str, time: TimeBase) -> Node {
    Node::connect(&NodeOptions {
        name: name.to_owned(),
        network: false,
        time,
        domain: None,
    })
    .unwrap()
}

/// The simulated arm in a node, the driver in another.
struct OverRos {
    arm: Option<RosArm>,
    clock: Lockstep,
    node: Node,
    world: SimulatedArm,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl OverRos {
    fn new() -> Self {
        let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
        let world = SimulatedArm::new(&chain, &start(), SimSettings::default()).unwrap();
        let ended = Arc::new(AtomicBool::new(false));
        let thread = std::thread::spawn({
            let (world, ended) = (world.clone(), Arc::clone(&ended));
            move || serve(&world, &ended)
        });
        let node = node("controller", TimeBase::Remote);
        let description = world.driver().description().clone();
        let parts = Lockstep::open(&node, &RosArmOptions::new(description)).unwrap();
        Self {
            arm: Some(parts.arm),
            clock: parts.clock,
            node,
            world,
            ended,
            thread: Some(thread),
        }
    }
}

/// The arm's node.
fn serve(world: &SimulatedArm, ended: &AtomicBool) {
    let mut arm = world.driver();
    let node = node("arm", TimeBase::Simulated);
    let names = arm.description().joint_names.clone();
    let mut lab = LabNode::new(&node, ArmNode::new(&node, names, None).unwrap()).unwrap();
    lab.show(world.now(), &arm.state().unwrap(), &Seen::default());
    while !ended.load(Ordering::SeqCst) {
        let answer = lab.await_answer(&mut arm, Duration::from_millis(20));
        if let Some(until) = answer.unwrap() {
            world.advance_to(until);
            lab.show(world.now(), &arm.state().unwrap(), &Seen::default());
        }
    }
    drop(lab);
    node.shutdown();
}

impl Harness for OverRos {
    fn arm(&mut self) -> &mut dyn Arm {
        self.arm.as_mut().unwrap()
    }

    fn now(&self) -> Stamp {
        self.clock.now()
    }

    fn advance_to(&mut self, stamp: Stamp) {
        self.clock.wait_until(stamp);
        assert!(!self.clock.is_lost(), "the arm's node does not answer");
    }

    fn true_joints(&self) -> Joints {
        self.world.true_joints()
    }

    fn emergency_stop(&mut self, pressed: bool) {
        if pressed {
            self.world.inject(Fault::EmergencyStop);
        } else {
            self.world.clear(Fault::EmergencyStop);
            // The operator clears the fault at the robot.
            self.world.driver().reset().unwrap();
        }
    }

    fn drop_driver(&mut self) {
        self.arm = None;
    }
}

impl Drop for OverRos {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::SeqCst);
        let served = self.thread.take().map(JoinHandle::join);
        self.node.clone().shutdown();
        if !std::thread::panicking() {
            assert!(served.is_some_and(|result| result.is_ok()));
        }
    }
}

#[test]
fn an_arm_over_ros_keeps_the_contract() {
    if is_parent_of("ros::contract::an_arm_over_ros_keeps_the_contract") {
        return;
    }
    keeps_the_contract(OverRos::new);
}
