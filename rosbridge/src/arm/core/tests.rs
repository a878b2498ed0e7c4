use hal::JointLimit;

use super::*;

const PERIOD: Duration = Duration::from_millis(16);

fn description() -> ArmDescription {
    let limit = JointLimit {
        lower: -2.0,
        upper: 2.0,
        velocity: 1.0,
        acceleration: 20.0,
        jerk: 2000.0,
    };
    ArmDescription {
        name: "arm".to_owned(),
        joint_names: vec!["a".to_owned(), "b".to_owned()],
        limits: vec![limit; 2],
        period: PERIOD,
    }
}

fn joints(a: f64, b: f64) -> Joints {
    Joints::from_slice(&[a, b]).unwrap()
}

/// An arm that executes exactly what it is sent, and its driver.
struct Bench {
    core: Core,
    now: Stamp,
    q: Joints,
    sequence: u64,
    /// How much of each rate it executes.
    obedience: f64,
    silent: bool,
}

impl Bench {
    fn new() -> Self {
        let core = Core::new(&description(), ArmTiming::default(), 0.05).unwrap();
        let now = Stamp::from_secs(1.0);
        Self {
            core,
            now,
            q: joints(0.1, 0.2),
            sequence: 0,
            obedience: 1.0,
            silent: false,
        }
    }

    fn enabled() -> Self {
        let mut bench = Self::new();
        bench.step();
        bench.core.enable(bench.now).unwrap();
        bench
    }

    fn step(&mut self) -> Option<Joints> {
        self.now = self.now + PERIOD;
        if !self.silent {
            self.core.feedback(self.now, self.now, self.q, None);
        }
        let rates = self.core.tick(self.now);
        if let Some(rates) = rates {
            let dt = PERIOD.as_secs_f64() * self.obedience;
            self.q = self.q.zip(&rates, |q, rate| q + rate * dt);
        }
        rates
    }

    fn command(&mut self, rates: Joints) -> Result<(), Refused> {
        self.sequence += 1;
        let command = RateCommand {
            sequence: self.sequence,
            stamp: self.now,
            rates,
        };
        self.core.command(self.now, &command)
    }

    fn mode(&self) -> ArmMode {
        self.core.mode
    }
}

#[test]
fn moves_at_the_commanded_rate_and_stops() {
    let mut bench = Bench::enabled();
    for _ in 0..60 {
        bench.command(joints(0.2, -0.1)).unwrap();
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Moving);
    assert_eq!(bench.step().unwrap(), joints(0.2, -0.1));
    let state = bench.core.state(bench.now).unwrap();
    assert!(
        (state.rates[0] - 0.2).abs() < 1e-12,
        "rates are differences of positions"
    );
    bench.core.stop();
    assert_eq!(bench.mode(), ArmMode::Stopping);
    assert_eq!(
        bench.command(joints(0.1, 0.1)).unwrap_err().kind(),
        ErrorKind::WrongMode
    );
    for _ in 0..10 {
        bench.step();
    }
    assert_eq!(
        (bench.mode(), bench.core.is_rest()),
        (ArmMode::Enabled, true)
    );
}

#[test]
fn before_feedback_there_is_no_arm() {
    let mut bench = Bench::new();
    assert_eq!(bench.core.state(bench.now), Err(Refused::NoFeedback));
    assert_eq!(
        bench.core.enable(bench.now).unwrap_err().kind(),
        ErrorKind::WrongMode
    );
    bench.core.stop();
    assert!(bench.core.tick(bench.now).is_none());
    bench.step();
    assert_eq!(bench.mode(), ArmMode::Connected);
    assert_eq!(
        bench.command(joints(0.0, 0.0)).unwrap_err().kind(),
        ErrorKind::WrongMode
    );
    assert!(
        bench.step().is_none(),
        "nothing is sent before it is enabled"
    );
}

#[test]
fn bad_commands_are_refused_and_change_nothing_but_non_finite_ones_fault() {
    let mut bench = Bench::enabled();
    bench.command(joints(0.1, 0.0)).unwrap();
    let repeated = RateCommand {
        sequence: 1,
        stamp: bench.now,
        rates: joints(0.5, 0.5),
    };
    assert_eq!(
        bench.core.command(bench.now, &repeated),
        Err(Refused::Sequence {
            sequence: 1,
            last: 1
        })
    );
    let old = bench.now - Duration::from_millis(101);
    let late = RateCommand {
        sequence: 2,
        stamp: old,
        rates: joints(0.5, 0.5),
    };
    assert_eq!(
        bench.core.command(bench.now, &late),
        Err(Refused::Late { age_ms: 101 })
    );
    let large = Joints::from([0.0; 6]);
    assert_eq!(
        bench.command(large),
        Err(Refused::Size {
            found: 6,
            expected: 2
        })
    );
    for _ in 0..2 {
        bench.step();
    }
    assert!(bench.step().unwrap()[0] <= 0.1);
    assert_eq!(
        bench.command(joints(f64::NAN, 0.0)),
        Err(Refused::NonFinite)
    );
    assert_eq!(
        bench.mode(),
        ArmMode::Faulted(FaultReason::NonFiniteCommand)
    );
    assert_eq!(
        bench.command(joints(0.0, 0.0)).unwrap_err().kind(),
        ErrorKind::Faulted
    );
    assert_eq!(
        bench.core.enable(bench.now).unwrap_err().kind(),
        ErrorKind::Faulted
    );
}

#[test]
fn silence_of_the_controller_ramps_to_rest_and_then_faults() {
    let mut bench = Bench::enabled();
    for _ in 0..30 {
        bench.command(joints(0.3, 0.0)).unwrap();
        bench.step();
    }
    let mut last = 0.3;
    for _ in 0..11 {
        let rate = bench.step().unwrap()[0];
        assert!(rate <= last);
        last = rate;
    }
    assert!(bench.core.is_rest());
    bench.step();
    assert_eq!(bench.mode(), ArmMode::Faulted(FaultReason::StaleCommand));
    assert!(bench.step().is_none(), "a faulted arm at rest is not ours");
    bench.core.reset(bench.now).unwrap();
    assert_eq!(bench.mode(), ArmMode::Connected);
    bench.core.enable(bench.now).unwrap();
}

#[test]
fn a_zero_command_may_grow_old() {
    let mut bench = Bench::enabled();
    bench.command(joints(0.0, 0.0)).unwrap();
    for _ in 0..50 {
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Enabled);
}

#[test]
fn silence_of_the_robot_faults_and_reset_waits_for_its_return() {
    let mut bench = Bench::enabled();
    bench.command(joints(0.3, 0.0)).unwrap();
    bench.silent = true;
    for _ in 0..8 {
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Faulted(FaultReason::StaleFeedback));
    assert!(matches!(
        bench.core.state(bench.now),
        Err(Refused::StaleFeedback { .. })
    ));
    assert!(bench.core.reset(bench.now).is_err());
    bench.silent = false;
    for _ in 0..20 {
        bench.step();
    }
    bench.core.reset(bench.now).unwrap();
    assert_eq!(bench.mode(), ArmMode::Connected);
}

#[test]
fn a_robot_that_does_not_follow_faults() {
    let mut bench = Bench::enabled();
    bench.obedience = 0.0;
    for _ in 0..40 {
        let _ = bench.command(joints(0.3, 0.0));
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Faulted(FaultReason::TrackingError));
}

#[test]
fn limits_hold_and_keep_the_direction() {
    let mut bench = Bench::enabled();
    for _ in 0..400 {
        let _ = bench.command(joints(4.0, 2.0));
        if let Some(rates) = bench.step() {
            assert!(rates.max_abs() <= 1.0 + 1e-12);
            assert!((rates[0] - 2.0 * rates[1]).abs() < 1e-9, "{rates:?}");
        }
        assert!(bench.q[0] <= 2.0 + 1e-9);
    }
    assert!(bench.q[0] > 1.9, "{:?}", bench.q);
}

#[test]
fn closing_comes_to_rest() {
    let mut bench = Bench::enabled();
    for _ in 0..30 {
        bench.command(joints(0.3, 0.0)).unwrap();
        bench.step();
    }
    bench.core.close();
    for _ in 0..10 {
        bench.step();
    }
    assert!(bench.core.is_closed() && bench.core.is_rest());
}
