//! Dry runs against a controller behind a network address: the emulated one, in a process or
//! a thread of its own.

use std::io::{BufRead, BufReader, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::process::{Child, Output, Stdio};
use std::sync::Arc;

use hal::Joints;
use needle_steer::clock::WallTime;
use robots::viper::emulator::{EmulatorConfig, Server};
use robots::viper::{Dialect, Emulator};

use super::{apart, emulator, joints_of, needle_steer, stderr};

const LOCALHOST: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

/// A run on the controller behind these ports, with `more` arguments.
fn run_on(motion: u16, state: u16, more: &[&str]) -> Output {
    let ports = [
        format!("viper.motion_port={motion}"),
        format!("viper.state_port={state}"),
    ];
    let mut arguments = vec!["run", "--backend", "viper", "--json"];
    arguments.extend(["--set", "viper.emulate=false"]);
    arguments.extend(["--set", &ports[0], "--set", &ports[1]]);
    // Five millimetres straight ahead after the straight start, as fast as the limits let it.
    for setting in [
        "run.law=none",
        "run.insertion_speed_mm_s=3",
        "target.kind=aligned",
        "target.depth_mm=5",
    ] {
        arguments.extend(["--set", setting]);
    }
    arguments.extend(more);
    needle_steer(&arguments)
}

/// Where the default insertion starts.
fn start() -> [f64; 6] {
    let output = needle_steer(&["run", "--dry-run"]);
    assert!(output.status.success(), "{}", stderr(&output));
    joints_of(&output)
}

/// `emulate viper` in a process of its own.
struct Controller {
    process: Child,
    ports: [u16; 2],
}

impl Controller {
    fn at(joints: [f64; 6]) -> Self {
        let joints = joints.map(|q| q.to_degrees().to_string()).join(",");
        let mut process = emulator()
            .arg(format!("--joints-deg={joints}"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let ports = [(); 2].map(|()| {
            let line = lines.next().unwrap().unwrap();
            let (_, address) = line.split_once(' ').unwrap();
            address.parse::<SocketAddr>().unwrap().port()
        });
        Self { process, ports }
    }

    /// A fault, or its end.
    #[expect(
        clippy::disallowed_methods,
        reason = "the other process reads on a thread of its own, on the wall clock"
    )]
    fn say(&mut self, line: &str) {
        let input = self.process.stdin.as_mut().unwrap();
        writeln!(input, "{line}").unwrap();
        input.flush().unwrap();
        // Read by a thread of its own.
        std::thread::sleep(std::time::Duration::from_millis(300));
    }

    /// Where the arm stands, by a dry run that moves nothing.
    fn joints(&self) -> [f64; 6] {
        joints_of(&run_on(self.ports[0], self.ports[1], &["--dry-run"]))
    }
}

impl Drop for Controller {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn the_arm_of_another_process_moves_in_air_and_only_then() {
    let start = start();
    // On the wall clock a busy computer may miss the driver's deadlines; that stops the arm, and
    // the next attempt starts anew.
    for attempt in 1..=3 {
        let controller = Controller::at(start);
        let [motion, state] = controller.ports;
        assert!(apart(&controller.joints(), &start) < 1e-4);
        assert!(
            apart(&controller.joints(), &start) < 1e-4,
            "a dry run moved"
        );
        let output = run_on(motion, state, &["--dry-run=air"]);
        let moved = apart(&controller.joints(), &start);
        let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let ended = summary["ended"].as_str().unwrap();
        if ended == "target passed" {
            assert!(output.status.success());
            // Ten millimetres at the end of an arm of half a metre.
            assert!((0.005..0.1).contains(&moved), "moved by {moved} rad");
            return;
        }
        assert!(ended.starts_with("stopped"), "attempt {attempt}: {ended}");
    }
    panic!("three attempts missed the driver's deadlines");
}

#[test]
fn faults_can_be_rehearsed_on_the_emulated_controller() {
    let mut controller = Controller::at(start());
    let [motion, state] = controller.ports;
    for (fault, end, told) in [
        ("e-stop", "release", "emergency stop"),
        ("manual", "automatic", "not in automatic mode"),
        ("silent", "speak", "did not report in time"),
    ] {
        controller.say(fault);
        let output = run_on(motion, state, &["--dry-run=air"]);
        let message = stderr(&output) + &String::from_utf8_lossy(&output.stdout);
        assert!(!output.status.success(), "{fault}: {message}");
        assert!(message.to_lowercase().contains(told), "{fault}: {message}");
        controller.say(end);
        controller.say("power on");
    }
    let shown = controller.joints();
    assert!(apart(&shown, &start()) < 1e-4, "{shown:?}");
}

#[test]
fn a_simulated_arm_performs_the_whole_insertion_in_air() {
    for backend in ["sim", "viper"] {
        // The law of the paper: `hybrid` gives the soft model up as out of its reach.
        let arguments = ["run", "--backend", backend, "--law", "paper", "--json"];
        let output = needle_steer(&[&arguments[..], &["--dry-run=air"]].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(summary["ended"], "target passed", "{backend}");
        assert!(summary["steps"].as_u64().unwrap() > 1000);
        // The plant is the controller's own model: what is left is the law's own.
        assert!(
            summary["true_error_mm"].as_f64().unwrap() < 0.5,
            "{backend}: {summary}"
        );
    }
}

#[test]
fn without_needle_or_camera_a_real_insertion_is_refused() {
    let files = [
        "--set",
        "cameras.calibration=no-such-file.yml",
        "--set",
        "cameras.registration=nor-this.json",
    ];
    for (more, told) in [
        (&[][..], "cameras.calibration"),
        (&["--sensor", "shape"][..], "ros.publish"),
        (&files[..2], "cameras.registration"),
        (&files[..], "no-such-file.yml"),
    ] {
        let output = run_on(1, 1, more);
        assert!(!output.status.success());
        let message = stderr(&output);
        assert!(message.contains(told), "{told}: {message}");
    }
}

#[test]
fn hosts_that_are_not_there_are_named() {
    let nowhere = ["--dry-run=air", "--set", "viper.host=no-such-host.invalid"];
    let output = run_on(0, 0, &nowhere);
    assert_eq!(output.status.code(), Some(1));
    let message = stderr(&output);
    assert!(message.contains("no-such-host.invalid"), "{message}");
    // Nobody listens at a port that was free a moment ago.
    let free = TcpListener::bind((LOCALHOST, 0)).unwrap().local_addr();
    let port = free.unwrap().port();
    for how in ["--dry-run", "--dry-run=air"] {
        let output = run_on(port, port, &[how]);
        assert_eq!(output.status.code(), Some(1));
        let message = stderr(&output);
        assert!(message.contains(&port.to_string()), "{message}");
    }
}

#[test]
fn an_arm_that_stands_elsewhere_is_named_and_does_not_move() {
    let mut elsewhere = start();
    elsewhere[2] += 0.02;
    let controller = Controller::at(elsewhere);
    let [motion, state] = controller.ports;
    let output = run_on(motion, state, &["--dry-run=air"]);
    assert_eq!(output.status.code(), Some(1));
    let message = stderr(&output);
    assert!(message.contains("joint 3"), "{message}");
    assert!(apart(&controller.joints(), &elsewhere) < 1e-4);
}

#[test]
fn the_controller_of_another_arm_is_named_and_nothing_moves() {
    let start = Joints::from(start());
    let mut config = EmulatorConfig::viper(Dialect::Steer, start);
    config.limits[1].upper += 0.5;
    let emulator = Emulator::new(config);
    let time = WallTime::start();
    let now = Arc::new(move || time.now());
    let server = Server::start(emulator.clone(), LOCALHOST, [0, 0], Some(now)).unwrap();
    for how in ["--dry-run", "--dry-run=air"] {
        let output = run_on(server.motion.port(), server.state.port(), &[how]);
        assert_eq!(output.status.code(), Some(1));
        let message = stderr(&output);
        assert!(message.contains("not the configured arm"), "{message}");
    }
    assert_eq!(emulator.true_joints(), start);
}
