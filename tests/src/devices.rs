//! Insertions with devices of fewer joints than an arm: what they can do is used, the rest is left
//! out of the plan.

use std::path::Path;
use std::time::Duration;

use hal::telemetry::Telemetry;
use hybrid_control::Unreachable;
use needle_steer::aim::TargetRefused;
use needle_steer::config::{self, Config};
use needle_steer::controls::Controls;
use needle_steer::hand::Prompt;
use needle_steer::identify::distortion::{Lie, map_of};
use needle_steer::outcome::Ended;
use needle_steer::rig::{self, Misfit, Rig, RigBuildError};
use needle_steer::run::{Observer, RunError, run, simulate};
use needle_steer::samples;
use needle_steer::springs::bevel_length;
use needle_steer::withdrawal::{BasePath, Lead, Refusal, make_ready};

/// The device of that name in `robots/urdf`, where the configuration puts its base.
fn unplaced(device: &str, more: &[&str]) -> Config {
    let urdf = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../robots/urdf/{device}.urdf"));
    let mut overrides = vec![
        format!("arm.urdf={:?}", urdf.to_str().unwrap()),
        "arm.tip_link=needle_base".to_owned(),
        "arm.mechanism=true".to_owned(),
        "run.sensor=shape".to_owned(),
    ];
    overrides.extend(more.iter().map(ToString::to_string));
    config::load(None, &overrides).unwrap()
}

/// The same where it can insert.
pub(crate) fn placed(device: &str, more: &[&str]) -> Config {
    rig::placed(&unplaced(device, more)).unwrap()
}

fn error(config: &Config) -> f64 {
    let summary = simulate(config).unwrap();
    assert_eq!(summary.ended, Ended::TargetPassed, "{}", config.arm.urdf);
    summary.true_error_mm.unwrap()
}

#[test]
fn a_stage_passes_targets_by_bevel_and_shift() {
    for kind in ["target.kind=aligned", "target.kind=shifted"] {
        for seed in ["run.seed=1", "run.seed=2"] {
            let off = error(&placed("stage", &[kind, seed]));
            assert!(off < 0.1, "{kind}, {seed}: {off} mm");
        }
    }
}

#[test]
fn insertion_and_spin_pass_an_aligned_target() {
    for law in ["run.law=hybrid", "run.law=tip-only"] {
        let off = error(&placed("insertion_spin", &["target.kind=aligned", law]));
        assert!(off < 0.1, "{law}: {off} mm");
    }
}

#[test]
fn what_a_device_cannot_do_is_refused_before_it_moves() {
    let aside = placed("insertion_spin", &["target.kind=shifted"]);
    let refused = simulate(&aside).unwrap_err();
    let RunError::Target(TargetRefused::Unreachable(Unreachable::Aside { reach_mm, .. })) = refused
    else {
        panic!("{refused}");
    };
    assert!((4.0..9.0).contains(&reach_mm), "{reach_mm}");
    let pivots = placed(
        "insertion_spin",
        &["target.kind=aligned", "run.law=base-only"],
    );
    let refused = simulate(&pivots).unwrap_err().to_string();
    assert!(refused.contains("law base-only"), "{refused}");
}

#[test]
fn a_device_that_is_mounted_elsewhere_is_refused_with_figures() {
    let beside = placed("stage", &[]);
    let mut config = beside.clone();
    // Beyond the travel of its axis across the needle.
    config.arm.base_mm[0] += 80.0;
    let refused = Rig::new(&config).unwrap_err();
    let RigBuildError::Misfit(Misfit::Mounted { across_mm, .. }) = refused else {
        panic!("{refused}");
    };
    assert!((15.0..40.0).contains(&across_mm), "{across_mm}");
    // One that stands a little aside makes up for it.
    config.arm.base_mm[0] -= 79.0;
    let rig = Rig::new(&config).unwrap();
    let moved = rig.home[0] - Rig::new(&beside).unwrap().home[0];
    assert!((moved.abs() - 1e-3).abs() < 1e-5, "{moved} m");
}

#[test]
fn a_stage_that_is_too_short_is_refused_in_millimetres() {
    let mut config = placed("stage", &[]);
    // The slide then starts 80 mm further on.
    config.arm.base_mm[2] += 80.0;
    let refused = Rig::new(&config).unwrap_err().to_string();
    assert!(
        refused.contains("joint_z comes to its end (150.0 mm)"),
        "{refused}"
    );
}

/// A thick needle through a guide in a stiff gel, as docs/REAL_NEEDLES.md has it.
pub(crate) fn through_a_guide(more: &[&str]) -> Config {
    let mut settings = vec![
        "run.phantom=gel-guide",
        "needle.support=\"guide\"",
        "needle.guide_gap_mm=25.0",
        "needle.length_mm=200.0",
        "needle.outer_diameter_mm=1.27",
        "needle.inner_diameter_mm=0.84",
        "estimator.stiffness_n_m2=2.1e5",
        "estimator.stiffness_sigma=0.1",
        "estimator.cut_angle_deg=0.36",
        "estimator.cut_angle_sigma=0.1",
        "estimator.tip_compliance_deg_n=0.1",
        "supervisor.tissue_stretch_mm=5.5",
    ];
    settings.extend(more);
    placed("guide", &settings)
}

#[test]
fn a_guide_near_the_tissue_passes_targets_by_shift() {
    for offset in ["target.offset_mm=0", "target.offset_mm=5"] {
        for seed in ["run.seed=1", "run.seed=2"] {
            let off = error(&through_a_guide(&[offset, seed]));
            assert!(off < 0.5, "{offset}, {seed}: {off} mm");
        }
    }
}

#[test]
fn an_electromagnetic_tip_in_an_even_field_closes_the_loop() {
    // What a distorted field costs is in docs/REAL_NEEDLES.md.
    let even = [
        "run.sensor=em",
        "target.kind=aligned",
        "phantom.em.distortion_mm=0.0",
        "phantom.em.axis_distortion_mrad=0.0",
    ];
    let stage = placed("stage", &even);
    let off = error(&stage);
    assert!(off < 0.2, "{off} mm");
    let summary = simulate(&stage).unwrap();
    assert_eq!(summary.true_error_less_bias_mm, summary.true_error_mm);
}

#[test]
fn an_electromagnetic_tip_closes_the_loop_through_a_guide() {
    // Without the shaft the tip has to tell how the guide lies: half a degree and 0.2 mm aside.
    for seed in ["run.seed=1", "run.seed=2", "run.seed=3"] {
        let off = error(&through_a_guide(&[
            "run.sensor=em",
            "target.offset_mm=5",
            "phantom.em.distortion_mm=0.0",
            "phantom.em.axis_distortion_mrad=0.0",
            seed,
        ]));
        assert!(off < 0.9, "{seed}: {off} mm");
    }
}

/// A folder for maps of this test.
fn maps(name: &str) -> std::path::PathBuf {
    let folder = std::env::temp_dir().join(format!("em-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// `config` with a map of its own field, made in air.
fn mapped(config: &Config, folder: &Path) -> Config {
    let (table, file) = (folder.join("in_air.csv"), folder.join("map.toml"));
    samples::in_air(config, &table).unwrap();
    let map = map_of(&table, Lie::Exact).unwrap();
    std::fs::write(&file, toml::to_string(&map).unwrap()).unwrap();
    let mut config = config.clone();
    config.em.map = file.display().to_string();
    config
}

#[test]
fn a_map_made_in_air_takes_the_fields_distortion_off() {
    for seed in ["run.seed=1", "run.seed=2"] {
        let folder = maps(&seed.replace('.', "-"));
        let bare = through_a_guide(&["run.sensor=em", "target.offset_mm=5", seed]);
        let config = mapped(&bare, &folder);
        let summary = simulate(&config).unwrap();
        assert_eq!(summary.ended, Ended::TargetPassed, "{seed}");
        let truly = summary.true_error_mm.unwrap();
        let less_bias = summary.true_error_less_bias_mm.unwrap();
        assert!(
            truly < 0.7 && less_bias < 0.7,
            "{seed}: {truly} mm, {less_bias} mm"
        );
        // What the map leaves of the field is small, and is what counts as the sensor's bias.
        assert!(
            (truly - less_bias).abs() < 0.3,
            "{seed}: {truly} mm, {less_bias} mm"
        );
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

#[test]
fn a_map_that_is_none_is_refused_with_file_and_key() {
    let folder = maps("none");
    let refused = |text: &str| {
        let file = folder.join("map.toml");
        std::fs::write(&file, text).unwrap();
        let map = format!("em.map={:?}", file.to_str().unwrap());
        let config = through_a_guide(&["run.sensor=em", &map]);
        Rig::new(&config).unwrap_err().to_string()
    };
    let problem = refused("along = 2\n");
    assert!(
        problem.contains("map.toml") && problem.contains("calibrate distortion"),
        "{problem}"
    );
    let smooth = "degree_across = 0\ndegree_along = 1\nbefore = 1.0\nleft = 0.5\n\
                  coefficients = [[0.0, 0.0, 0.0]]\n";
    let problem = refused(&format!(
        "along = 2\nmin_mm = [0.0, 0.0, 0.0]\nmax_mm = [1.0, 1.0, 1.0]\nplaces = 50\nnoise_mm = 0.1\n\
         [place_mm]\n{smooth}[axis_mrad]\n{smooth}"
    ));
    assert!(
        problem.contains("`place_mm`: expected 2 coefficients, found 1"),
        "{problem}"
    );
    let mut missing = through_a_guide(&["run.sensor=em"]);
    missing.em.map = folder.join("nowhere.toml").display().to_string();
    let problem = Rig::new(&missing).unwrap_err().to_string();
    assert!(
        problem.contains("nowhere.toml: cannot be read"),
        "{problem}"
    );
    std::fs::remove_dir_all(&folder).unwrap();
}

/// What was asked of the hand, and what was commanded of the joint that it pushes.
#[derive(Default)]
struct Prompts {
    asked: Vec<Prompt>,
    /// Advance that telemetry told at each prompt \[m\].
    depths: Vec<f64>,
    depth: f64,
}

impl Observer for Prompts {
    fn step(&mut self, telemetry: &Telemetry) {
        self.depth = telemetry.depth;
    }

    fn prompt(&mut self, prompt: Prompt) {
        self.asked.push(prompt);
        self.depths.push(self.depth);
    }
}

#[test]
fn a_hand_pushes_in_steps_and_the_guide_steers() {
    let folder = maps("hand");
    let bare = through_a_guide(&[
        "run.sensor=em",
        "target.offset_mm=5",
        "insertion.by=hand",
        "run.seed=1",
    ]);
    let config = mapped(&bare, &folder);
    let mut rig = Rig::new(&config).unwrap();
    let mut prompts = Prompts::default();
    let summary = run(&config, &mut rig, &mut prompts, &Controls::default()).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    assert_eq!(summary.ended, Ended::TargetPassed);
    let off = summary.true_error_less_bias_mm.unwrap();
    assert!(off < 1.2, "{off} mm");
    // Steps and holds take turns; no step is longer than was configured.
    let steps: Vec<f64> = prompts
        .asked
        .iter()
        .filter_map(|prompt| match prompt {
            Prompt::Advance(by) => Some(*by),
            Prompt::Hold => None,
        })
        .collect();
    assert!(steps.len() > 14, "{steps:?}");
    assert!(steps.iter().all(|by| *by <= 5e-3 + 1e-12), "{steps:?}");
    assert!(
        prompts
            .asked
            .windows(2)
            .all(|two| (two[0] == Prompt::Hold) != (two[1] == Prompt::Hold))
    );
    // What the hand did is what was measured: its steps are not what was asked for.
    let told = rig.slide.as_ref().unwrap().advance();
    // No joint drew it in, so none draws it out.
    let patience = Duration::from_secs(1);
    let mut path = BasePath::default();
    assert_eq!(
        make_ready(&mut rig, &mut path, Lead::WENT_ON, patience),
        Err(Refusal::ByHand)
    );
    // The path ends at the edge, a bevel's length ahead of O.
    let cut = rig.world.as_ref().unwrap().report().path_length;
    let truth = cut - bevel_length(&config);
    assert!((told - truth).abs() < 1e-3, "{told} m told, {truth} m deep");
    let asked: f64 = steps.iter().sum();
    assert!(
        (asked - truth).abs() > 0.5e-3,
        "{asked} m asked, {truth} m deep"
    );
}

#[test]
fn a_hand_whose_advance_is_not_measured_is_refused() {
    let refused = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
        config::load(None, &sets).unwrap_err().to_string()
    };
    let guide = ["insertion.by=hand", "needle.support=guide"];
    assert!(refused(&guide).contains("expected run.sensor"));
    assert!(refused(&guide[..1]).contains("expected needle.support"));
}

#[test]
fn a_guide_too_near_is_refused_with_its_key() {
    let mut config = through_a_guide(&[]);
    config.needle.guide_gap_mm = 0.5;
    let refused = Rig::new(&config).unwrap_err().to_string();
    assert!(refused.contains("needle.guide_gap_mm"), "{refused}");
    // A file that says so is refused before that.
    let refused = config::load(None, &["needle.guide_gap_mm=0.5".to_owned()]).unwrap_err();
    assert!(
        refused.to_string().contains("needle.guide_gap_mm"),
        "{refused}"
    );
}
