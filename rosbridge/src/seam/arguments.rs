//! Arguments that ROS adds to a command line: `a:=b` (ROS 1), and what stands between `--ros-args` and
//! `--` (ROS 2).

use std::ffi::{OsStr, OsString};

/// The process's arguments without those that are ROS's.
pub fn plain_arguments() -> impl Iterator<Item = OsString> {
    split(std::env::args_os()).0.into_iter()
}

/// Those that are ROS's.
#[cfg(feature = "ros2")]
pub(super) fn of_ros() -> Vec<String> {
    let ours = split(std::env::args_os()).1.into_iter();
    ours.map(|argument| argument.to_string_lossy().into_owned())
        .collect()
}

fn split(arguments: impl Iterator<Item = OsString>) -> (Vec<OsString>, Vec<OsString>) {
    let (mut plain, mut of_ros) = (Vec::new(), Vec::new());
    let mut inside = false;
    for (i, argument) in arguments.enumerate() {
        if i == 0 {
            plain.push(argument);
        } else if argument == OsStr::new("--ros-args") {
            inside = true;
        } else if inside && argument == OsStr::new("--") {
            inside = false;
        } else if inside || argument.to_string_lossy().contains(":=") {
            of_ros.push(argument);
        } else {
            plain.push(argument);
        }
    }
    (plain, of_ros)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_ross_is_taken_out() {
        let given = "needle-steer run a:=b --ros-args -r __node:=n -- --seed 3 --ros-args -p x:=1";
        let (plain, of_ros) = split(given.split(' ').map(OsString::from));
        assert_eq!(plain, ["needle-steer", "run", "--seed", "3"]);
        assert_eq!(of_ros, ["a:=b", "-r", "__node:=n", "-p", "x:=1"]);
    }
}
