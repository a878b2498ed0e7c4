//! What goes wrong in a laboratory, in pictures of the second renderer: clutter, losses, jumps,
//! and pairs that are none.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test reports, and fails where it cannot go on"
)]

#[path = "needle_pictures/mod.rs"]
mod needle_pictures;

use hal::telemetry::Tracking;
use needle_pictures::{Needle, Scene, rig};
use vision::camera::StereoRig;
use vision::track::{Appearance, Context, FrameError, Loss, StereoTracker, TrackSettings};

const STEP: f64 = 0.1e-3;

fn needle() -> Needle {
    Needle::bent(0.045, 0.0, 0.3)
}

fn tracker_of(rig: &StereoRig) -> StereoTracker {
    let needle = Appearance {
        diameter: 0.7e-3,
        bevel_length: 0.0,
    };
    StereoTracker::new(rig, needle, &TrackSettings::default()).unwrap()
}

fn advance(insertion: f64) -> Context<'static> {
    Context {
        insertion: Some(insertion),
        ..Context::default()
    }
}

/// What became of one pair.
#[derive(Debug)]
struct Outcome {
    status: Tracking,
    /// Distance of the tip from the truth \[m\].
    error: f64,
}

/// Shows the tracker a needle that moves by `moves` from pair to pair, odometry telling `told`.
fn watch(
    scene: &Scene,
    tracker: &mut StereoTracker,
    mut needle: Needle,
    moves: &[f64],
    told: f64,
) -> Vec<Outcome> {
    let mut outcomes = Vec::new();
    let first = tracker.tracked().shape.sequence + 1;
    for (number, step) in (first..).zip(moves) {
        needle.depth += step;
        // The loop's model knows where the needle is, to some tenths of a millimetre.
        let guess = needle.guess();
        let context = Context {
            guess: Some(&guess),
            ..advance(told)
        };
        let t = tracker
            .track(&scene.pair(&needle, number), &context)
            .unwrap();
        let e = t.shape.tip.position.coords() - needle.point(needle.depth);
        let outcome = Outcome {
            status: t.status,
            error: e.norm(),
        };
        println!("{number}: {outcome:?} {:?}", t.loss);
        outcomes.push(outcome);
    }
    outcomes
}

/// The place of the needle in the left image at depth `s`.
fn left_px(scene: &Scene, needle: &Needle, s: f64) -> [f64; 2] {
    let px = scene.rig.views()[0].project(&needle.point(s)).unwrap().0;
    [px.x, px.y]
}

#[test]
fn a_bubble_as_dark_as_the_needle_on_the_tips_path() {
    let mut scene = Scene::new(rig(640), 5);
    let needle = needle();
    // 1.5 mm wide, 6 mm ahead of the tip: a start beside such a bubble would take it for the tip.
    let [x, y] = left_px(&scene, &needle, needle.depth + 6e-3);
    scene.discs.push([x, y, 3.0]);
    let mut tracker = tracker_of(&scene.rig);
    let outcomes = watch(&scene, &mut tracker, needle, &[2.0 * STEP; 60], 2.0 * STEP);
    for (k, o) in outcomes.iter().enumerate() {
        // Beside the bubble as ever; within it nothing false: a bubble hides up to its width.
        let behind = !(20..52).contains(&k);
        assert!(
            o.error < if behind { 0.1e-3 } else { 0.25e-3 },
            "{k}: {o:?}"
        );
        if behind {
            assert_eq!(o.status, Tracking::Tracked, "{k}");
        }
    }
}

#[test]
fn a_static_dark_bar_across_the_shaft() {
    let mut scene = Scene::new(rig(640), 6);
    let needle = needle();
    let [_, y] = left_px(&scene, &needle, 0.5 * needle.depth);
    for learned in [true, false] {
        let mut tracker = tracker_of(&scene.rig);
        scene.bars.clear();
        if !learned {
            // The bar comes once the needle is followed.
            let first = watch(&scene, &mut tracker, needle, &[0.0; 3], 0.0);
            assert!(first.iter().all(|o| o.error < 0.1e-3));
        }
        scene.bars.push([0.0, 640.0, y - 5.0, y + 5.0]);
        for o in watch(&scene, &mut tracker, needle, &[STEP; 20], STEP) {
            assert_eq!(o.status, Tracking::Tracked);
            assert!(o.error < 0.1e-3, "{o:?}");
        }
    }
}

/// The model shows nothing of the needle until its tip is so deep; until then images count as
/// background, though the needle's end is in them.
#[test]
fn a_needle_that_was_learned_as_background_starts_at_its_tip() {
    const IN_SIGHT: f64 = 2.5e-3;
    const ADVANCE: f64 = 33e-6;
    let scene = Scene::new(rig(640), 9);
    for azimuth in [0.8, 1.6] {
        let mut needle = Needle::bent(0.8e-3, 1.57e-3, azimuth);
        let appearance = Appearance {
            diameter: 0.7e-3,
            bevel_length: needle.bevel_length,
        };
        let settings = TrackSettings::default();
        let mut tracker = StereoTracker::new(&scene.rig, appearance, &settings).unwrap();
        let mut started = None;
        for number in 1..=220 {
            needle.depth += ADVANCE;
            let seen = needle.depth - IN_SIGHT;
            let guess: Vec<_> = (0..=10)
                .filter(|_| seen > 0.0)
                .map(|i| needle.point(IN_SIGHT + seen * f64::from(i) / 10.0).into())
                .collect();
            let context = Context {
                guess: Some(&guess),
                bevel: Some(needle.bevel_direction().into_inner()),
                ..advance(ADVANCE)
            };
            let t = tracker
                .track(&scene.pair(&needle, number), &context)
                .unwrap();
            if t.status == Tracking::Tracked {
                started.get_or_insert(needle.depth);
                let e = (t.shape.tip.position.coords() - needle.point(needle.depth)).norm();
                // Twice the most that was seen; the sharp point lies 1.57 mm ahead.
                assert!(e < 0.1e-3, "azimuth {azimuth}, {number}: {e}");
            } else {
                assert!(
                    started.is_none(),
                    "azimuth {azimuth}, {number}: {:?}",
                    t.loss
                );
            }
        }
        // The shortest visible shaft, 12 px, is 3 mm.
        let depth = started.unwrap();
        println!("azimuth {azimuth}: started at {depth}");
        assert!(depth < IN_SIGHT + 4e-3, "azimuth {azimuth}: {depth}");
    }
}

#[test]
fn blank_frames_are_named_noticed_and_survived() {
    let scene = Scene::new(rig(640), 5);
    for grey in [0, 255] {
        let mut needle = needle();
        let mut tracker = tracker_of(&scene.rig);
        let mut lost_at = None;
        for k in 0..20_u64 {
            if (8..13).contains(&k) {
                let blank = scene.blank(grey, k);
                let error = tracker.track(&blank, &advance(STEP)).unwrap_err();
                let named = format!("left image shows nothing: grey levels from {grey} to {grey}");
                assert!(error.to_string().contains(&named), "{error}");
                if tracker.tracked().status == Tracking::Lost {
                    lost_at.get_or_insert(k);
                }
            } else {
                let pair = scene.pair(&needle, k);
                let status = tracker.track(&pair, &advance(STEP)).unwrap().status;
                // The first pair after the gap must do.
                let loss = tracker.tracked().loss;
                assert_eq!(status, Tracking::Tracked, "{k}: {loss:?}");
            }
            needle.depth += STEP;
        }
        assert_eq!(lost_at, Some(10));
    }
}

#[test]
fn blank_images_are_not_learned_before_the_start() {
    let scene = Scene::new(rig(640), 5);
    let needle = needle();
    let mut tracker = tracker_of(&scene.rig);
    for k in 0..5 {
        let error = tracker
            .track(&scene.blank(255, k), &Context::default())
            .unwrap_err();
        assert!(matches!(error, FrameError::Blank { .. }), "{error}");
        assert_eq!(tracker.tracked().status, Tracking::None);
    }
    let t = tracker
        .track(&scene.pair(&needle, 5), &Context::default())
        .unwrap();
    assert_eq!(t.status, Tracking::Tracked, "{:?}", t.loss);
    let e = (t.shape.tip.position.coords() - needle.point(needle.depth)).norm();
    assert!(e < 0.1e-3, "{e}");
}

#[test]
fn predicted_tips_say_how_far_they_may_be_off() {
    let scene = Scene::new(rig(640), 9);
    let mut needle = needle();
    let mut tracker = tracker_of(&scene.rig);
    let mut slips = [1.0, -1.0, 1.0, 1.0, -1.0].into_iter().cycle();
    let mut normalised = Vec::new();
    let mut variances = [0.0, 0.0];
    for k in 0..60_u64 {
        // Two of six pairs are blank: the needle is predicted and not yet lost.
        let gap = k % 6 > 3;
        let pair = if gap {
            scene.blank(255, k)
        } else {
            scene.pair(&needle, k)
        };
        // Odometry is off by as much as its setting allows for: 0.15 px are 0.038 mm.
        let slip = slips.next().unwrap() * 0.035e-3;
        let answer = tracker.track(&pair, &advance(STEP + slip)).is_err();
        assert_eq!(answer, gap);
        let tip = &tracker.tracked().shape.tip;
        if gap {
            assert_eq!(tracker.tracked().status, Tracking::Predicted);
            let e = tip.position.coords() - needle.point(needle.depth);
            let information = tip.covariance.try_inverse().unwrap();
            normalised.push(e.dot(&(information * e)) / 3.0);
        }
        variances[usize::from(gap)] += tip.covariance.trace();
        needle.depth += STEP;
    }
    let mean = normalised.iter().sum::<f64>() / normalised.len() as f64;
    println!("predicted: NEES {mean:.2} of its ideal");
    // Too large is overconfident. The lower end is loose: of three freedoms only the one along
    // the axis is disturbed here.
    assert!((0.05..2.0).contains(&mean), "{mean}");
    assert!(
        0.5 * variances[1] > 1.5 * variances[0] / 2.0,
        "{variances:?}"
    );
}

#[test]
fn missing_frames_are_bridged_by_odometry() {
    let scene = Scene::new(rig(640), 10);
    let mut needle = needle();
    let mut tracker = tracker_of(&scene.rig);
    let mut before = needle.depth;
    for k in [0, 1, 2, 3, 13, 14, 20, 21_u64] {
        needle.depth = 0.045 + STEP * k as f64;
        let t = tracker
            .track(&scene.pair(&needle, k), &advance(needle.depth - before))
            .unwrap();
        before = needle.depth;
        let e = (t.shape.tip.position.coords() - needle.point(needle.depth)).norm();
        assert_eq!(t.status, Tracking::Tracked, "{k}: {:?}", t.loss);
        assert!(e < 0.1e-3, "{k}: {e}");
    }
}

#[test]
fn a_pair_without_a_needle_is_lost_within_three() {
    let scene = Scene::new(rig(640), 6);
    let needle = needle();
    let mut tracker = tracker_of(&scene.rig);
    tracker
        .track(&scene.pair(&needle, 0), &Context::default())
        .unwrap();
    for k in 1..=3 {
        let t = tracker.track(&scene.empty(k), &Context::default()).unwrap();
        assert!(t.loss.is_some() && t.status != Tracking::Tracked);
        assert_eq!(t.status == Tracking::Lost, k == 3);
    }
}

#[test]
fn a_tip_that_jumps_is_found_again_within_three() {
    let scene = Scene::new(rig(640), 7);
    for jump in [3e-3, -3e-3] {
        let mut moves = [0.0; 12];
        moves[5] = jump;
        let mut tracker = tracker_of(&scene.rig);
        let outcomes = watch(&scene, &mut tracker, needle(), &moves, 0.0);
        for (k, o) in outcomes.iter().enumerate() {
            if !(5..8).contains(&k) {
                assert!(
                    o.status == Tracking::Tracked && o.error < 0.1e-3,
                    "{k}: {o:?}"
                );
            }
        }
    }
}

#[test]
fn a_tip_that_stops_against_the_odometry_is_not_carried_on() {
    let scene = Scene::new(rig(640), 11);
    let moves: Vec<f64> = (0..40).map(|k| if k < 10 { STEP } else { 0.0 }).collect();
    let mut tracker = tracker_of(&scene.rig);
    // Buckled outside: the base goes on, the tip does not.
    for (k, o) in watch(&scene, &mut tracker, needle(), &moves, STEP)
        .iter()
        .enumerate()
    {
        // 0.4 px an image that did not happen, of which the filter believes some.
        assert!(o.error < 0.1e-3, "{k}: {o:?}");
    }
}

#[test]
fn pairs_that_do_not_fit_are_named() {
    let scene = Scene::new(rig(640), 8);
    let mut tracker = tracker_of(&scene.rig);
    let needle = needle();
    let mut pair = scene.pair(&needle, 5);
    pair.right.stamp = hal::Stamp::from_secs(1.0);
    let e = tracker.track(&pair, &Context::default()).unwrap_err();
    assert_eq!(e.to_string(), "the images were taken 0.833 s apart");
    let other = Scene::new(rig(1280), 8).pair(&needle, 5);
    let e = tracker.track(&other, &Context::default()).unwrap_err();
    assert_eq!(
        e.to_string(),
        "the left image is 1280 x 960, the calibration is for 640 x 480"
    );
    let mut mixed = scene.pair(&needle, 6);
    mixed.right.image = other.right.image;
    let e = tracker.track(&mixed, &Context::default()).unwrap_err();
    assert!(
        e.to_string().starts_with("the right image is 1280 x 960"),
        "{e}"
    );
    let bad = TrackSettings {
        blur_px: f64::NAN,
        ..TrackSettings::default()
    };
    let needle = Appearance {
        diameter: 0.7e-3,
        bevel_length: 0.0,
    };
    let e = StereoTracker::new(&scene.rig, needle, &bad).unwrap_err();
    assert_eq!(e.key, "blur_px");
}

#[test]
fn a_calibration_that_does_not_fit_the_images_is_named() {
    let scene = Scene::new(rig(640), 12);
    let mut other = scene.rig;
    // The right camera nods by a degree.
    let nod = nalgebra::Isometry3::rotation(nalgebra::Vector3::x() * 1_f64.to_radians());
    other.right_from_left = hal::Transform::assume(nod * scene.rig.right_from_left.isometry());
    let needle = needle();
    let mut tracker = tracker_of(&other);
    for k in 0..3 {
        let t = tracker
            .track(&scene.pair(&needle, k), &Context::default())
            .unwrap();
        assert_eq!(t.status, Tracking::None);
        assert!(
            matches!(t.loss, Some(Loss::Disagreement { px }) if px > 5.0),
            "{:?}",
            t.loss
        );
    }
}
