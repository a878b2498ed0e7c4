//! What a run shows, as Cyclone DDS sees it, and what it is asked.

use std::collections::HashMap;
use std::time::Duration;

use rosbridge::log::{LogReader, Record};
use serde_json::Value;

use crate::peer::{Domain, Peer, wait_until};

const RUN: [&str; 8] = [
    "run",
    "--sensor",
    "shape",
    "--set",
    "ros.version=2",
    "--set",
    "ros.publish=true",
    "--out",
];

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn same(a: f64, b: f64) -> bool {
    // The peer's numbers went through a text.
    (a.is_nan() && b.is_nan()) || (a - b).abs() <= 1e-15 * a.abs()
}

/// Every step that the peer has got is that of the run's own log, number by number; targets are judged,
/// and services answer clients of Cyclone's kind.
#[test]
fn what_is_heard_is_what_the_log_holds() {
    let Some(domain) = Domain::new() else { return };
    let more = [
        "results",
        "--set",
        "ros.clock=simulated",
        "--set",
        "ros.autostart=false",
        "--set",
        "ros.stay=false",
    ];
    let mut run = domain.start(&[&RUN[..], &more].concat());
    let mut peer = domain.peer();
    peer.order("read /needle/state State reliable volatile");
    peer.order("read /joint_states JointState best volatile");
    peer.order("read /rosout Log reliable latched");
    peer.order("read /target/answer String reliable latched");
    let said = peer.message("/rosout");
    assert!(said["msg"].as_str().unwrap().contains("is up"), "{said}");
    assert_eq!(said["name"], "/needle_steer");
    let (enabled, answer) = peer.call("/needle_steer/enable true");
    assert!(enabled, "{answer}");
    // A metre behind the tip: refused, and the run keeps its own.
    peer.order("target world 0.4 0.0 1.5");
    let answer = peer.message("/target/answer");
    let answer = answer["data"].as_str().unwrap();
    assert!(answer.starts_with("target refused"), "{answer}");
    let (started, answer) = peer.call("/needle_steer/start");
    assert!(started, "{answer}");
    let mut said = Vec::new();
    let ended = wait_until(Duration::from_mins(2), || {
        said.extend(peer.rest());
        run.0.try_wait().unwrap().is_some()
    });
    assert!(ended, "the run does not end");
    said.extend(peer.rest());
    let mut heard: HashMap<u64, Value> = HashMap::new();
    let mut joints = 0;
    for said in said {
        assert!(said["error"].is_null(), "{said}");
        if said["topic"] == "/needle/state" {
            let step = said["message"]["step"].as_u64().unwrap();
            heard.insert(step, said["message"].clone());
        }
        joints += usize::from(said["topic"] == "/joint_states");
    }
    let log = LogReader::open(&domain.home().join("results/run.mcap")).unwrap();
    let mut steps = 0;
    for record in log {
        let Record::Step(step) = record.unwrap() else {
            continue;
        };
        steps += 1;
        let Some(state) = heard.get(&step.step) else {
            continue;
        };
        for (field, expected) in [
            ("lateral_error", step.lateral_error),
            ("axial_distance", step.axial_distance),
            ("depth", step.depth),
            ("predicted_miss", step.law.predicted_miss.norm()),
            ("stiffness", step.model.stiffness),
            ("max_stretch", step.model.max_stretch),
        ] {
            let found = number(&state[field]);
            assert!(same(expected, found), "{field}: {expected}, {found}");
        }
        let stamp = &state["header"]["stamp"];
        let nanos =
            stamp["sec"].as_u64().unwrap() * 1_000_000_000 + stamp["nanosec"].as_u64().unwrap();
        assert_eq!(nanos, step.stamp.as_nanos());
    }
    println!(
        "{} of {steps} steps heard, {joints} joint states",
        heard.len()
    );
    assert!(heard.len() * 10 >= steps * 9, "{} of {steps}", heard.len());
    assert!(joints * 2 > steps, "{joints} of {steps}");
}

/// Latched topics reach who comes late, qualities are what the manual says, and peers that die and come
/// back lose nothing but time; the run does not notice.
#[test]
fn late_and_dying_peers_do_not_matter() {
    let Some(domain) = Domain::new() else { return };
    let more = ["results", "--set", "ros.stay=true"];
    let mut run = domain.start(&[&RUN[..], &more].concat());
    let mut first = domain.peer();
    first.order("read /needle/state State reliable volatile");
    let before = first.message("/needle/state")["step"].as_u64().unwrap();
    first.lines.process.kill();
    drop(first);
    let mut late = domain.peer();
    late.order("read /tf_static TFMessage reliable latched");
    let still = late.message("/tf_static").to_string();
    for frame in ["world", "base_link", "left_camera_optical_frame"] {
        assert!(still.contains(frame), "{still}");
    }
    late.order("read /needle/state State reliable volatile");
    let after = late.message("/needle/state")["step"].as_u64().unwrap();
    assert!(after > before, "{after} after {before}");
    late.order("endpoints");
    let mut found = HashMap::new();
    while let Some(endpoint) = late.next(|said| said["endpoint"].is_string()) {
        if endpoint["endpoint"] == "end" {
            break;
        }
        if endpoint["own"] == false {
            let key = format!(
                "{} {}",
                endpoint["endpoint"].as_str().unwrap(),
                endpoint["name"].as_str().unwrap()
            );
            let promise = (endpoint["reliable"] == true, endpoint["latched"] == true);
            found.insert(key, (promise, endpoint["type"].to_string()));
        }
    }
    for (name, promise, kind) in [
        (
            "writer rt/tf_static",
            (true, true),
            "tf2_msgs::msg::dds_::TFMessage_",
        ),
        (
            "writer rt/tf",
            (true, false),
            "tf2_msgs::msg::dds_::TFMessage_",
        ),
        (
            "writer rt/joint_states",
            (true, false),
            "sensor_msgs::msg::dds_::JointState_",
        ),
        (
            "writer rt/left/image_raw",
            (false, false),
            "sensor_msgs::msg::dds_::Image_",
        ),
        (
            "writer rt/rosout",
            (true, true),
            "rcl_interfaces::msg::dds_::Log_",
        ),
        (
            "reader rt/target",
            (true, false),
            "geometry_msgs::msg::dds_::PointStamped_",
        ),
        (
            "reader rt/twist_cmd",
            (false, false),
            "geometry_msgs::msg::dds_::TwistStamped_",
        ),
        (
            "reader rq/needle_steer/startRequest",
            (true, false),
            "std_srvs::srv::dds_::Trigger_Request_",
        ),
        (
            "writer rr/needle_steer/startReply",
            (true, false),
            "std_srvs::srv::dds_::Trigger_Response_",
        ),
    ] {
        let known: Vec<_> = found.keys().collect();
        let (offered, typed) = found
            .get(name)
            .unwrap_or_else(|| panic!("{name}: {known:?}"));
        assert_eq!(*offered, promise, "{name}");
        assert!(typed.contains(kind), "{name}: {typed}");
    }
    let (stopped, answer) = late.call("/needle_steer/stop");
    assert!(stopped, "{answer}");
    assert!(run.0.try_wait().unwrap().is_none(), "the node has ended");
}

/// How much the node says is asked and told as of ROS 2's own nodes.
#[test]
fn the_level_of_the_nodes_logger_is_asked_and_told() {
    let Some(domain) = Domain::new() else { return };
    let more = ["results", "--set", "ros.autostart=false"];
    let _run = domain.start(&[&RUN[..], &more].concat());
    let mut peer = domain.peer();
    peer.order("read /rosout Log reliable latched");
    let said = peer.message("/rosout");
    assert!(said["msg"].as_str().unwrap().contains("is up"), "{said}");
    let levels = |peer: &mut Peer| {
        peer.order("levels /needle_steer needle_steer another");
        let said = peer.next(|said| said["levels"].is_array());
        said.unwrap()["levels"].to_string()
    };
    let told = |peer: &mut Peer, name: &str, level: u32| {
        peer.order(&format!("level /needle_steer {name} {level}"));
        let said = peer.next(|said| said["results"].is_array());
        let result = said.unwrap()["results"][0].clone();
        (result[0] == true, result[1].as_str().unwrap().to_owned())
    };
    // Information; a logger that there is not has no level.
    assert_eq!(levels(&mut peer), r#"[["needle_steer",20],["another",0]]"#);
    let (done, why) = told(&mut peer, "another", 10);
    assert!(!done && why.contains("there is needle_steer"), "{why}");
    let (done, why) = told(&mut peer, "needle_steer", 15);
    assert!(!done && why.contains("10, 20, 30, 40, 50"), "{why}");
    assert!(levels(&mut peer).contains(r#"["needle_steer",20]"#));
    assert_eq!(told(&mut peer, "needle_steer", 10), (true, String::new()));
    assert!(levels(&mut peer).contains(r#"["needle_steer",10]"#));
    // Answers of services are said at this level alone.
    let (_, answer) = peer.call("/needle_steer/pause");
    assert!(answer.contains("no insertion"), "{answer}");
    let heard = peer.next(|said| {
        said["message"]["msg"]
            .to_string()
            .contains("~pause refused")
    });
    assert_eq!(heard.unwrap()["message"]["level"], 10);
}

#[test]
fn what_the_environment_asks_for_in_vain_is_said() {
    let Some(domain) = Domain::new() else { return };
    for (name, value) in [
        ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
        ("ROS_STATIC_PEERS", "192.0.2.1"),
        ("ROS_DOMAIN_ID", "233"),
    ] {
        let mut command = domain.command(&[&RUN[..], &["x"]].concat());
        let output = command.env(name, value).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains(name), "{said}");
    }
}
