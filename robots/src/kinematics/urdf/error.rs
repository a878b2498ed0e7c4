//! What can be wrong with a URDF.

use std::path::Path;

/// Who names a link that is in no joint of the file.
pub(super) const CALLER: &str = "the caller";

/// Why a URDF gives no chain.
#[derive(Debug, thiserror::Error)]
pub enum UrdfError {
    /// The text is not well-formed XML.
    #[error("line {line}: not well-formed XML: {source}; mend that line or fetch the file again")]
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
    #[error("not a URDF: the file holds no XML element{what}")]
    NoXml {
        /// What it is instead, and what to do about it.
        what: &'static str,
    },
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
    #[error(
        "joint {joint}: {source}; a joint is <joint name=\"\" type=\"revolute\"> with \
         <parent link=\"\"/>, <child link=\"\"/>, <origin/>, <axis/> and <limit/>"
    )]
    Joint {
        /// Its name.
        joint: String,
        /// What the parser says of it.
        source: urdf_rs::UrdfError,
    },
    /// Something else stands where numbers should.
    #[error(
        "line {line}: joint {joint}: {attribute}=\"{found}\" of <{element}>; write {} there, with \
         decimal points, in m and rad",
        in_words(*count)
    )]
    NotNumbers {
        /// Its line, from 1.
        line: usize,
        /// Name of the joint.
        joint: String,
        /// The element.
        element: &'static str,
        /// The attribute.
        attribute: &'static str,
        /// What it is.
        found: String,
        /// How many numbers it should be.
        count: usize,
    },
    /// A link has no name.
    #[error("line {line}: link (unnamed): the attribute name is missing; name it")]
    UnnamedLink {
        /// Its line, from 1.
        line: usize,
    },
    /// A joint has an element twice.
    #[error("joint {joint}: more than one <{element}>; keep the one that is right")]
    RepeatedElement {
        /// Name of the joint.
        joint: String,
        /// The element.
        element: String,
    },
    /// A joint does not say what it connects.
    #[error(
        "joint {joint}: <{element} link=\"...\"/> is missing; add it, a joint connects two links"
    )]
    Unconnected {
        /// Name of the joint.
        joint: String,
        /// `parent` or `child`.
        element: &'static str,
    },
    /// Two joints or two links have one name.
    #[error("the name {name} is used twice; rename one of the two")]
    RepeatedName {
        /// The name.
        name: String,
    },
    /// A joint or the caller names a link that the file does not have.
    #[error(
        "link {link}, named by {by}, is not in the file; it has: {known}{}",
        how_to_name(by)
    )]
    UnknownLink {
        /// The missing link.
        link: String,
        /// Who names it.
        by: String,
        /// The links of the file.
        known: String,
    },
    /// The link at which the chain shall begin is not above its tip.
    #[error(
        "base link {base} is not above {tip}; {}",
        how_to_connect(above, *below)
    )]
    NotAbove {
        /// The base wanted.
        base: String,
        /// The tip.
        tip: String,
        /// The links above the tip.
        above: String,
        /// Whether the base is below the tip: the two are exchanged.
        below: bool,
    },
    /// A joint that shall be held still is not in the chain.
    #[error(
        "joint {joint}, to be held still, is not in the chain; hold one of its moving joints: \
         {known}"
    )]
    UnknownJoint {
        /// The joint named.
        joint: String,
        /// The joints of the chain.
        known: String,
    },
    /// A joint shall be held where it cannot go.
    #[error(
        "joint {joint} cannot be held at {position}: its limits are {lower} and {upper}; choose a \
         value between them"
    )]
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
    #[error(
        "link {link} is the child of both {first} and {second}: a loop; a URDF is a tree: remove \
         one of these joints"
    )]
    TwoParents {
        /// The link.
        link: String,
        /// The joint met first.
        first: String,
        /// The other joint.
        second: String,
    },
    /// Going from this link to its parents never ends.
    #[error("link {link} is its own ancestor: a loop; mend <parent> of a joint above it")]
    Loop {
        /// A link of the loop.
        link: String,
    },
    /// The file holds several trees.
    #[error(
        "two roots, {first} and {second}: the links are not connected; add a fixed joint between \
         them or remove the part that is not needed"
    )]
    TwoRoots {
        /// A root.
        first: String,
        /// Another one.
        second: String,
    },
    /// Something is missing, and links or joints have names that no reader of URDFs knows.
    #[error(
        "line {line}: <{element}> is not read, for the elements of a URDF have no prefix: take \
         `{prefix}:` off"
    )]
    Prefixed {
        /// The first of them.
        element: String,
        /// Its prefix.
        prefix: String,
        /// Its line, from 1.
        line: usize,
    },
    /// A joint of the chain moves in a way that the chain does not admit.
    #[error(
        "joint {joint}: type {found}; the chain may hold {admitted} joints only: {}{}",
        how_to_leave_out(child, above.as_deref()),
        how_to_hold(joint, found)
    )]
    JointType {
        /// Name of the joint.
        joint: String,
        /// Its type.
        found: &'static str,
        /// Types that may be there.
        admitted: &'static str,
        /// The link that it moves.
        child: String,
        /// The link above it, where the joints above make an arm already.
        above: Option<String>,
    },
    /// A joint of the chain copies one that is not in the chain.
    #[error(
        "joint {joint} mimics {mimicked}, which does not move in the chain; hold {joint} still \
         (--hold {joint}=VALUE, arm.held_joints_deg)"
    )]
    Mimic {
        /// Name of the joint.
        joint: String,
        /// The joint that it follows.
        mimicked: String,
    },
    /// A joint has no limits.
    #[error(
        "joint {joint}: <limit> is missing; add <limit lower=\"\" upper=\"\" velocity=\"\"/>, or make \
         its type \"continuous\" if it turns without ends"
    )]
    MissingLimits {
        /// Name of the joint.
        joint: String,
    },
    /// The limits of a joint leave no travel.
    #[error(
        "joint {joint}: limits from {lower} to {upper} allow no motion; {}",
        how_to_move(joint, *lower, *upper)
    )]
    NoTravel {
        /// Name of the joint.
        joint: String,
        /// Lower limit \[rad or m\].
        lower: f64,
        /// Upper limit \[rad or m\].
        upper: f64,
    },
    /// A number of a joint is not finite.
    #[error(
        "joint {joint}: <{element}> is not finite; write numbers there{}",
        or_endless(element)
    )]
    NonFinite {
        /// Name of the joint.
        joint: String,
        /// The element.
        element: &'static str,
    },
    /// The axis of a joint has no direction.
    #[error("joint {joint}: <axis> is zero; write its direction, as in <axis xyz=\"0 0 1\"/>")]
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
        /// What mends it.
        hint: String,
    },
}

impl UrdfError {
    /// The error about a file without XML, by how it begins.
    pub(super) fn no_xml(text: &str) -> Self {
        let begins = |start: &str| text.trim_start().starts_with(start);
        let what = if text.trim().is_empty() {
            ": it is empty; fetch it again"
        } else if begins("version https://git-lfs") {
            ": it is a pointer of Git LFS; `git lfs pull` fetches the file"
        } else if begins("\u{1f}") {
            ": it is compressed; unpack it (`gzip -d`)"
        } else if begins("PK\u{3}") {
            ": it is a ZIP archive; unpack it (`unzip`)"
        } else if begins("{") || begins("[") {
            ": it looks like JSON; take the arm's .urdf"
        } else if begins("solid") {
            ": it looks like an STL mesh; take the .urdf that refers to it"
        } else {
            "; take the arm's .urdf"
        };
        Self::NoXml { what }
    }

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

fn or_endless(element: &str) -> &'static str {
    if element == "limit" {
        ", or make its type \"continuous\" if it has no ends"
    } else {
        ""
    }
}

fn in_words(count: usize) -> &'static str {
    match count {
        1 => "one number",
        3 => "three numbers",
        _ => "four numbers",
    }
}

fn how_to_leave_out(child: &str, above: Option<&str>) -> String {
    match above {
        Some(link) => format!("end it above (--tip {link}, arm.tip_link = \"{link}\")"),
        None => format!("begin it below (--base {child}, arm.base_link = \"{child}\")"),
    }
}

fn how_to_hold(joint: &str, found: &str) -> String {
    match found {
        "prismatic" => {
            format!(" or hold it still (--hold {joint}=METRES, arm.held_joints_mm)")
        }
        _ => String::new(),
    }
}

fn how_to_name(by: &str) -> &'static str {
    if by == CALLER {
        "; name one of these (--tip, --base; arm.tip_link, arm.base_link)"
    } else {
        "; add the link or mend the name"
    }
}

fn how_to_connect(above: &str, below: bool) -> String {
    match (below, above) {
        (true, "") => "it is below: exchange base and tip".to_owned(),
        (true, _) => format!("it is below: exchange base and tip, or begin above: {above}"),
        (false, "") => "nothing is: that is the root; name a tip further out".to_owned(),
        (false, _) => format!("begin at one that is, upwards: {above}"),
    }
}

fn how_to_move(joint: &str, lower: f64, upper: f64) -> String {
    if lower > upper {
        return "exchange lower and upper".to_owned();
    }
    format!(
        "mend lower and upper in rad (m where it slides), or hold it still \
         (--hold {joint}={lower}, arm.held_joints_deg)"
    )
}
