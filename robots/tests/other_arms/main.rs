//! URDFs as other laboratories have them: what kinematics does not need, joints without ends or
//! speeds, arms on rails, coupled joints, and files that are damaged or no URDF.
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

mod refused;

use core::f64::consts::PI;
use core::fmt::Write;

use hal::Joints;
use nalgebra::Vector3;
use robots::kinematics::{Chain, JointKind, Section, Turns};

/// Joints of an arm of the test: name, type, origin and axis; base `base`, tip `tip`.
const SIX: [(&str, &str, &str, &str); 7] = [
    ("j1", "revolute", "0 0 0.31", "0 0 1"),
    ("j2", "revolute", "0.06 0 0", "0 1 0"),
    ("j3", "revolute", "0 0 0.36", "0 1 0"),
    ("j4", "revolute", "0.21 0 0.02", "1 0 0"),
    ("j5", "revolute", "0.17 0 0", "0 1 0"),
    ("j6", "revolute", "0.08 0 0", "1 0 0"),
    ("flange", "fixed", "0 0 0", "1 0 0"),
];
const LIMIT: &str = r#"<limit lower="-2.8" upper="2.8" effort="9" velocity="2"/>"#;

/// The arm with `limit` in every joint of the types given.
fn arm(kind: &str, limit: &str) -> String {
    let mut urdf = String::from("<robot name=\"a\"><link name=\"base\"/>");
    let mut parent = "base";
    for (name, of, xyz, axis) in SIX {
        let kind = if of == "fixed" { "fixed" } else { kind };
        let child = if of == "fixed" { "tip" } else { name };
        write!(
            urdf,
            "\n<link name=\"{child}\"><visual/></link><joint name=\"{name}\" type=\"{kind}\">\
             <parent link=\"{parent}\"/><child link=\"{child}\"/><origin xyz=\"{xyz}\" rpy=\"0 0 0\"/>\
             <axis xyz=\"{axis}\"/>{limit}</joint>"
        )
        .unwrap();
        parent = child;
    }
    urdf + "\n</robot>\n"
}

fn q() -> Joints {
    Joints::from([0.1, 0.2, 0.5, -0.4, 0.6, 0.3])
}

fn chain(urdf: &str) -> Chain {
    Chain::from_urdf(urdf, "tip").unwrap()
}

fn assert_as_plain(urdf: &str) {
    let plain = chain(&arm("revolute", LIMIT)).forward(&q());
    assert_eq!(chain(urdf).forward(&q()), plain, "{urdf}");
}

#[test]
fn what_kinematics_does_not_need_cannot_break_it() {
    let shape = "<geometry><box size=\"1 1 1\"/></geometry>";
    let inside = [
        format!("<visual>{shape}<material name=\"m\"><texture/></material></visual>"),
        format!("<visual>{shape}<material name=\"a\"/><material name=\"b\"/></visual>"),
        format!("<visual>{shape}<material name=\"a\"><color rgba=\"1 1\"/></material></visual>"),
        format!("<visual><origin/><origin xyz=\"0 0\"/>{shape}</visual>"),
        "<inertial><mass value=\"heavy\"/><inertia ixx=\"\"/></inertial>".to_owned(),
        "<collision><geometry><mesh/><capsule/></geometry></collision>".to_owned(),
        "<drake:x a:b='1'/><![CDATA[ <joint/> ]]><!-- <link/> -->".to_owned(),
    ];
    for text in inside {
        assert_as_plain(&arm("revolute", LIMIT).replacen("<visual/>", &text, 1));
    }
    let beside = [
        "<gazebo><sensor:camera/><joint name=\"j1\"/></gazebo>",
        "<transmission><joint name=\"j1\"/><joint name=\"j1\"/></transmission>",
        "<material/><material name=\"m\"><color rgba=\"red\"/></material>",
        "<link name=\"grip\"/><joint name=\"g\" type=\"screw\"><parent link=\"tip\"/>\
         <child link=\"grip\"/><origin xyz=\"a\"/><mimic/></joint>",
    ];
    for text in beside {
        assert_as_plain(&arm("revolute", LIMIT).replace("</robot>", &format!("{text}</robot>")));
    }
    let dynamics =
        format!("{LIMIT}<dynamics damping=\"?\"/><safety_controller/><calibration rising=\"\"/>");
    assert_as_plain(&arm("revolute", &dynamics));
    let spaced = arm("revolute", LIMIT).replace("xyz=\"0 0 0.31\"", "xyz='\n 0\t0  0.31 '");
    assert_as_plain(&spaced);
    let with_mark = format!("\u{feff}{}", arm("revolute", LIMIT));
    assert_as_plain(&with_mark);
}

#[test]
fn a_file_in_utf_16_or_with_latin_names_is_read() {
    let urdf = arm("revolute", LIMIT);
    let plain = chain(&urdf).forward(&q());
    let wide: Vec<u8> = [0xff, 0xfe]
        .into_iter()
        .chain(urdf.encode_utf16().flat_map(u16::to_le_bytes))
        .collect();
    let bare: Vec<u8> = urdf.encode_utf16().flat_map(u16::to_be_bytes).collect();
    let latin = urdf.replace("name=\"a\"", "name=\"\u{1}\"").into_bytes();
    let latin: Vec<u8> = latin
        .into_iter()
        .map(|b| if b == 1 { 0xe9 } else { b })
        .collect();
    for bytes in [wide, bare, latin] {
        let chain = Chain::from_section(&bytes, &Section::arm("tip")).unwrap();
        assert_eq!(chain.forward(&q()), plain);
    }
}

#[test]
fn continuous_joints_turn_without_ends_and_solutions_are_principal_angles() {
    let limits = ["", "<limit effort=\"1\" velocity=\"2\"/>", LIMIT];
    for limit in limits {
        let chain = chain(&arm("continuous", limit));
        assert!(
            chain
                .kinds()
                .iter()
                .all(|kind| *kind == JointKind::Continuous)
        );
        let far = q().map(|x| x + 40.0 * PI);
        assert!(chain.within_limits(&far), "{limit}");
        let pose = chain.forward(&far);
        assert!((pose.to_homogeneous() - chain.forward(&q()).to_homogeneous()).norm() < 1e-12);
        for turns in [Turns::One, Turns::All] {
            let solutions = chain.inverse(&pose, turns);
            assert!((1..=16).contains(&solutions.len()), "{}", solutions.len());
            for solution in solutions {
                assert!(
                    solution.iter().all(|x| -PI < *x && *x <= PI),
                    "{solution:?}"
                );
            }
        }
    }
    // Half a turn has two names; one of them is given.
    let chain = chain(&arm("continuous", ""));
    let half = Joints::from([PI, 0.2, 0.5, 0.3, 0.6, -PI]);
    for solution in chain.inverse(&chain.forward(&half), Turns::One) {
        assert!(
            solution.iter().all(|x| -PI < *x && *x <= PI),
            "{solution:?}"
        );
    }
}

#[test]
fn a_speed_that_is_not_known_keeps_nobody_from_kinematics() {
    for speed in ["velocity=\"0\"", "velocity=\"-1\"", "velocity=\"inf\"", ""] {
        let limit = format!("<limit lower=\"-2.8\" upper=\"2.8\" {speed}/>");
        let chain = chain(&arm("revolute", &limit));
        assert_as_plain(&arm("revolute", &limit));
        assert!(!chain.inverse(&chain.forward(&q()), Turns::One).is_empty());
        let missing: Vec<&str> = chain.without_speed().collect();
        assert_eq!(missing, ["j1", "j2", "j3", "j4", "j5", "j6"]);
        let chain = chain.with_speed(1.5);
        assert_eq!(chain.without_speed().count(), 0);
        assert!((chain.limits()[2].velocity - 1.5).abs() < 1e-15);
    }
}

/// The arm on a rail, which stands on a column that turns.
fn on_a_rail() -> String {
    let below = "<link name=\"floor\"/><link name=\"column\"/>\
        <joint name=\"turn\" type=\"revolute\"><parent link=\"floor\"/><child link=\"column\"/>\
        <axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>\
        <joint name=\"rail\" type=\"prismatic\"><parent link=\"column\"/><child link=\"base\"/>\
        <axis xyz=\"0 2 0\"/><limit lower=\"0\" upper=\"0.8\" effort=\"1\" velocity=\"1\"/></joint></robot>";
    arm("revolute", LIMIT).replace("</robot>", below)
}

#[test]
fn an_arm_on_a_rail_begins_at_a_base_or_the_rail_is_held() {
    let urdf = on_a_rail();
    let plain = chain(&arm("revolute", LIMIT)).forward(&q());
    let read = |section: &Section| Chain::from_section(urdf.as_bytes(), section);
    let message = read(&Section::arm("tip")).unwrap_err().to_string();
    for part in [
        "rail",
        "prismatic",
        "--base base",
        "arm.base_link",
        "--hold rail=",
    ] {
        assert!(message.contains(part), "{message}");
    }
    let from_base = read(&Section::arm("tip").from("base")).unwrap();
    assert_eq!(from_base.base(), "base");
    assert_eq!(from_base.forward(&q()), plain);

    let held = read(
        &Section::arm("tip")
            .holding("rail", 0.3)
            .holding("turn", 0.5),
    )
    .unwrap();
    assert_eq!((held.len(), held.base()), (6, "floor"));
    let turned = nalgebra::Isometry3::rotation(Vector3::z() * 0.5)
        * nalgebra::Translation3::new(0.0, 0.3, 0.0)
        * plain;
    let apart = held.forward(&q()).to_homogeneous() - turned.to_homogeneous();
    assert!(apart.norm() < 1e-14, "{apart}");

    let error = |section: Section| read(&section).unwrap_err().to_string();
    assert!(error(Section::arm("tip").from("tip2")).contains("tip2"));
    let above = error(Section::arm("j3").from("tip"));
    assert!(
        above.contains("floor") && above.contains("not above"),
        "{above}"
    );
    let outside = error(Section::arm("tip").from("column").holding("rail", 0.9));
    assert!(
        outside.contains("0.9") && outside.contains("0.8"),
        "{outside}"
    );
    let unknown = error(Section::arm("tip").from("base").holding("rail", 0.1));
    assert!(
        unknown.contains("rail") && unknown.contains("j1"),
        "{unknown}"
    );
}

#[test]
fn a_prismatic_joint_moves_in_a_mechanism() {
    let urdf = on_a_rail();
    let section = Section::mechanism("tip").from("column");
    let chain = Chain::from_section(urdf.as_bytes(), &section).unwrap();
    assert_eq!(chain.kinds()[0], JointKind::Prismatic);
    let q = Joints::from([0.25, 0.1, 0.2, 0.5, -0.4, 0.6, 0.3]);
    let (pose, jacobian) = chain.forward_jacobian(&q);
    assert_eq!(pose, chain.forward(&q));
    for i in 0..7 {
        let step = 1e-6;
        let at = |sign: f64| {
            let mut moved = q;
            moved[i] += sign * step;
            chain.forward(&moved)
        };
        let (back, ahead) = (at(-1.0), at(1.0));
        let linear = (ahead.translation.vector - back.translation.vector) / (2.0 * step);
        let angular = (ahead.rotation * back.rotation.inverse()).scaled_axis() / (2.0 * step);
        let column = jacobian.column(i);
        assert!((column.fixed_rows::<3>(0) - linear).norm() < 1e-8, "{i}");
        assert!((column.fixed_rows::<3>(3) - angular).norm() < 1e-8, "{i}");
    }
    let solutions = chain.inverse(&pose, Turns::One);
    assert!(!solutions.is_empty());
    for solution in solutions {
        assert!(chain.within_limits(&solution));
        let apart = chain.forward(&solution).to_homogeneous() - pose.to_homogeneous();
        assert!(apart.norm() < 1e-9);
    }
    // A stage alone: one joint.
    let stage = Chain::from_section(urdf.as_bytes(), &Section::mechanism("base").from("column"));
    let stage = stage.unwrap();
    let at = stage.forward(&Joints::from_slice(&[0.4]).unwrap());
    assert!((at.translation.vector - Vector3::new(0.0, 0.4, 0.0)).norm() < 1e-15);
}

/// The arm with a second elbow that follows j3.
fn coupled(mimic: &str) -> String {
    let joint = format!(
        "<link name=\"k\"/><joint name=\"j3b\" type=\"revolute\"><parent link=\"j3\"/><child link=\"k\"/>\
         <origin xyz=\"0.05 0 0\"/><axis xyz=\"0 1 0\"/>\
         <limit lower=\"-1\" upper=\"0.5\" effort=\"1\" velocity=\"1\"/>{mimic}</joint></robot>"
    );
    let parent = "<parent link=\"j3\"/><child link=\"j4\"/>";
    arm("revolute", LIMIT)
        .replace(parent, "<parent link=\"k\"/><child link=\"j4\"/>")
        .replace("</robot>", &joint)
}

#[test]
fn a_joint_that_follows_another_moves_with_it() {
    let free = Section::mechanism("tip");
    let seven = Chain::from_section(coupled("").as_bytes(), &free).unwrap();
    let six = chain(&coupled(
        "<mimic joint=\"j3\" multiplier=\"-0.5\" offset=\"0.1\"/>",
    ));
    assert_eq!(six.len(), 6);
    let q = q();
    let whole = Joints::from([q[0], q[1], q[2], 0.1 - 0.5 * q[2], q[3], q[4], q[5]]);
    let apart = six.forward(&q).to_homogeneous() - seven.forward(&whole).to_homogeneous();
    assert!(apart.norm() < 1e-15);
    let (a, b) = (six.jacobian(&q), seven.jacobian(&whole));
    assert!((a.column(2) - (b.column(2) - b.column(3) * 0.5)).norm() < 1e-15);
    assert!((a.column(3) - b.column(4)).norm() < 1e-15);
    // The follower's ends, -1 to 0.5 at half the speed, are the leader's too.
    let limit = six.limits()[2];
    assert!((limit.lower - -0.8).abs() < 1e-12 && (limit.upper - 2.2).abs() < 1e-12);
    assert!((limit.velocity - 2.0).abs() < 1e-12);
    let solutions = six.inverse(&six.forward(&q), Turns::One);
    assert!(
        solutions
            .iter()
            .any(|s| s.zip(&q, |a, b| a - b).max_abs() < 1e-6)
    );

    for (mimic, part) in [
        ("<mimic joint=\"j9\"/>", "j9"),
        ("<mimic joint=\"j3b\"/>", "j3b"),
        ("<mimic joint=\"flange\"/>", "flange"),
        ("<mimic joint=\"j3\" multiplier=\"nan\"/>", "j3b"),
        ("<mimic joint=\"j3\" offset=\"9\"/>", "j3"),
    ] {
        let error = Chain::from_urdf(&coupled(mimic), "tip")
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{mimic}: {error}");
    }
}

#[test]
fn the_last_joint_knows_its_sense_and_the_tip_off_its_axis() {
    let tip = |rpy: &str, xyz: &str| {
        let place = format!(
            "<origin xyz=\"{xyz}\" rpy=\"{rpy}\"/><axis xyz=\"1 0 0\"/>{LIMIT}</joint>\n</robot>"
        );
        let urdf = arm("revolute", LIMIT);
        let flange = urdf.rfind("<origin").unwrap();
        *chain(&format!("{}{place}", &urdf[..flange]))
            .spin()
            .unwrap()
    };
    let quarter = PI / 2.0;
    for (turn, sense) in [(quarter, 1.0), (-quarter, -1.0)] {
        let spin = tip(&format!("0 {turn} 0"), "0.1 0 0");
        assert!((spin.sense - sense).abs() < 1e-15);
        assert!(spin.tilt < 1e-12 && spin.aside < 1e-12, "{spin:?}");
        let spin = tip(&format!("0 {} 0", turn - 0.1), "0.1 0.02 0");
        assert!((spin.tilt - 0.1).abs() < 1e-12 && (spin.aside - 0.02).abs() < 1e-12);
    }
    let spin = tip("0 0 0", "0 0 0");
    assert!((spin.tilt - quarter).abs() < 1e-12, "{spin:?}");
}
