//! A node that waits, is moved by hand, inserts, withdraws and ends, as its services say.

use std::time::Duration;

use crate::master::{Master, wait_until};
use crate::{among_others, call, phase, signal, start, wait_for_node};

/// Positions of the joints [rad].
fn joints(master: &Master) -> Vec<f64> {
    let text = master.output(
        20,
        "rostopic",
        &["echo", "-n", "1", "/joint_states/position"],
    );
    let line = text.lines().next().unwrap_or_default();
    line.trim_matches(|c| "[()]".contains(c))
        .split(", ")
        .map(|number| number.parse().unwrap_or_else(|_| panic!("{text}")))
        .collect()
}

fn apart(a: &[f64], b: &[f64]) -> f64 {
    let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    apart.fold(0.0, f64::max)
}

/// Publishes a twist at 50 Hz for a second.
fn twist(master: &Master, upwards: f64) {
    let script = format!(
        "import rospy\nfrom geometry_msgs.msg import TwistStamped\n\
         rospy.init_node('hand', disable_signals=True)\n\
         p = rospy.Publisher('/twist_cmd', TwistStamped, queue_size=1)\n\
         while p.get_num_connections() == 0: rospy.rostime.wallsleep(0.01)\n\
         m = TwistStamped()\nm.header.frame_id = 'world'\nm.twist.linear.z = {upwards}\n\
         for _ in range(50):\n    m.header.stamp = rospy.Time.now()\n    p.publish(m)\n\
         \x20   rospy.rostime.wallsleep(0.02)\nrospy.rostime.wallsleep(0.5)\n"
    );
    let done = master.run(30, "python3", &["-c", &script]);
    assert!(done.status.success(), "{done:?}");
}

fn home(master: &Master, place: &[f64]) {
    let (accepted, answer) = call(master, "/steer/home");
    assert!(accepted, "{answer}");
    let mut at = Vec::new();
    let there = wait_until(Duration::from_secs(15), || {
        at = joints(master);
        apart(&at, place) < 2e-3
    });
    assert!(there, "{at:?} is not {place:?}");
}

#[test]
fn services_and_hands_lead_through_a_run() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let out = master.home().join("services");
    let arguments = [
        "run",
        "--set",
        "ros.publish=true",
        "--set",
        "ros.autostart=false",
    ];
    // As roslaunch adds them.
    let added = ["__name:=steer", "__log:=steer.log", "_speed:=3", "--out"];
    let all = [&arguments[..], &added[..], &[out.to_str().unwrap()]].concat();
    let mut run = start(&master, &all);
    wait_for_node(&master, "/steer");
    let refused = [
        ("retract", "nothing is inserted"),
        ("pause", "no insertion"),
    ];
    for (service, reason) in refused {
        let (accepted, answer) = call(&master, &format!("/steer/{service}"));
        assert!(!accepted && answer.contains(reason), "{answer}");
    }
    let place = joints(&master);
    twist(&master, 0.01);
    let lifted = joints(&master);
    assert!(apart(&place, &lifted) > 5e-3, "{place:?} {lifted:?}");
    home(&master, &place);
    // Not into the tissue.
    twist(&master, -0.01);
    let pressed = joints(&master);
    assert!(apart(&place, &pressed) < 3e-3, "{place:?} {pressed:?}");
    let mut goal = place.clone();
    goal[5] += 0.3;
    let names = (1..=6).map(|i| format!("joint_{i}")).collect::<Vec<_>>();
    let trajectory = format!(
        "{{joint_names: [{}], points: [{{positions: {goal:?}, time_from_start: {{secs: 1}}}}]}}",
        names.join(", ")
    );
    let topic = "/joint_trajectory_controller/command";
    let kind = "trajectory_msgs/JointTrajectory";
    master.run(20, "rostopic", &["pub", "-1", topic, kind, &trajectory]);
    let turned = wait_until(Duration::from_secs(10), || {
        apart(&joints(&master), &goal) < 3e-3
    });
    assert!(turned, "{:?} is not {goal:?}", joints(&master));
    home(&master, &place);

    let (started, answer) = call(&master, "/steer/start");
    assert!(started, "{answer}");
    let (accepted, answer) = call(&master, "/steer/home");
    assert!(!accepted && answer.contains("under way"), "{answer}");
    let inserting = wait_until(Duration::from_secs(20), || {
        phase(&master).contains("Insertion")
    });
    assert!(
        inserting || phase(&master).contains("Steering"),
        "{}",
        phase(&master)
    );
    let (retracting, answer) = call(&master, "/steer/retract");
    assert!(retracting, "{answer}");
    let summary = out.join("summary.json");
    let ended = wait_until(Duration::from_secs(30), || summary.exists());
    assert!(ended, "{}", phase(&master));
    let text = std::fs::read_to_string(&summary).unwrap();
    assert!(text.contains("\"retracted\""), "{text}");
    let (again, answer) = call(&master, "/steer/start");
    assert!(!again && answer.contains("has ended"), "{answer}");
    signal(&run.0, "-TERM");
    let code = run.0.wait().unwrap().code();
    assert_eq!(code, Some(1), "retracted is no success");
    for tool in ["rosnode", "rostopic", "rosservice"] {
        let left = master.output(10, tool, &["list"]);
        assert!(
            !left.contains("steer") && !left.contains("needle"),
            "{left}"
        );
    }
}
