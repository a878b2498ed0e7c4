//! The contract of [`hal::Arm`], clause by clause, for every back end.
//!
//! A back end takes part with a [`Harness`] and one test that calls [`keeps_the_contract`].

use core::time::Duration;

use hal::guarded::Guard;
use hal::{
    Arm, ArmMode, Error, ErrorKind, FaultReason, Guarded, Joints, Limiter, RateCommand, Recorded,
    Stamp,
};
use robots::arms::{NEEDLE_BASE, VIPER_S650};
use robots::kinematics::Chain;
use robots::sim::{Fault, SimSettings, SimulatedArm, SimulatedDriver};

/// An arm, the world that moves it, and its emergency stop.
pub(crate) trait Harness {
    /// The arm; at first connected, not enabled, and at rest at [`start`].
    fn arm(&mut self) -> &mut dyn Arm;
    /// The present time.
    fn now(&self) -> Stamp;
    /// Lets time pass.
    fn advance_to(&mut self, stamp: Stamp);
    /// Where the joints really are.
    fn true_joints(&self) -> Joints;
    /// Presses or releases the emergency stop.
    fn emergency_stop(&mut self, pressed: bool);
    /// Drops the driver; the world goes on.
    fn drop_driver(&mut self);
    /// How many times longer than others the arm takes for a long way: more than one for a
    /// controller that stands at the end of every segment.
    fn slowness(&self) -> u32 {
        1
    }
}

/// Joints at the start \[rad\]: away from all limits and singularities.
pub(crate) fn start() -> Joints {
    Joints::from([0.1, -1.2, 2.4, 0.2, 0.9, -0.3])
}

/// Rates that every arm can reach within a few periods \[rad/s\].
fn gentle() -> Joints {
    Joints::from([0.02, -0.01, 0.015, -0.02, 0.01, 0.03])
}

/// What a clause of the contract says, and its check.
type Clause<H> = (&'static str, fn(&mut Session<H>));

/// Checks every clause on a fresh arm.
pub(crate) fn keeps_the_contract<H: Harness>(fresh: impl Fn() -> H) {
    let clauses: [Clause<H>; 13] = [
        ("starts connected and at rest", starts_connected),
        ("enable and command need their modes", modes_are_required),
        ("moves as commanded", moves_as_commanded),
        ("non-finite commands fault", non_finite_commands_fault),
        (
            "late, old and duplicate commands change nothing",
            old_commands_change_nothing,
        ),
        ("a missed command is ridden out", a_fresh_command_resumes),
        (
            "a missing command ramps to zero, then faults",
            stale_commands_fault,
        ),
        ("a command of zero needs no renewal", zero_needs_no_renewal),
        ("stop works in every mode", stop_works_in_every_mode),
        ("excessive commands are slowed, not bent", excess_is_slowed),
        ("no joint passes its end", ends_are_kept),
        ("an emergency stop latches", emergency_stop_latches),
        ("dropping the driver stops", dropping_stops),
    ];
    for (name, clause) in clauses {
        println!("clause: {name}");
        clause(&mut Session::new(fresh()));
    }
}

/// A harness with the counting of commands.
struct Session<H> {
    harness: H,
    sequence: u64,
}

impl<H: Harness> Session<H> {
    fn new(harness: H) -> Self {
        Self {
            harness,
            sequence: 0,
        }
    }

    fn period(&mut self) -> Duration {
        self.harness.arm().description().period
    }

    fn wait(&mut self, duration: Duration) {
        let until = self.harness.now() + duration;
        while self.harness.now() < until {
            let next = (self.harness.now() + Duration::from_millis(4)).min(until);
            self.harness.advance_to(next);
        }
    }

    fn mode(&mut self) -> ArmMode {
        self.harness.arm().state().unwrap().mode
    }

    fn send(&mut self, rates: &Joints) -> Result<(), Error> {
        self.sequence += 1;
        let command = RateCommand {
            sequence: self.sequence,
            stamp: self.harness.now(),
            rates: *rates,
        };
        self.harness.arm().command(&command)
    }

    /// Sends `rates` every period for `duration`.
    fn drive(&mut self, rates: &Joints, duration: Duration) {
        let until = self.harness.now() + duration;
        while self.harness.now() < until {
            self.send(rates).unwrap();
            let period = self.period();
            self.wait(period);
        }
    }

    /// Waits until the joints stand still; at most two seconds.
    fn settle(&mut self) -> Joints {
        for _ in 0..20 {
            let before = self.harness.true_joints();
            self.wait(Duration::from_millis(100));
            if distance(&before, &self.harness.true_joints()) < 1e-6 {
                return self.harness.true_joints();
            }
        }
        panic!("the arm does not come to rest");
    }
}

fn distance(a: &Joints, b: &Joints) -> f64 {
    a.zip(b, |a, b| a - b).max_abs()
}

fn kind(result: Result<(), Error>) -> ErrorKind {
    result.expect_err("has to be refused").kind()
}

fn starts_connected<H: Harness>(s: &mut Session<H>) {
    let description = s.harness.arm().description().clone();
    assert_eq!(description.joint_names.len(), 6);
    assert_eq!(description.limits.len(), 6);
    assert!(description.period > Duration::ZERO);
    let state = s.harness.arm().state().unwrap();
    assert_eq!(state.mode, ArmMode::Connected);
    // Encoders and wires may round, by less than this.
    assert!(distance(&state.positions, &start()) < 1e-4);
    let mut last = state.stamp;
    for _ in 0..20 {
        s.wait(Duration::from_millis(16));
        let stamp = s.harness.arm().state().unwrap().stamp;
        assert!(stamp >= last && stamp <= s.harness.now());
        last = stamp;
    }
    assert!(last > Stamp::ZERO);
    assert!(distance(&s.harness.true_joints(), &start()) < 1e-6);
}

fn modes_are_required<H: Harness>(s: &mut Session<H>) {
    assert_eq!(kind(s.send(&gentle())), ErrorKind::WrongMode);
    s.harness.arm().enable().unwrap();
    assert_eq!(s.mode(), ArmMode::Enabled);
    assert_eq!(kind(s.harness.arm().enable()), ErrorKind::WrongMode);
    s.send(&gentle().zeroed()).unwrap();
    s.send(&gentle()).unwrap();
    assert_eq!(s.mode(), ArmMode::Moving);
    assert_eq!(kind(s.harness.arm().enable()), ErrorKind::WrongMode);
    let short = Joints::from_slice(&[0.0; 5]).unwrap();
    assert_eq!(kind(s.send(&short)), ErrorKind::Rejected);
    s.harness.arm().stop().unwrap();
    assert_eq!(s.mode(), ArmMode::Stopping);
    assert_eq!(kind(s.send(&gentle())), ErrorKind::WrongMode);
}

fn moves_as_commanded<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_secs(1));
    let before = s.harness.true_joints();
    s.drive(&gentle(), Duration::from_secs(1));
    let moved = s.harness.true_joints().zip(&before, |a, b| a - b);
    // The second of duration is whole periods: 1.008 s; the rest is the wire's rounding.
    assert!(
        distance(&moved, &gentle().map(|x| x * 1.008)) < 2e-4,
        "{moved:?}"
    );
    let state = s.harness.arm().state().unwrap();
    assert!(distance(&state.rates, &gentle()) < 0.01);
    assert!(distance(&state.positions, &s.harness.true_joints()) < 0.01);
}

fn non_finite_commands_fault<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_millis(200));
    let mut bad = gentle();
    bad[3] = f64::NAN;
    assert_eq!(kind(s.send(&bad)), ErrorKind::Rejected);
    let fault = ArmMode::Faulted(FaultReason::NonFiniteCommand);
    assert_eq!(s.mode(), fault);
    assert_eq!(kind(s.send(&gentle())), ErrorKind::Faulted);
    assert_eq!(kind(s.harness.arm().enable()), ErrorKind::Faulted);
    s.settle();
    assert_eq!(s.mode(), fault);
    s.harness.arm().reset().unwrap();
    assert_eq!(s.mode(), ArmMode::Connected);
    assert_eq!(kind(s.send(&gentle())), ErrorKind::WrongMode);
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_millis(100));
    bad[3] = f64::INFINITY;
    assert_eq!(kind(s.send(&bad)), ErrorKind::Rejected);
    assert_eq!(s.mode(), fault);
}

fn old_commands_change_nothing<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_millis(500));
    let (now, sequence) = (s.harness.now(), s.sequence);
    let wild = gentle().map(|x| -20.0 * x);
    s.send(&gentle()).unwrap();
    for (sequence, stamp) in [
        (sequence + 1, now),
        (sequence, now),
        (1, now),
        (sequence + 2, now - Duration::from_millis(150)),
        (sequence + 2, now + Duration::from_millis(150)),
    ] {
        let command = RateCommand {
            sequence,
            stamp,
            rates: wild,
        };
        let result = s.harness.arm().command(&command);
        assert_eq!(kind(result), ErrorKind::Rejected, "{command:?}");
    }
    let before = s.harness.true_joints();
    s.wait(Duration::from_millis(16));
    s.sequence += 2;
    s.drive(&gentle(), Duration::from_millis(480));
    let moved = s.harness.true_joints().zip(&before, |a, b| a - b);
    assert!(
        distance(&moved, &gentle().map(|x| x * 0.496)) < 2e-4,
        "{moved:?}"
    );
}

fn a_fresh_command_resumes<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_millis(300));
    s.wait(Duration::from_millis(100));
    assert_eq!(s.mode(), ArmMode::Moving);
    s.drive(&gentle(), Duration::from_millis(300));
    let rates = s.harness.arm().state().unwrap().rates;
    assert!(distance(&rates, &gentle()) < 0.01, "{rates:?}");
}

fn stale_commands_fault<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_millis(480));
    let before = s.harness.true_joints();
    s.wait(Duration::from_millis(176));
    assert_eq!(s.mode(), ArmMode::Moving);
    let ramped = s.harness.true_joints();
    // 48 ms at full rate, a ramp, the arm's latency and lag: less than 150 ms of travel.
    assert!(distance(&ramped, &before) < 0.15 * gentle().max_abs());
    s.wait(Duration::from_millis(40));
    assert_eq!(s.mode(), ArmMode::Faulted(FaultReason::StaleCommand));
    s.wait(Duration::from_secs(1));
    assert!(distance(&s.harness.true_joints(), &ramped) < 1e-3);
    assert_eq!(kind(s.send(&gentle())), ErrorKind::Faulted);
}

fn zero_needs_no_renewal<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    s.wait(Duration::from_secs(1));
    assert_eq!(s.mode(), ArmMode::Enabled);
    s.drive(&gentle(), Duration::from_millis(300));
    s.drive(&gentle().zeroed(), Duration::from_millis(160));
    s.wait(Duration::from_secs(1));
    assert_eq!(s.mode(), ArmMode::Enabled);
    s.send(&gentle()).unwrap();
}

fn stop_works_in_every_mode<H: Harness>(s: &mut Session<H>) {
    for expected in [ArmMode::Connected, ArmMode::Enabled] {
        assert_eq!(s.mode(), expected);
        s.harness.arm().stop().unwrap();
        s.harness.arm().stop().unwrap();
        assert_eq!(s.mode(), expected);
        if expected == ArmMode::Connected {
            s.harness.arm().enable().unwrap();
        }
    }
    s.drive(&gentle(), Duration::from_millis(300));
    s.harness.arm().stop().unwrap();
    assert_eq!(s.mode(), ArmMode::Stopping);
    s.harness.arm().stop().unwrap();
    let stopped = s.settle();
    assert_eq!(s.mode(), ArmMode::Enabled);
    s.wait(Duration::from_secs(1));
    assert!(distance(&s.harness.true_joints(), &stopped) < 1e-6);
    // Ready for more.
    s.drive(&gentle(), Duration::from_millis(100));
    s.harness.emergency_stop(true);
    s.wait(Duration::from_millis(100));
    s.harness.arm().stop().unwrap();
    assert!(matches!(s.mode(), ArmMode::Faulted(_)));
}

fn excess_is_slowed<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    let wild = gentle().map(|x| 1e4 * x);
    let before = s.harness.true_joints();
    s.drive(&wild, Duration::from_millis(160));
    s.harness.arm().stop().unwrap();
    let moved = s.settle().zip(&before, |a, b| a - b);
    // Along the line of the command, to the wire's rounding.
    let line = gentle();
    let dot = |a: &Joints, b: &Joints| a.iter().zip(b.iter()).map(|(a, b)| a * b).sum::<f64>();
    let along = dot(&moved, &line) / dot(&line, &line);
    assert!(along > 0.0);
    assert!(distance(&moved, &line.map(|x| x * along)) < 1e-3 * moved.max_abs());
}

fn ends_are_kept<H: Harness>(s: &mut Session<H>) {
    let limits = s.harness.arm().description().limits.clone();
    s.harness.arm().enable().unwrap();
    for (joint, sense) in [(4, 1.0), (2, -1.0), (5, 1.0), (1, 1.0)] {
        let mut wild = gentle().zeroed();
        wild[joint] = sense * limits[joint].velocity * 3.0;
        for _ in 0..250 * s.harness.slowness() {
            s.send(&wild).unwrap();
            let period = s.period();
            s.wait(period);
            let q = s.harness.true_joints()[joint];
            assert!(
                (limits[joint].lower..=limits[joint].upper).contains(&q),
                "{joint}: {q}"
            );
        }
        let end = if sense > 0.0 {
            limits[joint].upper
        } else {
            limits[joint].lower
        };
        assert!(
            (s.harness.true_joints()[joint] - end).abs() < 0.1,
            "far from the end"
        );
        s.drive(&wild.zeroed(), Duration::from_millis(160));
    }
}

fn emergency_stop_latches<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_millis(300));
    s.harness.emergency_stop(true);
    // Feedback of the state may be as slow as 10 Hz.
    let mut sent = Ok(());
    for _ in 0..16 {
        sent = s.send(&gentle());
        s.wait(Duration::from_millis(16));
    }
    assert_eq!(kind(sent), ErrorKind::Faulted);
    let fault = ArmMode::Faulted(FaultReason::EmergencyStop);
    assert_eq!(s.mode(), fault);
    let stopped = s.settle();
    assert_eq!(kind(s.harness.arm().reset()), ErrorKind::Faulted);
    s.harness.emergency_stop(false);
    s.wait(Duration::from_millis(500));
    assert_eq!(s.mode(), fault);
    assert_eq!(kind(s.send(&gentle())), ErrorKind::Faulted);
    s.harness.arm().reset().unwrap();
    assert_eq!(s.mode(), ArmMode::Connected);
    s.wait(Duration::from_millis(500));
    assert!(distance(&s.harness.true_joints(), &stopped) < 1e-6);
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_millis(100));
}

fn dropping_stops<H: Harness>(s: &mut Session<H>) {
    s.harness.arm().enable().unwrap();
    s.drive(&gentle(), Duration::from_millis(300));
    let before = s.harness.true_joints();
    s.harness.drop_driver();
    let stopped = s.settle();
    assert!(distance(&stopped, &before) < 0.15 * gentle().max_abs());
}

/// A simulated arm, behind decorators or not.
struct Simulated<A> {
    world: SimulatedArm,
    driver: Option<A>,
}

impl<A: Arm> Simulated<A> {
    fn new(settings: SimSettings, decorate: impl Fn(SimulatedDriver) -> A) -> Self {
        let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
        let world = SimulatedArm::new(&chain, &start(), settings).unwrap();
        let driver = Some(decorate(world.driver()));
        Self { world, driver }
    }
}

impl<A: Arm> Harness for Simulated<A> {
    fn arm(&mut self) -> &mut dyn Arm {
        self.driver.as_mut().unwrap()
    }

    fn now(&self) -> Stamp {
        self.world.now()
    }

    fn advance_to(&mut self, stamp: Stamp) {
        self.world.advance_to(stamp);
    }

    fn true_joints(&self) -> Joints {
        self.world.true_joints()
    }

    fn emergency_stop(&mut self, pressed: bool) {
        if pressed {
            self.world.inject(Fault::EmergencyStop);
        } else {
            self.world.clear(Fault::EmergencyStop);
        }
    }

    fn drop_driver(&mut self) {
        self.driver = None;
    }
}

fn guarded(driver: SimulatedDriver) -> Guarded<SimulatedDriver> {
    let margin = 0.5_f64.to_radians();
    let hold = Duration::from_millis(48);
    let limiter = Limiter::new(&driver.description().limits, margin, hold).unwrap();
    Guarded::new(driver, Guard::new(limiter)).unwrap()
}

#[test]
fn the_simulated_arm_keeps_the_contract() {
    keeps_the_contract(|| Simulated::new(SimSettings::default(), |driver| driver));
    keeps_the_contract(|| Simulated::new(SimSettings::ideal(), |driver| driver));
}

#[test]
fn a_guarded_arm_keeps_the_contract() {
    keeps_the_contract(|| Simulated::new(SimSettings::default(), guarded));
}

#[test]
fn a_recorded_arm_keeps_the_contract() {
    keeps_the_contract(|| {
        Simulated::new(SimSettings::default(), |driver| Recorded::new(driver, 8))
    });
}
