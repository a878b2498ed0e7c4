//! What a laboratory does with its runs: replay, comparison, campaigns, reports, identification,
//! and what is left when a process is killed.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::{folder, json, needle_steer, program, stderr, stdout, text};

/// The log of a short insertion.
fn log_of(folder: &Path, more: &[&str]) -> PathBuf {
    let mut arguments = vec![
        "run",
        "--out",
        text(folder),
        "--set",
        "target.depth_mm=30",
        "--set",
        "target.offset_mm=1",
    ];
    arguments.extend(more);
    let output = needle_steer(&arguments);
    assert!(output.status.code().is_some(), "{}", stderr(&output));
    folder.join("run.mcap")
}

#[test]
fn replay_gives_the_same_commands_and_another_law_others() {
    for law in ["hybrid", "paper", "paper-verbatim", "broyden"] {
        let log = log_of(&folder(&format!("lab/replay-{law}")), &["--law", law]);
        let output = needle_steer(&["replay", "--json", text(&log)]);
        assert!(output.status.success(), "{law}: {}", stderr(&output));
        let report = json(&output);
        assert!(report["steps"].as_u64().unwrap() > 500, "{report}");
        assert_eq!(report["differing"], 0, "{law}: {report}");
        assert_eq!(report["differing_reports"], 0, "{law}: {report}");
        assert_eq!(report["complete"], true);
    }
    let log = folder("lab/replay-other");
    let log = log_of(&log, &[]);
    let output = needle_steer(&["replay", "--json", "--law", "none", text(&log)]);
    assert_eq!(output.status.code(), Some(1));
    let report = json(&output);
    assert!(report["differing"].as_u64().unwrap() > 100, "{report}");
    assert!(
        report["first"]["depth_mm"].as_f64().unwrap() > 1.0,
        "{report}"
    );
}

#[test]
fn the_emulated_viper_replays_too() {
    let log = log_of(&folder("lab/replay-viper"), &["--backend", "viper"]);
    let output = needle_steer(&["replay", "--json", text(&log)]);
    assert!(output.status.success(), "{}", stdout(&output));
}

#[test]
fn diff_says_where_two_runs_part() {
    let first = log_of(&folder("lab/diff-a"), &["--seed", "3"]);
    let same = log_of(&folder("lab/diff-b"), &["--seed", "3"]);
    let other = log_of(&folder("lab/diff-c"), &["--seed", "4"]);
    let output = needle_steer(&["diff", "--json", text(&first), text(&same)]);
    assert!(output.status.success(), "{}", stdout(&output));
    let output = needle_steer(&["diff", "--json", text(&first), text(&other)]);
    assert_eq!(output.status.code(), Some(1));
    let found = json(&output);
    assert_eq!(found["config"][0]["key"], "run.seed");
    let part = |what: &str| found[what]["step"].as_u64().unwrap();
    // What is measured differs before what is decided can.
    assert!(part("measurements") <= part("commands"), "{found}");
    assert!(found["results"][0]["ended"].is_string());
}

const CAMPAIGN: &str = "laws = [\"hybrid\", \"none\"]\nseeds = { first = 11, count = 4 }\n\
    [[target]]\nkind = \"aligned\"\ndepth_mm = 25.0\n[[target]]\nname = \"aside\"\n\
    depth_mm = 25.0\noffset_mm = 1.0\n[config.run]\ninsertion_speed_mm_s = 2.0\n";

fn campaign(folder: &Path) -> PathBuf {
    let file = folder.join("campaign-file.toml");
    std::fs::write(&file, CAMPAIGN).unwrap();
    file
}

#[test]
fn shards_merge_to_the_table_of_the_whole() {
    let folder = folder("lab/campaign-shards");
    let file = campaign(&folder);
    let (whole, one, two) = (folder.join("whole"), folder.join("one"), folder.join("two"));
    let output = needle_steer(&["campaign", text(&file), "--out", text(&whole), "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let found = json(&output);
    assert_eq!(
        (&found["runs"], &found["finished"]),
        (&16.into(), &16.into())
    );
    assert_eq!(found["pairs"].as_array().unwrap().len(), 2);
    for (shard, out) in [("1/2", &one), ("2/2", &two)] {
        let output = needle_steer(&[
            "campaign",
            text(&file),
            "--shard",
            shard,
            "--jobs",
            "1",
            "--out",
            text(out),
        ]);
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let merged = folder.join("merged");
    // One shard alone is not the whole.
    let output = needle_steer(&["campaign", "merge", text(&one), "--out", text(&merged)]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("8 of 16 runs are missing"),
        "{}",
        stderr(&output)
    );
    let output = needle_steer(&[
        "campaign",
        "merge",
        text(&one),
        text(&two),
        "--out",
        text(&merged),
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    let table = |folder: &Path| std::fs::read_to_string(folder.join("results.csv")).unwrap();
    assert_eq!(table(&merged), table(&whole));
    // What was put together is reported like what was made in one place.
    let output = needle_steer(&["report", text(&merged)]);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(table(&whole).lines().count(), 17);
    // The page of the campaign.
    let output = needle_steer(&["report", text(&whole)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let page = std::fs::read_to_string(whole.join("report.html")).unwrap();
    assert!(page.contains("Paired against the law hybrid"));
}

/// Pseudo-random numbers below one: moments to kill at.
fn moments(count: usize) -> Vec<f64> {
    let mut state = 20_u64;
    (0..count)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(99);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        })
        .collect()
}

#[expect(
    clippy::disallowed_methods,
    reason = "the kill is timed by the wall clock"
)]
fn kill_after(mut child: Child, delay: Duration) {
    std::thread::sleep(delay);
    // SIGKILL; one that has ended is as good.
    let _ = child.kill();
    child.wait().unwrap();
}

#[expect(
    clippy::disallowed_methods,
    reason = "the kill is timed by the wall clock"
)]
fn now() -> Instant {
    Instant::now()
}

#[test]
fn a_campaign_killed_at_random_moments_loses_and_doubles_nothing() {
    let folder = folder("lab/campaign-killed");
    let file = campaign(&folder);
    let whole = folder.join("whole");
    let begun = now();
    let output = needle_steer(&["campaign", text(&file), "--out", text(&whole)]);
    let duration = begun.elapsed();
    assert!(output.status.success(), "{}", stderr(&output));
    let expected = std::fs::read_to_string(whole.join("results.csv")).unwrap();
    let killed = folder.join("killed");
    let ledger = killed.join("ledger-1-of-1.csv");
    let mut kept: Vec<String> = Vec::new();
    for moment in moments(20) {
        let child = program()
            .args(["campaign", text(&file), "--out", text(&killed)])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        kill_after(child, duration.mul_f64(0.3 * moment));
        // What was finished before is still there, in the same words.
        let lines = std::fs::read_to_string(&ledger).unwrap_or_default();
        let whole_lines: Vec<String> = lines
            .split_inclusive('\n')
            .filter(|line| line.ends_with('\n'))
            .map(str::to_owned)
            .collect();
        assert!(whole_lines.starts_with(&kept), "a finished run was lost");
        kept = whole_lines;
    }
    let output = needle_steer(&["campaign", text(&file), "--out", text(&killed)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let table = std::fs::read_to_string(killed.join("results.csv")).unwrap();
    assert_eq!(table, expected);
}

#[test]
fn a_run_killed_at_random_moments_leaves_a_readable_log() {
    let folder = folder("lab/run-killed");
    let begun = now();
    log_of(&folder.join("whole"), &["--set", "target.depth_mm=80"]);
    let duration = begun.elapsed();
    let mut readable = 0;
    for (k, moment) in moments(20).into_iter().enumerate() {
        let out = folder.join(k.to_string());
        let child = program()
            .args(["run", "--out", text(&out)])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        kill_after(child, duration.mul_f64(0.1 + 0.8 * moment));
        let log = out.join("run.mcap");
        if !log.exists() || log.metadata().unwrap().len() < 20_000 {
            continue;
        }
        let output = needle_steer(&["replay", "--json", text(&log)]);
        // Killed before its first step it has none, and says so.
        if output.status.code() == Some(2) {
            assert!(stderr(&output).contains("no step"), "{}", stderr(&output));
            continue;
        }
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(json(&output)["differing"], 0);
        readable += 1;
    }
    assert!(readable >= 10, "only {readable} of 20 logs had a step");
}

#[test]
fn a_report_is_one_page_that_fetches_nothing() {
    let folder = folder("lab/report");
    let log = log_of(&folder, &[]);
    let output = needle_steer(&["report", text(&log)]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(stdout(&output).trim(), text(&folder.join("run.html")));
    let page = std::fs::read_to_string(folder.join("run.html")).unwrap();
    for part in [
        "target passed",
        "Fig. 3",
        "tissue stiffness",
        "Limits that acted",
        "Time of a step",
        "\"sliders\"",
        "What the cameras saw",
        "<polyline",
        "[run]",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<script src") && !page.contains("<link"));
    assert_eq!(
        page.matches("plotly.js v").count(),
        1,
        "the library stands once"
    );
    let reproduced = folder.join("reproduced");
    let output = needle_steer(&[
        "reproduce",
        "--experiments",
        "e1,e2",
        "--runs",
        "2",
        "--out",
        text(&reproduced),
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    let output = needle_steer(&["report", text(&reproduced.join("reproduce.json"))]);
    assert!(output.status.success(), "{}", stderr(&output));
}

/// Run in the page: how many charts were drawn, and whether a frame of the slider moves the needle.
const PROBE: &str = "<script>setTimeout(async () => {
    const scene = document.getElementById('scene');
    const tip = () => scene.data[0].z.slice(-1)[0];
    const last = tip();
    await Plotly.animate('scene', ['5'],
        {mode: 'immediate', frame: {duration: 0, redraw: true}, transition: {duration: 0}});
    const buttons = [...document.querySelectorAll('.updatemenu-button')].map(b => b.textContent);
    document.title = 'probe ' + document.querySelectorAll('.js-plotly-plot').length + ' ' +
        (tip() > last + 5) + ' ' + buttons.join(' ');
}, 500);</script></body>";

/// Needs a browser: says so and ends where none is installed.
#[test]
fn a_browser_draws_the_report_and_its_slider_moves_the_needle() {
    let Some(browser) = ["chromium", "chromium-browser", "google-chrome"]
        .into_iter()
        .find(|name| Command::new(name).arg("--version").output().is_ok())
    else {
        println!("no chromium here: the report was not drawn");
        return;
    };
    let folder = folder("lab/browser");
    let log = log_of(&folder, &[]);
    assert!(needle_steer(&["report", text(&log)]).status.success());
    let page = std::fs::read_to_string(folder.join("run.html")).unwrap();
    let probed = folder.join("probe.html");
    std::fs::write(&probed, page.replace("</body>", PROBE)).unwrap();
    // A browser on a busy computer may give up drawing in software; it then starts anew.
    let mut told = String::new();
    for _ in 0..3 {
        let output = Command::new(browser)
            .args([
                "--headless=new",
                "--no-sandbox",
                "--use-gl=angle",
                "--use-angle=swiftshader",
            ])
            .args([
                "--enable-unsafe-swiftshader",
                "--virtual-time-budget=20000",
                "--dump-dom",
            ])
            .arg(format!("file://{}", text(&probed)))
            .output()
            .unwrap();
        let dom = String::from_utf8_lossy(&output.stdout);
        let title = dom
            .split("<title>")
            .nth(1)
            .and_then(|t| t.split("</title>").next());
        if title == Some("probe 10 true play pause") {
            return;
        }
        told = format!("{title:?}: {}", stderr(&output));
    }
    panic!("{told}");
}

#[test]
fn identification_writes_a_configuration_that_runs() {
    let folder = folder("lab/estimate");
    let mut logs = Vec::new();
    for seed in ["21", "22"] {
        let out = folder.join(seed);
        let output = needle_steer(&["run", "--seed", seed, "--out", text(&out)]);
        assert!(output.status.code().is_some());
        logs.push(out.join("run.mcap"));
    }
    let config = folder.join("mine.toml");
    let output = needle_steer(&[
        "estimate",
        text(&logs[0]),
        text(&logs[1]),
        "--out",
        text(&config),
        "--json",
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    let found = json(&output);
    let k = found["stiffness_n_m2"]["value"].as_f64().unwrap();
    // The phantom's mean is 10 000 with a spread of a fifth.
    assert!((5_000.0..20_000.0).contains(&k), "{found}");
    let output = needle_steer(&["run", text(&config), "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    // A straight insertion turns no bevel.
    let straight = folder.join("straight");
    needle_steer(&["run", "--law", "none", "--out", text(&straight)]);
    let log = straight.join("run.mcap");
    let output = needle_steer(&["estimate", text(&log), "--json"]);
    let found = json(&output);
    assert_eq!(found["cut_angle_deg"]["identified"], false, "{found}");
    assert!(
        found["cut_angle_deg"]["reason"]
            .as_str()
            .unwrap()
            .contains("bevel")
    );
}

#[test]
fn what_cannot_be_read_is_named_and_nothing_is_written() {
    let folder = folder("lab/bad-input");
    let foreign = folder.join("foreign.mcap");
    std::fs::write(&foreign, "this is no log").unwrap();
    let empty = folder.join("empty.mcap");
    std::fs::write(&empty, "").unwrap();
    let csv = folder.join("short.csv");
    std::fs::write(&csv, "t_s,base_x_m\n0,1\n").unwrap();
    let campaign_file = campaign(&folder);
    let typo = folder.join("typo.toml");
    std::fs::write(&typo, CAMPAIGN.replace("laws", "lawz")).unwrap();
    let other = folder.join("other.toml");
    std::fs::write(&other, CAMPAIGN.replace("count = 4", "count = 1")).unwrap();
    let out = folder.join("out");
    let cases: Vec<(Vec<&str>, i32, &str)> = vec![
        (vec!["replay", text(&foreign)], 2, "foreign.mcap"),
        (vec!["replay", text(&empty)], 2, "empty.mcap"),
        (vec!["replay", "/does/not/exist.mcap"], 2, "exist.mcap"),
        (
            vec!["diff", text(&foreign), text(&empty)],
            2,
            "foreign.mcap",
        ),
        (vec!["report", text(&foreign)], 2, "foreign.mcap"),
        (vec!["estimate", text(&csv)], 2, "the columns base_y_m"),
        (vec!["estimate", text(&foreign)], 2, "foreign.mcap"),
        (
            vec!["campaign", text(&typo), "--out", text(&out)],
            2,
            "line 1",
        ),
        (
            vec![
                "campaign",
                text(&campaign_file),
                "--shard",
                "3/2",
                "--out",
                text(&out),
            ],
            2,
            "expected K/N",
        ),
        (vec!["campaign", text(&campaign_file)], 2, "--out"),
        (vec!["campaign", "merge", text(&folder)], 2, "campaign.toml"),
        (
            vec!["campaign", text(&campaign_file), "--out", "/proc/nowhere"],
            1,
            "/proc/nowhere",
        ),
    ];
    for (arguments, code, expected) in cases {
        let output = needle_steer(&arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(message.contains(expected), "{arguments:?}: {message}");
        assert!(!out.exists(), "{arguments:?} wrote something");
    }
    // A folder with another campaign's results is left alone.
    let output = needle_steer(&["campaign", text(&other), "--out", text(&out)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let before = std::fs::read(out.join("results.csv")).unwrap();
    let output = needle_steer(&["campaign", text(&campaign_file), "--out", text(&out)]);
    assert!(
        stderr(&output).contains("another campaign"),
        "{}",
        stderr(&output)
    );
    assert_eq!(std::fs::read(out.join("results.csv")).unwrap(), before);
    assert_eq!(
        std::fs::read_to_string(out.join("campaign.toml")).unwrap(),
        std::fs::read_to_string(&other).unwrap()
    );
}

#[test]
fn the_version_names_the_commit_of_a_checkout() {
    let version = stdout(&needle_steer(&["--version"]));
    assert!(
        version.starts_with(concat!("needle-steer ", env!("CARGO_PKG_VERSION"))),
        "{version}"
    );
    let commit = Command::new("git")
        .args(["rev-parse", "--short=10", "HEAD"])
        .output();
    if let Ok(commit) = commit
        && commit.status.success()
    {
        assert!(version.contains(stdout(&commit).trim()), "{version}");
    }
}
