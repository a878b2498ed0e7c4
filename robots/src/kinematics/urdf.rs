//! From the text of a URDF to a [`Chain`], with errors that name the element.

pub(super) mod error;
mod mimic;
mod outline;
mod scan;
mod section;

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};

use hal::JointLimit;
use nalgebra::{Rotation3, Vector3};
use urdf_rs::{Joint, JointType};

use super::chain::{Chain, ENDLESS, Independent, JointKind, Placed};
use super::rigid::{Rigid, z_onto};
use error::{CALLER, UrdfError};
pub use outline::arm_sections;
use scan::{Scan, scan};
pub use section::Section;

/// Acceleration \[rad/s2\] and jerk \[rad/s3\] of a joint for which the URDF gives none.
const DEFAULT_DYNAMICS: (f64, f64) = (4.0, 40.0);
/// The same for the last joint, which turns little mass.
const LAST_JOINT_DYNAMICS: (f64, f64) = (40.0, 400.0);

pub(super) fn read(xml: &str, section: &Section) -> Result<Chain, UrdfError> {
    let scan = scan(xml)?;
    let (base, path) = path(&scan, section)?;
    let joints = parse(&scan, &path)?;
    section.check_held(&joints)?;
    let followers = mimic::followers(&joints, section)?;

    let mut independent: Vec<Independent> = Vec::new();
    for (scanned, joint) in path.iter().zip(&joints) {
        let moves = !section.holds(&joint.name) && !followers.contains_key(joint.name.as_str());
        if joint.joint_type == JointType::Fixed || !moves {
            continue;
        }
        independent.push(Independent {
            name: joint.name.clone(),
            kind: section.admit(joint, independent.len())?,
            limit: limit(joint, scanned.has_limit)?,
        });
    }
    section.check_count(&base, &joints, &independent)?;
    for (joint, scanned) in joints.iter().zip(&path) {
        if let Some(follower) = followers.get(joint.name.as_str()) {
            section.admit(joint, 0)?;
            let own = scanned.has_limit.then(|| limit(joint, true)).transpose()?;
            follower.narrow(joint, own.as_ref(), &mut independent)?;
        }
    }

    let mut placed = Vec::with_capacity(joints.len());
    let mut pending = Rigid::IDENTITY;
    for joint in &joints {
        pending = pending.then(&origin(joint)?);
        if joint.joint_type == JointType::Fixed {
            continue;
        }
        let axis = axis(joint)?;
        let slides = joint.joint_type == JointType::Prismatic;
        let follower = followers.get(joint.name.as_str());
        let leader = follower.map_or(joint.name.as_str(), |follower| follower.leader);
        let (ratio, offset) =
            follower.map_or((1.0, 0.0), |follower| (follower.ratio, follower.offset));
        if let Some(position) = section.held_at(leader) {
            pending = pending.then(&displaced(&axis, slides, ratio * position + offset));
            continue;
        }
        let known = independent.iter().position(|joint| joint.name == leader);
        let index = known.ok_or_else(|| UrdfError::Mimic {
            joint: joint.name.clone(),
            mimicked: leader.to_owned(),
        })?;
        placed.push(Placed {
            origin: core::mem::replace(&mut pending, Rigid::IDENTITY),
            axis,
            slides,
            joint: index,
            ratio,
            offset,
        });
    }
    let last = independent.last_mut();
    if let Some(last) = last.filter(|joint| joint.kind != JointKind::Prismatic) {
        fill_dynamics(&mut last.limit, LAST_JOINT_DYNAMICS);
    }
    for joint in &mut independent {
        let (acceleration, jerk) = DEFAULT_DYNAMICS;
        let unit = joint.kind.unit();
        fill_dynamics(&mut joint.limit, (acceleration * unit, jerk * unit));
    }
    let tip = section.tip().to_owned();
    Ok(Chain::assemble(base, tip, independent, placed, pending))
}

/// The text of a file.
pub(super) fn decode(file: &[u8]) -> Cow<'_, str> {
    let units = |of: fn([u8; 2]) -> u16| -> Vec<u16> {
        let pairs = file.chunks_exact(2);
        pairs.map(|pair| of([pair[0], pair[1]])).collect()
    };
    match file {
        // Without a byte-order mark, by the bracket that XML begins with.
        [0xff, 0xfe, ..] | [b'<', 0, ..] => {
            String::from_utf16_lossy(&units(u16::from_le_bytes)).into()
        }
        [0xfe, 0xff, ..] | [0, b'<', ..] => {
            String::from_utf16_lossy(&units(u16::from_be_bytes)).into()
        }
        _ => String::from_utf8_lossy(file),
    }
}

/// The base link of the section and its joints, base to tip.
fn path<'a>(
    scan: &'a Scan,
    section: &Section,
) -> Result<(String, Vec<&'a scan::Joint>), UrdfError> {
    if scan.links.is_empty() {
        let mut others: Vec<String> = scan.others.iter().cloned().collect();
        others.sort();
        return Err(prefixed(scan).unwrap_or(UrdfError::NoLinks { others }));
    }
    let parents = parents(scan)?;
    let tip = section.tip();
    for link in [Some(tip), section.base()].into_iter().flatten() {
        if !scan.links.iter().any(|known| known == link) {
            return Err(unknown_link(scan, link, CALLER));
        }
    }
    let mut path = Vec::new();
    let mut link = tip;
    while section.base() != Some(link)
        && let Some((joint, parent)) = parents.get(link)
    {
        path.push(*joint);
        link = parent;
        if path.len() > scan.joints.len() {
            return Err(UrdfError::Loop {
                link: link.to_owned(),
            });
        }
    }
    if let Some(base) = section.base().filter(|base| *base != link) {
        let above: Vec<&str> = path.iter().filter_map(|j| j.parent.as_deref()).collect();
        return Err(UrdfError::NotAbove {
            base: base.to_owned(),
            tip: tip.to_owned(),
            above: above.join(", "),
            below: is_below(&parents, base, tip),
        });
    }
    path.reverse();
    Ok((link.to_owned(), path))
}

/// Whether `link` hangs on `other`.
fn is_below(parents: &HashMap<&str, (&scan::Joint, &str)>, link: &str, other: &str) -> bool {
    let mut at = link;
    for _ in 0..parents.len() {
        let Some((_, parent)) = parents.get(at) else {
            break;
        };
        at = parent;
        if at == other {
            return true;
        }
    }
    false
}

/// Joint and link above each link; the links must form one tree.
fn parents(scan: &Scan) -> Result<HashMap<&str, (&scan::Joint, &str)>, UrdfError> {
    let mut links = HashSet::new();
    let mut names = HashSet::new();
    let links_and_joints = scan.links.iter().map(|link| (true, link));
    for (is_link, name) in links_and_joints.chain(scan.joints.iter().map(|j| (false, &j.name))) {
        let set = if is_link { &mut links } else { &mut names };
        if !set.insert(name.as_str()) {
            return Err(UrdfError::RepeatedName { name: name.clone() });
        }
    }
    let mut parents: HashMap<&str, (&scan::Joint, &str)> = HashMap::new();
    for joint in &scan.joints {
        let end = |link: &'_ Option<String>, element| match link {
            Some(link) if !links.contains(link.as_str()) => {
                Err(unknown_link(scan, link, &format!("joint {}", joint.name)))
            }
            Some(_) => Ok(()),
            None => Err(UrdfError::Unconnected {
                joint: joint.name.clone(),
                element,
            }),
        };
        end(&joint.parent, "parent")?;
        end(&joint.child, "child")?;
        let (Some(parent), Some(child)) = (&joint.parent, &joint.child) else {
            continue;
        };
        if let Some((first, _)) = parents.insert(child, (joint, parent)) {
            return Err(UrdfError::TwoParents {
                link: child.clone(),
                first: first.name.clone(),
                second: joint.name.clone(),
            });
        }
    }
    let mut roots = scan
        .links
        .iter()
        .filter(|link| !parents.contains_key(link.as_str()));
    match (roots.next(), roots.next()) {
        (Some(first), Some(second)) => Err(prefixed(scan).unwrap_or_else(|| UrdfError::TwoRoots {
            first: first.clone(),
            second: second.clone(),
        })),
        _ => Ok(parents),
    }
}

/// Links or joints that are not read, if there are any: a reason why others are missing.
fn prefixed(scan: &Scan) -> Option<UrdfError> {
    let (element, line) = scan.prefixed.as_ref()?;
    let (prefix, _) = element.split_once(':')?;
    Some(UrdfError::Prefixed {
        element: element.clone(),
        prefix: prefix.to_owned(),
        line: *line,
    })
}

fn unknown_link(scan: &Scan, link: &str, by: &str) -> UrdfError {
    prefixed(scan).unwrap_or_else(|| UrdfError::UnknownLink {
        link: link.to_owned(),
        by: by.to_owned(),
        known: scan.links.join(", "),
    })
}

/// The joints of the path as the parser reads them.
fn parse(scan: &Scan, path: &[&scan::Joint]) -> Result<Vec<Joint>, UrdfError> {
    if let Some((joint, wrong)) = path
        .iter()
        .find_map(|joint| Some((joint, joint.not_numbers.as_ref()?)))
    {
        return Err(UrdfError::NotNumbers {
            line: wrong.line,
            joint: joint.name.clone(),
            element: wrong.element,
            attribute: wrong.attribute,
            found: wrong.found.clone(),
            count: wrong.count,
        });
    }
    let robot = |joints: &str| {
        let text = format!("<robot name=\"chain\"{}>{joints}</robot>", scan.version);
        urdf_rs::read_from_string(&text)
    };
    let all: String = path.iter().map(|joint| joint.xml.as_str()).collect();
    robot(&all).map(|robot| robot.joints).map_err(|error| {
        // The first that the parser does not take alone either.
        let culprit = path.iter().find_map(|joint| {
            let source = robot(&joint.xml).err()?;
            Some(UrdfError::Joint {
                joint: joint.name.clone(),
                source,
            })
        });
        culprit.unwrap_or(UrdfError::NotUrdf(error))
    })
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

/// A joint held still at `position` along or about its axis.
fn displaced(axis: &Vector3<f64>, slides: bool, position: f64) -> Rigid {
    let onto_axis = Rigid {
        rotation: z_onto(axis),
        translation: Vector3::zeros(),
    };
    let moved = if slides {
        onto_axis.slid(position)
    } else {
        onto_axis.turned(position)
    };
    moved.then(&onto_axis.inverse())
}

/// Limits of a joint; a speed that is not known is 0.
fn limit(joint: &Joint, given: bool) -> Result<JointLimit, UrdfError> {
    let name = || joint.name.clone();
    let urdf_rs::JointLimit {
        mut lower,
        mut upper,
        velocity,
        acceleration,
        jerk,
        ..
    } = joint.limit;
    let endless = joint.joint_type == JointType::Continuous;
    if endless {
        (lower, upper) = (-ENDLESS, ENDLESS);
    } else if !given {
        return Err(UrdfError::MissingLimits { joint: name() });
    }
    if ![lower, upper, velocity].iter().all(|x| x.is_finite())
        || acceleration.is_nan()
        || jerk.is_nan()
    {
        return Err(UrdfError::NonFinite {
            joint: name(),
            element: "limit",
        });
    }
    if lower >= upper {
        return Err(UrdfError::NoTravel {
            joint: name(),
            lower,
            upper,
        });
    }
    let unless_none = |x: f64| if x > 0.0 { x } else { f64::INFINITY };
    Ok(JointLimit {
        lower,
        upper,
        velocity: velocity.max(0.0),
        acceleration: unless_none(acceleration),
        jerk: unless_none(jerk),
    })
}

fn fill_dynamics(limit: &mut JointLimit, (acceleration, jerk): (f64, f64)) {
    if limit.acceleration.is_infinite() {
        limit.acceleration = acceleration;
    }
    if limit.jerk.is_infinite() {
        limit.jerk = jerk;
    }
}
