//! T17: the same trace from the simulator and from driver, wire and controller.

use hal::{Arm, ArmMode, Joints, RateCommand, Stamp};
use robots::sim::{SimSettings, SimulatedArm};
use robots::viper::driver::Core;
use robots::viper::emulator::EmulatorConfig;
use robots::viper::{Config, Dialect, Emulator, Lockstep, ViperArm, viper_limits};

use crate::bench::{Bench, HOME, PERIOD, slow};

#[test]
fn steer_and_2018_connect_enable_move_and_rest() {
    for dialect in [Dialect::Steer, Dialect::Adept2018] {
        let mut bench = Bench::enabled(dialect);
        assert_eq!(bench.mode(), ArmMode::Enabled);
        bench.go(slow(), 100);
        assert_eq!(
            bench.mode(),
            ArmMode::Moving,
            "{:?}",
            bench.arm().monitor().fault()
        );
        bench.go([0.0; 6], 40);
        assert_eq!(bench.mode(), ArmMode::Enabled, "{dialect:?}");
        bench.rest(40);
        assert_eq!(bench.mode(), ArmMode::Enabled, "{dialect:?}");
        let ordered = bench.arm().monitor().set_point().unwrap();
        assert!(bench.travel(&ordered) < 1e-6, "{dialect:?}");
        assert!(bench.travel(&Joints::from(HOME)) > 0.05, "{dialect:?}");
    }
}

/// Smooth rates with standstill, reversals and different frequencies per joint, within all
/// limits: the driver keeps half a degree from the ends of the joints, the simulator nothing.
fn rates(tick: u32) -> Joints {
    let t = f64::from(tick) * PERIOD.as_secs_f64();
    let envelope = (0.4 * t).sin().max(0.0);
    let mut rates = [0.0; 6];
    for (joint, rate) in (1_u32..).zip(&mut rates) {
        let joint = f64::from(joint);
        *rate = 0.07 * joint * envelope * (0.3 * joint * t).sin();
    }
    Joints::from(rates)
}

/// Commands `ticks` periods; true positions at every tick.
fn trace(arm: &mut dyn Arm, mut advance: impl FnMut(Stamp) -> Joints, ticks: u32) -> Vec<Joints> {
    let mut now = Stamp::ZERO;
    for _ in 0..20 {
        now = now + PERIOD;
        advance(now);
    }
    arm.enable().unwrap();
    let mut trace = Vec::new();
    for tick in 0..ticks {
        let command = RateCommand {
            sequence: u64::from(tick) + 1,
            stamp: now,
            rates: rates(tick),
        };
        arm.command(&command).unwrap();
        now = now + PERIOD;
        trace.push(advance(now));
    }
    trace
}

fn core() -> Core {
    Core::new(Config::viper("emulated", Dialect::Steer)).unwrap()
}

fn emulator() -> Emulator {
    Emulator::new(EmulatorConfig::viper(Dialect::Steer, Joints::from(HOME)))
}

fn driven((mut arm, mut rig): (ViperArm, Lockstep), ticks: u32) -> Vec<Joints> {
    let emulator = rig.emulator().clone();
    let advance = |now| {
        rig.advance_to(now);
        emulator.true_joints()
    };
    trace(&mut arm, advance, ticks)
}

/// A simulated arm that executes rates at once, as the `steer` controller does: the limits of
/// acceleration are kept by the rates.
fn simulated(ticks: u32) -> Vec<Joints> {
    let mut limits = viper_limits();
    for limit in &mut limits {
        (limit.acceleration, limit.jerk) = (1e5, 1e9);
    }
    let names = (1..=6).map(|joint| format!("joint_{joint}")).collect();
    let home = Joints::from(HOME);
    let arm = SimulatedArm::from_limits(names, &limits, &home, SimSettings::ideal()).unwrap();
    let advance = |now| {
        arm.advance_to(now);
        arm.true_joints()
    };
    trace(&mut arm.driver(), advance, ticks)
}

fn largest_difference(a: &[Joints], b: &[Joints]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| a.zip(b, |a, b| a - b).max_abs())
        .fold(0.0, f64::max)
}

#[test]
fn t17_simulator_and_driver_give_the_same_trace_in_lockstep() {
    let ticks = 2000;
    let memory = driven(Lockstep::in_memory(core(), emulator()), ticks);
    let simulated = simulated(ticks);
    let travel = memory
        .iter()
        .map(|q| q.zip(&Joints::from(HOME), |a, b| a - b).max_abs());
    assert!(travel.fold(0.0, f64::max) > 0.2);
    // Single precision on the wire: half a unit in the last place of 2..4 rad.
    let difference = largest_difference(&memory, &simulated);
    println!("simulator against driver: {difference:.2e} rad");
    assert!(difference <= 2.4e-7, "{difference} rad");
}

#[test]
fn t17_sockets_and_memory_give_the_same_trace_in_lockstep() {
    let ticks = 300;
    let memory = driven(Lockstep::in_memory(core(), emulator()), ticks);
    let sockets = driven(Lockstep::over_tcp(core(), emulator()).unwrap(), ticks);
    assert_eq!(largest_difference(&memory, &sockets), 0.0);
}
