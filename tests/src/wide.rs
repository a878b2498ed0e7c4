//! A sample of the insertions in wide worlds, each verdict held against the truth.

use needle_steer::experiments::in_parallel;
use needle_steer::outcome::Cause;
use needle_steer::robustness::wide::{Verdict, World, judge};

/// First of the sampled worlds, and how many: every law meets five.
const SAMPLE: (u64, u64) = (9000, 35);

#[test]
fn verdicts_in_wide_worlds_are_true() {
    let worlds: Vec<World> = (SAMPLE.0..SAMPLE.0 + SAMPLE.1).map(World::new).collect();
    let verdicts = in_parallel(&worlds, 2, |world| judge(&world.config().unwrap()).unwrap());
    let broken = |is: fn(&Verdict) -> bool| -> Vec<String> {
        let pairs = worlds.iter().zip(&verdicts);
        let found = pairs.filter(|(_, verdict)| is(verdict));
        found
            .map(|(world, verdict)| format!("{}: {} {verdict:?}", world.index, verdict.ended))
            .collect()
    };
    for (what, found) in [
        (
            "passed with the tip elsewhere",
            broken(Verdict::is_false_pass),
        ),
        ("pushed blind", broken(Verdict::pushed_blind)),
        ("failed model read", broken(Verdict::read_failed_model)),
    ] {
        assert!(found.is_empty(), "{what}: {found:#?}");
    }
    let named: Vec<&Verdict> = verdicts.iter().filter(|v| v.cause.is_some()).collect();
    let doubtful = named.iter().filter(|v| !v.confirmed).count();
    // 95 % are asked for; a sample of some thirty that keeps them has four more in one of a hundred.
    assert!(doubtful <= 4, "{doubtful} of {}", named.len());
    // An audit in which nothing passes and nothing fails would hold nothing.
    let passed = verdicts.iter().filter(|v| v.ended.is_success()).count();
    assert!(passed >= 5 && named.len() >= 5, "{passed}, {}", named.len());
}

/// Friction holds a shaft that bows until the tissue tears along it, with the tip where it is said to be
/// and a model that shows a third of the stretch: only the measured shaft tells.
#[test]
fn a_shaft_that_friction_bends_out_of_its_path_is_a_tear() {
    for number in [1001, 1009, 1160] {
        let verdict = judge(&World::new(number).config().unwrap()).unwrap();
        assert_eq!(verdict.cause, Some(Cause::Tear), "{number}: {verdict:?}");
        assert!(verdict.confirmed, "{number}: {verdict:?}");
    }
}

/// Tissue that drifts by 12 mm/min leads the base to the end of its workspace, and the model's needle out of
/// the tissue: its stretch is zero from then on, which is no evidence of anything.
#[test]
fn a_model_outside_of_the_tissue_has_failed() {
    let verdict = judge(&World::new(349).config().unwrap()).unwrap();
    assert!(!verdict.read_failed_model(), "{verdict:?}");
    assert!(
        matches!(
            verdict.cause,
            Some(Cause::ModelFailed | Cause::TissueMotion)
        ) && verdict.confirmed,
        "{verdict:?}"
    );
}
