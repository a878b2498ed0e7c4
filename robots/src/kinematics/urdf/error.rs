//! What can be wrong with a URDF.

use std::path::Path;

/// Why a URDF gives no chain.
#[derive(Debug, thiserror::Error)]
pub enum UrdfError {
    /// The text is not well-formed XML.
    #[error("line {line}: not well-formed XML: {source}")]
    Xml {
        /// Line where the reader stopped, from 1.
        line: usize,
        /// What it did not like.
        source: quick_xml::Error,
    },
    /// The text ends within an element.
    #[error("the file ends within <{element}>: it is not complete; fetch it again")]
    Truncated {
        /// The element that is not closed.
        element: String,
    },
    /// The text holds no element at all.
    #[error("not a URDF: the file holds no XML element")]
    NoXml,
    /// The root of the document is no robot.
    #[error(
        "not a URDF, whose root is <robot>: the root is <{root}>, {}",
        what_is(root)
    )]
    Root {
        /// Tag of the root.
        root: String,
    },
    /// The file is the source of a URDF.
    #[error(
        "a xacro file (it holds {found}), not a URDF yet; `xacro FILE.urdf.xacro > FILE.urdf` \
         makes one of it"
    )]
    Xacro {
        /// What gave it away.
        found: String,
    },
    /// There is a robot, but no link.
    #[error("not a URDF of an arm: the robot has no <link>{}", what_it_has(others))]
    NoLinks {
        /// What else the robot has.
        others: Vec<String>,
    },
    /// The parser's verdict on the chain as a whole.
    #[error("not a URDF: {0}")]
    NotUrdf(#[from] urdf_rs::UrdfError),
    /// A joint is not as a URDF has it.
    #[error("joint {joint}: {source}")]
    Joint {
        /// Its name.
        joint: String,
        /// What the parser says of it.
        source: urdf_rs::UrdfError,
    },
    /// A link has no name.
    #[error("link (unnamed): the attribute name is missing")]
    UnnamedLink,
    /// A joint has an element twice.
    #[error("joint {joint}: more than one <{element}>")]
    RepeatedElement {
        /// Name of the joint.
        joint: String,
        /// The element.
        element: String,
    },
    /// A joint does not say what it connects.
    #[error("joint {joint}: <{element} link=\"...\"/> is missing")]
    Unconnected {
        /// Name of the joint.
        joint: String,
        /// `parent` or `child`.
        element: &'static str,
    },
    /// Two joints or two links have one name.
    #[error("the name {name} is used twice")]
    RepeatedName {
        /// The name.
        name: String,
    },
    /// A joint or the caller names a link that the file does not have.
    #[error("link {link}, named by {by}, is not in the file; it has: {known}")]
    UnknownLink {
        /// The missing link.
        link: String,
        /// Who names it.
        by: String,
        /// The links of the file.
        known: String,
    },
    /// The link at which the chain shall begin is not above its tip.
    #[error("base link {base} is not above {tip}; above it are, upwards: {above}")]
    NotAbove {
        /// The base wanted.
        base: String,
        /// The tip.
        tip: String,
        /// The links above the tip.
        above: String,
    },
    /// A joint that shall be held still is not in the chain.
    #[error("joint {joint}, to be held still, is not in the chain, whose joints are: {known}")]
    UnknownJoint {
        /// The joint named.
        joint: String,
        /// The joints of the chain.
        known: String,
    },
    /// A joint shall be held where it cannot go.
    #[error("joint {joint} cannot be held at {position}: its limits are {lower} and {upper}")]
    HeldOutside {
        /// The joint.
        joint: String,
        /// Where it shall be held \[rad or m\].
        position: f64,
        /// Lower limit \[rad or m\].
        lower: f64,
        /// Upper limit \[rad or m\].
        upper: f64,
    },
    /// A link hangs on two joints: the mechanism has a closed loop.
    #[error("link {link} is the child of both {first} and {second}: a loop")]
    TwoParents {
        /// The link.
        link: String,
        /// The joint met first.
        first: String,
        /// The other joint.
        second: String,
    },
    /// Going from this link to its parents never ends.
    #[error("link {link} is its own ancestor: a loop")]
    Loop {
        /// A link of the loop.
        link: String,
    },
    /// The file holds several trees.
    #[error("two roots, {first} and {second}: the links are not connected")]
    TwoRoots {
        /// A root.
        first: String,
        /// Another one.
        second: String,
    },
    /// A joint of the chain moves in a way that the chain does not admit.
    #[error(
        "joint {joint}: type {found}; the chain may hold revolute, continuous and fixed joints \
         only: begin it below (--base {child}, arm.base_link = \"{child}\"){}",
        how_to_hold(joint, found)
    )]
    JointType {
        /// Name of the joint.
        joint: String,
        /// Its type.
        found: &'static str,
        /// The link that it moves.
        child: String,
    },
    /// A joint of the chain copies one that is not in the chain.
    #[error("joint {joint} mimics {mimicked}, which does not move in the chain")]
    Mimic {
        /// Name of the joint.
        joint: String,
        /// The joint that it follows.
        mimicked: String,
    },
    /// A joint has no limits.
    #[error("joint {joint}: <limit> is missing")]
    MissingLimits {
        /// Name of the joint.
        joint: String,
    },
    /// The limits of a joint leave no travel.
    #[error("joint {joint}: limits from {lower} to {upper} allow no motion")]
    NoTravel {
        /// Name of the joint.
        joint: String,
        /// Lower limit \[rad or m\].
        lower: f64,
        /// Upper limit \[rad or m\].
        upper: f64,
    },
    /// A number of a joint is not finite.
    #[error("joint {joint}: <{element}> is not finite")]
    NonFinite {
        /// Name of the joint.
        joint: String,
        /// The element.
        element: &'static str,
    },
    /// The axis of a joint has no direction.
    #[error("joint {joint}: <axis> is zero")]
    ZeroAxis {
        /// Name of the joint.
        joint: String,
    },
    /// The chain has too few or too many joints.
    #[error(
        "the chain from {base} to {tip} has {found} moving joints; {admitted} are supported{hint}"
    )]
    JointCount {
        /// First link.
        base: String,
        /// Last link.
        tip: String,
        /// Moving joints between them.
        found: usize,
        /// How many there may be.
        admitted: &'static str,
        /// What makes it fewer, if anything does.
        hint: String,
    },
}

impl UrdfError {
    /// The message with the name of the file that it is about, also in the remedy.
    pub fn in_file(&self, file: &Path) -> String {
        let name = file.display();
        let Self::Xacro { found } = self else {
            return format!("{name}: {self}");
        };
        let text = name.to_string();
        let made = match text.strip_suffix(".xacro") {
            Some(stem) => format!("{}.urdf", stem.strip_suffix(".urdf").unwrap_or(stem)),
            None => format!("{text}.expanded.urdf"),
        };
        format!(
            "{name}: a xacro file (it holds {found}), not a URDF yet; `xacro {name} > {made}` \
             makes one of it"
        )
    }
}

/// What a document with another root is, and what to do about it.
fn what_is(root: &str) -> &'static str {
    match root {
        "sdf" | "gazebo" | "world" | "model" => {
            "which is an SDF model; take the URDF that the arm's maker gives, or convert it \
             (sdf2urdf of pysdf)"
        }
        "mujoco" | "mujocoinclude" => {
            "which is a MuJoCo model (MJCF); take the URDF that it was made from"
        }
        "COLLADA" => "which is a COLLADA mesh; take the URDF that refers to it",
        "launch" => "which is a ROS launch file; take the URDF that it loads as robot_description",
        "html" | "HTML" | "!DOCTYPE" => "which is a web page; download the file itself (\"raw\")",
        _ => "which is another format; a URDF is needed",
    }
}

fn what_it_has(others: &[String]) -> String {
    if others.iter().any(|tag| tag == "group") {
        return "; it has groups: an SRDF, which goes with a URDF".to_owned();
    }
    if others.is_empty() {
        return String::new();
    }
    format!("; it has: {}", others.join(", "))
}

fn how_to_hold(joint: &str, found: &str) -> String {
    match found {
        "prismatic" => {
            format!(" or hold it still (--hold {joint}=METRES, arm.held_joints_mm)")
        }
        _ => String::new(),
    }
}
