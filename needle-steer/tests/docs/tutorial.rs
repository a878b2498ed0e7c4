//! The tutorial, command by command in its order. An output block shows all that the commands of the
//! block before it print; `RENEW_DOCS=1 cargo test --release -p needle-steer --test docs tutorial`
//! writes the outputs into the page anew, with all runs.

use std::path::Path;

use super::{ROOT, needle_steer, reduced, words};

/// Commands that say that something differs, by their exit code.
const DIFFER: [&str; 2] = [
    "diff first/run.mcap second/run.mcap",
    "replay first/run.mcap --law paper",
];
/// How far a printed number may lie from the page's: another processor adds in another order.
const RELATIVE: f64 = 0.05;
/// The same for numbers near zero, in whatever unit they are printed.
const ABSOLUTE: f64 = 0.05;

/// A piece of a page.
enum Piece {
    /// Words, and fences that are neither of the next two.
    Text(Vec<String>),
    /// A fence `toml` below a line that names its file.
    File(String, String),
    /// A fence `sh`.
    Commands(Vec<String>),
    /// A bare fence.
    Output(Vec<String>),
}

#[expect(clippy::panic, reason = "a page that cannot be read fails its test")]
fn pieces(page: &str) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let mut text: Vec<String> = Vec::new();
    let mut lines = page.lines();
    while let Some(line) = lines.next() {
        let Some(language) = line.strip_prefix("```") else {
            text.push(line.to_owned());
            continue;
        };
        let body: Vec<String> = lines
            .by_ref()
            .take_while(|line| *line != "```")
            .map(str::to_owned)
            .collect();
        let named = text.iter().rev().find(|line| !line.is_empty()).cloned();
        let file = named.as_deref().and_then(|line| {
            line.split('`')
                .find(|word| Path::new(word).extension().is_some_and(|e| e == "toml"))
                .map(str::to_owned)
        });
        pieces.push(Piece::Text(std::mem::take(&mut text)));
        pieces.push(match (language, file) {
            ("sh", _) => Piece::Commands(body),
            ("", _) => Piece::Output(body),
            ("toml", Some(name)) => Piece::File(name, body.join("\n") + "\n"),
            _ => panic!("a fence of `{language}` under `{named:?}`"),
        });
    }
    pieces.push(Piece::Text(text));
    pieces
}

/// The page with its pieces put together again.
fn page(pieces: &[Piece]) -> String {
    let mut text = String::new();
    for piece in pieces {
        let (open, lines): (Option<&str>, Vec<&str>) = match piece {
            Piece::Text(lines) => (None, lines.iter().map(String::as_str).collect()),
            Piece::File(_, body) => (Some("toml"), body.lines().collect()),
            Piece::Commands(lines) => (Some("sh"), lines.iter().map(String::as_str).collect()),
            Piece::Output(lines) => (Some(""), lines.iter().map(String::as_str).collect()),
        };
        let fence = open.map(|language| format!("```{language}"));
        let close = open.map(|_| "```".to_owned());
        for line in fence
            .into_iter()
            .chain(lines.into_iter().map(str::to_owned))
            .chain(close)
        {
            text += &line;
            text.push('\n');
        }
    }
    text
}

/// The words of a text with its numbers apart: `0.041 mm` is `# mm` and 0.041. The build's name is
/// left out.
fn words_and_numbers(text: &str) -> (String, Vec<f64>) {
    let (mut words, mut numbers) = (String::new(), Vec::new());
    for word in text.split_whitespace() {
        let build = word.starts_with('(') && word.trim_end_matches([')', ':']).len() == 11;
        if build {
            continue;
        }
        let mut rest = word;
        while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
            let sign = usize::from(rest[..at].ends_with(['-', '+']));
            words += &rest[..at - sign];
            let number = &rest[at - sign..];
            let length = (1..=number.len())
                .rev()
                .find(|&n| number.is_char_boundary(n) && number[..n].parse::<f64>().is_ok())
                .unwrap();
            numbers.push(number[..length].parse().unwrap());
            words.push('#');
            rest = &number[length..];
        }
        words += rest;
        words.push(' ');
    }
    (words, numbers)
}

/// Asserts that the page prints what was printed; of a command with fewer runs the words only.
fn agree(command: &str, shown: &str, printed: &str, whole: bool) {
    let (mut words, numbers) = words_and_numbers(shown);
    let (mut printed_words, printed_numbers) = words_and_numbers(printed);
    if !whole {
        // Few seeds have no interval of the median.
        words = words.replace("# to #", "-");
        printed_words = printed_words.replace("# to #", "-");
    }
    assert_eq!(
        words, printed_words,
        "{command}: the page shows\n{shown}\nand it prints\n{printed}"
    );
    for (shown_number, number) in numbers.iter().zip(&printed_numbers) {
        let tolerance = RELATIVE * number.abs() + ABSOLUTE;
        assert!(
            !whole || (shown_number - number).abs() <= tolerance,
            "{command}: {shown_number} on the page, {number} printed:\n{printed}"
        );
    }
}

#[test]
fn numbers_are_told_from_words() {
    let (words, numbers) =
        words_and_numbers("p = 4.14e-2, [-0.026 to 20/20], 0.1.0 (98b9cde642): e2");
    assert_eq!(words, "p = #, [# to #/#], #.# e# ");
    assert_eq!(numbers, [4.14e-2, -0.026, 20.0, 20.0, 0.1, 0.0, 2.0]);
}

#[test]
fn the_tutorial_works_and_prints_as_written() {
    let renew = std::env::var_os("RENEW_DOCS").is_some();
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("tutorial");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    std::os::unix::fs::symlink(Path::new(ROOT).join("robots"), folder.join("robots")).unwrap();
    let file = Path::new(ROOT).join("docs/TUTORIAL.md");
    let text = std::fs::read_to_string(&file).unwrap();
    let mut pieces = pieces(&text);
    assert_eq!(page(&pieces), text, "a page is its pieces");

    let (mut done, mut compared) = (0, 0);
    let mut printed = String::new();
    let (mut last, mut whole) = (String::new(), true);
    for piece in &mut pieces {
        match piece {
            Piece::Text(_) => {}
            Piece::File(name, body) => {
                let fewer = body.replace("count = 20", "count = 2");
                assert_ne!(&fewer, body, "{name}");
                std::fs::write(folder.join(name), if renew { body } else { &fewer }).unwrap();
            }
            Piece::Commands(lines) => {
                printed.clear();
                whole = true;
                for line in lines {
                    last = line.strip_prefix("needle-steer ").unwrap().to_owned();
                    let (command, to) = match last.split_once(" > ") {
                        Some((command, file)) => (command, Some(file)),
                        None => (last.as_str(), None),
                    };
                    let words = if renew {
                        words(command)
                    } else {
                        reduced(command)
                    };
                    whole &= !command.starts_with("campaign");
                    let words: Vec<&str> = words.iter().map(String::as_str).collect();
                    let output = needle_steer(&words, &folder);
                    let expected = i32::from(DIFFER.contains(&command));
                    assert_eq!(
                        output.status.code(),
                        Some(expected),
                        "{command}: {}",
                        String::from_utf8_lossy(&output.stderr)
                    );
                    let stdout = String::from_utf8(output.stdout).unwrap();
                    match to {
                        Some(file) => std::fs::write(folder.join(file), stdout).unwrap(),
                        None => printed += &stdout,
                    }
                    done += 1;
                }
            }
            Piece::Output(shown) if renew => {
                *shown = printed.lines().map(str::to_owned).collect();
            }
            Piece::Output(shown) => {
                agree(&last, &shown.join("\n"), &printed, whole);
                compared += 1;
            }
        }
    }
    if renew {
        std::fs::write(&file, page(&pieces)).unwrap();
        return;
    }
    assert!(done >= 18, "only {done} commands");
    assert!(compared >= 8, "only {compared} outputs");
    for file in [
        "first/run.html",
        "laws/report.html",
        "all/results.csv",
        "needle.toml",
    ] {
        assert!(folder.join(file).exists(), "{file}");
    }
}
