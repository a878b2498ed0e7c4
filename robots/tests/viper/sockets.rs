//! The driver's thread and the emulator's server over real sockets, on the wall clock: T4 with
//! resets and silence on the wire, T15's threads, T17's final positions, T18. Bounds in time are wide: what happens is
//! tested, not how fast.

use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use hal::{Arm, ArmMode, ErrorKind, FaultReason, Joints, RateCommand, Stamp};
use robots::sim::{SimSettings, SimulatedArm};
use robots::viper::arm::Now;
use robots::viper::emulator::{EmulatorConfig, Server};
use robots::viper::{Config, Dialect, Emulator, LinkError, Port, ViperArm, viper_limits};

use crate::bench::{HOME, slow};

const LOCALHOST: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

#[expect(clippy::disallowed_methods, reason = "tests on the wall clock")]
fn wall() -> Now {
    let origin = Instant::now();
    Arc::new(move || Stamp::ZERO + origin.elapsed())
}

#[expect(clippy::disallowed_methods, reason = "tests on the wall clock")]
fn nap(milliseconds: u64) {
    std::thread::sleep(Duration::from_millis(milliseconds));
}

/// Polls for at most ten seconds.
fn eventually(what: &str, mut condition: impl FnMut() -> bool) {
    for _ in 0..2000 {
        if condition() {
            return;
        }
        nap(5);
    }
    panic!("{what}: not within ten seconds");
}

fn emulator(dialect: Dialect) -> Emulator {
    Emulator::new(EmulatorConfig::viper(dialect, Joints::from(HOME)))
}

/// Patient with a busy machine: commands may be two seconds old.
fn config(dialect: Dialect, motion: SocketAddr, state: SocketAddr) -> Config {
    let mut config = Config::viper(motion.ip().to_string(), dialect);
    (config.motion_port, config.state_port) = (motion.port(), state.port());
    config.timing.command_hold = Duration::from_secs(1);
    config.timing.command_fault = Duration::from_secs(2);
    config.timing.feedback = Duration::from_secs(1);
    config.timing.acknowledgement = Duration::from_secs(2);
    config.timing.silence = Duration::from_secs(2);
    config.timing.controller_watchdog = Duration::from_millis(500);
    config
}

struct Rig {
    arm: ViperArm,
    emulator: Emulator,
    now: Now,
    sequence: u64,
    server: Server,
}

impl Rig {
    fn new(dialect: Dialect) -> Self {
        let (emulator, now) = (emulator(dialect), wall());
        let clock = Some(Arc::clone(&now));
        let server = Server::start(emulator.clone(), LOCALHOST, [0, 0], clock).unwrap();
        let config = config(dialect, server.motion, server.state);
        let arm = ViperArm::connect(config, Arc::clone(&now)).unwrap();
        Self {
            arm,
            emulator,
            now,
            sequence: 0,
            server,
        }
    }

    fn mode(&self) -> ArmMode {
        self.arm.monitor().mode()
    }

    fn command(&mut self, rates: [f64; 6]) -> Result<(), hal::Error> {
        self.sequence += 1;
        let command = RateCommand {
            sequence: self.sequence,
            stamp: (self.now)(),
            rates: Joints::from(rates),
        };
        self.arm.command(&command)
    }

    fn start_moving(&mut self) {
        eventually("connection", || self.mode() == ArmMode::Connected);
        self.arm.enable().unwrap();
        let at = self.emulator.true_joints();
        self.command(slow()).unwrap();
        eventually("motion", || {
            self.emulator.true_joints().zip(&at, |a, b| a - b).max_abs() > 1e-3
        });
    }
}

#[test]
fn both_dialects_move_and_stop_over_sockets() {
    for dialect in [Dialect::Steer, Dialect::Adept2018] {
        let mut rig = Rig::new(dialect);
        rig.start_moving();
        rig.arm.stop().unwrap();
        eventually("rest", || rig.mode() == ArmMode::Enabled);
        let at = rig.emulator.true_joints();
        nap(100);
        assert_eq!(rig.emulator.true_joints(), at);
        let metrics = rig.arm.monitor().metrics();
        assert!(
            metrics.points > 0 && metrics.success_rate == 1.0,
            "{metrics:?}"
        );
        let emulator = rig.emulator.clone();
        drop(rig.arm);
        eventually("goodbye", || {
            Port::ALL.iter().all(|port| !emulator.has_client(*port))
        });
    }
}

/// T17 on the wall clock: the same commands to the simulator and to driver, sockets and
/// controller. They end within two periods of travel of each other: the driver takes a command up
/// at its next tick. A tick that this machine's load loses is not made up for, and counts.
#[test]
fn t17_on_the_wall_clock_simulator_and_driver_end_at_the_same_place() {
    const PERIOD: f64 = 0.016;
    let mut rig = Rig::new(Dialect::Steer);
    eventually("connection", || rig.mode() == ArmMode::Connected);
    let names = (1..=6).map(|joint| format!("joint_{joint}")).collect();
    let mut limits = viper_limits();
    for limit in &mut limits {
        // The simulator has no limiter's ramps; the gentle rates have none either.
        (limit.acceleration, limit.jerk) = (1e5, 1e9);
    }
    let home = Joints::from(HOME);
    let world = SimulatedArm::from_limits(names, &limits, &home, SimSettings::ideal()).unwrap();
    let mut simulated = world.driver();
    world.advance_to((rig.now)());
    rig.arm.enable().unwrap();
    simulated.enable().unwrap();

    let gentle = slow().map(|rate| 0.5 * rate);
    let before = rig.arm.monitor().metrics();
    let (mut steps, started) = (0, (rig.now)());
    while steps < 100 {
        steps += 1;
        let rates = if steps < 100 { gentle } else { [0.0; 6] };
        rig.sequence += 1;
        let command = RateCommand {
            sequence: rig.sequence,
            stamp: (rig.now)(),
            rates: Joints::from(rates),
        };
        world.advance_to(command.stamp);
        // A caller that is held up for longer than a command lives tests something else.
        simulated.command(&command).unwrap();
        rig.arm.command(&command).unwrap();
        nap(16);
    }
    let moved_for = (rig.now)().secs_since(started);
    world.advance_to((rig.now)());
    eventually("rest", || rig.mode() == ArmMode::Enabled);
    eventually("the arm's rest", || {
        rig.emulator.true_rates().max_abs() == 0.0
    });
    let after = rig.arm.monitor().metrics();
    let lost = (moved_for / PERIOD - (after.points - before.points) as f64).max(0.0)
        + (after.held_back - before.held_back) as f64;
    let driven = rig.emulator.true_joints();
    let simulated = world.true_joints();
    println!("{steps} commands in {moved_for:.2} s, {lost:.1} periods lost");
    for joint in 0..6 {
        let travel = simulated[joint] - HOME[joint];
        let apart = (driven[joint] - simulated[joint]).abs();
        let bound = (2.0 + lost) * PERIOD * gentle[joint].abs();
        assert!(travel.abs() > 50.0 * PERIOD * gentle[joint].abs());
        assert!(apart <= bound, "joint {joint}: {apart} > {bound}");
    }
}

#[test]
fn t13_dropping_a_moving_driver_brakes_over_sockets() {
    let mut rig = Rig::new(Dialect::Steer);
    rig.start_moving();
    let emulator = rig.emulator.clone();
    drop(rig.arm);
    let at = emulator.true_joints();
    nap(200);
    // The goodbye waits for the answer to the stop: the arm stands or brakes already.
    let travel = emulator.true_joints().zip(&at, |a, b| a - b).max_abs();
    assert!(travel <= 2.0 * crate::bench::SEGMENT, "{travel}");
    assert_eq!(emulator.true_rates().max_abs(), 0.0);
}

#[test]
fn t18_a_second_client_is_refused_and_the_first_is_not_disturbed() {
    let mut rig = Rig::new(Dialect::Steer);
    rig.start_moving();
    let config = config(Dialect::Steer, rig.server.motion, rig.server.state);
    let second = ViperArm::connect(config, Arc::clone(&rig.now)).unwrap();
    eventually("refusal", || {
        // However slow this machine is, the first client goes on meanwhile.
        rig.command(slow()).unwrap();
        matches!(
            second.monitor().link_error(),
            LinkError::Closed | LinkError::Broken { .. }
        )
    });
    assert_eq!(second.monitor().mode(), ArmMode::Disconnected);
    rig.command(slow()).unwrap();
    assert_eq!(rig.mode(), ArmMode::Moving);
    let links = rig.arm.monitor().metrics().links;
    drop(second);
    nap(50);
    rig.command(slow()).unwrap();
    assert_eq!(rig.mode(), ArmMode::Moving);
    assert_eq!(rig.arm.monitor().metrics().links, links);
}

#[test]
fn t04_a_host_that_does_not_resolve_and_a_closed_port_are_named() {
    let nowhere = Config::viper("no such host.invalid", Dialect::Steer);
    let mut arm = ViperArm::connect(nowhere, wall()).unwrap();
    eventually("a reason", || {
        arm.monitor().link_error() != LinkError::NotYet
    });
    let error = arm.monitor().link_error();
    assert!(
        matches!(error, LinkError::Resolve { .. } | LinkError::ConnectTimeout),
        "{error}"
    );
    assert_eq!(arm.state().unwrap_err().kind(), ErrorKind::Disconnected);
    assert_eq!(arm.enable().unwrap_err().kind(), ErrorKind::Disconnected);
    arm.stop().unwrap();

    // A port that was free a moment ago.
    let closed = TcpListener::bind((LOCALHOST, 0))
        .unwrap()
        .local_addr()
        .unwrap();
    let arm = ViperArm::connect(config(Dialect::Steer, closed, closed), wall()).unwrap();
    eventually("a reason", || {
        arm.monitor().link_error() != LinkError::NotYet
    });
    let error = arm.monitor().link_error();
    assert!(matches!(error, LinkError::Connect { .. }), "{error}");
    assert!(error.to_string().contains(&closed.to_string()), "{error}");
}

#[test]
fn t04_a_server_that_accepts_and_hangs_is_given_up() {
    let listener = TcpListener::bind((LOCALHOST, 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let mut config = config(Dialect::Adept2018, address, address);
    config.timing.silence = Duration::from_millis(200);
    let arm = ViperArm::connect(config, wall()).unwrap();
    eventually("a reason", || arm.monitor().link_error() == LinkError::Mute);
    assert_eq!(arm.monitor().mode(), ArmMode::Disconnected);
}

/// A proxy for one port that can fall silent, end or reset.
struct Proxy {
    address: SocketAddr,
    silent: Arc<AtomicBool>,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Proxy {
    /// `reset` ends connections by RST instead of FIN.
    fn new(target: SocketAddr, reset: bool) -> Self {
        let listener = TcpListener::bind((LOCALHOST, 0)).unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap();
        let silent = Arc::new(AtomicBool::new(false));
        let end = Arc::new(AtomicBool::new(false));
        let (quiet, ended) = (Arc::clone(&silent), Arc::clone(&end));
        let thread = std::thread::spawn(move || {
            let client = loop {
                if ended.load(Ordering::Relaxed) {
                    return;
                }
                match listener.accept() {
                    Ok((client, _)) => break client,
                    Err(_) => nap(1),
                }
            };
            // One connection; later ones are refused.
            drop(listener);
            let server = TcpStream::connect(target).unwrap();
            for stream in [&client, &server] {
                stream.set_nonblocking(true).unwrap();
                stream.set_nodelay(true).unwrap();
            }
            while !ended.load(Ordering::Relaxed) {
                for (mut from, mut to) in [(&client, &server), (&server, &client)] {
                    let mut buffer = [0; 4096];
                    match from.read(&mut buffer) {
                        Ok(0) => return,
                        Ok(n) if !quiet.load(Ordering::Relaxed) => {
                            let _ = to.write_all(&buffer[..n]);
                        }
                        _ => {}
                    }
                }
                nap(1);
            }
            if reset {
                let runtime = tokio::runtime::Builder::new_current_thread()
                    .enable_all()
                    .build()
                    .unwrap();
                runtime.block_on(async {
                    let client = tokio::net::TcpStream::from_std(client).unwrap();
                    client.set_zero_linger().unwrap();
                });
            }
        });
        Self {
            address,
            silent,
            end,
            thread: Some(thread),
        }
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        let _ = self.thread.take().unwrap().join();
    }
}

/// A driver moving an arm through two proxies.
fn through_proxies(reset: bool) -> (Rig, [Proxy; 2]) {
    let (emulator, now) = (emulator(Dialect::Steer), wall());
    let clock = Some(Arc::clone(&now));
    let server = Server::start(emulator.clone(), LOCALHOST, [0, 0], clock).unwrap();
    let proxies = [
        Proxy::new(server.motion, reset),
        Proxy::new(server.state, reset),
    ];
    let config = config(Dialect::Steer, proxies[0].address, proxies[1].address);
    let arm = ViperArm::connect(config, Arc::clone(&now)).unwrap();
    let mut rig = Rig {
        arm,
        emulator,
        now,
        sequence: 0,
        server,
    };
    rig.start_moving();
    (rig, proxies)
}

fn stands_still(rig: &Rig) {
    let emulator = &rig.emulator;
    eventually("rest", || emulator.true_rates().max_abs() == 0.0);
    let at = emulator.true_joints();
    nap(200);
    assert_eq!(emulator.true_joints(), at);
}

#[test]
fn t04_reset_and_end_of_the_connection_fault_and_the_arm_stands() {
    for reset in [true, false] {
        let (rig, proxies) = through_proxies(reset);
        drop(proxies);
        eventually("fault", || matches!(rig.mode(), ArmMode::Faulted(_)));
        assert_eq!(
            rig.mode(),
            ArmMode::Faulted(FaultReason::ConnectionLost),
            "reset: {reset}"
        );
        stands_still(&rig);
    }
}

#[test]
fn t04_silence_on_the_wire_faults_and_the_controllers_watchdog_brakes() {
    let (rig, proxies) = through_proxies(false);
    for proxy in &proxies {
        proxy.silent.store(true, Ordering::Relaxed);
    }
    eventually("fault", || matches!(rig.mode(), ArmMode::Faulted(_)));
    let ArmMode::Faulted(reason) = rig.mode() else {
        panic!()
    };
    assert!(
        matches!(
            reason,
            FaultReason::StaleFeedback | FaultReason::StaleAcknowledgement
        ),
        "{reason:?}"
    );
    stands_still(&rig);
}

#[test]
fn t15_fifty_drivers_in_a_row_leave_no_thread_and_no_socket() {
    let emulator = emulator(Dialect::Steer);
    let now = wall();
    let clock = Some(Arc::clone(&now));
    let server = Server::start(emulator.clone(), LOCALHOST, [0, 0], clock).unwrap();
    let config = config(Dialect::Steer, server.motion, server.state);
    for _ in 0..50 {
        let arm = ViperArm::connect(config.clone(), Arc::clone(&now)).unwrap();
        eventually("connection", || arm.monitor().mode() == ArmMode::Connected);
        drop(arm);
        // Ended threads have closed their sockets: the emulator is free for the next one.
        eventually("goodbye", || {
            Port::ALL.iter().all(|port| !emulator.has_client(*port))
        });
    }
}
