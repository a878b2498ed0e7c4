//! What the system says of a file, in words that name the remedy.

/// The system's words, and what they mean to somebody who gave a file.
const WORDS: [(&str, &str); 9] = [
    (
        "No such file or directory",
        "there is no such file or folder; look at its name, and at the folder from which it counts",
    ),
    (
        "Permission denied",
        "permission denied: its owner or its mode (ls -l) does not let you",
    ),
    ("Is a directory", "is a folder, expected a file"),
    (
        "Not a directory",
        "a part of this path is a file, expected a folder",
    ),
    (
        "No space left on device",
        "the disk is full; make room, or name a folder elsewhere",
    ),
    (
        "Read-only file system",
        "nothing can be written there (read-only); name a folder elsewhere",
    ),
    ("File name too long", "the name is too long"),
    (
        "Address already in use",
        "another program has this port; end that one, or name another port",
    ),
    (
        "stream did not contain valid UTF-8",
        "is not text in UTF-8: a binary file, or UTF-16 as some editors write it; save it as UTF-8",
    ),
];

/// `text` with the system's words replaced, without their numbers.
pub(super) fn plain(text: &str) -> String {
    let mut text = text.to_owned();
    for (said, meant) in WORDS {
        text = text.replace(said, meant);
    }
    while let Some(from) = text.find(" (os error ") {
        let Some(length) = text.get(from..).and_then(|rest| rest.find(')')) else {
            break;
        };
        text.replace_range(from..=from + length, "");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn what_the_system_says_becomes_what_to_do() {
        let missing = std::fs::read("/nowhere/at/all").unwrap_err().to_string();
        let told = plain(&format!("a.toml: cannot be read: {missing}"));
        assert!(
            told.starts_with("a.toml: cannot be read: there is no such file"),
            "{told}"
        );
        assert!(!told.contains("os error"), "{told}");
        assert_eq!(
            plain("x: Broken thing (os error 7); y (os error 8)"),
            "x: Broken thing; y"
        );
        assert_eq!(plain("odd (os error"), "odd (os error");
    }
}
