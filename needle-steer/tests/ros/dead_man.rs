//! The dead-man's switch over a real master: the topic and the service keep a run going.

use std::time::Duration;

use crate::master::{Master, wait_until};
use crate::{among_others, call, signal, start_run, wait_for_node};

/// Tokens at 20 Hz for so many seconds, once the node listens.
fn tokens(seconds: u32) -> String {
    format!(
        "import rospy\nfrom std_msgs.msg import Empty\n\
         rospy.init_node('operator', disable_signals=True)\n\
         p = rospy.Publisher('/steer/dead_man', Empty, queue_size=1)\n\
         while p.get_num_connections() == 0: rospy.rostime.wallsleep(0.01)\n\
         for _ in range({}):\n    p.publish(Empty())\n    rospy.rostime.wallsleep(0.05)\n",
        20 * seconds
    )
}

#[test]
fn tokens_over_ros_keep_a_run_going_until_they_stop() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let out = master.home().join("dead-man");
    let switch = ["--set", "supervisor.dead_man_ms=3000", "__name:=steer"];
    let mut run = start_run(&master, &switch, &out);
    wait_for_node(&master, "/steer");
    // The first token over the service, then for longer than one of them lasts over the topic.
    let held = wait_until(Duration::from_secs(10), || {
        call(&master, "/steer/dead_man").0
    });
    assert!(held, "the service does not answer");
    let mut operator = master.python(&tokens(8));
    assert!(operator.0.wait().unwrap().success());
    let summary = out.join("summary.json");
    assert!(!summary.exists(), "it ended while the switch was held");
    let ended = wait_until(Duration::from_secs(30), || summary.exists());
    assert!(ended, "it goes on though nobody holds the switch");
    let text = std::fs::read_to_string(&summary).unwrap();
    assert!(text.contains("dead-man's switch released"), "{text}");
    let series = std::fs::read_to_string(out.join("series.csv")).unwrap();
    let depth = |line: &str| line.split(',').nth(1).unwrap().parse::<f64>().unwrap();
    let (first, last) = (series.lines().nth(1), series.lines().last());
    let advance = depth(last.unwrap()) - depth(first.unwrap());
    assert!(advance > 3.0, "{advance} mm in 8 s at 1 mm/s");
    signal(&run.0, "-TERM");
    assert_eq!(run.0.wait().unwrap().code(), Some(1));
}
