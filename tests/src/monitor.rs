//! What goes wrong between base and tip, on whole simulated insertions: the run stops in time, and
//! says why.

use hal::telemetry::TruthEvent;
use hal::{SensedShape, ShapeSensor, Stamp};
use nalgebra::Vector3;
use needle_steer::config::{self, Config};
use needle_steer::controls::Controls;
use needle_steer::outcome::{Cause, Ended, Summary};
use needle_steer::rig::{Eyes, Rig};
use needle_steer::run::{Observer, Unobserved, run};
use needle_steer::supervisor::StopReason;

fn config(overrides: &[&str]) -> Config {
    let all: Vec<String> = ["run.sensor=shape", "run.check_reach=false"]
        .iter()
        .chain(overrides)
        .map(ToString::to_string)
        .collect();
    config::load(None, &all).unwrap()
}

fn insert(overrides: &[&str]) -> Summary {
    let config = config(overrides);
    let mut rig = Rig::new(&config).unwrap();
    run(&config, &mut rig, &mut Unobserved, &Controls::default()).unwrap()
}

/// As [`insert`], with a sensor that changes what the phantom's says.
fn insert_seen(
    overrides: &[&str],
    change: impl FnMut(&mut SensedShape) + Send + 'static,
) -> Summary {
    let config = config(overrides);
    let mut rig = Rig::new(&config).unwrap();
    let Eyes::Shape(sensor) = core::mem::replace(&mut rig.eyes, Eyes::Shape(Box::new(Blind)))
    else {
        panic!("this rig looks through cameras");
    };
    rig.eyes = Eyes::Shape(Box::new(Tampered(sensor, change)));
    run(&config, &mut rig, &mut Unobserved, &Controls::default()).unwrap()
}

struct Blind;

impl ShapeSensor for Blind {
    fn poll(&mut self) -> Result<Option<SensedShape>, hal::Error> {
        Ok(None)
    }
}

struct Tampered<F>(Box<dyn ShapeSensor>, F);

impl<F: FnMut(&mut SensedShape) + Send> ShapeSensor for Tampered<F> {
    fn poll(&mut self) -> Result<Option<SensedShape>, hal::Error> {
        let mut shape = self.0.poll()?;
        if let Some(shape) = &mut shape {
            (self.1)(shape);
        }
        Ok(shape)
    }
}

/// Advance of the base since the true tip last advanced by a fifth of a millimetre.
#[derive(Default)]
struct Pushing {
    base: Option<nalgebra::Isometry3<f64>>,
    tip: Option<Vector3<f64>>,
    advance: f64,
    farthest: f64,
}

impl Observer for Pushing {
    fn step(&mut self, t: &hal::telemetry::Telemetry) {
        let Some(truth) = &t.truth else { return };
        let base = *t.world_from_base.isometry();
        if let Some(last) = self.base {
            let way = base.translation.vector - last.translation.vector;
            self.advance += way.dot(&(base.rotation * Vector3::z()));
        }
        self.base = Some(base);
        let tip = *self.tip.get_or_insert(truth.tip);
        if truth.direction.dot(&(truth.tip - tip)) > 0.2e-3 {
            self.tip = Some(truth.tip);
            self.advance = 0.0;
        }
        self.farthest = self.farthest.max(self.advance);
    }
}

#[test]
fn sticky_tissue_stops_the_base_within_three_millimetres_of_the_tip() {
    for seed in [770_001, 770_002, 770_003] {
        for friction in ["100.0", "150.0"] {
            let seed = format!("run.seed={seed}");
            let friction = format!("phantom.friction.shaft_n_m={friction}");
            let config = config(&[&seed, &friction]);
            let mut rig = Rig::new(&config).unwrap();
            let mut pushing = Pushing::default();
            let summary = run(&config, &mut rig, &mut pushing, &Controls::default()).unwrap();
            // A tenth more: the true tip may creep by less than what counts as advance.
            let farthest = pushing.farthest * 1e3;
            assert!(
                farthest < 3.3,
                "{seed} {friction}: {farthest} mm, {summary:?}"
            );
            if summary.ended != Ended::TargetPassed {
                // A needle that tears out of its hole as a whole leaps, which is named as such.
                let leapt = summary.cause == Some(Cause::NeedleLost)
                    && summary.ended.to_string().contains("leapt");
                let named = matches!(
                    summary.cause,
                    Some(Cause::Stall | Cause::Buckling | Cause::Tear | Cause::OutOfReach)
                );
                // A model that the measured shaft contradicts says so of its stretch.
                let doubted = matches!(
                    summary.ended,
                    Ended::Stopped(StopReason::ModelContradicted { .. })
                );
                assert!(named || leapt || doubted, "{seed} {friction}: {summary:?}");
            }
        }
    }
    // A base that goes on straight, whatever the shaft does.
    let (seed, friction) = ("run.seed=770001", "phantom.friction.shaft_n_m=100.0");
    let torn = insert(&[seed, friction, "run.law=none"]);
    assert_eq!(torn.cause, Some(Cause::Tear), "{torn:?}");
    assert!(torn.spoilt && !torn.hit, "{torn:?}");
    let unbounded = "supervisor.tissue_stretch_mm=20.0";
    let stalled = insert(&[seed, friction, "run.law=none", unbounded]);
    assert_eq!(stalled.cause, Some(Cause::Stall), "{stalled:?}");
    assert!(stalled.spoilt && !stalled.hit, "{stalled:?}");
    let kinds: Vec<_> = stalled.events.iter().map(|event| event.kind).collect();
    // Which of the two is damaged first depends on where the law holds the base.
    let damaged = [TruthEvent::Yielding, TruthEvent::Tearing];
    assert!(damaged.iter().any(|kind| kinds.contains(kind)), "{kinds:?}");
}

/// A base that goes far aside has to come closer only for the tip to stay where it is.
#[test]
fn a_base_that_goes_far_aside_is_no_stall() {
    for angle in ["0.0", "90.0", "270.0"] {
        let angle = format!("target.angle_deg={angle}");
        let summary = insert(&["run.seed=101", "target.offset_mm=20.0", &angle]);
        assert!(summary.ended.is_success(), "{angle}: {summary:?}");
    }
}

#[test]
fn nothing_is_passed_that_no_measurement_saw_passed() {
    // A bevel eight millimetres long, of which the needle has one and a half: where the estimate has passed
    // the target, the tip may be 30 mm before it.
    let summary = insert(&[
        "run.seed=1",
        "target.depth_mm=30.0",
        "target.offset_mm=1.0",
        "needle.bevel_deg=5.0",
        "phantom.needle.bevel_deg=24.0",
    ]);
    let truly = summary
        .axial_error_mm
        .is_some_and(|ahead| ahead.abs() < 1.0);
    assert!(!summary.ended.is_success() || truly, "{summary:?}");
}

#[test]
fn shapes_in_millimetres_are_not_of_this_needle() {
    let summary = insert_seen(&[], |shape| {
        let scale = |p: &mut hal::Position<hal::frame::LeftCamera>| {
            *p = hal::Position::new((p.coords() * 1e3).into());
        };
        scale(&mut shape.tip.position);
        for point in &mut shape.points {
            scale(&mut point.position);
        }
    });
    assert!(
        matches!(
            summary.ended,
            Ended::Stopped(StopReason::Implausible { .. })
        ),
        "{summary:?}"
    );
    assert!(summary.ended.to_string().contains("units"), "{summary:?}");
}

#[test]
fn half_a_second_of_latency_is_slower_and_more_is_refused_at_once() {
    for latency in ["200.0", "300.0", "500.0"] {
        let key = format!("phantom.sensor.latency_ms={latency}");
        let summary = insert(&[&key, "run.seed=2", "target.kind=aligned"]);
        assert!(summary.hit, "{latency}: {summary:?}");
    }
    let summary = insert(&["phantom.sensor.latency_ms=600.0"]);
    let Ended::Stopped(StopReason::MeasurementsLate { age_s, .. }) = summary.ended else {
        panic!("{summary:?}");
    };
    assert!((0.6..0.65).contains(&age_s), "{age_s}");
    assert!(summary.steps < 60, "{} steps", summary.steps);
}

#[test]
fn stamps_ahead_of_the_clock_are_refused_with_the_skew() {
    // The phantom's latency is 50 ms: less is not ahead when it arrives.
    for ahead in [0.2, 10.0, 3600.0] {
        let summary = insert_seen(&[], move |shape| {
            shape.stamp = Stamp::from_secs(shape.stamp.as_secs() + ahead);
        });
        let Ended::Stopped(StopReason::MeasurementsAhead { by_s }) = summary.ended else {
            panic!("{ahead}: {summary:?}");
        };
        assert!((by_s - ahead + 0.05).abs() < 0.03, "{ahead}: {by_s}");
    }
}

#[test]
fn deep_breathing_that_cannot_be_followed_is_named() {
    let summary = insert(&[
        "run.seed=770001",
        "run.phantom=harsh",
        "phantom.motion.breathing_mm=15.0",
    ]);
    assert_eq!(summary.cause, Some(Cause::TissueMotion), "{summary:?}");
}

#[test]
fn settings_that_make_no_estimate_are_refused() {
    for key in ["estimator.step_mm=0.001", "estimator.step_mm=0.0"] {
        let error = config::load(None, &[key.to_owned()]).unwrap_err();
        assert!(error.to_string().contains("step_mm"), "{error}");
    }
}
