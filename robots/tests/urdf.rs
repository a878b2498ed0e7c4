//! URDFs that are broken, each with an error that names the element, and one of seven joints.
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

use hal::Joints;
use robots::arms::{NEEDLE_BASE, VIPER_S650};
use robots::kinematics::{Chain, Turns, UrdfError};

const JOINT_3_ORIGIN: &str = r#"<origin xyz="0.270 0 0" rpy="0 0 0"/>
    <parent link="link_2"/>"#;

fn error_of(from: &str, to: &str) -> UrdfError {
    let broken = VIPER_S650.replacen(from, to, 1);
    assert_ne!(broken, VIPER_S650, "{from} is not in the file");
    Chain::from_urdf(&broken, NEEDLE_BASE).unwrap_err()
}

/// What a change of the Viper's URDF is answered with, and what the message has to name.
#[test]
fn broken_files_name_the_element() {
    let joint_3 = |to: &str| error_of(JOINT_3_ORIGIN, to);
    let twice = format!("<origin xyz=\"0 0 0\"/>{JOINT_3_ORIGIN}");
    let limit_3 = r#"<limit lower="-0.5061454830783556" upper="4.468042885105484" effort="0" velocity="6.544984694978735"/>"#;
    let joint_3_type = r#"<joint name="joint_3" type="revolute">"#;
    let cases: [(UrdfError, &[&str]); 14] = [
        (joint_3(&twice), &["joint_3", "<origin>"]),
        (error_of(limit_3, ""), &["joint_3", "<limit> is missing"]),
        (
            error_of(limit_3, r#"<limit effort="0" velocity="1"/>"#),
            &["joint_3", "no motion"],
        ),
        (
            error_of(
                limit_3,
                r#"<limit lower="-inf" upper="1" effort="0" velocity="1"/>"#,
            ),
            &["joint_3", "<limit>"],
        ),
        (
            joint_3(&JOINT_3_ORIGIN.replace("0.270", "NaN")),
            &["joint_3", "<origin>"],
        ),
        (
            joint_3(&JOINT_3_ORIGIN.replace("link_2", "link_9")),
            &["joint_3", "link_9"],
        ),
        (
            joint_3(&JOINT_3_ORIGIN.replace("link_2", "link_5")),
            &["loop"],
        ),
        (
            error_of(joint_3_type, r#"<joint name="joint_3" type="prismatic">"#),
            &["joint_3", "prismatic"],
        ),
        (
            error_of(joint_3_type, r#"<joint name="joint_3" type="fixed">"#),
            &["base_link", "needle_base", "5"],
        ),
        (
            error_of(joint_3_type, r#"<joint name="joint_2" type="revolute">"#),
            &["joint_2", "twice"],
        ),
        (
            error_of(limit_3, &format!("{limit_3}<mimic joint=\"joint_9\"/>")),
            &["joint_3", "joint_9"],
        ),
        (
            error_of(
                "<link name=\"tool0\"/>",
                "<link name=\"tool0\"/><link name=\"lost\"/>",
            ),
            &["lost", "roots"],
        ),
        (
            error_of("<child link=\"tool0\"/>", "<child link=\"needle_base\"/>"),
            &["needle_base", "loop"],
        ),
        (error_of("</robot>", "</robt>"), &["XML"]),
    ];
    for (error, names) in cases {
        let message = error.to_string();
        for name in names {
            assert!(message.contains(name), "{message:?} does not name {name:?}");
        }
    }
}

/// What the parser itself refuses, with the name of the element that it does not give.
#[test]
fn what_the_parser_refuses_is_named_too() {
    let limit_3 = r#"<limit lower="-0.5061454830783556" upper="4.468042885105484" effort="0" velocity="6.544984694978735"/>"#;
    let joint_3 = r#"<joint name="joint_3" type="revolute">"#;
    let cases = [
        (
            limit_3,
            r#"<limit lower="a" upper="1" effort="0" velocity="1"/>"#,
            "joint_3",
        ),
        (
            JOINT_3_ORIGIN,
            r#"<origin xyz="0.27 0"/><parent link="link_2"/>"#,
            "joint_3",
        ),
        (
            JOINT_3_ORIGIN,
            r#"<origin xyz="a b c"/><parent link="link_2"/>"#,
            "joint_3",
        ),
        (JOINT_3_ORIGIN, r#"<origin xyz="0.27 0 0"/>"#, "joint_3"),
        (
            JOINT_3_ORIGIN,
            r#"<origin xyz="0.27 0 0"/><parent/>"#,
            "joint_3",
        ),
        (
            joint_3,
            r#"<joint name="joint_3" type="turning">"#,
            "joint_3",
        ),
        (joint_3, r#"<joint name="joint_3">"#, "joint_3"),
        (joint_3, r#"<joint type="revolute">"#, "(unnamed)"),
        ("<link name=\"tool0\"/>", "<link/>", "link (unnamed)"),
    ];
    for (from, to, name) in cases {
        let message = error_of(from, to).to_string();
        assert!(
            message.contains(name),
            "{to}: {message:?} does not name {name:?}"
        );
    }
}

#[test]
fn joints_off_the_chain_and_elements_unknown_do_no_harm() {
    let gripper = r#"<link name="finger"/><joint name="grip" type="prismatic"><parent link="tool0"/>
        <child link="finger"/><axis xyz="1 0 0"/><limit lower="0" upper="0.1" effort="1" velocity="1"/>
        <mimic joint="other"/></joint>
        <link name="wheel"/><joint name="roll" type="continuous"><parent link="tool0"/>
        <child link="wheel"/><axis xyz="0 0 0"/></joint>
        <gazebo/><gazebo><plugin name="a"/><plugin name="b"/></gazebo></robot>"#;
    let more = VIPER_S650.replacen("</robot>", gripper, 1);
    let plain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let q = Joints::from([0.3, -0.7, 2.4, 1.1, 0.5, -0.8]);
    let chain = Chain::from_urdf(&more, NEEDLE_BASE).unwrap();
    assert_eq!(chain.forward(&q), plain.forward(&q));
    for (tip, joint) in [("finger", "grip"), ("wheel", "roll")] {
        let message = Chain::from_urdf(&more, tip).unwrap_err().to_string();
        assert!(message.contains(joint), "{message}");
    }
    // Not even a NaN.
    let broken = more.replace("upper=\"0.1\"", "upper=\"wide\"");
    let chain = Chain::from_urdf(&broken, NEEDLE_BASE).unwrap();
    assert_eq!(chain.forward(&q), plain.forward(&q));
}

#[test]
fn an_axis_of_any_length_counts_by_its_direction_and_none_is_x() {
    let q = Joints::from([0.3, -0.7, 2.4, 1.1, 0.5, -0.8]);
    let plain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE)
        .unwrap()
        .forward(&q);
    for length in ["7", "1e-9", "1e-200", "1e300"] {
        let long = VIPER_S650.replace("xyz=\"0 1 0\"", &format!("xyz=\"0 {length} 0\""));
        assert_ne!(long, VIPER_S650);
        let pose = Chain::from_urdf(&long, NEEDLE_BASE).unwrap().forward(&q);
        let error = (pose.to_homogeneous() - plain.to_homogeneous()).norm();
        assert!(error < 1e-14, "{length}: {error:e}");
    }
    let with = VIPER_S650.replacen("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"1 0 0\"/>", 1);
    let without = VIPER_S650.replacen("<axis xyz=\"0 1 0\"/>", "", 1);
    let pose = |urdf: &str| Chain::from_urdf(urdf, NEEDLE_BASE).unwrap().forward(&q);
    assert_eq!(pose(&with), pose(&without));
}

#[test]
fn a_zero_axis_and_an_unknown_tip_are_named() {
    let zero = VIPER_S650.replace(r#"<axis xyz="0 1 0"/>"#, r#"<axis xyz="0 0 0"/>"#);
    let message = Chain::from_urdf(&zero, NEEDLE_BASE)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("joint_2") && message.contains("<axis>"),
        "{message}"
    );
    let message = Chain::from_urdf(VIPER_S650, "hand")
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("hand") && message.contains("needle_base"),
        "{message}"
    );
    for text in [
        "",
        "<robot/>",
        "<robot name=\"r\"><link/></robot>",
        "not xml",
        "<a><b></a>",
    ] {
        assert!(Chain::from_urdf(text, NEEDLE_BASE).is_err(), "{text:?}");
    }
}

/// A 7-joint arm with the published lengths of the KUKA LBR iiwa 14 R820.
fn seven_joints() -> String {
    let mut urdf = String::from("<robot name=\"seven\"><link name=\"l0\"/>");
    let joints = [
        (0.36, "0 0 1", 170),
        (0.0, "0 1 0", 120),
        (0.42, "0 0 1", 170),
        (0.0, "0 -1 0", 120),
        (0.40, "0 0 1", 170),
        (0.0, "0 1 0", 120),
        (0.126, "0 0 1", 175),
    ];
    for (i, (z, axis, range)) in joints.iter().enumerate() {
        let range = f64::from(*range).to_radians();
        let next = i + 1;
        let joint = format!(
            "<link name=\"l{next}\"/><joint name=\"j{next}\" type=\"revolute\"><parent link=\"l{i}\"/>\
             <child link=\"l{next}\"/><origin xyz=\"0 0 {z}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-{range}\" upper=\"{range}\" effort=\"1\" velocity=\"1.7\"/></joint>"
        );
        urdf.push_str(&joint);
    }
    urdf + "</robot>"
}

#[test]
fn seven_joints_work_as_six_do() {
    let chain = Chain::from_urdf(&seven_joints(), "l7").unwrap();
    assert_eq!(chain.len(), 7);
    let q = Joints::from([0.3, 0.7, -0.4, 1.1, 0.5, -0.8, 0.2]);
    let pose = chain.forward(&q);
    let solutions = chain.inverse(&pose, Turns::One);
    assert!(solutions.len() > 4, "{}", solutions.len());
    for solution in &solutions {
        let error = (chain.forward(solution).to_homogeneous() - pose.to_homogeneous()).norm();
        assert!(chain.within_limits(solution) && error < 1e-10, "{error:e}");
    }
    let twist = hal::Twist {
        linear: nalgebra::Vector3::new(0.01, -0.02, 0.005),
        angular: nalgebra::Vector3::new(0.1, 0.05, -0.2),
    };
    let out = chain.rates(&q, &twist, &robots::kinematics::RateSettings::default());
    assert_eq!(out.rates.len(), 7);
    assert!((out.realised.to_vector() - twist.to_vector()).norm() < 1e-12);
}
