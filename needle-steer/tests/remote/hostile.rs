//! Clients that mean no good: the insertion is the same, and memory is bounded.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use hal::{RateCommand, StereoFrame, Telemetry};
use igtl::{Body, Message, Text, Transform};
use needle_steer::config::{self, Config};
use needle_steer::controls::Controls;
use needle_steer::rig::{Pace, Rig};
use needle_steer::run::{Both, Observer, run};
use needle_steer::session::Session;
use vision::track::Tracked;

/// What a run did, to be compared bit by bit: a few bytes a step, for memory is watched meanwhile.
#[derive(Debug, Default, PartialEq)]
struct Trace {
    commands: Vec<u64>,
    steps: Vec<u64>,
    images: usize,
    times: Vec<Duration>,
}

/// A hash of the debug output: that of a float is the shortest text that reads back as the same bits.
fn fingerprint(value: &impl std::fmt::Debug) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(format!("{value:?}").as_bytes());
    hasher.finish()
}

impl Observer for Trace {
    fn step(&mut self, telemetry: &Telemetry) {
        self.steps.push(fingerprint(telemetry));
    }

    fn command(&mut self, command: &RateCommand) {
        self.commands.push(fingerprint(command));
    }

    fn images(&mut self, _: &StereoFrame, _: &Tracked) {
        self.images += 1;
    }

    fn timed(&mut self, step: Duration) {
        self.times.push(step);
    }
}

fn configured(sets: &[&str]) -> Config {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    config::load(None, &sets).unwrap()
}

/// Carries a run out, with a session where `config` asks for one, and with `clients` connected.
fn carried_out(
    config: &Config,
    pace: Pace,
    clients: impl FnOnce(SocketAddr, &Arc<AtomicBool>) -> Vec<JoinHandle<()>>,
) -> (Trace, String, BTreeMap<&'static str, u64>) {
    let mut rig = Rig::simulated(config, pace).unwrap();
    let controls = Arc::new(Controls::default());
    let mut session = Session::open(config, None, &rig, &controls).unwrap();
    let over = Arc::new(AtomicBool::new(false));
    let mut trace = Trace::default();
    let mut dropped = BTreeMap::new();
    let summary = match &mut session {
        Some(session) => {
            let (address, counters) = session.igtl().unwrap();
            let clients = clients(address, &over);
            let mut both = Both(session, &mut trace);
            let summary = run(config, &mut rig, &mut both, &controls).unwrap();
            over.store(true, Ordering::Release);
            for client in clients {
                client.join().unwrap();
            }
            dropped = counters.counts();
            summary
        }
        None => run(config, &mut rig, &mut trace, &controls).unwrap(),
    };
    (trace, format!("{summary:?}"), dropped)
}

fn string(text: &str) -> Vec<u8> {
    let body = Body::Text(Text::new(text));
    Message::new("Command", body).encode().unwrap()
}

/// Kinds of clients, by number.
fn client(kind: usize, address: SocketAddr, over: &AtomicBool) {
    let mut noise = 0x9e37_79b9_u32.wrapping_mul(1 + u32::try_from(kind).unwrap());
    let mut garbage = move || {
        noise ^= noise << 13;
        noise ^= noise >> 17;
        noise ^= noise << 5;
        noise.to_be_bytes()
    };
    let mut target = Transform::at([f32::NAN; 3]);
    target.axes[0] = [3.0, 0.0, 0.0];
    let target = Message::new("NewTarget", Body::Transform(target));
    let target = target.encode().unwrap();
    let behind = string("TARGET 400 0 400");
    let pause = Duration::from_millis(20);
    while !over.load(Ordering::Acquire) {
        let Ok(mut stream) = TcpStream::connect(address) else {
            std::thread::sleep(pause);
            continue;
        };
        let _ = stream.set_write_timeout(Some(pause));
        let _ = stream.set_read_timeout(Some(pause));
        let mut sent = true;
        while sent && !over.load(Ordering::Acquire) {
            let waits = Duration::from_millis(if kind % 8 < 2 { 20 } else { 1 });
            sent = match kind % 8 {
                // Silent, and never reading.
                0 => stream.peer_addr().is_ok(),
                // A byte now and then, of a message that never ends.
                1 => stream.write(&[0]).is_ok(),
                // Bytes that mean nothing.
                2 => stream.write_all(&garbage()).is_ok(),
                // As many words as there is room for.
                3 => stream.write_all(&string("NONSENSE").repeat(50)).is_ok(),
                // As many targets as there is room for, all bad.
                4 => stream
                    .write_all(&[target.clone(), behind.clone()].concat().repeat(20))
                    .is_ok(),
                // A body that is larger than anything.
                5 => {
                    let mut large = string("STOP");
                    large[42..50].copy_from_slice(&u64::MAX.to_be_bytes());
                    stream.write_all(&large).is_ok()
                }
                // A wrong checksum.
                6 => {
                    let mut damaged = string("STOP");
                    *damaged.last_mut().unwrap() ^= 1;
                    stream.write_all(&damaged).is_ok()
                }
                // Reads a little and goes.
                _ => {
                    let mut few = [0; 64];
                    let _ = stream.read(&mut few);
                    false
                }
            };
            std::thread::sleep(waits);
        }
        std::thread::sleep(pause);
    }
}

fn crowd(n: usize, address: SocketAddr, over: &Arc<AtomicBool>) -> Vec<JoinHandle<()>> {
    (0..n)
        .map(|kind| {
            let over = Arc::clone(over);
            std::thread::spawn(move || {
                client(kind, address, &over);
            })
        })
        .collect()
}

/// Memory of this process \[kB\], where the system tells.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Minutes without and with clients; the 99th percentile of one minute varies by a tenth by itself.
const ROUNDS: usize = 3;
/// Seconds in which buffers come to their size.
const SETTLED: usize = 10;

const SHORT: [&str; 3] = [
    "target.depth_mm=30",
    "target.offset_mm=1",
    "igtl.address=\"127.0.0.1:0\"",
];

#[test]
fn an_insertion_among_hostile_clients_is_the_same_bit_by_bit() {
    for sensor in ["shape", "images"] {
        let sensor = format!("run.sensor={sensor:?}");
        let alone = configured(&[&SHORT[..], &[&sensor]].concat());
        let served = configured(&[&SHORT[..], &[&sensor, "igtl.serve=true"]].concat());
        let (mut expected, ended, _) = carried_out(&alone, Pace::Free, |_, _| Vec::new());
        let (mut found, ended_too, dropped) = carried_out(&served, Pace::Free, |address, over| {
            crowd(24, address, over)
        });
        expected.times.clear();
        found.times.clear();
        assert_eq!(ended_too, ended);
        assert_eq!(found, expected, "{sensor}");
        assert!(
            expected.commands.len() > 1000,
            "{}",
            expected.commands.len()
        );
        assert!(dropped.contains_key("version"), "{dropped:?}");
        eprintln!("{sensor}: {dropped:?}");
    }
}

/// Memory of this process, once a second until `over`.
fn watch_memory(over: &Arc<AtomicBool>, seen: &Arc<Mutex<Vec<u64>>>) -> JoinHandle<()> {
    let (over, seen) = (Arc::clone(over), Arc::clone(seen));
    std::thread::spawn(move || {
        while !over.load(Ordering::Acquire) {
            seen.lock().unwrap().extend(resident());
            std::thread::sleep(Duration::from_secs(1));
        }
    })
}

/// Says to [`clients_of_their_own_process`] whom they are to trouble.
const CROWD: &str = "NEEDLE_STEER_TEST_CROWD";

/// Whom the clients of their own process trouble.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Troubled {
    /// Nobody: there are none.
    Nobody,
    /// Another server in their own process: what they cost whoever shares the machine with them.
    Another,
    /// The run.
    Run,
}

/// The program in which clients of [`fifty_hostile_clients_for_a_minute`] live; does nothing by itself.
#[test]
#[ignore = "started by another test"]
fn clients_of_their_own_process() {
    let Ok(asked) = std::env::var(CROWD) else {
        return;
    };
    // Until this process is ended.
    let over = Arc::new(AtomicBool::new(false));
    let trouble = |address| {
        for client in crowd(50, address, &over) {
            client.join().unwrap();
        }
    };
    if let Ok(address) = asked.parse() {
        return trouble(address);
    }
    let served = configured(&["igtl.serve=true", "igtl.address=\"127.0.0.1:0\""]);
    let rig = Rig::simulated(&served, Pace::Free).unwrap();
    let session = Session::open(&served, None, &rig, &Arc::default()).unwrap();
    trouble(session.unwrap().igtl().unwrap().0);
}

/// Fifty clients in a process of their own until `over`, who trouble `address` or else another server
/// there. Its lowest priority is for the machines that clients have to themselves elsewhere.
fn crowd_elsewhere(address: Option<SocketAddr>, over: &Arc<AtomicBool>) -> JoinHandle<()> {
    let whom = address.map_or("another".to_owned(), |address| address.to_string());
    let mut process = Command::new("nice")
        .args(["-n", "19"])
        .arg(std::env::current_exe().unwrap())
        .args([
            "--ignored",
            "--exact",
            "hostile::clients_of_their_own_process",
        ])
        .env(CROWD, whom)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let over = Arc::clone(over);
    std::thread::spawn(move || {
        while !over.load(Ordering::Acquire) {
            std::thread::sleep(Duration::from_millis(100));
        }
        process.kill().unwrap();
        process.wait().unwrap();
    })
}

/// Fifty of them for a minute of wall-clock time, three times, each time after a minute of none and a
/// minute in which they trouble another server on the same machine: times of steps, and memory. A
/// measurement, run by hand:
/// `cargo test --release -p needle-steer --test remote -- --ignored --nocapture fifty`.
#[test]
#[ignore = "measures for nine minutes"]
fn fifty_hostile_clients_for_a_minute() {
    let long = [
        "target.depth_mm=55",
        "target.offset_mm=1",
        "igtl.address=\"127.0.0.1:0\"",
    ];
    let mut times: BTreeMap<Troubled, Vec<Duration>> = BTreeMap::new();
    for troubled in [Troubled::Nobody, Troubled::Another, Troubled::Run].repeat(ROUNDS) {
        let memory = Arc::default();
        let served = configured(&[&long[..], &["igtl.serve=true"]].concat());
        let pace = Pace::Paced(needle_steer::clock::WallTime::start());
        let (trace, ended, dropped) = carried_out(&served, pace, |address, over| {
            let mut threads = vec![watch_memory(over, &memory)];
            match troubled {
                Troubled::Nobody => {}
                Troubled::Another => threads.push(crowd_elsewhere(None, over)),
                Troubled::Run => threads.push(crowd_elsewhere(Some(address), over)),
            }
            threads
        });
        let memory = memory.lock().unwrap();
        let settled = &memory[memory.len().min(SETTLED)..];
        let (least, most) = (settled.iter().min(), settled.iter().max());
        eprintln!(
            "trouble for {troubled:?}: memory after {SETTLED} s {least:?} to {most:?} kB, {dropped:?}\n{ended}"
        );
        times.entry(troubled).or_default().extend(trace.times);
        // It grows with the run's own history, by some kilobytes a second.
        assert!(
            most.unwrap_or(&0) - least.unwrap_or(&0) < 16 << 10,
            "{memory:?}"
        );
    }
    for (troubled, mut times) in times {
        times.sort_unstable();
        let p = |share: usize| times[(times.len() - 1) * share / 100];
        let (half, most) = (p(50), p(99));
        eprintln!(
            "trouble for {troubled:?}: {} steps, p50 {half:?}, p99 {most:?}",
            times.len()
        );
    }
}
