//! The Viper's driver on its controller's emulator keeps the contract of an arm.
//!
//! The 2018 program stands at the end of every segment, so that long ways take it many times
//! longer. The fault tests in `robots` cover both dialects.

use core::time::Duration;

use hal::{Arm, Joints, Stamp};
use robots::viper::driver::Core;
use robots::viper::emulator::EmulatorConfig;
use robots::viper::{Config, Dialect, Emulator, Lockstep, ViperArm};

use crate::arm_contract::{Harness, keeps_the_contract, start};

struct Emulated {
    arm: Option<ViperArm>,
    rig: Lockstep,
    now: Stamp,
    slowness: u32,
}

impl Emulated {
    fn new(dialect: Dialect, over_tcp: bool) -> Self {
        let core = Core::new(Config::viper("emulated", dialect)).unwrap();
        let emulator = Emulator::new(EmulatorConfig::viper(dialect, start()));
        let (arm, rig) = if over_tcp {
            Lockstep::over_tcp(core, emulator).unwrap()
        } else {
            Lockstep::in_memory(core, emulator)
        };
        let mut this = Self {
            arm: Some(arm),
            rig,
            now: Stamp::ZERO,
            slowness: if dialect == Dialect::Steer { 1 } else { 12 },
        };
        // Connecting and the first feedback take time; 20 periods.
        this.advance_to(Stamp::ZERO + Duration::from_millis(320));
        this
    }
}

impl Harness for Emulated {
    fn arm(&mut self) -> &mut dyn Arm {
        self.arm.as_mut().unwrap()
    }

    fn now(&self) -> Stamp {
        self.now
    }

    fn advance_to(&mut self, stamp: Stamp) {
        self.now = stamp;
        self.rig.advance_to(stamp);
    }

    fn true_joints(&self) -> Joints {
        self.rig.emulator().true_joints()
    }

    fn emergency_stop(&mut self, pressed: bool) {
        self.rig.emulator().turn(|knobs| {
            knobs.e_stop = pressed;
            // Releasing the button alone gives no power.
            knobs.powered = !pressed;
        });
    }

    fn drop_driver(&mut self) {
        self.arm = None;
    }

    fn slowness(&self) -> u32 {
        self.slowness
    }
}

#[test]
fn the_viper_keeps_the_contract_with_steer() {
    keeps_the_contract(|| Emulated::new(Dialect::Steer, false));
}

#[test]
fn the_viper_keeps_the_contract_over_sockets() {
    keeps_the_contract(|| Emulated::new(Dialect::Steer, true));
}

#[test]
fn the_viper_keeps_the_contract_with_the_2018_program() {
    keeps_the_contract(|| Emulated::new(Dialect::Adept2018, false));
}
