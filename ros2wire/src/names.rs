//! ROS 2's names: how they are resolved and remapped, and what DDS calls them.

/// Arguments that ROS 2 adds to a command line, as far as they are understood.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Arguments {
    /// Rules `from:=to`, in their order; names as they were written.
    pub remaps: Vec<(String, String)>,
    /// Arguments that are passed over.
    pub passed_over: Vec<String>,
}

impl Arguments {
    /// Reads what stands behind `--ros-args`, and rules in the style of ROS 1 (`a:=b`).
    pub fn read(arguments: impl IntoIterator<Item = String>) -> Self {
        let mut read = Self::default();
        let mut arguments = arguments.into_iter();
        while let Some(argument) = arguments.next() {
            match argument.as_str() {
                "--ros-args" | "--" => {}
                "-r" | "--remap" => match arguments.next() {
                    Some(rule) => read.rule(rule),
                    None => read.passed_over.push(argument),
                },
                "-p" | "--param" | "--params-file" | "--log-level" | "--log-config-file" | "-e"
                | "--enclave" => {
                    read.passed_over.push(argument);
                    read.passed_over.extend(arguments.next());
                }
                _ => read.rule(argument),
            }
        }
        read
    }

    fn rule(&mut self, rule: String) {
        match rule.split_once(":=") {
            // Private parameters in the style of ROS 1.
            Some((from, _)) if from.starts_with('_') && !from.starts_with("__") => {
                self.passed_over.push(rule);
            }
            Some((from, to)) => self.remaps.push((from.to_owned(), to.to_owned())),
            None => self.passed_over.push(rule),
        }
    }
}

/// A node's name and what its relative names stand for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names {
    namespace: String,
    node: String,
    /// Full names.
    remaps: Vec<(String, String)>,
}

/// A name that ROS 2 does not allow.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{name}` is no name of ROS 2: letters, digits and underscores between slashes, none of them beginning with a digit"
)]
pub struct BadName {
    /// The name.
    pub name: String,
}

impl Names {
    /// Of a node called `node`, unless the arguments call it otherwise.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow.
    pub fn new(node: &str, arguments: &Arguments) -> Result<Self, BadName> {
        let chosen = |keys: &[&str]| {
            let rule = arguments.remaps.iter().rev();
            rule.clone()
                .find(|(from, _)| keys.contains(&from.rsplit(':').next().unwrap_or_default()))
                .map(|(_, to)| to.clone())
        };
        let namespace = chosen(&["__ns"]).unwrap_or_default();
        let mut names = Self {
            namespace: namespace.trim_matches('/').to_owned(),
            node: chosen(&["__node", "__name"]).unwrap_or_else(|| node.to_owned()),
            remaps: Vec::new(),
        };
        check(&names.full())?;
        if names.node.contains('/') {
            return Err(BadName { name: names.node });
        }
        for (from, to) in &arguments.remaps {
            // A rule for one node: `node:from`.
            let from = match from.split_once(':') {
                Some((of, from)) if of == names.node => from,
                Some(_) => continue,
                None => from,
            };
            if from.starts_with("__") {
                continue;
            }
            let rule = (names.expand(from), names.expand(to));
            check(&rule.0)?;
            check(&rule.1)?;
            names.remaps.push(rule);
        }
        Ok(names)
    }

    /// The namespace, with the slash before it.
    pub fn namespace(&self) -> String {
        format!("/{}", self.namespace)
    }

    /// The node's own name.
    pub fn node(&self) -> &str {
        &self.node
    }

    /// The node's full name.
    pub fn full(&self) -> String {
        if self.namespace.is_empty() {
            format!("/{}", self.node)
        } else {
            format!("/{}/{}", self.namespace, self.node)
        }
    }

    /// The full name that `name` stands for: `~x` and `~/x` are the node's own.
    pub fn resolve(&self, name: &str) -> String {
        let full = self.expand(name);
        self.remaps
            .iter()
            .find(|(from, _)| *from == full)
            .map_or(full, |(_, to)| to.clone())
    }

    fn expand(&self, name: &str) -> String {
        if let Some(own) = name.strip_prefix('~') {
            format!("{}/{}", self.full(), own.trim_start_matches('/'))
        } else if name.starts_with('/') {
            name.to_owned()
        } else if self.namespace.is_empty() {
            format!("/{name}")
        } else {
            format!("/{}/{name}", self.namespace)
        }
    }
}

/// Refuses a full name that ROS 2 does not allow.
///
/// # Errors
/// See [`BadName`].
pub fn check(full: &str) -> Result<(), BadName> {
    let token = |token: &str| {
        token.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && token.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    match full.strip_prefix('/') {
        Some(rest) if rest.split('/').all(token) => Ok(()),
        _ => Err(BadName {
            name: full.to_owned(),
        }),
    }
}

/// What DDS calls a topic.
pub(crate) fn topic(full: &str) -> String {
    format!("rt{full}")
}

/// What DDS calls a service's requests.
pub(crate) fn requests(full: &str) -> String {
    format!("rq{full}Request")
}

/// What DDS calls a service's replies.
pub(crate) fn replies(full: &str) -> String {
    format!("rr{full}Reply")
}

/// What DDS calls a message's type, `package/Name`.
pub(crate) fn message_type(name: &str) -> String {
    let (package, name) = name.split_once('/').unwrap_or(("", name));
    format!("{package}::msg::dds_::{name}_")
}

/// What DDS calls the types of a service's requests and replies, `package/Name`.
pub(crate) fn service_types(name: &str) -> [String; 2] {
    let (package, name) = name.split_once('/').unwrap_or(("", name));
    ["Request", "Response"].map(|part| format!("{package}::srv::dds_::{name}_{part}_"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(arguments: &[&str]) -> Names {
        let arguments = arguments.iter().map(|&text| text.to_owned());
        Names::new("needle_steer", &Arguments::read(arguments)).unwrap()
    }

    #[test]
    fn names_are_resolved_as_ros_2_does() {
        let plain = names(&[]);
        assert_eq!(plain.full(), "/needle_steer");
        assert_eq!(plain.resolve("joint_states"), "/joint_states");
        assert_eq!(plain.resolve("~start"), "/needle_steer/start");
        assert_eq!(plain.resolve("/tf"), "/tf");
        let arguments = [
            "--ros-args",
            "-r",
            "__ns:=/lab/one",
            "--remap",
            "__node:=steerer",
            "-r",
            "a/b:=/c",
            "-r",
            "~/start:=go",
            "-r",
            "other:x:=y",
            "-r",
            "steerer:x:=z",
            "-p",
            "rate:=3",
            "--",
        ];
        let moved = names(&arguments);
        assert_eq!(moved.full(), "/lab/one/steerer");
        assert_eq!(moved.namespace(), "/lab/one");
        assert_eq!(moved.resolve("joint_states"), "/lab/one/joint_states");
        assert_eq!(moved.resolve("a/b"), "/c");
        assert_eq!(moved.resolve("~start"), "/lab/one/go");
        assert_eq!(moved.resolve("x"), "/lab/one/z");
        assert_eq!(names(&["a:=b", "__name:=n"]).full(), "/n");
        assert_eq!(names(&["a:=b"]).resolve("a"), "/b");
    }

    #[test]
    fn names_that_ros_2_does_not_allow_are_refused() {
        for rule in ["__node:=a-b", "__ns:=/1x", "__node:=a/b", "x:=/y//z"] {
            let read = Arguments::read([rule.to_owned()]);
            assert!(Names::new("n", &read).is_err(), "{rule}");
        }
        let read = Arguments::read(["-p", "x:=1", "--log-level", "debug"].map(str::to_owned));
        assert!(read.remaps.is_empty());
        assert_eq!(read.passed_over.len(), 4);
    }

    #[test]
    fn dds_names_are_those_of_ros_2() {
        assert_eq!(topic("/joint_states"), "rt/joint_states");
        assert_eq!(requests("/n/start"), "rq/n/startRequest");
        assert_eq!(replies("/n/start"), "rr/n/startReply");
        assert_eq!(
            message_type("geometry_msgs/TwistStamped"),
            "geometry_msgs::msg::dds_::TwistStamped_"
        );
        assert_eq!(
            service_types("std_srvs/Trigger"),
            [
                "std_srvs::srv::dds_::Trigger_Request_",
                "std_srvs::srv::dds_::Trigger_Response_"
            ]
        );
    }
}
