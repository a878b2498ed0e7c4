//! Every command that the documentation shows is a command of this program, and what a page prints is
//! what the program prints.
#![expect(clippy::unwrap_used, reason = "a failed step is a failed test")]

mod tutorial;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

fn pages() -> Vec<(PathBuf, String)> {
    let root = Path::new(ROOT);
    let mut files: Vec<PathBuf> = std::fs::read_dir(root.join("docs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "md"))
        .collect();
    files.push(root.join("README.md"));
    files.sort();
    files
        .into_iter()
        .map(|file| (file.clone(), std::fs::read_to_string(file).unwrap()))
        .collect()
}

/// The commands of a page: in code spans, and lines of code blocks; without the program's name.
fn commands(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut add = |code: &str| {
        let code = code.split(" #").next().unwrap_or(code).trim();
        for start in ["needle-steer ", "cargo run --release -- "] {
            if let Some(command) = code.strip_prefix(start) {
                found.push(command.trim().to_owned());
            }
        }
    };
    let mut fenced = false;
    let mut prose = String::new();
    for line in text.lines() {
        if line.starts_with("```") {
            fenced = !fenced;
        } else if fenced || line.starts_with("    ") {
            add(line.trim());
        } else {
            prose.push_str(line);
            prose.push(' ');
        }
    }
    for span in prose.split('`').skip(1).step_by(2) {
        add(span);
    }
    found
}

/// The words of a command as a shell has them: quotes hold blanks and fall away.
fn words(command: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    for c in command.chars() {
        match (quote, c) {
            (Some(open), c) if c == open => quote = None,
            (None, '\'' | '"') => quote = Some(c),
            (None, c) if c.is_whitespace() => words.push(String::new()),
            (_, c) => words.last_mut().unwrap().push(c),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

fn needle_steer(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_needle-steer"))
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

#[test]
fn every_command_and_option_in_the_docs_exists() {
    let mut checked = 0;
    for (file, text) in pages() {
        for command in commands(&text) {
            let words = words(&command);
            let words: Vec<&str> = words.iter().map(String::as_str).collect();
            let mut arguments: Vec<&str> = Vec::new();
            // Subcommands are the leading words that the help of what stands before names.
            let mut help = help_of(&arguments);
            while let Some(word) = words.get(arguments.len()) {
                let named = !word.starts_with('-')
                    && help.lines().any(|line| {
                        line.starts_with("  ") && line.split_whitespace().next() == Some(word)
                    });
                if !named {
                    break;
                }
                arguments.push(word);
                help = help_of(&arguments);
            }
            let global = words.first().is_some_and(|w| w.starts_with("--"));
            assert!(
                !arguments.is_empty() || global,
                "{}: `needle-steer {command}`: no such command",
                file.display()
            );
            let options = words
                .iter()
                .filter(|word| word.starts_with("--") && word.len() > 2)
                .map(|word| word.split('=').next().unwrap_or(word));
            for option in options {
                assert!(
                    help.contains(option),
                    "{}: `needle-steer {command}` has no {option}",
                    file.display()
                );
            }
            checked += 1;
        }
    }
    assert!(checked > 25, "only {checked} commands found");
}

fn help_of(arguments: &[&str]) -> String {
    let mut with_help = arguments.to_vec();
    with_help.push("--help");
    let output = needle_steer(&with_help, Path::new("."));
    String::from_utf8(output.stdout).unwrap()
}

/// Less of what takes long; what is not the point of a command stays.
fn reduced(command: &str) -> Vec<String> {
    let mut words = words(command);
    if let Some(k) = words.iter().position(|w| w == "--runs") {
        words[k + 1] = "1".into();
    } else if words[0] == "reproduce" {
        words.extend(["--runs".into(), "1".into()]);
    }
    words
}

/// Whether a command stands for many: file names, dots or upper case in place of arguments.
fn is_pattern(command: &str) -> bool {
    command.contains("...")
        || command.contains("images")
        || command
            .split(|c: char| c.is_whitespace() || c == '/')
            .any(|word| word.len() > 1 && word.chars().all(|c| c.is_ascii_uppercase() || c == '_'))
}

/// Files that a page shows: a fence `toml` below a line that names one.
fn shown_files(text: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut named: Option<String> = None;
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if line == "```toml" {
            let body: Vec<&str> = lines.by_ref().take_while(|line| *line != "```").collect();
            found.extend(named.take().map(|name| (name, body.join("\n"))));
        } else if !line.is_empty() {
            let is_toml = |word: &&str| Path::new(word).extension().is_some_and(|e| e == "toml");
            named = line.split('`').find(is_toml).map(str::to_owned);
        }
    }
    found
}

/// Commands that connect to a controller, which is not here: they end with that reason.
const NEEDS_A_PEER: [&str; 1] = ["run --set viper.emulate=false --backend viper --dry-run"];

/// The other pages' commands, as far as they stand alone.
#[test]
fn commands_of_the_other_pages_run() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pages");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(
        folder.join("arm.toml"),
        "[arm]\ntip_link = \"needle_base\"\n",
    )
    .unwrap();
    std::fs::write(folder.join("arm.urdf"), robots::arms::VIPER_S650).unwrap();
    // Pages name the arms of the project as from its root.
    let urdf = Path::new(ROOT).join("robots/urdf");
    std::fs::create_dir_all(folder.join("robots/urdf")).unwrap();
    for arm in std::fs::read_dir(urdf).unwrap().map(Result::unwrap) {
        let copy = folder.join("robots/urdf").join(arm.file_name());
        std::fs::copy(arm.path(), copy).unwrap();
    }
    let mut seen = BTreeSet::new();
    for (file, text) in pages() {
        if file.ends_with("TUTORIAL.md") {
            continue;
        }
        for (name, body) in shown_files(&text) {
            let shown = folder.join(name);
            if !shown.exists() {
                std::fs::write(shown, body).unwrap();
            }
        }
        for command in commands(&text) {
            let first = command.split_whitespace().next().unwrap_or_default();
            // Devices that wait for a peer, pictures, maps and logs that are not here.
            let elsewhere = ["emulate", "calibrate", "track", "ros", "relay"].contains(&first)
                || command.contains(" ros")
                || command.contains(".mcap")
                || command.contains("em.map=")
                // Served until somebody stops it, or measured by another program; `tests/remote` does.
                || ["--live", "--igtl", "--tracker"].iter().any(|way| command.contains(way))
                || command.contains('>');
            if elsewhere || is_pattern(&command) || !seen.insert(command.clone()) {
                continue;
            }
            let words = reduced(&command);
            let words: Vec<&str> = words.iter().map(String::as_str).collect();
            let output = needle_steer(&words, &folder);
            let expected = i32::from(NEEDS_A_PEER.contains(&command.as_str()));
            assert_eq!(
                output.status.code(),
                Some(expected),
                "{}: {command}: {}",
                file.display(),
                String::from_utf8_lossy(&output.stderr)
            );
            if expected == 1 {
                let errors = String::from_utf8_lossy(&output.stderr);
                assert!(errors.contains("cannot connect"), "{command}: {errors}");
            }
        }
    }
    assert!(seen.len() >= 5, "{seen:?}");
}
