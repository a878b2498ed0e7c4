use hal::{ErrorKind, JointLimit};

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
    /// Motion of the first joint that nobody commands [rad/s].
    creep: f64,
    /// How far the feedback's stamps are behind [s].
    behind: f64,
}

impl Bench {
    fn new() -> Self {
        let core = Core::new(
            &description(),
            ArmTiming::default(),
            ArmTolerances::default(),
        )
        .unwrap();
        let now = Stamp::from_secs(1.0);
        Self {
            core,
            now,
            q: joints(0.1, 0.2),
            sequence: 0,
            obedience: 1.0,
            silent: false,
            creep: 0.0,
            behind: 0.0,
        }
    }

    fn enabled() -> Self {
        Self::enabled_while(0.0)
    }

    /// An arm whose first joint moves meanwhile.
    fn enabled_while(creep: f64) -> Self {
        let mut bench = Self::new();
        bench.creep = creep;
        bench.step();
        bench.core.enable(bench.now).unwrap();
        bench
    }

    fn reading(&self) -> Reading {
        Reading {
            stamp: self.now,
            behind: self.behind,
            positions: self.q,
            rates: None,
        }
    }

    fn step(&mut self) -> Option<Joints> {
        self.now = self.now + PERIOD;
        if !self.silent {
            self.core.feedback(self.now, self.reading());
        }
        let rates = self.core.tick(self.now);
        self.q[0] += self.creep * PERIOD.as_secs_f64();
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

#[test]
fn an_arm_taken_over_in_motion_may_brake_and_must() {
    for brakes in [true, false] {
        let mut bench = Bench::enabled_while(0.4);
        for period in 0..120 {
            if brakes && period == 10 {
                bench.creep = 0.0;
            }
            bench.step();
        }
        let expected = if brakes {
            ArmMode::Enabled
        } else {
            ArmMode::Faulted(FaultReason::UncommandedMotion)
        };
        assert_eq!(bench.mode(), expected);
    }
}

#[test]
fn an_arm_that_creeps_while_nothing_is_commanded_faults_within_millimetres() {
    for paused in [false, true] {
        let mut bench = Bench::enabled();
        let mut sequence = 0;
        let mut run = |bench: &mut Bench, periods: usize| {
            for _ in 0..periods {
                if paused {
                    let rates = joints(if sequence < 60 { 0.01 } else { 0.0 }, 0.0);
                    let _ = bench.command(rates);
                    sequence += 1;
                }
                bench.step();
                if let ArmMode::Faulted(_) = bench.mode() {
                    return;
                }
            }
        };
        run(&mut bench, 120);
        assert_eq!(bench.mode(), ArmMode::Enabled);
        let before = bench.q[0];
        // 14 mm/s at half a metre.
        bench.creep = 0.028;
        run(&mut bench, 120);
        assert_eq!(
            bench.mode(),
            ArmMode::Faulted(FaultReason::UncommandedMotion)
        );
        let moved_mm = 500.0 * (bench.q[0] - before);
        assert!(moved_mm < 2.5, "noticed after {moved_mm} mm");
        let words = bench.core.explanation().unwrap();
        assert!(words.contains("joint 1 moved by"), "{words}");
    }
}

#[test]
fn feedback_of_another_clock_is_no_feedback_and_the_skew_is_named() {
    for behind in [10.0, 0.15, -0.06, -3600.0] {
        let mut bench = Bench::new();
        bench.behind = behind;
        bench.step();
        assert_eq!(
            bench.core.state(bench.now),
            Err(Refused::Skew { behind_s: behind })
        );
        bench.behind = 0.0;
        bench.step();
        bench.core.enable(bench.now).unwrap();
        bench.behind = behind;
        for _ in 0..8 {
            bench.step();
        }
        assert_eq!(bench.mode(), ArmMode::Faulted(FaultReason::ClockSkew));
        let words = bench.core.explanation().unwrap();
        let figure = format!("{:.3} s", behind.abs());
        assert!(words.contains(&figure), "{words}");
    }
}

#[test]
fn a_repeated_reading_is_not_a_fresh_one() {
    let mut bench = Bench::enabled();
    let same = bench.reading();
    for _ in 0..8 {
        bench.now = bench.now + PERIOD;
        bench.core.feedback(bench.now, same);
        bench.core.tick(bench.now);
    }
    assert_eq!(bench.mode(), ArmMode::Faulted(FaultReason::StaleFeedback));
}

#[test]
fn commands_from_the_future_are_refused() {
    let mut bench = Bench::enabled();
    let command = RateCommand {
        sequence: 1,
        stamp: bench.now + Duration::from_millis(49),
        rates: joints(0.1, 0.0),
    };
    assert_eq!(
        bench.core.command(bench.now, &command),
        Err(Refused::Ahead { ahead_ms: 49 })
    );
    assert_eq!(bench.mode(), ArmMode::Enabled);
}

#[test]
fn a_second_controller_is_refused_at_the_start_and_faults_on_the_way() {
    let mut bench = Bench::new();
    bench.step();
    bench.core.others("/velocities", vec!["/other".to_owned()]);
    let refused = bench.core.enable(bench.now).unwrap_err().to_string();
    assert!(
        refused.contains("/velocities") && refused.contains("/other"),
        "{refused}"
    );
    bench.core.others("/velocities", Vec::new());
    bench.core.enable(bench.now).unwrap();
    bench.core.others("/velocities", vec!["/other".to_owned()]);
    bench.step();
    assert_eq!(
        bench.mode(),
        ArmMode::Faulted(FaultReason::SecondController)
    );
}

#[test]
fn a_node_that_is_cut_off_faults_its_arm_for_good() {
    let mut bench = Bench::enabled();
    bench.command(joints(0.3, 0.0)).unwrap();
    bench.step();
    bench.core.cut_off("the node was shut down");
    for _ in 0..10 {
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Faulted(FaultReason::ConnectionLost));
    assert!(bench.core.is_rest());
    let refused = bench.core.reset(bench.now).unwrap_err().to_string();
    assert!(refused.contains("the node was shut down"), "{refused}");
}

#[test]
fn a_robot_that_reports_no_more_is_noticed_where_it_did_regularly() {
    // One latched report, and none since.
    let mut bench = Bench::enabled();
    bench.core.robot(bench.now, None);
    for _ in 0..200 {
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Enabled);
    // Twice a second, and then silence.
    for period in 0..400 {
        if period % 30 == 0 {
            bench.core.robot(bench.now, None);
        }
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Enabled);
    for _ in 0..130 {
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Faulted(FaultReason::StaleFeedback));
    let words = bench.core.explanation().unwrap();
    assert!(words.contains("robot_status"), "{words}");
    // Who clears that goes on without: a needle has to come out.
    bench.core.reset(bench.now).unwrap();
    bench.core.enable(bench.now).unwrap();
    for _ in 0..200 {
        bench.step();
    }
    assert_eq!(bench.mode(), ArmMode::Enabled);
}
