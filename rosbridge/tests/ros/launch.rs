//! `roslaunch` end to end: launch files, wrapper, robot description, rviz.
//!
//! The binary is stood in for by this test's own node, so that the package is tested alone.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::master::{Master, Running, wait_until};

/// A running `roslaunch`; interrupted on drop so that it ends its nodes.
struct Launch(Running);

impl Launch {
    fn start(master: &Master, arguments: &[&str], screen: Option<&str>) -> Self {
        let stand_in = master.home().join("stand-in");
        let own = std::env::current_exe().unwrap();
        // The node lives until its standard input closes; roslaunch gives it none.
        let script = format!(
            "#!/bin/sh\necho \"$@\" >> {}\nsleep 300 | ROSBRIDGE_TEST_PART=bridge {} --exact \
             child::plays_its_part --nocapture\n",
            master.home().join("arguments").display(),
            own.display()
        );
        std::fs::write(&stand_in, script).unwrap();
        std::fs::set_permissions(&stand_in, std::fs::Permissions::from_mode(0o755)).unwrap();
        let packages = concat!(env!("CARGO_MANIFEST_DIR"), "/ros:/usr/share");
        let mut command = master.command("roslaunch");
        command
            .args(arguments)
            .env("ROS_PACKAGE_PATH", packages)
            .env("NEEDLE_STEER_BIN", stand_in)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        if let Some(screen) = screen {
            command
                .env("DISPLAY", screen)
                .env("LIBGL_ALWAYS_SOFTWARE", "1")
                .env("QT_QPA_PLATFORM", "xcb")
                .env("XDG_RUNTIME_DIR", master.home());
        }
        Self(Running(command.spawn().unwrap()))
    }
}

impl Drop for Launch {
    fn drop(&mut self) {
        let _ = Command::new("kill")
            .args(["-INT", &self.0.0.id().to_string()])
            .status();
        let _ = self.0.0.wait();
    }
}

fn nodes(master: &Master) -> String {
    master.output(10, "rosnode", &["list"])
}

#[test]
fn sim_launch_starts_the_node_and_the_arms_frames() {
    let Some(master) = Master::start() else {
        return;
    };
    let arguments = [
        "needle_steer",
        "sim.launch",
        "rviz:=false",
        "law:=paper",
        "seed:=7",
    ];
    let launch = Launch::start(&master, &arguments, None);
    let up = wait_until(Duration::from_secs(30), || {
        let nodes = nodes(&master);
        nodes.contains("/needle_steer") && nodes.contains("/robot_state_publisher")
    });
    assert!(up, "{}", nodes(&master));
    let passed = std::fs::read_to_string(master.home().join("arguments")).unwrap();
    let wanted = "run --backend sim --law paper --seed 7 --set ros.publish=true \
                  --set ros.autostart=true";
    assert!(passed.starts_with(wanted), "{passed}");
    // From the robot's description and joint_states, through robot_state_publisher.
    let script = "import rospy\nfrom tf2_msgs.msg import TFMessage\n\
        rospy.init_node('frames', disable_signals=True)\nseen = set()\n\
        def take(m): seen.update(t.header.frame_id + '>' + t.child_frame_id for t in m.transforms)\n\
        a = rospy.Subscriber('/tf', TFMessage, take)\n\
        b = rospy.Subscriber('/tf_static', TFMessage, take)\n\
        rospy.rostime.wallsleep(4)\nprint('\\n'.join(sorted(seen)))\n";
    let frames = master.output(20, "python3", &["-c", script]);
    for edge in [
        "world>base_link",
        "link_5>link_6",
        "tool0>needle_base",
        "needle_base>needle_tip",
    ] {
        assert!(
            frames.lines().any(|line| line == edge),
            "{edge} is missing: {frames}"
        );
    }
    drop(launch);
    let left = nodes(&master);
    assert!(!left.contains("robot_state_publisher"), "{left}");
}

/// An X window dump: true colour, three or four bytes a pixel, least significant byte first.
struct Picture {
    width: usize,
    height: usize,
    pixel: usize,
    line: usize,
    data: Vec<u8>,
}

impl Picture {
    fn parse(dump: &[u8]) -> Self {
        let field =
            |i: usize| u32::from_be_bytes(dump[4 * i..4 * i + 4].try_into().unwrap()) as usize;
        assert_eq!((field(1), field(7)), (7, 0), "version and byte order");
        let data = dump[field(0) + 12 * field(19)..].to_vec();
        Self {
            width: field(4),
            height: field(5),
            pixel: field(11) / 8,
            line: field(12),
            data,
        }
    }

    fn rgb(&self, x: usize, y: usize) -> [u8; 3] {
        let at = y * self.line + x * self.pixel;
        [self.data[at + 2], self.data[at + 1], self.data[at]]
    }

    /// Number of pixels that satisfy `is` in the 3D view, and their mean place.
    fn find(&self, is: impl Fn([u8; 3]) -> bool) -> (usize, [f64; 2]) {
        let (mut count, mut sum) = (0, [0.0; 2]);
        for y in 70..self.height - 40 {
            for x in 380..self.width - 20 {
                if is(self.rgb(x, y)) {
                    count += 1;
                    sum = [sum[0] + x as f64, sum[1] + y as f64];
                }
            }
        }
        let mean = sum.map(|s| s / f64::from(u32::try_from(count.max(1)).unwrap()));
        (count, mean)
    }
}

#[test]
fn rviz_shows_arm_needle_and_target() {
    let Some(master) = Master::start() else {
        return;
    };
    if !["/usr/bin/rviz", "/usr/bin/Xvfb", "/usr/bin/xwd"]
        .iter()
        .all(|p| Path::new(p).exists())
    {
        let required = std::env::var_os("NEEDLE_STEER_REQUIRE_ROS").is_some();
        assert!(
            !required,
            "rviz, Xvfb and xwd are required and not installed"
        );
        eprintln!("skipped: rviz, xvfb or x11-apps is not installed");
        return;
    }
    let number = master.home().join("display");
    let _server = Running(
        master
            .command("Xvfb")
            .args([
                "-displayfd",
                "1",
                "-screen",
                "0",
                "1280x900x24",
                "+extension",
                "GLX",
            ])
            .args(["-nolisten", "tcp"])
            .stdout(std::fs::File::create(&number).unwrap())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let read = || {
        std::fs::read_to_string(&number)
            .unwrap_or_default()
            .trim()
            .to_owned()
    };
    assert!(
        wait_until(Duration::from_secs(20), || !read().is_empty()),
        "no X server"
    );
    let screen = format!(":{}", read());
    let _launch = Launch::start(&master, &["needle_steer", "sim.launch"], Some(&screen));

    let is_target = |[r, g, b]: [u8; 3]| r > 200 && g < 60 && b < 60;
    let is_tip_axis = |[r, g, b]: [u8; 3]| g > 90 && r < g / 2 && b < g / 2;
    let is_needle = |[r, g, b]: [u8; 3]| b > r.saturating_add(8) && b > 180 && g >= r;
    let is_arm = |[r, g, b]: [u8; 3]| r.abs_diff(g) <= 6 && g.abs_diff(b) <= 10 && r >= 60;
    let mut found = String::new();
    let shown = wait_until(Duration::from_mins(2), || {
        let dump = master
            .command("xwd")
            .args(["-root", "-silent", "-display", &screen])
            .output();
        let dump = dump.unwrap().stdout;
        if dump.is_empty() {
            return false;
        }
        let picture = Picture::parse(&dump);
        let target = picture.find(is_target);
        let axis = picture.find(is_tip_axis);
        let needle = picture.find(is_needle);
        let arm = picture.find(is_arm);
        found = format!("target {target:?}, axis {axis:?}, needle {needle:?}, arm {arm:?}");
        let seen = target.0 > 10 && axis.0 > 8 && needle.0 > 40 && arm.0 > 20_000;
        // From top to bottom on the screen: needle, tip axis, target; the arm to their left.
        let placed = needle.1[1] < axis.1[1] && axis.1[1] < target.1[1];
        if seen && placed && arm.1[0] < needle.1[0] {
            if let Some(keep) = std::env::var_os("NEEDLE_STEER_PICTURE") {
                std::fs::write(keep, &dump).unwrap();
            }
            return true;
        }
        false
    });
    println!("{found}");
    assert!(shown, "{found}");
}
