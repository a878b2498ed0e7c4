//! Files of which no chain can be made: what is wrong, where, and what to do about it.

use std::path::Path;

use hal::Joints;
use robots::kinematics::{Chain, Section, UrdfError};

use crate::{LIMIT, arm, assert_as_plain, coupled, on_a_rail};

#[test]
fn a_file_that_is_no_urdf_is_called_what_it_is() {
    let xacro = "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\" name=\"a\">\
                 <xacro:include filename=\"b\"/></robot>";
    let cases = [
        (xacro, "xacro FILE.urdf.xacro > FILE.urdf"),
        ("<sdf version=\"1.7\"><model name=\"a\"/></sdf>", "SDF"),
        ("<mujoco model=\"a\"/>", "MJCF"),
        ("<!DOCTYPE html><html><body/></html>", "web page"),
        ("<launch/>", "launch"),
        ("<COLLADA/>", "COLLADA"),
        ("<robot name=\"a\"><group name=\"arm\"/></robot>", "SRDF"),
        ("<robot name=\"a\"/>", "no <link>"),
        ("", "no XML"),
        ("solid cube", "no XML"),
    ];
    for (text, part) in cases {
        let error = Chain::from_urdf(text, "tip").unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
        assert!(!error.ends_with("has: "), "{error}");
    }
    let error = Chain::from_urdf(xacro, "tip").unwrap_err();
    let message = error.in_file(Path::new("dir/arm.urdf.xacro"));
    assert!(
        message.contains("`xacro dir/arm.urdf.xacro > dir/arm.urdf`"),
        "{message}"
    );
    // A declared prefix that is not used is what xacro itself leaves behind.
    let expanded = arm("revolute", LIMIT).replace(
        "<robot ",
        "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\" ",
    );
    assert_as_plain(&expanded);
    let property = arm("revolute", LIMIT).replace("0 0 0.31", "0 0 ${height}");
    let error = Chain::from_urdf(&property, "tip").unwrap_err();
    assert!(matches!(error, UrdfError::Xacro { .. }), "{error}");
}

/// What is wrong, where, and what to do about it.
#[test]
fn a_message_names_the_place_and_the_remedy() {
    let plain = arm("revolute", LIMIT);
    let changed = |from: &str, to: &str| {
        assert!(plain.contains(from), "{from}");
        plain.replacen(from, to, 1)
    };
    let in_line_2 = "line 2: joint j1: ";
    let cases: [(String, &str, &[&str]); 9] = [
        (
            plain
                .replace("<joint", "<x:joint")
                .replace("</joint", "</x:joint"),
            "tip",
            &["line 2: <x:joint>", "take `x:` off"],
        ),
        (
            plain
                .replace("<link", "<x:link")
                .replace("</link", "</x:link"),
            "tip",
            &["line 1: <x:link>", "take `x:` off"],
        ),
        (
            changed("0 0 0.31", "0 0 0,31"),
            "tip",
            &[
                in_line_2,
                "xyz=\"0 0 0,31\" of <origin>",
                "write three numbers",
            ],
        ),
        (
            changed("0 0 0.31", "0 x 0 0.31"),
            "tip",
            &[in_line_2, "xyz=\"0 x 0 0.31\"", "write three numbers"],
        ),
        (
            changed("lower=\"-2.8\"", "lower=\"-pi\""),
            "tip",
            &[in_line_2, "lower=\"-pi\" of <limit>", "write one number"],
        ),
        (
            changed(
                "lower=\"-2.8\" upper=\"2.8\"",
                "lower=\"0.5\" upper=\"0.5\"",
            ),
            "tip",
            &["joint j1", "0.5 to 0.5", "--hold j1=0.5"],
        ),
        (
            changed(
                "lower=\"-2.8\" upper=\"2.8\"",
                "lower=\"2.8\" upper=\"-2.8\"",
            ),
            "tip",
            &["joint j1", "exchange lower and upper"],
        ),
        (
            changed(LIMIT, ""),
            "tip",
            &["joint j1", "<limit> is missing; add", "continuous"],
        ),
        (
            changed("lower=\"-2.8\"", "lower=\"-inf\""),
            "tip",
            &["joint j1", "write numbers", "continuous"],
        ),
    ];
    assert_named(&cases);
    // Of a fixed joint, no more than its place is needed.
    let (start, flange) = plain.split_at(plain.find("<joint name=\"flange\"").unwrap());
    let flange = flange.replace("1 0 0", "none").replace("-2.8", "");
    assert_as_plain(&format!("{start}{flange}"));
}

fn assert_named(cases: &[(String, &str, &[&str])]) {
    for (urdf, tip, parts) in cases {
        let message = Chain::from_urdf(urdf, tip).unwrap_err().to_string();
        for part in *parts {
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        }
    }
}

#[test]
fn a_chain_that_is_not_there_is_told_with_one_that_may_be() {
    let plain = arm("revolute", LIMIT);
    let finger = "<link name=\"finger\"/><joint name=\"grip\" type=\"prismatic\">\
        <parent link=\"tip\"/><child link=\"finger\"/></joint></robot>";
    let cases: [(String, &str, &[&str]); 8] = [
        (
            plain.replace("</robot>", finger),
            "finger",
            &[
                "joint grip: type prismatic",
                "end it above (--tip tip",
                "--hold grip=",
            ],
        ),
        (
            plain.clone(),
            "j2",
            &["2 moving joints", "end it further out", "--mechanism"],
        ),
        (
            plain.clone(),
            "base",
            &["0 moving joints", "end it further out"],
        ),
        (
            plain.clone(),
            "tcp",
            &["link tcp", "name one of these (--tip"],
        ),
        (
            "version https://git-lfs.github.com/spec/v1\noid sha256:1\n".to_owned(),
            "tip",
            &["Git LFS", "git lfs pull"],
        ),
        (
            "\u{1f}\u{fffd}\u{8}".to_owned(),
            "tip",
            &["compressed", "gzip -d"],
        ),
        (
            "{\"robot\": {}}".to_owned(),
            "tip",
            &["JSON", "take the arm's .urdf"],
        ),
        (
            " \r\n".to_owned(),
            "tip",
            &["it is empty", "fetch it again"],
        ),
    ];
    assert_named(&cases);
    let section = Section::arm("base").from("tip");
    let error = Chain::from_section(plain.as_bytes(), &section).unwrap_err();
    assert!(
        error.to_string().contains("exchange base and tip"),
        "{error}"
    );
}

/// What is put into files to damage them.
const WORDS: [&str; 26] = [
    "",
    "<",
    ">",
    "\"",
    "&",
    "&#0;",
    "nan",
    "-inf",
    "1e999",
    "\u{0}",
    "é",
    "<!--",
    "]]>",
    "<?",
    "</robot>",
    "<joint>",
    "xacro:",
    "${x}",
    "type=\"planar\"",
    "name=\"j1\"",
    "link=\"tip\"",
    "1 2",
    "--1",
    "<link name=\"tip\"/>",
    "0",
    "base",
];

/// What a message may tell the user to do.
const REMEDIES: [&str; 17] = [
    "add", "begin", "choose", "convert", "download", "end", "exchange", "fetch", "hold", "keep",
    "make", "mend", "name", "remove", "rename", "take", "write",
];

fn helps(message: &str) -> bool {
    let mut parts = message.split([';', ':', ',', '(']).map(str::trim_start);
    parts.any(|part| REMEDIES.contains(&part.split(' ').next().unwrap_or_default()))
        || [
            "`xacro dir/arm.urdf",
            "a joint is <joint",
            "a URDF is needed",
            "an SRDF",
        ]
        .iter()
        .any(|words| message.contains(words))
}

/// Names of joints in other alphabets, tags cut in half, numbers that are none: whatever was
/// done to a file, the answer is a chain or a message.
#[test]
fn a_thousand_damaged_files_are_answered_with_a_chain_or_a_message() {
    let plain = [
        arm("revolute", LIMIT),
        on_a_rail(),
        coupled("<mimic joint=\"j3\"/>"),
        robots::arms::VIPER_S650.to_owned(),
    ];
    let mut chance = 7_u64;
    let mut draw = |below: usize| {
        chance = chance
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        usize::try_from(chance >> 33).unwrap() % below
    };
    let (mut read, mut refused) = (0, 0);
    for k in 0..1000 {
        let mut bytes = plain[k % plain.len()].clone().into_bytes();
        for _ in 0..=draw(3) {
            let (at, length) = (draw(bytes.len()), draw(30));
            let end = (at + length).min(bytes.len());
            let word = WORDS[draw(WORDS.len())].bytes();
            match draw(4) {
                0 => bytes.truncate(at.max(1)),
                1 => bytes[at] = u8::try_from(draw(256)).unwrap(),
                2 => drop(bytes.splice(at..end, word)),
                _ => {
                    let copied = bytes[at..end].to_vec();
                    let to = draw(bytes.len());
                    drop(bytes.splice(to..to, copied));
                }
            }
        }
        let tip = if k % plain.len() == 3 {
            "needle_base"
        } else {
            "tip"
        };
        for section in [
            Section::arm(tip),
            Section::mechanism(tip),
            Section::arm(tip).from("base"),
        ] {
            match Chain::from_section(&bytes, &section) {
                Ok(chain) => {
                    let pose = chain.forward(&Joints::zeros(chain.len()).unwrap());
                    assert!(pose.translation.vector.iter().all(|x| !x.is_nan()));
                    read += 1;
                }
                Err(error) => {
                    let message = error.in_file(Path::new("dir/arm.urdf"));
                    assert!(
                        message.starts_with("dir/arm.urdf: ") && message.len() > 30,
                        "{message}"
                    );
                    assert!(helps(&message), "no remedy: {message}");
                    refused += 1;
                }
            }
        }
        let _ = robots::kinematics::arm_sections(&bytes);
    }
    assert!(read > 50 && refused > 500, "{read} read, {refused} refused");
}
