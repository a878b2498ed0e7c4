//! From the text of a URDF to a [`Chain`], with errors that name the element.

use core::ops::Range;
use std::collections::{HashMap, HashSet};

use hal::{JointLimit, MAX_JOINTS};
use nalgebra::{Rotation3, Vector3};
use quick_xml::events::{BytesStart, Event};
use urdf_rs::{Joint, JointType, Robot};

use super::chain::{Chain, Revolute, Rigid};
use super::urdf_error::UrdfError;

/// Acceleration \[rad/s2\] and jerk \[rad/s3\] of a joint for which the URDF gives none.
const DEFAULT_DYNAMICS: (f64, f64) = (4.0, 40.0);
/// The same for the last joint, which turns little mass.
const LAST_JOINT_DYNAMICS: (f64, f64) = (40.0, 400.0);

pub(super) fn read(xml: &str, tip: &str) -> Result<Chain, UrdfError> {
    let Scanned {
        with_limits,
        elements,
    } = scan(xml)?;
    let robot =
        urdf_rs::read_from_string(xml).map_err(|error| whose_fault(xml, elements, error))?;
    let parents = tree(&robot)?;
    if !robot.links.iter().any(|link| link.name == tip) {
        return Err(unknown_link(&robot, tip, "the caller"));
    }

    let mut path = Vec::new();
    let mut link = tip;
    while let Some(joint) = parents.get(link) {
        path.push(*joint);
        link = &joint.parent.link;
    }
    let base = link.to_owned();

    let mut revolute: Vec<Revolute> = Vec::new();
    let mut pending = Rigid::IDENTITY;
    for joint in path.into_iter().rev() {
        pending = pending.then(&origin(joint)?);
        if joint.joint_type == JointType::Fixed {
            continue;
        }
        revolute.push(Revolute {
            name: joint.name.clone(),
            origin: core::mem::replace(&mut pending, Rigid::IDENTITY),
            axis: axis(joint)?,
            limit: limit(joint, with_limits.contains(&joint.name))?,
        });
    }
    if !(6..=MAX_JOINTS).contains(&revolute.len()) {
        return Err(UrdfError::JointCount {
            base,
            tip: tip.to_owned(),
            found: revolute.len(),
        });
    }
    if let Some(last) = revolute.last_mut() {
        let (acceleration, jerk) = LAST_JOINT_DYNAMICS;
        fill_dynamics(&mut last.limit, acceleration, jerk);
    }
    for joint in &mut revolute {
        let (acceleration, jerk) = DEFAULT_DYNAMICS;
        fill_dynamics(&mut joint.limit, acceleration, jerk);
    }
    Ok(Chain::assemble(base, tip.to_owned(), revolute, pending))
}

/// What a joint has at most once.
const ONCE: [&str; 6] = ["origin", "parent", "child", "axis", "limit", "mimic"];

/// A joint, link or other child of the robot.
struct Element {
    kind: String,
    name: String,
    bytes: Range<usize>,
}

struct Scanned {
    with_limits: HashSet<String>,
    elements: Vec<Element>,
}

/// Finds what the parser would report without a name, or fill in silently: elements given
/// twice in a joint, which joints have limits, and where everything is.
fn scan(xml: &str) -> Result<Scanned, UrdfError> {
    let mut reader = quick_xml::Reader::from_str(xml);
    let mut scanned = Scanned {
        with_limits: HashSet::new(),
        elements: Vec::new(),
    };
    let mut depth = 0_usize;
    let mut joint: Option<(String, HashSet<String>)> = None;
    loop {
        let begin = position(&reader);
        let event = reader.read_event().map_err(|source| UrdfError::Xml {
            byte: reader.error_position(),
            source,
        })?;
        match &event {
            Event::Start(element) | Event::Empty(element) => {
                let tag = String::from_utf8_lossy(element.name().as_ref()).into_owned();
                match (depth, &mut joint) {
                    (1, _) => {
                        scanned.elements.push(Element {
                            kind: tag.clone(),
                            name: attribute_name(element),
                            bytes: begin..position(&reader),
                        });
                        joint = (tag == "joint").then(|| (attribute_name(element), HashSet::new()));
                    }
                    (2, Some((name, seen))) => {
                        if tag == "limit" {
                            scanned.with_limits.insert(name.clone());
                        }
                        if ONCE.contains(&tag.as_str()) && !seen.insert(tag.clone()) {
                            return Err(UrdfError::RepeatedElement {
                                joint: name.clone(),
                                element: tag,
                            });
                        }
                    }
                    _ => {}
                }
                if matches!(event, Event::Start(_)) {
                    depth += 1;
                }
            }
            Event::End(_) => {
                depth = depth.saturating_sub(1);
                if let Some(last) = scanned.elements.last_mut().filter(|_| depth == 1) {
                    last.bytes.end = position(&reader);
                }
            }
            Event::Eof => return Ok(scanned),
            _ => {}
        }
    }
}

fn position(reader: &quick_xml::Reader<&[u8]>) -> usize {
    usize::try_from(reader.buffer_position()).unwrap_or(usize::MAX)
}

/// The parser's error with the name of the element that it is about: the first that the parser
/// does not take alone either.
fn whose_fault(xml: &str, elements: Vec<Element>, error: urdf_rs::UrdfError) -> UrdfError {
    for Element { kind, name, bytes } in elements {
        let alone = format!(
            "<robot name=\"alone\">{}</robot>",
            xml.get(bytes).unwrap_or_default()
        );
        if let Err(source) = urdf_rs::read_from_string(&alone) {
            return UrdfError::Element { kind, name, source };
        }
    }
    UrdfError::NotUrdf(error)
}

fn attribute_name(element: &BytesStart<'_>) -> String {
    element
        .attributes()
        .flatten()
        .find(|attribute| attribute.key.as_ref() == b"name")
        .map_or_else(
            || "(unnamed)".to_owned(),
            |attribute| String::from_utf8_lossy(&attribute.value).into_owned(),
        )
}

/// Checks that the links form one tree; returns the joint above each link.
fn tree(robot: &Robot) -> Result<HashMap<&str, &Joint>, UrdfError> {
    let mut links = HashSet::new();
    let mut joints = HashSet::new();
    for (names, name) in robot
        .links
        .iter()
        .map(|link| (true, &link.name))
        .chain(robot.joints.iter().map(|joint| (false, &joint.name)))
    {
        let set = if names { &mut links } else { &mut joints };
        if !set.insert(name.as_str()) {
            return Err(UrdfError::RepeatedName { name: name.clone() });
        }
    }

    let mut parents: HashMap<&str, &Joint> = HashMap::new();
    for joint in &robot.joints {
        for link in [&joint.parent.link, &joint.child.link] {
            if !links.contains(link.as_str()) {
                return Err(unknown_link(robot, link, &joint.name));
            }
        }
        if let Some(first) = parents.insert(&joint.child.link, joint) {
            return Err(UrdfError::TwoParents {
                link: joint.child.link.clone(),
                first: first.name.clone(),
                second: joint.name.clone(),
            });
        }
    }

    let mut root: Option<&str> = None;
    for link in &robot.links {
        let (mut top, mut steps) = (link.name.as_str(), 0);
        while let Some(joint) = parents.get(top) {
            top = &joint.parent.link;
            steps += 1;
            if steps > robot.joints.len() {
                return Err(UrdfError::Loop {
                    link: top.to_owned(),
                });
            }
        }
        match root {
            Some(first) if first != top => {
                return Err(UrdfError::TwoRoots {
                    first: first.to_owned(),
                    second: top.to_owned(),
                });
            }
            _ => root = Some(top),
        }
    }
    Ok(parents)
}

fn unknown_link(robot: &Robot, link: &str, by: &str) -> UrdfError {
    let known: Vec<&str> = robot.links.iter().map(|link| link.name.as_str()).collect();
    UrdfError::UnknownLink {
        link: link.to_owned(),
        by: by.to_owned(),
        known: known.join(", "),
    }
}

fn origin(joint: &Joint) -> Result<Rigid, UrdfError> {
    let (xyz, rpy) = (*joint.origin.xyz, *joint.origin.rpy);
    if !xyz.iter().chain(&rpy).all(|x| x.is_finite()) {
        return Err(UrdfError::NonFinite {
            joint: joint.name.clone(),
            element: "origin",
        });
    }
    Ok(Rigid {
        rotation: Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]).into_inner(),
        translation: Vector3::from(xyz),
    })
}

fn axis(joint: &Joint) -> Result<Vector3<f64>, UrdfError> {
    let axis = Vector3::from(*joint.axis.xyz);
    if !axis.iter().all(|x| x.is_finite()) {
        return Err(UrdfError::NonFinite {
            joint: joint.name.clone(),
            element: "axis",
        });
    }
    let size = axis.amax();
    if size == 0.0 {
        return Err(UrdfError::ZeroAxis {
            joint: joint.name.clone(),
        });
    }
    // First to a size whose square is a number.
    Ok((axis / size).normalize())
}

fn limit(joint: &Joint, given: bool) -> Result<JointLimit, UrdfError> {
    let name = || joint.name.clone();
    let found = match joint.joint_type {
        JointType::Revolute | JointType::Fixed => None,
        JointType::Continuous => Some("continuous"),
        JointType::Prismatic => Some("prismatic"),
        JointType::Floating => Some("floating"),
        JointType::Planar => Some("planar"),
        JointType::Spherical => Some("spherical"),
    };
    if let Some(found) = found {
        let joint = name();
        return Err(UrdfError::JointType { joint, found });
    }
    if let Some(mimic) = &joint.mimic {
        return Err(UrdfError::Mimic {
            joint: name(),
            mimicked: mimic.joint.clone(),
        });
    }
    if !given {
        return Err(UrdfError::MissingLimits { joint: name() });
    }
    let urdf_rs::JointLimit {
        lower,
        upper,
        velocity,
        acceleration,
        jerk,
        ..
    } = joint.limit;
    if ![lower, upper, velocity].iter().all(|x| x.is_finite())
        || acceleration.is_nan()
        || jerk.is_nan()
    {
        return Err(UrdfError::NonFinite {
            joint: name(),
            element: "limit",
        });
    }
    if lower >= upper || [velocity, acceleration, jerk].iter().any(|x| *x <= 0.0) {
        return Err(UrdfError::NoTravel {
            joint: name(),
            lower,
            upper,
            velocity,
        });
    }
    Ok(JointLimit {
        lower,
        upper,
        velocity,
        acceleration,
        jerk,
    })
}

fn fill_dynamics(limit: &mut JointLimit, acceleration: f64, jerk: f64) {
    if limit.acceleration.is_infinite() {
        limit.acceleration = acceleration;
    }
    if limit.jerk.is_infinite() {
        limit.jerk = jerk;
    }
}
