//! Driver and emulator in lockstep, with short words for what tests do.

use std::time::Duration;

use hal::{Arm, ArmMode, Error, FaultReason, Joints, RateCommand, Stamp};
use robots::viper::driver::Core;
use robots::viper::emulator::{EmulatorConfig, Entry};
use robots::viper::{Config, Dialect, Emulator, Lockstep, ViperArm};

pub(crate) const PERIOD: Duration = Duration::from_millis(16);

/// Away from limits and singularities; exact in single precision.
pub(crate) const HOME: [f64; 6] = [0.0, -0.75, 2.0, 0.0, 1.0, 0.0];

pub(crate) struct Bench {
    pub(crate) arm: Option<ViperArm>,
    pub(crate) rig: Lockstep,
    pub(crate) now: Stamp,
    pub(crate) sequence: u64,
}

impl Bench {
    pub(crate) fn new(dialect: Dialect) -> Self {
        let emulator = EmulatorConfig::viper(dialect, Joints::from(HOME));
        Self::with(Config::viper("emulated", dialect), emulator)
    }

    pub(crate) fn with(config: Config, emulator: EmulatorConfig) -> Self {
        let core = Core::new(config).unwrap();
        let (arm, rig) = Lockstep::in_memory(core, Emulator::new(emulator));
        Self {
            arm: Some(arm),
            rig,
            now: Stamp::ZERO,
            sequence: 0,
        }
    }

    /// Connected and enabled.
    pub(crate) fn enabled(dialect: Dialect) -> Self {
        let mut bench = Self::new(dialect);
        bench.rest(20);
        bench.arm().enable().unwrap();
        bench
    }

    /// Enabled and moving for half a second.
    pub(crate) fn moving(dialect: Dialect) -> Self {
        let mut bench = Self::enabled(dialect);
        bench.go(slow(), 30);
        assert_eq!(bench.mode(), ArmMode::Moving);
        bench
    }

    pub(crate) fn arm(&mut self) -> &mut ViperArm {
        self.arm.as_mut().unwrap()
    }

    pub(crate) fn emulator(&self) -> &Emulator {
        self.rig.emulator()
    }

    pub(crate) fn mode(&self) -> ArmMode {
        self.arm.as_ref().unwrap().monitor().mode()
    }

    pub(crate) fn reason(&self) -> Option<FaultReason> {
        match self.mode() {
            ArmMode::Faulted(reason) => Some(reason),
            _ => None,
        }
    }

    /// One period passes.
    pub(crate) fn tick(&mut self) {
        self.now = self.now + PERIOD;
        self.rig.advance_to(self.now);
    }

    /// Periods pass without a command.
    pub(crate) fn rest(&mut self, ticks: u32) {
        (0..ticks).for_each(|_| self.tick());
    }

    /// One command with the present time.
    pub(crate) fn command(&mut self, rates: [f64; 6]) -> Result<(), Error> {
        self.sequence += 1;
        let command = RateCommand {
            sequence: self.sequence,
            stamp: self.now,
            rates: Joints::from(rates),
        };
        self.arm().command(&command)
    }

    /// A command every period.
    pub(crate) fn go(&mut self, rates: [f64; 6], ticks: u32) {
        for _ in 0..ticks {
            self.command(rates).unwrap();
            self.tick();
        }
    }

    /// The same, whether or not the driver takes it.
    pub(crate) fn try_to_go(&mut self, rates: [f64; 6], ticks: u32) {
        for _ in 0..ticks {
            let _ = self.command(rates);
            self.tick();
        }
    }

    /// Travel of the truth since `from`: largest joint \[rad\].
    pub(crate) fn travel(&self, from: &Joints) -> f64 {
        self.truth().zip(from, |a, b| a - b).max_abs()
    }

    pub(crate) fn truth(&self) -> Joints {
        self.emulator().true_joints()
    }

    pub(crate) fn entries(&self) -> Vec<Entry> {
        self.emulator().journal().entries().cloned().collect()
    }

    /// The arm stands still for a second while a caller goes on commanding, and stays disabled
    /// until it is reset and enabled.
    pub(crate) fn assert_dead(&mut self) {
        let at = self.truth();
        self.try_to_go(slow(), 62);
        assert!(
            self.travel(&at) < 1e-12,
            "moved by {} rad",
            self.travel(&at)
        );
        let mode = self.mode();
        assert!(
            !matches!(mode, ArmMode::Enabled | ArmMode::Moving | ArmMode::Stopping),
            "{mode:?}"
        );
    }

    /// Reset and enable bring it back.
    pub(crate) fn assert_revives(&mut self) {
        self.rest(20);
        self.arm().reset().unwrap();
        assert_eq!(self.mode(), ArmMode::Connected);
        self.arm().enable().unwrap();
        let at = self.truth();
        self.go(slow(), 20);
        assert!(self.travel(&at) > 1e-4);
    }
}

/// About 5 mm/s at the needle.
pub(crate) fn slow() -> [f64; 6] {
    [0.01, 0.008, -0.008, 0.005, 0.01, 0.05]
}

/// Largest rate of [`slow`] over a period: one segment \[rad\].
pub(crate) const SEGMENT: f64 = 0.05 * 0.016;
