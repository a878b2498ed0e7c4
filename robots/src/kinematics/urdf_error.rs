//! What can be wrong with a URDF.

/// Why a URDF gives no chain.
#[derive(Debug, thiserror::Error)]
pub enum UrdfError {
    /// The text is not well-formed XML.
    #[error("not well-formed XML at byte {byte}: {source}")]
    Xml {
        /// Where the reader stopped.
        byte: u64,
        /// What it did not like.
        source: quick_xml::Error,
    },
    /// The text is XML, but no URDF.
    #[error("not a URDF: {0}")]
    NotUrdf(#[from] urdf_rs::UrdfError),
    /// An element of the robot is not as a URDF has it.
    #[error("{kind} {name}: {source}")]
    Element {
        /// `joint`, `link` or what else stands in a robot.
        kind: String,
        /// Its name.
        name: String,
        /// What the parser says of it.
        source: urdf_rs::UrdfError,
    },
    /// A joint has an element twice.
    #[error("joint {joint}: more than one <{element}>")]
    RepeatedElement {
        /// Name of the joint.
        joint: String,
        /// The element.
        element: String,
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
    /// A moving joint of the chain is not a limited revolute joint.
    #[error("joint {joint}: type {found}; the chain may hold revolute and fixed joints only")]
    JointType {
        /// Name of the joint.
        joint: String,
        /// Its type.
        found: &'static str,
    },
    /// A joint of the chain copies another one.
    #[error("joint {joint} mimics {mimicked}; only independent joints are supported")]
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
    /// The limits of a joint leave no travel or no speed.
    #[error(
        "joint {joint}: limits from {lower} to {upper} rad at {velocity} rad/s allow no motion"
    )]
    NoTravel {
        /// Name of the joint.
        joint: String,
        /// Lower limit \[rad\].
        lower: f64,
        /// Upper limit \[rad\].
        upper: f64,
        /// Highest speed \[rad/s\].
        velocity: f64,
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
    /// The chain has not six or seven revolute joints.
    #[error("the chain from {base} to {tip} has {found} revolute joints; 6 or 7 are supported")]
    JointCount {
        /// First link.
        base: String,
        /// Last link.
        tip: String,
        /// Revolute joints between them.
        found: usize,
    },
}
