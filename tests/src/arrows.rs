//! Holds the crates' dependencies against the allowed arrows.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Command;

pub(crate) const MEMBERS: [&str; 12] = [
    "hal",
    "needle-model",
    "hybrid-control",
    "vision",
    "robots",
    "phantom",
    "ros2wire",
    "rosbridge",
    "igtl",
    "needle-steer",
    "python",
    "tests",
];

/// Which of our crates each crate may depend on, directly or through others.
fn allowed(member: &str) -> &'static [&'static str] {
    match member {
        "hybrid-control" => &["hal", "needle-model"],
        // With the feature `ros2`, `rosbridge` may use more: that has its own test.
        "vision" | "robots" | "phantom" | "rosbridge" => &["hal"],
        // The application may use every library; they stand before it.
        "needle-steer" => &MEMBERS[..9],
        // A layer over the application.
        "python" => &MEMBERS[..10],
        _ => &[],
    }
}

fn workspace() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// Members of ours in the tree of `member`, itself excluded. Without `--no-dedupe` a subtree
/// that was printed before is cut, and an arrow could hide in it.
fn dependencies(member: &str, edges: &str) -> BTreeSet<String> {
    tree(member, edges, &[])
}

fn tree(member: &str, edges: &str, more: &[&str]) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args([
            "tree",
            "--offline",
            "--locked",
            "--no-dedupe",
            "--prefix",
            "none",
        ])
        .args(["--format", "{p}", "-e", edges, "-p", member])
        .args(more)
        .current_dir(workspace())
        // Features unified over the workspace make every member a root of the tree.
        .env_remove("CARGO_RESOLVER_FEATURE_UNIFICATION")
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| MEMBERS.contains(name) && *name != member)
        .map(str::to_owned)
        .collect()
}

#[test]
fn crates_keep_to_the_allowed_arrows() {
    for member in MEMBERS {
        for edges in ["normal,build", "normal,build,dev"] {
            if member == "tests" && edges.contains("dev") {
                continue; // its dev-dependencies are its purpose
            }
            let found = dependencies(member, edges);
            let allowed: BTreeSet<String> =
                allowed(member).iter().map(|s| (*s).to_owned()).collect();
            let forbidden: Vec<_> = found.difference(&allowed).collect();
            assert!(
                forbidden.is_empty(),
                "{member} ({edges}) must not depend on {forbidden:?}"
            );
        }
    }
}

#[test]
fn the_phantom_cannot_see_the_controller() {
    let found = dependencies("phantom", "normal,build,dev");
    assert_eq!(found, BTreeSet::from(["hal".to_owned()]));
}

/// What speaks ROS 2 is no part of a build that does not ask for it.
#[test]
fn ros_2_is_asked_for() {
    for member in ["rosbridge", "needle-steer", "python"] {
        let found = dependencies(member, "normal,build");
        assert!(!found.contains("ros2wire"), "{member}");
    }
    let asked = tree("rosbridge", "normal,build", &["--features", "ros2"]);
    let expected = ["hal", "ros2wire"].map(str::to_owned);
    assert_eq!(asked, BTreeSet::from(expected));
}

#[test]
fn the_workspace_has_exactly_these_members() {
    let manifest: toml::Table = std::fs::read_to_string(workspace().join("Cargo.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let members: Vec<&str> = manifest["workspace"]["members"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_str().unwrap())
        .collect();
    assert_eq!(members, MEMBERS);
    assert!(
        !manifest.contains_key("package"),
        "the root stays a virtual manifest"
    );
}
