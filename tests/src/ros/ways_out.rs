//! The kinds of stop of `ways_out` with the arm in another node.

use std::sync::Arc;
use std::sync::mpsc::channel;

use needle_steer::config::{Backend, RosClock};
use needle_steer::controls::Controls;
use needle_steer::rig::Rig;
use needle_steer::ros::{Link, Watchdog, serve};

use super::is_parent_of;
use crate::ways_out::{Machine, config_of, each, forget, in_lockstep, stop_and_withdraw};

#[test]
fn after_every_kind_of_stop_the_needle_comes_out_over_ros() {
    if is_parent_of("ros::ways_out::after_every_kind_of_stop_the_needle_comes_out_over_ros") {
        return;
    }
    each(in_lockstep(), |kind| {
        let mut config = config_of(kind, Backend::Ros);
        config.ros.clock = RosClock::Simulated;
        let controls = Arc::new(Controls::default());
        let (give, arm) = channel();
        let laboratory = std::thread::spawn({
            let (config, controls) = (config.clone(), Arc::clone(&controls));
            move || {
                serve(&config, Watchdog::Stops, &controls, |arm, _| {
                    give.send(arm.clone()).unwrap();
                })
                .unwrap();
            }
        });
        let machine = Machine::Laboratory(arm.recv().unwrap());
        let link = Link::new(&config).unwrap().unwrap();
        let rig = Rig::build(&config, Some(&link)).unwrap();
        let log = stop_and_withdraw(kind, &config, rig, &machine);
        forget(&log);
        link.node.shutdown();
        controls.interrupt();
        laboratory.join().unwrap();
    });
}
