//! What kinematics needs of a URDF's text: links and joints, and of these only where they are.
//!
//! Shapes, materials, inertias, plugins and elements with undeclared prefixes are passed over, so
//! that nothing in them keeps a chain from being read.

use std::collections::HashSet;
use std::fmt::Write;

use quick_xml::events::{BytesStart, Event};

use super::error::UrdfError;

/// Elements of a joint that kinematics needs, each at most once, and their attributes.
const PARTS: [(&str, &[&str]); 6] = [
    ("origin", &["xyz", "rpy", "quat_xyzw"]),
    ("parent", &["link"]),
    ("child", &["link"]),
    ("axis", &["xyz"]),
    (
        "limit",
        &["lower", "upper", "velocity", "acceleration", "jerk"],
    ),
    ("mimic", &["joint", "multiplier", "offset"]),
];

/// Of these, what fixed joints need.
const OF_FIXED: [&str; 3] = ["origin", "parent", "child"];

/// Attributes that are numbers, and how many.
const NUMBERS: [(&str, usize); 10] = [
    ("xyz", 3),
    ("rpy", 3),
    ("quat_xyzw", 4),
    ("lower", 1),
    ("upper", 1),
    ("velocity", 1),
    ("acceleration", 1),
    ("jerk", 1),
    ("multiplier", 1),
    ("offset", 1),
];

/// Prefix of elements that only the preprocessor xacro understands.
const XACRO: &str = "xacro:";

/// A joint of the file.
#[derive(Debug, Default)]
pub(super) struct Joint {
    pub(super) name: String,
    pub(super) parent: Option<String>,
    pub(super) child: Option<String>,
    /// The attribute `type`; empty where it is missing.
    pub(super) kind: String,
    pub(super) has_limit: bool,
    pub(super) mimics: bool,
    /// The first attribute that should be numbers and is none.
    pub(super) not_numbers: Option<NotNumbers>,
    /// The joint with nothing but the [`PARTS`], as XML.
    pub(super) xml: String,
    seen: HashSet<&'static str>,
}

/// An attribute that should be numbers.
#[derive(Clone, Debug)]
pub(super) struct NotNumbers {
    /// Its line, from 1.
    pub(super) line: usize,
    pub(super) element: &'static str,
    pub(super) attribute: &'static str,
    pub(super) found: String,
    /// How many numbers it should be.
    pub(super) count: usize,
}

/// Links and joints of a file.
#[derive(Debug, Default)]
pub(super) struct Scan {
    /// The attribute `version` of the robot, ready to be written again.
    pub(super) version: String,
    pub(super) links: Vec<String>,
    pub(super) joints: Vec<Joint>,
    /// Names of the robot's other children.
    pub(super) others: HashSet<String>,
    /// A link or joint with a prefix, which is none, and its line.
    pub(super) prefixed: Option<(String, usize)>,
}

/// Reads links and joints.
pub(super) fn scan(xml: &str) -> Result<Scan, UrdfError> {
    let xml = xml.trim_start_matches('\u{feff}');
    let mut reader = quick_xml::Reader::from_str(xml);
    let mut scan = Scan::default();
    let mut open: Vec<String> = Vec::new();
    let mut in_joint = false;
    let mut has_root = false;
    loop {
        let event = reader
            .read_event()
            .map_err(|source| syntax(xml, reader.error_position(), source))?;
        match &event {
            Event::Start(element) | Event::Empty(element) => {
                let tag = String::from_utf8_lossy(element.name().as_ref()).into_owned();
                if let Some(found) = tag.strip_prefix(XACRO)
                    && open.len() < 3
                {
                    return Err(UrdfError::Xacro {
                        found: format!("<{XACRO}{found}>"),
                    });
                }
                let position = reader.buffer_position();
                match open.len() {
                    0 if tag == "robot" => {
                        has_root = true;
                        scan.version = attributes(xml, position, element, &["version"])?;
                    }
                    0 => return Err(UrdfError::Root { root: tag }),
                    1 => {
                        in_joint = tag == "joint";
                        if in_joint {
                            scan.joints.push(joint(xml, position, element)?);
                        } else if tag == "link" {
                            let name = value(xml, position, element, "name")?;
                            let line = line_of(xml, position);
                            scan.links
                                .push(name.ok_or(UrdfError::UnnamedLink { line })?);
                        } else {
                            if tag.ends_with(":link") || tag.ends_with(":joint") {
                                let here = (tag.clone(), line_of(xml, position));
                                scan.prefixed.get_or_insert(here);
                            }
                            scan.others.insert(tag.clone());
                        }
                    }
                    2 if in_joint => {
                        if let Some(joint) = scan.joints.last_mut() {
                            part(xml, position, element, &tag, joint)?;
                        }
                    }
                    _ => {}
                }
                if matches!(event, Event::Start(_)) {
                    open.push(tag);
                }
            }
            Event::End(_) => {
                open.pop();
            }
            Event::Eof => break,
            _ => {}
        }
    }
    if let Some(element) = open.pop() {
        return Err(UrdfError::Truncated { element });
    }
    if !has_root {
        return Err(UrdfError::no_xml(xml));
    }
    for joint in &mut scan.joints {
        joint.xml.push_str("</joint>");
    }
    Ok(scan)
}

fn joint(xml: &str, position: u64, element: &BytesStart<'_>) -> Result<Joint, UrdfError> {
    let name = value(xml, position, element, "name")?;
    let shown = attributes(xml, position, element, &["name", "type"])?;
    Ok(Joint {
        name: name.unwrap_or_else(|| format!("(unnamed) in line {}", line_of(xml, position))),
        kind: value(xml, position, element, "type")?.unwrap_or_default(),
        xml: format!("<joint{shown}>"),
        ..Joint::default()
    })
}

/// Keeps an element of a joint, if kinematics needs it.
fn part(
    xml: &str,
    position: u64,
    element: &BytesStart<'_>,
    tag: &str,
    joint: &mut Joint,
) -> Result<(), UrdfError> {
    let Some((part, needed)) = PARTS.iter().find(|(part, _)| *part == tag) else {
        return Ok(());
    };
    if joint.kind == "fixed" && !OF_FIXED.contains(part) {
        return Ok(());
    }
    if !joint.seen.insert(part) {
        return Err(UrdfError::RepeatedElement {
            joint: joint.name.clone(),
            element: tag.to_owned(),
        });
    }
    let mut shown = attributes(xml, position, element, needed)?;
    for (attribute, count) in NUMBERS.iter().filter(|(name, _)| needed.contains(name)) {
        let found = value(xml, position, element, attribute)?;
        if let Some(found) = found.filter(|found| !is_numbers(found, *count)) {
            joint.not_numbers.get_or_insert_with(|| NotNumbers {
                line: line_of(xml, position),
                element: part,
                attribute,
                found: found.split_whitespace().collect::<Vec<_>>().join(" "),
                count: *count,
            });
        }
    }
    match *part {
        "parent" => joint.parent = value(xml, position, element, "link")?,
        "child" => joint.child = value(xml, position, element, "link")?,
        "mimic" => joint.mimics = true,
        "limit" => {
            joint.has_limit = true;
            if value(xml, position, element, "velocity")?.is_none_or(|v| is_no_speed(&v)) {
                let rest = ["lower", "upper", "acceleration", "jerk"];
                shown = attributes(xml, position, element, &rest)?;
                shown.push_str(" velocity=\"0\"");
            }
        }
        _ => {}
    }
    // Writing to a string cannot fail.
    let _ = write!(joint.xml, "<{part}{shown}/>");
    Ok(())
}

fn is_numbers(text: &str, count: usize) -> bool {
    let mut numbers = text.split_whitespace().map(str::parse::<f64>);
    (0..count).all(|_| matches!(numbers.next(), Some(Ok(_)))) && numbers.next().is_none()
}

/// Whether a speed says that none is known.
fn is_no_speed(text: &str) -> bool {
    let speed = text.trim().parse::<f64>();
    speed.is_ok_and(|speed| speed <= 0.0 || speed == f64::INFINITY)
}

/// The `wanted` attributes of an element as XML, their white space made single.
fn attributes(
    xml: &str,
    position: u64,
    element: &BytesStart<'_>,
    wanted: &[&str],
) -> Result<String, UrdfError> {
    let mut text = String::new();
    for name in wanted {
        if let Some(value) = value(xml, position, element, name)? {
            let value = value.split_whitespace().collect::<Vec<_>>().join(" ");
            if value.contains("${") || value.contains("$(") {
                return Err(UrdfError::Xacro {
                    found: format!("{name}=\"{value}\""),
                });
            }
            let _ = write!(text, " {name}=\"{}\"", quick_xml::escape::escape(value));
        }
    }
    Ok(text)
}

fn value(
    xml: &str,
    position: u64,
    element: &BytesStart<'_>,
    name: &str,
) -> Result<Option<String>, UrdfError> {
    let found = element
        .try_get_attribute(name)
        .map_err(|source| syntax(xml, position, source.into()))?;
    found
        .map(|attribute| match attribute.unescape_value() {
            Ok(value) => Ok(value.into_owned()),
            Err(source) => Err(syntax(xml, position, source)),
        })
        .transpose()
}

fn syntax(xml: &str, byte: u64, source: quick_xml::Error) -> UrdfError {
    UrdfError::Xml {
        line: line_of(xml, byte),
        source,
    }
}

/// The line, from 1, of a byte's place.
fn line_of(xml: &str, byte: u64) -> usize {
    let end = usize::try_from(byte).unwrap_or(usize::MAX).min(xml.len());
    xml.as_bytes()[..end].split(|byte| *byte == b'\n').count()
}
