//! An arm of one's own behind a guard: it is told to turn at 60 degrees/s and never told to stop;
//! it keeps its speed, acceleration and jerk, and comes to rest before its end stop.
//!
//! `cargo run --release -p hal --example guarded_arm`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use core::time::Duration;

use hal::{
    Arm, ArmDescription, ArmMode, ArmState, Error, ErrorKind, Guard, Guarded, JointLimit, Joints,
    Limiter, RateCommand, Stamp,
};

/// A turntable that does at once whatever it is told.
struct Turntable {
    description: ArmDescription,
    state: ArmState,
}

impl Turntable {
    fn new(limit: JointLimit, period: Duration) -> Result<Self, Box<dyn std::error::Error>> {
        Ok(Self {
            description: ArmDescription {
                name: "turntable".to_owned(),
                joint_names: vec!["table".to_owned()],
                limits: vec![limit],
                period,
            },
            state: ArmState {
                stamp: Stamp::ZERO,
                positions: Joints::zeros(1)?,
                rates: Joints::zeros(1)?,
                mode: ArmMode::Connected,
            },
        })
    }
}

impl Arm for Turntable {
    fn description(&self) -> &ArmDescription {
        &self.description
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        Ok(self.state)
    }

    fn enable(&mut self) -> Result<(), Error> {
        self.state.mode = ArmMode::Enabled;
        Ok(())
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        if !matches!(self.state.mode, ArmMode::Enabled | ArmMode::Moving) {
            return Err(Error::new("turntable", ErrorKind::WrongMode));
        }
        let dt = self.description.period.as_secs_f64();
        let positions = self.state.positions.zip(&command.rates, |q, v| q + v * dt);
        self.state = ArmState {
            stamp: command.stamp + self.description.period,
            positions,
            rates: command.rates,
            mode: ArmMode::Moving,
        };
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Error> {
        self.state.rates = self.state.rates.zeroed();
        self.state.mode = ArmMode::Enabled;
        Ok(())
    }

    fn reset(&mut self) -> Result<(), Error> {
        self.state.mode = ArmMode::Connected;
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let limit = JointLimit {
        lower: -0.5,
        upper: 0.5,
        velocity: 0.6,
        acceleration: 2.0,
        jerk: 40.0,
    };
    let (period, hold) = (Duration::from_millis(16), Duration::from_millis(48));
    let guard = Guard::new(Limiter::new(&[limit], 0.0, hold)?);
    let mut arm = Guarded::new(Turntable::new(limit, period)?, guard)?;
    arm.enable()?;

    let wanted = Joints::from_slice(&[60_f64.to_radians()])?;
    println!("wanted: {:.1} degrees/s, for ever", wanted[0].to_degrees());
    println!(" time [s]  position [deg]  rate [deg/s]  limits that acted");
    for sequence in 1..=125 {
        let stamp = arm.state()?.stamp;
        arm.command(&RateCommand {
            sequence,
            stamp,
            rates: wanted,
        })?;
        let state = arm.state()?;
        assert!(state.rates[0] <= limit.velocity && state.positions[0] <= limit.upper);
        if sequence % 10 == 1 {
            println!(
                "{:9.3}  {:14.2}  {:12.2}  {:?}",
                state.stamp.as_secs(),
                state.positions[0].to_degrees(),
                state.rates[0].to_degrees(),
                arm.acted(),
            );
        }
    }
    let left = (limit.upper - arm.state()?.positions[0]).to_degrees();
    println!("at rest {left:.4} degrees before the end stop");
    assert!(left < 1.0, "the guard gives away range");
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}
