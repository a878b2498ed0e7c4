//! A screen in memory, and what rviz draws on it.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use crate::master::{Master, Running, wait_until};

/// An X window dump: true colour, three or four bytes a pixel, least significant byte first.
pub(crate) struct Picture {
    width: usize,
    height: usize,
    pixel: usize,
    line: usize,
    data: Vec<u8>,
}

impl Picture {
    pub(crate) fn parse(dump: &[u8]) -> Self {
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
    pub(crate) fn find(&self, is: impl Fn([u8; 3]) -> bool) -> (usize, [f64; 2]) {
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

/// A screen in memory; nothing where rviz or the screen is not installed and not required.
pub(crate) struct Screen {
    name: String,
    _server: Running,
}

impl Screen {
    pub(crate) fn start(master: &Master) -> Option<Self> {
        if !["/usr/bin/rviz", "/usr/bin/Xvfb", "/usr/bin/xwd"]
            .iter()
            .all(|program| Path::new(program).exists())
        {
            let required = std::env::var_os("NEEDLE_STEER_REQUIRE_ROS").is_some();
            assert!(
                !required,
                "rviz, Xvfb and xwd are required and not installed"
            );
            eprintln!("skipped: rviz, xvfb or x11-apps is not installed");
            return None;
        }
        let number = master.home().join("display");
        let mut command = master.command("Xvfb");
        command
            .args(["-displayfd", "1", "-screen", "0", "1280x900x24"])
            .args(["+extension", "GLX", "-nolisten", "tcp"])
            .stdout(std::fs::File::create(&number).unwrap())
            .stderr(Stdio::null());
        let server = Running(command.spawn().unwrap());
        let read = || {
            let text = std::fs::read_to_string(&number).unwrap_or_default();
            text.trim().to_owned()
        };
        let up = wait_until(Duration::from_secs(20), || !read().is_empty());
        assert!(up, "no X server");
        Some(Self {
            name: format!(":{}", read()),
            _server: server,
        })
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// What is on the screen now; nothing while there is none.
    pub(crate) fn dump(&self, master: &Master) -> Vec<u8> {
        let mut command = master.command("xwd");
        command.args(["-root", "-silent", "-display", &self.name]);
        command.output().unwrap().stdout
    }
}

/// Whether arm, needle, tip axis and target are there, by colour and place, and what was found.
pub(crate) fn shows_the_scene(picture: &Picture) -> (bool, String) {
    let target = picture.find(|[r, g, b]| r > 200 && g < 60 && b < 60);
    let axis = picture.find(|[r, g, b]| g > 90 && r < g / 2 && b < g / 2);
    let needle = picture.find(|[r, g, b]| b > r.saturating_add(8) && b > 180 && g >= r);
    let arm = picture.find(|[r, g, b]| r.abs_diff(g) <= 6 && g.abs_diff(b) <= 10 && r >= 60);
    let found = format!("target {target:?}, axis {axis:?}, needle {needle:?}, arm {arm:?}");
    let seen = target.0 > 4 && axis.0 > 8 && needle.0 > 20 && arm.0 > 20_000;
    // From top to bottom on the screen: needle, tip axis, the arm to their left. How far the axis
    // is above the target depends on where the insertion was held; past it, it is below.
    let down = [axis, target].iter().all(|below| needle.1[1] < below.1[1]);
    let placed = down && arm.1[0] < needle.1[0];
    (seen && placed, found)
}
