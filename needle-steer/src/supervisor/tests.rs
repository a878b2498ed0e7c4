use super::*;
use hal::frame::{NeedleBase, World};
use hal::telemetry::{LawReport, ModelReport, Phase, Tracking};
use hal::{Joints, Position, Transform, Twist};
use nalgebra::Isometry3;

fn bounds() -> Bounds {
    Bounds {
        tissue_stretch: 8e-3,
        entry_force: 5.0,
        axis: (Point3::origin(), -Vector3::z_axis()),
        workspace_radius: 0.06,
        base_speed: 0.012,
        image_hold: Duration::from_millis(200),
        image_stop: Duration::from_secs(2),
        image_age: Duration::from_millis(550),
        encoder_stop: Duration::from_millis(350),
        dead_man: None,
    }
}

fn state() -> ArmState {
    let positions = Joints::from([0.0; 6]);
    ArmState {
        stamp: Stamp::ZERO,
        positions,
        rates: positions,
        mode: ArmMode::Moving,
    }
}

fn telemetry() -> Telemetry {
    let world_from_base: Transform<World, NeedleBase> =
        Transform::assume(Isometry3::translation(0.01, 0.0, 0.1));
    Telemetry {
        step: 1,
        stamp: Stamp::ZERO,
        image_stamp: None,
        phase: Phase::Steering,
        tracking: Tracking::Tracked,
        arm_mode: ArmMode::Moving,
        joints: state().positions,
        joint_rates: state().positions,
        world_from_base,
        world_from_tip: Transform::identity(),
        base_twist: Twist::zero(),
        measured_tip: None,
        target: Position::new(Point3::origin()),
        lateral_error: 0.0,
        axial_distance: 0.0,
        depth: 0.0,
        law: LawReport::default(),
        model: ModelReport::default(),
        truth: None,
    }
}

#[test]
fn bounds_are_kept_and_latched() {
    type Change = fn(&mut Telemetry);
    let changes: [(&str, Change); 5] = [
        ("stretch", |t| t.model.max_stretch = 9e-3),
        ("stretch", |t| t.model.max_stretch = f64::NAN),
        ("force", |t| t.model.entry_force = 6.0),
        ("rates", |t| t.joint_rates[2] = f64::NAN),
        ("base", |t| {
            t.world_from_base = Transform::assume(Isometry3::translation(0.05, 0.05, 0.1));
        }),
    ];
    for (what, change) in changes {
        let mut supervisor = Supervisor::new(bounds(), Stamp::ZERO);
        let good = telemetry();
        assert_eq!(
            supervisor.judge(Stamp::ZERO, &state(), &good, &Evidence::default()),
            Verdict::Go
        );
        let mut bad = telemetry();
        change(&mut bad);
        // One bad image holds; what lasts stops.
        let mut judge = |t: &Telemetry, seconds: f64| {
            let now = Stamp::from_secs(seconds);
            supervisor.judge(now, &state(), t, &Evidence::default())
        };
        assert_ne!(judge(&bad, 0.0), Verdict::Go, "{what}");
        let verdict = judge(&bad, 0.3);
        let Verdict::Stop(reason) = verdict else {
            panic!("{what}: {verdict:?}")
        };
        assert!(reason.to_string().contains(what), "{what}: {reason}");
        // Compared as text: a reason may hold NaN.
        let again = judge(&good, 0.31);
        let Verdict::Stop(kept) = again else {
            panic!("{what}: {again:?}")
        };
        assert_eq!(kept.to_string(), reason.to_string());
        assert_eq!(
            supervisor.latched().map(ToString::to_string),
            Some(reason.to_string())
        );
    }
}

#[test]
fn a_base_that_swings_is_stopped() {
    let mut supervisor = Supervisor::new(bounds(), Stamp::ZERO);
    let mut at = |seconds: f64, x: f64, z: f64| {
        let stamp = Stamp::from_secs(seconds);
        let arm = ArmState { stamp, ..state() };
        let mut t = telemetry();
        t.stamp = stamp;
        t.world_from_base = Transform::assume(Isometry3::translation(x, 0.0, z));
        supervisor.image(stamp, None);
        supervisor.judge(stamp, &arm, &t, &Evidence::default())
    };
    // Along its axis as fast as it likes, across within the bound; single readings do not count.
    assert_eq!(at(0.0, 0.0, 0.1), Verdict::Go);
    assert_eq!(at(0.15, 0.0016, 0.0), Verdict::Go);
    assert_eq!(at(0.16, 0.0030, 0.0), Verdict::Go);
    assert_eq!(at(0.3, 0.0032, 0.0), Verdict::Go);
    let Verdict::Stop(reason) = at(0.42, 0.0052, 0.0) else {
        panic!("16 mm/s pass")
    };
    assert!(reason.to_string().contains("16.7 mm/s"), "{reason}");
}

#[test]
fn watchdogs_hold_before_they_stop() {
    let mut supervisor = Supervisor::new(bounds(), Stamp::ZERO);
    let mut at = |seconds: f64| {
        let now = Stamp::from_secs(seconds);
        supervisor.judge(
            now,
            &ArmState {
                stamp: now,
                ..state()
            },
            &telemetry(),
            &Evidence::default(),
        )
    };
    assert_eq!(at(0.2), Verdict::Go);
    assert_eq!(at(0.21), Verdict::Hold(Cause::MeasurementsLate));
    assert!(matches!(
        at(2.1),
        Verdict::Stop(StopReason::ImageTimeout { .. })
    ));
    let mut supervisor = Supervisor::new(bounds(), Stamp::ZERO);
    let late = supervisor.judge(
        Stamp::from_secs(0.36),
        &state(),
        &telemetry(),
        &Evidence::default(),
    );
    assert!(matches!(
        late,
        Verdict::Stop(StopReason::EncoderTimeout { .. })
    ));
}

/// The cause of the stop, if any, where half a second long `seen` and the evidence of each instant are
/// judged.
fn cause_of(seen: &Telemetry, evidence: impl Fn(Stamp) -> Evidence) -> Option<Cause> {
    let mut supervisor = Supervisor::new(bounds(), Stamp::ZERO);
    let mut last = Verdict::Go;
    for k in 0..30 {
        let now = Stamp::from_secs(0.016 * f64::from(k));
        supervisor.image(now, None);
        let arm = ArmState {
            stamp: now,
            ..state()
        };
        last = supervisor.judge(now, &arm, seen, &evidence(now));
    }
    match last {
        Verdict::Stop(reason) => Some(reason.cause()),
        _ => None,
    }
}

/// The cause of the stop by a model's largest stretch, with the measured shaft so far beside the
/// model's.
fn cause_of_stretch(stretch: f64, off: f64) -> Option<Cause> {
    let mut seen = telemetry();
    seen.model.max_stretch = stretch;
    seen.model.shaft_off = off;
    cause_of(&seen, |_| Evidence::default())
}

#[test]
fn a_stretch_that_the_measured_shaft_contradicts_is_the_models_fault() {
    assert_eq!(cause_of_stretch(7e-3, 3e-3), None);
    assert_eq!(cause_of_stretch(8.5e-3, 0.3e-3), Some(Cause::Tear));
    assert_eq!(cause_of_stretch(12e-3, 1e-3), Some(Cause::Tear));
    assert_eq!(cause_of_stretch(8.5e-3, 2e-3), Some(Cause::ModelFailed));
    // No shaft in sight contradicts nothing.
    assert_eq!(cause_of_stretch(8.5e-3, f64::NAN), Some(Cause::Tear));
}

/// What a measured shaft so far beside its path comes to, in tissue that was seen to move by `motion`
/// and with a model that has `failed` or has not.
fn cause_beside(off: f64, motion: f64, failed: bool) -> Option<Cause> {
    let mut seen = telemetry();
    seen.model.path_off = off;
    cause_of(&seen, |now| Evidence {
        tissue_motion: (motion > 0.0).then_some(motion),
        largest_tissue_motion: motion,
        model: failed.then(|| (now, String::new())),
        ..Evidence::default()
    })
}

#[test]
fn a_shaft_beside_its_path_is_a_tear_whatever_the_model_says() {
    assert_eq!(cause_beside(7.9e-3, 0.0, false), None);
    assert_eq!(cause_beside(8.1e-3, 0.0, false), Some(Cause::Tear));
    assert_eq!(cause_beside(8.1e-3, 0.0, true), Some(Cause::Tear));
    // What the tissue moves by itself stretches nothing; what is not known stops nothing.
    assert_eq!(cause_beside(8.1e-3, 2e-3, false), None);
    assert_eq!(cause_beside(10.1e-3, 2e-3, false), Some(Cause::Tear));
    assert_eq!(cause_beside(f64::NAN, 0.0, false), None);
}
