//! `withdraw`: the needle out by the log of an insertion whose process is gone.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use super::{apart, emulator, folder, joints_of, json, needle_steer, program, stderr, text};

/// Waits until the log has grown to this many bytes, and a little longer.
fn wait_for_log(log: &Path, bytes: u64) {
    for _ in 0..6000 {
        if log.metadata().is_ok_and(|file| file.len() > bytes) {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{} does not grow", log.display());
}

/// Withdraws by `log` and asserts that the needle is out, by the truth, and logged.
fn assert_out(log: &Path, more: &[&str]) -> serde_json::Value {
    let output = needle_steer(&[&["withdraw", text(log), "--json"], more].concat());
    let summary = json(&output);
    assert!(output.status.success(), "{summary} {}", stderr(&output));
    assert_eq!(summary["ended"], "retracted", "{summary}");
    assert!(summary["withdrawn_mm"].as_f64().unwrap() > 3.0, "{summary}");
    let own = Path::new(env!("CARGO_TARGET_TMPDIR")).join(summary["log"].as_str().unwrap());
    assert!(own.metadata().unwrap().len() > 10_000, "{summary}");
    for file in ["summary.json", "series.csv", "config.toml"] {
        assert!(own.with_file_name(file).exists(), "{file}: {summary}");
    }
    assert_eq!(summary["log_complete"], true);
    summary
}

#[test]
fn a_killed_insertion_is_withdrawn_by_its_log() {
    for backend in ["sim", "viper"] {
        let out = folder(&format!("withdraw/killed-{backend}"));
        let mut run = program()
            .args(["run", "--sensor", "shape", "--backend", backend])
            .args(["--set", "run.insertion_speed_mm_s=0.5"])
            .args(["--out", text(&out)])
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let log = out.join("run.mcap");
        wait_for_log(&log, 6_000_000);
        // SIGKILL.
        run.kill().unwrap();
        run.wait().unwrap();
        assert!(!out.join("summary.json").exists());
        let summary = assert_out(&log, &[]);
        let depth = summary["tip_depth_mm"].as_f64().unwrap();
        assert!(depth < 1.0, "{backend}: {summary}");
        let first = out.join("withdrawal-1").join("run.mcap");
        // The withdrawal's own log leads on: there is nothing left to withdraw.
        let output = needle_steer(&["withdraw", text(&first), "--json"]);
        let again = json(&output);
        let ended = again["ended"].as_str().unwrap();
        assert!(ended.starts_with("already at the start"), "{again}");
        assert!(output.status.success());
    }
}

#[test]
fn a_log_that_a_full_disk_cut_off_leads_out() {
    for backend in ["sim", "viper"] {
        full_disk(backend);
    }
}

fn full_disk(backend: &str) {
    let out = folder(&format!("withdraw/full-disk-{backend}"));
    // Beyond this size writing fails, as on a full disk; the signal that goes with it is ignored.
    let script = "trap '' XFSZ; ulimit -f 20000; exec \"$0\" \"$@\"";
    let run = Command::new("sh")
        .args(["-c", script, env!("CARGO_BIN_EXE_needle-steer")])
        .args(["run", "--sensor", "shape", "--json", "--backend", backend])
        .args(["--set", "run.insertion_speed_mm_s=0.5"])
        .args(["--out", text(&out)])
        .output()
        .unwrap();
    assert!(!run.status.success() || !run.stdout.is_empty());
    let summary = assert_out(&out.join("run.mcap"), &[]);
    assert!(summary["tip_depth_mm"].as_f64().unwrap() < 1.0, "{summary}");
}

/// What stands on the disk after a power failure: the beginning of the file, or the whole length
/// with nothing in its end.
#[test]
fn a_log_that_a_power_failure_cut_off_leads_out() {
    let out = folder("withdraw/power");
    let short = ["--set", "target.depth_mm=30", "--set", "target.offset_mm=1"];
    let run = ["run", "--sensor", "shape", "--out", text(&out)];
    let output = needle_steer(&[&run[..], &short].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let whole = std::fs::read(out.join("run.mcap")).unwrap();
    for (name, kept, zeros) in [
        ("first", 400_000, 0),
        ("half", whole.len() / 2, 0),
        ("zeros", whole.len() / 2, whole.len() / 4),
        ("end", whole.len() - 100, 0),
    ] {
        let cut = folder(&format!("withdraw/power-{name}"));
        std::fs::create_dir_all(&cut).unwrap();
        let log = cut.join("run.mcap");
        let mut bytes = whole[..kept].to_vec();
        bytes.resize(kept + zeros, 0);
        std::fs::write(&log, bytes).unwrap();
        let output = needle_steer(&["withdraw", text(&log), "--json"]);
        let summary = json(&output);
        assert!(
            output.status.success(),
            "{name}: {summary} {}",
            stderr(&output)
        );
        assert_eq!(summary["ended"], "retracted", "{name}: {summary}");
        let depth = summary["tip_depth_mm"].as_f64().unwrap();
        assert!(depth < 1.0, "{name}: {summary}");
    }
}

#[test]
fn what_is_no_log_of_an_insertion_is_named() {
    let folder = folder("withdraw/no-log");
    std::fs::create_dir_all(&folder).unwrap();
    let empty = folder.join("empty.mcap");
    std::fs::write(&empty, "").unwrap();
    for log in [&empty, &folder.join("none.mcap")] {
        let output = needle_steer(&["withdraw", text(log)]);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains(text(log)), "{}", stderr(&output));
    }
}

/// `emulate viper` in a process of its own: an arm that outlives its drivers.
struct Controller {
    process: Child,
    ports: [String; 2],
}

impl Controller {
    /// With the arm at the start of the default insertion, some joints moved \[rad\].
    fn start(aside: f64) -> Self {
        let output = needle_steer(&["run", "--dry-run", "--sensor", "shape"]);
        let mut joints = joints_of(&output);
        joints[2] += aside;
        let joints = joints.map(|q| q.to_degrees().to_string()).join(",");
        let mut process = emulator()
            .arg(format!("--joints-deg={joints}"))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let ports = ["motion", "state"].map(|name| {
            let line = lines.next().unwrap().unwrap();
            let (_, address) = line.split_once(' ').unwrap();
            let port = address.parse::<SocketAddr>().unwrap().port();
            format!("viper.{name}_port={port}")
        });
        Self { process, ports }
    }

    fn peer(&self) -> [&str; 4] {
        ["--set", &self.ports[0], "--set", &self.ports[1]]
    }

    /// A slow straight insertion in air.
    fn insert(&self, out: &Path) -> Command {
        let mut command = program();
        command
            .args(["run", "--backend", "viper", "--dry-run=air", "--json"])
            .args(["--sensor", "shape", "--law", "none"])
            .args(["--set", "viper.emulate=false"])
            .args(["--set", "run.insertion_speed_mm_s=3"])
            .args([
                "--set",
                "target.kind=aligned",
                "--set",
                "target.depth_mm=60",
            ])
            .args(self.peer())
            .args(["--out", text(out)]);
        command
    }

    fn joints(&self) -> [f64; 6] {
        let arguments = [
            "run",
            "--backend",
            "viper",
            "--dry-run",
            "--sensor",
            "shape",
        ];
        let emulate = ["--set", "viper.emulate=false"];
        let output = needle_steer(&[&arguments[..], &emulate, &self.peer()].concat());
        joints_of(&output)
    }
}

impl Drop for Controller {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// On the wall clock a busy computer may miss the driver's deadlines, which stops the arm; then
/// the same command goes on.
fn withdraw_at_last(log: &Path) -> serde_json::Value {
    let mut last = serde_json::Value::Null;
    for _ in 0..5 {
        let output = needle_steer(&["withdraw", text(log), "--json"]);
        last = json(&output);
        if output.status.success() {
            return last;
        }
    }
    panic!("still inside: {last}");
}

#[test]
fn an_arm_left_inside_by_another_process_is_withdrawn() {
    // To the program, or for a time to the controller: the link is lost, and comes back.
    for signal in ["-KILL", "-INT", "-STOP"] {
        let controller = Controller::start(0.0);
        let start = controller.joints();
        let out = folder(&format!("withdraw/process{signal}"));
        let mut run = controller
            .insert(&out)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let log = out.join("run.mcap");
        wait_for_log(&log, 500_000);
        let struck = if signal == "-STOP" {
            &controller.process
        } else {
            &run
        };
        let pid = struck.id().to_string();
        let send = |signal: &str| Command::new("kill").args([signal, &pid]).status();
        assert!(send(signal).unwrap().success());
        run.wait().unwrap();
        if signal == "-STOP" {
            let summary = std::fs::read_to_string(out.join("summary.json")).unwrap();
            assert!(summary.contains(r#""cause": "device""#), "{summary}");
            assert!(send("-CONT").unwrap().success());
        }
        let inside = controller.joints();
        assert!(apart(&start, &inside) > 5e-3, "{start:?} {inside:?}");
        // Another insertion is refused, and told the way out.
        let output = controller
            .insert(&folder("withdraw/refused"))
            .output()
            .unwrap();
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{message}");
        let told = format!("needle-steer withdraw {}", text(&log));
        assert!(message.contains(&told), "{message}");
        let summary = withdraw_at_last(&log);
        assert_eq!(summary["ended"], "retracted", "{summary}");
        let back = controller.joints();
        assert!(apart(&start, &back) < 6e-3, "{start:?} {back:?}");
        let again = withdraw_at_last(&log);
        let ended = again["ended"].as_str().unwrap();
        assert!(ended.starts_with("already at the start"), "{again}");
    }
}

#[test]
fn an_arm_beside_the_recorded_path_is_refused_with_figures() {
    let out = folder("withdraw/beside");
    let short = ["--set", "target.depth_mm=30", "--set", "target.offset_mm=1"];
    let run = ["run", "--sensor", "shape", "--out", text(&out)];
    let output = needle_steer(&[&run[..], &short].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let controller = Controller::start(0.05);
    let before = controller.joints();
    let log = out.join("run.mcap");
    let viper = ["--backend", "viper", "--set", "viper.emulate=false"];
    let own = ["withdraw", text(&log), "--json"];
    let output = needle_steer(&[&own[..], &viper, &controller.peer()].concat());
    assert_eq!(output.status.code(), Some(1));
    let summary = json(&output);
    let ended = summary["ended"].as_str().unwrap();
    assert!(ended.contains("mm and"), "{ended}");
    assert!(stderr(&output).contains("joints ["), "{}", stderr(&output));
    assert!(apart(&before, &controller.joints()) < 1e-4);
}
