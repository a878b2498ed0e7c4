//! The same bytes as two independent implementations: `pyigtl`, and Debian's build of the reference
//! library, from its public interface. Each reads what this crate writes, packs what it read anew,
//! and what comes out is the same bit by bit.
//!
//! `NEEDLE_STEER_PEERS` names a Python that has `pyigtl`; with `NEEDLE_STEER_REQUIRE_IGTL` set a
//! peer that is missing fails instead of being passed over. `scripts/test` sets both.

#![expect(clippy::unwrap_used, reason = "a failed step is a failed test")]
#![expect(clippy::print_stderr, reason = "a test that is skipped says so")]

mod samples;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use igtl::{Body, Message};

/// Interface of the reference library, as Debian's libopenigtlink-dev has it.
const INCLUDE: &str = "/usr/include/openigtlink";

/// Says that a peer is missing, or fails where it must not be.
fn missing(what: &str) {
    assert!(
        std::env::var_os("NEEDLE_STEER_REQUIRE_IGTL").is_none(),
        "{what} is missing"
    );
    eprintln!("skipped: {what} is missing");
}

fn peers_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers")
}

/// What `peer` writes when it reads `input`.
fn answer(peer: &mut Command, input: &[u8]) -> Vec<u8> {
    let mut child = peer
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_vec();
    let writer = std::thread::spawn(move || stdin.write_all(&input));
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap().unwrap();
    assert!(output.status.success(), "{}", output.status);
    output.stdout
}

/// A line and the bytes of a message after it, for each message.
fn answers(mut output: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut answers = Vec::new();
    while !output.is_empty() {
        let end = output.iter().position(|&byte| byte == b'\n').unwrap();
        let line = String::from_utf8(output[..end].to_vec()).unwrap();
        let (length, rest) = output[end + 1..].split_first_chunk::<4>().unwrap();
        let (bytes, rest) = rest.split_at(u32::from_be_bytes(*length) as usize);
        answers.push((line, bytes.to_vec()));
        output = rest;
    }
    answers
}

fn bytes_of(messages: &[Message]) -> Vec<Vec<u8>> {
    messages.iter().map(|m| m.encode().unwrap()).collect()
}

#[test]
fn pyigtl_reads_and_writes_the_same_messages() {
    let Some(python) = std::env::var_os("NEEDLE_STEER_PEERS") else {
        return missing("a Python with pyigtl (NEEDLE_STEER_PEERS)");
    };
    let sent = samples::messages();
    let bytes = bytes_of(&sent);
    let script = peers_folder().join("pyigtl_bytes.py");
    let answers = answers(&answer(Command::new(python).arg(script), &bytes.concat()));
    assert_eq!(answers.len(), sent.len());
    let mut same = 0;
    for ((message, bytes), (line, packed)) in sent.iter().zip(&bytes).zip(&answers) {
        let kind = message.body.kind();
        if ["POSITION", "STATUS", "TRAJ"].contains(&kind) {
            assert!(line.contains("\"known\": false"), "{line}");
            continue;
        }
        assert!(line.contains(&format!("\"kind\": \"{kind}\"")), "{line}");
        assert!(line.contains("\"device\": \"NeedleTip\""), "{line}");
        let told = match &message.body {
            Body::Transform(_) => {
                "[[0.0, -1.0, 0.0, 10.5], [1.0, 0.0, 0.0, -20.25], [0.0, 0.0, 1.0, 30.125], "
            }
            Body::Points(_) => {
                "\"names\": [\"target\", \"entry\"], \"positions\": [[4.0, 5.0, 6.0], [-4.0, -5.0, -6.0]]"
            }
            // Its centre is that of the pixels' centres.
            Body::Image(_) => {
                "\"shape\": [1, 2, 4, 3], \"sum\": 276, \"matrix\": [[0.5, 0.0, 0.0, 9.25], [0.0, 0.25, 0.0, 19.875], "
            }
            Body::Text(_) => "\"string\": \"START\"",
            _ => "",
        };
        assert!(line.contains(told), "{told} in {line}");
        if let (Some(extension), true) = (&message.extension, kind != "POLYDATA") {
            assert!(
                line.contains(&format!("\"id\": {}", extension.id)),
                "{line}"
            );
            let told = line.contains("\"frame\": \"world\"");
            assert_eq!(told, !extension.metadata.is_empty(), "{line}");
        }
        let read = Message::decode(packed).unwrap();
        assert_eq!(read.stamp, message.stamp, "{kind}");
        if let (Body::PolyData(read), Body::PolyData(sent)) = (&read.body, &message.body) {
            // It packs no attributes.
            assert_eq!((&read.points, &read.lines), (&sent.points, &sent.lines));
        } else {
            assert_eq!(packed, bytes, "{kind}");
            same += 1;
        }
    }
    assert_eq!(same, 3 * 4, "types that are the same bit by bit");
}

/// The program that links the reference library, made anew.
fn reference() -> Option<PathBuf> {
    if !Path::new(INCLUDE).is_dir() {
        missing("Debian's libopenigtlink-dev");
        return None;
    }
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("igtl-reference");
    let made = Command::new("c++")
        .args(["-O1", "-w", "-I", INCLUDE, "-o"])
        .arg(&program)
        .arg(peers_folder().join("reference.cxx"))
        .arg("-lOpenIGTLink")
        .status();
    if made.is_err() {
        missing("a C++ compiler (c++)");
        return None;
    }
    assert!(made.unwrap().success());
    Some(program)
}

#[test]
fn the_reference_library_reads_and_writes_the_same_messages() {
    let Some(program) = reference() else {
        return;
    };
    // Version 1.11 speaks protocol versions 1 and 2.
    let mut sent = samples::messages();
    sent.retain(|message| message.extension.is_none());
    let bytes = bytes_of(&sent);
    let answers = answers(&answer(&mut Command::new(program), &bytes.concat()));
    assert_eq!(answers.len(), sent.len());
    for ((message, bytes), (line, packed)) in sent.iter().zip(&bytes).zip(&answers) {
        let told = match &message.body {
            Body::Transform(_) => "TRANSFORM NeedleTip 0 -1 0 10.5 1 0 0 -20.25 0 0 1 30.125",
            Body::Position(_) => "POSITION NeedleTip 1.5 2.5 -3.5 0.5 -0.5 0.5 0.5",
            Body::Points(_) => "POINT NeedleTip target 4 5 6 entry -4 -5 -6",
            Body::Trajectories(_) => "TRAJ NeedleTip path 3 7 8 9 10 11 12",
            Body::PolyData(_) => "POLYDATA NeedleTip 5 3 2",
            Body::Image(_) => "IMAGE NeedleTip 4 2 1 3 1 10 20 30 0.5 0.25 1 276",
            Body::Status(_) => "STATUS NeedleTip 1 -7 Steering depth 12.5 mm",
            Body::Text(_) => "STRING NeedleTip 3 START",
        };
        assert_eq!(line, told);
        assert_eq!(packed, bytes);
    }
}
