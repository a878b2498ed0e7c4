//! Targets over ROS: refused in words to who gave them, before a start and during an insertion.

use std::io::{BufRead, BufReader, Lines, Write};
use std::process::{ChildStdin, ChildStdout, Stdio};
use std::time::Duration;

use crate::master::{Master, Running, wait_until};
use crate::{among_others, call, phase, signal, start_run, wait_for_node};

/// Publishes a target a line (frame, coordinates [mm]); prints the answer and what `/rosout` says.
const OPERATOR: &str = "import sys, threading, rospy\n\
    from geometry_msgs.msg import PointStamped\nfrom rosgraph_msgs.msg import Log\n\
    from std_msgs.msg import String\n\
    rospy.init_node('operator', disable_signals=True)\n\
    answers, said = [], []\n\
    rospy.Subscriber('/target/answer', String, lambda m: answers.append(m.data))\n\
    rospy.Subscriber('/rosout', Log, lambda m: said.append(m.msg))\n\
    p = rospy.Publisher('/target', PointStamped, queue_size=1)\n\
    while p.get_num_connections() == 0: rospy.rostime.wallsleep(0.01)\n\
    print('up', flush=True)\n\
    for line in sys.stdin:\n\
    \x20   frame, x, y, z = line.split()\n\
    \x20   m = PointStamped()\n    m.header.frame_id = frame\n\
    \x20   m.point.x, m.point.y, m.point.z = [float(v) * 1e-3 for v in (x, y, z)]\n\
    \x20   del answers[:], said[:]\n    p.publish(m)\n\
    \x20   for _ in range(300):\n        if answers: break\n        rospy.rostime.wallsleep(0.01)\n\
    \x20   rospy.rostime.wallsleep(0.2)\n\
    \x20   heard = any('target refused' in text for text in said)\n\
    \x20   print(answers[-1] if answers else 'no answer', '(on rosout)' if heard else '', flush=True)\n";

/// 60 mm below the surface of the default insertion, and 5 mm above it.
const DOWN_60: &str = "world 400 0 190";
const UP_5: &str = "world 400 0 255";

struct Operator {
    _process: Running,
    orders: ChildStdin,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Operator {
    fn start(master: &Master) -> Self {
        let mut child = master
            .command("python3")
            .args(["-c", OPERATOR])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut operator = Self {
            orders: child.stdin.take().unwrap(),
            lines: BufReader::new(child.stdout.take().unwrap()).lines(),
            _process: Running(child),
        };
        assert_eq!(operator.lines.next().unwrap().unwrap(), "up");
        operator
    }

    fn aim(&mut self, target: &str) -> String {
        writeln!(self.orders, "{target}").unwrap();
        self.lines.next().unwrap().unwrap()
    }

    fn is_refused(&mut self, target: &str, words: &str) {
        let answer = self.aim(target);
        let told = answer.contains("target refused") && answer.contains(words);
        assert!(told && answer.contains("on rosout"), "{target}: {answer}");
    }
}

/// Refused at the start, the node stays and takes another; refused on the way, the insertion goes
/// on to the one that it has.
#[test]
fn targets_are_refused_in_words_and_the_node_stays() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let out = master.home().join("targets");
    // Deeper than the needle is long, and the node starts by itself.
    let mut run = start_run(&master, &["--set", "target.depth_mm=300"], &out);
    wait_for_node(&master, "/needle_steer");
    let (started, answer) = call(&master, "/needle_steer/start");
    assert!(!started && answer.contains("too short"), "{answer}");
    let mut operator = Operator::start(&master);
    operator.is_refused("world 0 0 -17000", "too short for the target");
    operator.is_refused("base_link 0 0 0", "base_link");
    operator.is_refused("world nan 0 0", "finite");
    let (started, answer) = call(&master, "/needle_steer/start");
    assert!(!started && answer.contains("target refused"), "{answer}");
    let answer = operator.aim(DOWN_60);
    assert!(answer.contains("60.0 mm ahead"), "{answer}");
    let (started, answer) = call(&master, "/needle_steer/start");
    assert!(started, "{answer}");
    let steering = wait_until(Duration::from_secs(40), || {
        phase(&master).contains("Steering")
    });
    assert!(steering, "{}", phase(&master));
    operator.is_refused("world 0 0 -17000", "too short for the target");
    operator.is_refused(UP_5, "behind the tip");
    let answer = operator.aim(DOWN_60);
    assert!(answer.contains("aiming there"), "{answer}");
    assert!(!out.join("summary.json").exists(), "the insertion goes on");
    let (stopped, answer) = call(&master, "/needle_steer/stop");
    assert!(stopped, "{answer}");
    let ended = wait_until(Duration::from_secs(20), || {
        out.join("summary.json").exists()
    });
    assert!(ended, "{}", phase(&master));
    operator.is_refused(DOWN_60, "the insertion has ended");
    assert!(run.0.try_wait().unwrap().is_none(), "the node stays");
    signal(&run.0, "-TERM");
    assert_eq!(run.0.wait().unwrap().code(), Some(1));
}
