//! Arms that fit an insertion, and arms that do not.

use core::fmt::Write;

use super::super::{RigBuildError, arm_place, start, suggest};
use super::*;
use crate::config;
use nalgebra::Translation3;
use robots::kinematics::Section;

/// An arm of the ordinary kind; its last joint turns about `axis` between plus and minus
/// `ends` \[rad\], its first one about z by `turn` \[rad\] to either side.
fn arm(axis: &str, ends: f64, turn: f64) -> Chain {
    let joints = [
        ("0 0 0.3", "0 0 1", turn),
        ("0.06 0 0", "0 1 0", 1.9),
        ("0 0 0.38", "0 1 0", 2.4),
        ("0.2 0 0.02", "1 0 0", 3.3),
        ("0.18 0 0", "0 1 0", 2.0),
        ("0.08 0 0", axis, ends),
    ];
    let mut urdf = String::from("<robot name=\"a\"><link name=\"l0\"/>");
    for (i, (xyz, axis, end)) in joints.iter().enumerate() {
        let n = i + 1;
        write!(
            urdf,
            "<link name=\"l{n}\"/><joint name=\"j{n}\" type=\"revolute\"><parent link=\"l{i}\"/>\
             <child link=\"l{n}\"/><origin xyz=\"{xyz}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-{end}\" upper=\"{end}\" velocity=\"3\"/></joint>"
        )
        .unwrap();
    }
    let quarter = core::f64::consts::FRAC_PI_2;
    write!(
        urdf,
        "<link name=\"tip\"/><joint name=\"f\" type=\"fixed\"><parent link=\"l6\"/>\
         <child link=\"tip\"/><origin rpy=\"0 {quarter} 0\"/></joint></robot>"
    )
    .unwrap();
    Chain::from_section(urdf.as_bytes(), &Section::arm("tip")).unwrap()
}

fn refusal(chain: &Chain, overrides: &[&str]) -> String {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    let config = config::load(None, &overrides).unwrap();
    match start(&config, chain, &arm_place(&config)) {
        Err(RigBuildError::Misfit(misfit)) => misfit.to_string(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_arm_that_cannot_insert_is_refused_with_the_reason() {
    let good = arm("1 0 0", 6.0, 3.0);
    let config = config::load(None, &[]).unwrap();
    start(&config, &good, &arm_place(&config)).unwrap();

    let behind = ["arm.base_rpy_deg=[0.0,0.0,180.0]"];
    let ends = refusal(&arm("1 0 0", 6.0, core::f64::consts::PI), &behind);
    assert!(
        ends.contains("j1 starts at its end (180.0")
            || ends.contains("j1 starts at its end (-180.0"),
        "{ends}"
    );
    let short = refusal(&arm("1 0 0", 2.5, 3.0), &[]);
    assert!(short.contains("j6") && short.contains("286.5"), "{short}");
    let far = refusal(&good, &["arm.base_mm=[-390.0,0.0,0.0]"]);
    assert!(far.contains("deep") && far.contains("--suggest"), "{far}");
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 5_f64.to_radians());
    let askew = good.clone().with_tool(&Isometry3::from_parts(
        Translation3::new(0.0, 0.01, 0.0),
        tilt,
    ));
    let off = refusal(&askew, &[]);
    for part in [
        "z of tip is 5.0 degrees off the axis of j6",
        "10.0 mm beside",
        "arm.tip_rpy_deg = [",
        "arm.tip_mm = [",
    ] {
        assert!(off.contains(part), "{off}");
    }
    // What is offered mends it.
    let mended = askew.clone().with_tool(&askew.tool_on_last_axis().unwrap());
    assert_eq!(check_chain(&mended), Ok(()));
    let slow = refusal(
        &arm("1 0 0", 6.0, 3.0)
            .with_limits(
                good.limits()
                    .iter()
                    .map(|l| hal::JointLimit {
                        velocity: 0.0,
                        ..*l
                    })
                    .collect(),
            )
            .unwrap(),
        &[],
    );
    assert!(
        slow.contains("j1, j2") && slow.contains("arm.joint_speed_deg_s"),
        "{slow}"
    );
}

/// Speeds and units that a URDF may have wrong.
#[test]
fn an_arm_that_is_too_slow_or_in_other_units_is_refused_with_the_reason() {
    let good = arm("1 0 0", 6.0, 3.0);
    let with = |joint: usize, change: &dyn Fn(&mut hal::JointLimit)| {
        let mut limits = good.limits().to_vec();
        change(&mut limits[joint]);
        refusal(&good.clone().with_limits(limits).unwrap(), &[])
    };
    let spin = with(5, &|limit| limit.velocity = 0.2);
    assert!(
        spin.contains("j6 is too slow: 11.5 deg/s, of the 23 deg/s with which it must turn"),
        "{spin}"
    );
    let tilt = with(1, &|limit| limit.velocity = 0.002);
    assert!(
        tilt.contains("j2 is too slow: 0.1 deg/s, and does not follow"),
        "{tilt}"
    );
    let degrees = with(2, &|limit| (limit.lower, limit.upper) = (-170.0, 80.0));
    assert!(
        degrees.contains("j3 turns from -170 to 80 rad: are these degrees?"),
        "{degrees}"
    );
    // A spindle, and what stands for no ends at all.
    for (joint, end) in [(5, 300.0), (0, 1e6)] {
        let mut limits = good.limits().to_vec();
        (limits[joint].lower, limits[joint].upper) = (-end, end);
        let chain = good.clone().with_limits(limits).unwrap();
        assert_eq!(check_chain(&chain), Ok(()));
    }
    let long = good
        .clone()
        .with_tool(&Translation3::new(0.0, 0.0, 900.0).into());
    let millimetres = refusal(&long, &[]);
    assert!(
        millimetres.contains(" m from l0: are these millimetres?"),
        "{millimetres}"
    );
}

#[test]
fn a_place_that_is_suggested_is_one() {
    for chain in [arm("1 0 0", 6.0, 3.0), arm("-1 0 0", 2.7, 2.9)] {
        for inward in ["[0.0,0.0,-1.0]", "[1.0,0.0,0.0]"] {
            let overrides = [
                format!("tissue.inward={inward}"),
                "arm.base_mm=[900.0,0.0,0.0]".into(),
            ];
            let mut config = config::load(None, &overrides).unwrap();
            assert!(start(&config, &chain, &arm_place(&config)).is_err());
            let place = suggest(&config, &chain).unwrap();
            (config.arm.base_mm, config.arm.base_rpy_deg) = (place.base_mm, place.base_rpy_deg);
            let start = start(&config, &chain, &arm_place(&config)).unwrap();
            assert!(start.course.room > ROOM);
            assert!(chain.within_limits(&start.joints));
        }
    }
}

/// What an insertion meets does not depend on how far the arm's first axis has turned it.
#[test]
fn a_way_is_judged_alike_wherever_the_arm_points() {
    use robots::arms::{NEEDLE_BASE, VIPER_S650};

    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let demand = Demand {
        depth: 0.033,
        tilt: 0.07,
        shift: 0.0,
        length: 0.126,
    };
    for (elbow, wrist) in [(2.4, 1.2), (2.8, 0.9)] {
        let courses = (0..60).map(|k| {
            let turn = 0.01 * f64::from(k);
            let q = Joints::from([turn, -0.9, elbow, 0.0, wrist, 0.0]);
            follow(&chain, &q, &demand).unwrap_or_else(|why| panic!("{turn}: {why}"))
        });
        let least: Vec<f64> = courses.map(|course| course.dexterity).collect();
        for dexterity in &least {
            // Poses are approached to 0.05 mm and 0.5 mrad.
            assert!((dexterity - least[0]).abs() < 2e-3, "{dexterity} {least:?}");
        }
    }
}
