//! A machine that stands still for a second while a simulation runs at the pace of the wall clock.

use std::time::Duration;

use crate::master::Master;
use crate::{alone, signal, start, start_run, wait_for_node};

/// How long the process stands still: far beyond what a paced clock catches up.
const PAUSE: Duration = Duration::from_millis(1200);
/// What stamps and motions may be late by on a busy machine \[s\]: half of the pause.
const LATE: f64 = 0.6;

fn pause(run: &std::process::Child) {
    signal(run, "-STOP");
    std::thread::sleep(PAUSE);
    signal(run, "-CONT");
    std::thread::sleep(Duration::from_millis(500));
}

/// Least age of what comes in three seconds on each topic \[s\].
const AGES: &str = "import rospy, time\n\
    from sensor_msgs.msg import JointState, Image\n\
    rospy.init_node('watcher', disable_signals=True)\n\
    ages = {}\n\
    def see(name):\n    \
        return lambda m: ages.setdefault(name, []).append(time.time() - m.header.stamp.to_sec())\n\
    rospy.Subscriber('/joint_states', JointState, see('joints'))\n\
    rospy.Subscriber('/left/image_raw', Image, see('images'))\n\
    rospy.rostime.wallsleep(3)\n\
    print(min(ages['joints']), min(ages['images']))\n";

/// How long the arm moves after one twist, and how fast at most \[s, rad/s\].
const TWIST: &str = "import rospy, time\n\
    from sensor_msgs.msg import JointState\n\
    from geometry_msgs.msg import TwistStamped\n\
    rospy.init_node('hand', disable_signals=True)\n\
    moves = []\n\
    def see(m):\n    \
        speed = max(abs(v) for v in m.velocity)\n    \
        if speed > 1e-4: moves.append((time.time(), speed))\n\
    rospy.Subscriber('/joint_states', JointState, see)\n\
    p = rospy.Publisher('/twist_cmd', TwistStamped, queue_size=1)\n\
    while p.get_num_connections() == 0: rospy.rostime.wallsleep(0.01)\n\
    rospy.rostime.wallsleep(0.5)\n\
    m = TwistStamped()\n\
    m.header.stamp = rospy.Time.from_sec(time.time())\n\
    m.header.frame_id = 'world'\n\
    m.twist.linear.z = 0.002\n\
    p.publish(m)\n\
    rospy.rostime.wallsleep(4)\n\
    print(moves[-1][0] - moves[0][0], max(speed for _, speed in moves))\n";

fn numbers(master: &Master, script: &str) -> [f64; 2] {
    let said = master.output(30, "python3", &["-c", script]);
    let words: Vec<f64> = said
        .split_whitespace()
        .map(|word| word.parse().unwrap_or_else(|_| panic!("{said}")))
        .collect();
    words.try_into().unwrap_or_else(|_| panic!("{said}"))
}

#[test]
fn after_a_pause_of_the_machine_all_stamps_are_of_one_clock_and_a_twist_ends() {
    let Some(master) = Master::start() else {
        return;
    };
    let _alone = alone();
    let out = master.home().join("images");
    let out = ["--out", out.to_str().unwrap()];
    let run = ["run", "--set", "ros.publish=true"];
    let mut insertion = start(&master, &[&run[..], &out[..]].concat());
    wait_for_node(&master, "/needle_steer");
    std::thread::sleep(Duration::from_secs(3));
    pause(&insertion.0);
    let [joints, images] = numbers(&master, AGES);
    assert!(joints < LATE && images < LATE, "{joints} {images} s old");
    signal(&insertion.0, "-TERM");
    insertion.0.wait().unwrap();

    let waits = ["--set", "ros.autostart=false"];
    let waiting = start_run(&master, &waits, &master.home().join("hand"));
    wait_for_node(&master, "/needle_steer");
    std::thread::sleep(Duration::from_secs(1));
    pause(&waiting.0);
    let [moves, speed] = numbers(&master, TWIST);
    assert!(moves < LATE, "{moves} s, up to {speed} rad/s");
}
