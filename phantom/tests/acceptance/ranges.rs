//! Every numeric setting: refused beyond its range with the range, simulated up to its ends.

use hal::{Stamp, StereoCamera, Transform};
use nalgebra::{Isometry3, Vector3};
use phantom::camera::{CameraSettings, RigError, StereoRig};
use phantom::experiment::default_setup;
use phantom::{Bench, Settings, SettingsError, Setup};
use toml::{Table, Value};

use crate::support::{Dice, finite};

/// Key, lowest, highest.
type Range = (&'static str, f64, f64);

const RANGES: [Range; 97] = [
    ("needle.length_mm", 20.0, 400.0),
    ("needle.outer_diameter_mm", 0.2, 3.0),
    ("needle.inner_diameter_mm", 0.0, 2.99),
    ("needle.young_gpa", 10.0, 500.0),
    ("needle.shear_gpa", 3.0, 200.0),
    ("needle.bevel_deg", 5.0, 85.0),
    ("needle.elements", 16.0, 2000.0),
    ("needle.yield_mpa", 10.0, 1e4),
    ("tissue.stiffness_n_m2", 1e2, 1e6),
    ("tissue.stiffening", 0.0, 10.0),
    ("tissue.relaxed_fraction", 0.0, 0.9),
    ("tissue.relaxation_s", 0.1, 1e4),
    ("tissue.slit_gap_um", 0.0, 500.0),
    ("tissue.tear_mm", 0.0, 50.0),
    ("tissue.field_cv", 0.0, 0.3),
    ("tissue.field_length_mm", 1.0, 100.0),
    ("tissue.layers.from_mm", 0.0, 400.0),
    ("tissue.layers.stiffness_ratio", 0.3, 5.0),
    ("tissue.layers.cut_ratio", 0.7, 1.4),
    ("tissue.layers.puncture_n", 0.0, 5.0),
    ("tip.cut_angle_deg", 0.0, 15.0),
    ("tip.compliance_deg_n", 0.0, 30.0),
    ("tip.moment_compliance_deg_nm", 0.0, 1e4),
    ("tip.field_cv", 0.0, 0.3),
    ("tip.field_length_mm", 1.0, 100.0),
    ("tip.direction_noise_deg", 0.0, 3.0),
    ("tip.direction_noise_length_mm", 1.0, 100.0),
    ("tip.hold_n_m", 1e2, 1e6),
    ("tip.cutting_n", 0.0, 2.0),
    ("friction.shaft_n_m", 0.0, 300.0),
    ("friction.presliding_um", 0.1, 100.0),
    ("friction.static_ratio", 1.0, 3.0),
    ("entry.skin_n_m", 0.0, 1e4),
    ("entry.slide_n", 0.0, 10.0),
    ("entry.grip_n", 0.0, 2.0),
    ("entry.follow", 0.0, 1.0),
    ("motion.breathing_mm", 0.0, 30.0),
    ("motion.breathing_hz", 0.0, 2.0),
    ("motion.breathing_direction", -1e3, 1e3),
    ("motion.breathing_phase_deg", -360.0, 360.0),
    ("motion.breathing_fade_1_m", -100.0, 20.0),
    ("motion.drift_mm_min", -60.0, 60.0),
    ("motion.rotation_deg_min", -60.0, 60.0),
    ("em.rate_hz", 1.0, 1000.0),
    ("em.latency_ms", 0.0, 1000.0),
    ("em.drop_fraction", 0.0, 0.95),
    ("em.noise_mm", 0.0, 5.0),
    ("em.axis_noise_mrad", 0.0, 300.0),
    ("em.distortion_mm", 0.0, 10.0),
    ("em.axis_distortion_mrad", 0.0, 300.0),
    ("em.distortion_length_mm", 1.0, 1000.0),
    ("em.stated_mm", 0.0, 10.0),
    ("em.stated_mrad", 0.0, 300.0),
    ("em.setback_mm", 0.0, 30.0),
    ("guide.gap_mm", 0.0, 200.0),
    ("hand.speed_mm_s", 0.1, 50.0),
    ("hand.step_error", 0.0, 1.0),
    ("hand.pause_s", 0.0, 60.0),
    ("hand.reaction_s", 0.0, 5.0),
    ("fbg.rate_hz", 1.0, 1000.0),
    ("fbg.latency_ms", 0.0, 1000.0),
    ("fbg.drop_fraction", 0.0, 0.95),
    ("fbg.noise_pm", 0.0, 1000.0),
    ("fbg.drift_pm", 0.0, 1000.0),
    ("fbg.gain_error", 0.0, 0.5),
    ("fbg.azimuth_error_deg", 0.0, 45.0),
    ("fbg.roll_error_deg", 0.0, 45.0),
    ("fbg.warming_k", -50.0, 50.0),
    ("fbg.warming_s", 1e-3, 1e4),
    ("fbg.thermal_pm_k", 0.0, 100.0),
    ("fbg.thermal_mismatch", 0.0, 1.0),
    ("fbg.grating_mm", 0.1, 20.0),
    ("sensor.rate_hz", 1.0, 1000.0),
    ("sensor.latency_ms", 0.0, 1000.0),
    ("sensor.drop_fraction", 0.0, 0.95),
    ("sensor.spacing_mm", 0.1, 50.0),
    ("sensor.noise_mm", 0.0, 5.0),
    ("sensor.direction_noise_deg", 0.0, 20.0),
    ("sensor.bias_mm", 0.0, 5.0),
    ("robot.kinematic_mm", 0.0, 5.0),
    ("robot.kinematic_deg", 0.0, 5.0),
    ("robot.kinematic_length_mm", 10.0, 1e4),
    ("robot.holder_offset_mm", 0.0, 5.0),
    ("robot.holder_tilt_deg", 0.0, 5.0),
    ("robot.servo_lag_ms", 0.0, 500.0),
    ("robot.compliance_mm_n", 0.0, 0.5),
    ("robot.compliance_deg_nm", 0.0, 50.0),
    ("spread.stiffness_cv", 0.0, 1.0),
    ("spread.cut_angle_cv", 0.0, 1.0),
    ("spread.azimuth_deg", 0.0, 60.0),
    ("spread.tilt_deg", 0.0, 5.0),
    ("spread.pre_insertion_mm", 0.0, 50.0),
    ("continuum.face_pressure_ratio", 0.0, 300.0),
    ("continuum.indent_n_m", 50.0, 1e5),
    ("continuum.puncture_n", 0.0, 5.0),
    ("continuum.edge_offset_ratio", 0.0, 1.0),
    ("continuum.slit_memory_mm", 0.1, 30.0),
];

const CAMERA_RANGES: [Range; 44] = [
    ("width_px", 32.0, 4096.0),
    ("height_px", 32.0, 4096.0),
    ("focal_px", 100.0, 50_000.0),
    ("principal_offset_px", -200.0, 200.0),
    ("distortion k1", -1.0, 1.0),
    ("distortion k2", -5.0, 5.0),
    ("distortion p1", -0.02, 0.02),
    ("distortion p2", -0.02, 0.02),
    ("distortion k3", -50.0, 50.0),
    ("distance_mm", 103.0, 5000.0),
    ("separation_deg", 5.0, 120.0),
    ("azimuth_deg", -360.0, 360.0),
    ("rate_hz", 0.1, 1000.0),
    ("container.gel_half_width_mm", 10.0, 300.0),
    ("container.gel_depth_mm", 20.0, 500.0),
    ("container.wall_mm", 0.0, 30.0),
    ("container.wall_index", 1.0, 2.0),
    ("container.gel_index", 1.0, 1.7),
    ("backlight.level_grey", 10.0, 255.0),
    ("backlight.gradient", 0.0, 1.0),
    ("backlight.vignetting", 0.0, 0.9),
    ("backlight.moire", 0.0, 0.5),
    ("backlight.moire_period_px", 2.0, 1000.0),
    ("backlight.clouds", 0.0, 0.2),
    ("optics.blur_sigma_px", 0.0, 8.0),
    ("optics.needle_grey", 0.0, 200.0),
    ("optics.haze", 0.0, 0.99),
    ("optics.specular_grey", 0.0, 255.0),
    ("bubbles.count", 0.0, 5000.0),
    ("bubbles.radius_min_mm", 0.01, 5.0),
    ("bubbles.radius_max_mm", 0.1, 5.0),
    ("noise.gaussian_grey", 0.0, 20.0),
    ("noise.poisson_grey", 0.0, 1.0),
    ("delivery.latency_min_ms", 0.0, 2000.0),
    ("delivery.latency_max_ms", 30.0, 2000.0),
    ("delivery.drop_probability", 0.0, 1.0),
    ("calibration.views", 3.0, 200.0),
    ("calibration.corner_sigma_px", 0.0, 5.0),
    ("calibration.drift_mrad", 0.0, 50.0),
    ("calibration.container_mm", 0.0, 20.0),
    ("calibration.container_deg", 0.0, 10.0),
    ("calibration.gel_index", 0.0, 0.05),
    ("calibration.registration_mm", 0.0, 50.0),
    ("calibration.registration_deg", 0.0, 20.0),
];

/// Where a key's number is: names into tables, `*` for the first or last of an array.
fn path(key: &str) -> Vec<&str> {
    match key.strip_prefix("distortion ") {
        Some(coefficient) => {
            let names = ["k1", "k2", "p1", "p2", "k3"];
            let indices = ["0", "1", "2", "3", "4"];
            let index = names.iter().position(|n| *n == coefficient).unwrap();
            vec!["distortion", "*", indices[index]]
        }
        None => key.split('.').collect(),
    }
}

/// The number at `path`, in the first or the last element of arrays.
fn slot<'a>(value: &'a mut Value, path: &[&str], last: bool) -> &'a mut Value {
    match value {
        Value::Table(table) => slot(table.get_mut(path[0]).unwrap(), &path[1..], last),
        Value::Array(array) => {
            let end = if last { array.len() - 1 } else { 0 };
            // A name after an array of tables belongs to its tables.
            match path.first().map(|step| (step.parse::<usize>(), *step)) {
                Some((Ok(index), _)) => slot(&mut array[index], &path[1..], last),
                Some((_, "*")) => slot(&mut array[end], &path[1..], last),
                _ => slot(&mut array[end], path, last),
            }
        }
        number => number,
    }
}

/// `table` with `key` at `x`, rounded where the setting is a whole number.
fn with(table: &Table, key: &str, last: bool, x: f64) -> Table {
    let mut value = Value::Table(table.clone());
    let slot = slot(&mut value, &path(key), last);
    #[expect(clippy::cast_possible_truncation, reason = "whole numbers are small")]
    match slot {
        Value::Integer(i) => *i = x.round() as i64,
        Value::Float(f) => *f = x,
        other => unreachable!("{key}: {other:?} is no number"),
    }
    match value {
        Value::Table(table) => table,
        _ => unreachable!(),
    }
}

/// Keys of all numbers.
fn keys(value: &Value, name: &str, found: &mut Vec<String>) {
    match value {
        Value::Table(table) => {
            for (key, value) in table {
                let dot = if name.is_empty() { "" } else { "." };
                keys(value, &format!("{name}{dot}{key}"), found);
            }
        }
        Value::Array(array) => keys(&array[0], name, found),
        Value::Integer(_) | Value::Float(_) => found.push(name.to_owned()),
        _ => {}
    }
}

/// Every number of `table` is in `ranges`, and is refused outside its range with that range.
fn refused_outside(
    table: &Table,
    ranges: &[Range],
    check: impl Fn(Table) -> Result<(), SettingsError>,
) {
    let mut found = Vec::new();
    keys(&Value::Table(table.clone()), "", &mut found);
    for key in &found {
        let listed = ranges
            .iter()
            .any(|(k, ..)| k.split(' ').next() == Some(key));
        assert!(listed, "{key} has no range here");
    }
    for (key, lowest, highest) in ranges {
        for last in [false, true] {
            let mut value = Value::Table(table.clone());
            let whole = matches!(slot(&mut value, &path(key), last), Value::Integer(_));
            let beyond = |x: f64| if whole { 1.0 } else { 1e-9 * (1.0 + x.abs()) };
            let mut bad = vec![lowest - beyond(*lowest), highest + beyond(*highest)];
            if whole {
                bad.retain(|x| *x >= 0.0);
            } else {
                bad.extend([f64::NAN, f64::INFINITY, f64::NEG_INFINITY]);
            }
            for x in bad {
                match check(with(table, key, last, x)).unwrap_err() {
                    SettingsError::OutOfRange {
                        key: k,
                        value,
                        lowest: l,
                        highest: h,
                    } => {
                        assert_eq!(k, *key);
                        assert!(value.to_bits() == x.to_bits(), "{key}: {value} {x}");
                        assert_eq!((l, h), (*lowest, *highest), "{key}");
                    }
                    other => unreachable!("{key} = {x}: {other}"),
                }
            }
            for x in [*lowest, *highest] {
                let allowed = check(with(table, key, last, x));
                // It may contradict another setting.
                let sound = match &allowed {
                    Ok(()) | Err(SettingsError::Inconsistent { .. }) => true,
                    Err(SettingsError::OutOfRange { key: other, .. }) => other != key,
                    Err(_) => false,
                };
                assert!(sound, "{key} = {x}: {allowed:?}");
            }
        }
    }
}

/// `harsh`, in which every effect is on.
fn harsh() -> Table {
    Table::try_from(Settings::preset("harsh").unwrap()).unwrap()
}

fn settings(table: Table) -> Result<Settings, SettingsError> {
    Settings::default().overridden(table)
}

#[test]
fn every_number_of_the_settings_has_its_range() {
    refused_outside(&harsh(), &RANGES, |table| settings(table).map(|_| ()));
}

#[test]
fn every_number_of_the_cameras_has_its_range() {
    let table = Table::try_from(CameraSettings::paper()).unwrap();
    refused_outside(&table, &CAMERA_RANGES, |table| {
        CameraSettings::default().overridden(table)?.validate()
    });
}

/// What the plant `continuum` reads; robot and sensors are those of the rod's bench.
const CONTINUUM: [&str; 8] = [
    "needle.",
    "tissue.stiffness",
    "tissue.tear",
    "tip.",
    "friction.",
    "motion.",
    "guide.",
    "continuum.",
];

/// The same with the plant `continuum`.
fn ride_continuum(settings: &Settings, seed: u64, name: &str) {
    let setup = default_setup(settings, seed);
    match Bench::continuum(settings, &setup) {
        Ok(bench) => drop(ride_on(bench, &setup, &format!("continuum, {name}"))),
        // A guide.
        Err(e) => assert!(matches!(e, SettingsError::Inconsistent { .. }), "{e}"),
    }
}

fn ride(settings: &Settings, seed: u64, name: &str) -> Bench {
    let setup = default_setup(settings, seed);
    ride_on(Bench::new(settings, &setup).unwrap(), &setup, name)
}

/// In, aside and around, on, and out again; everything seen must be finite.
fn ride_on(mut bench: Bench, setup: &Setup, name: &str) -> Bench {
    bench.attach_marker(&Vector3::new(0.4, 0.0, 0.2));
    let mut pose = *setup.world_from_base.isometry();
    let mut seconds = 0.0;
    for (way, turn, lasting) in [
        ([0.0, 0.0, 0.025], 0.0, 5.0),
        ([3e-3, -2e-3, 0.0], 6.0, 1.0),
        ([0.0, 0.0, 0.010], 0.0, 2.0),
        ([0.0, 0.0, -0.060], -2.0, 3.0),
    ] {
        let steps = 20.0 * lasting;
        let step = Isometry3::new(Vector3::from(way) / steps, Vector3::z() * (turn / steps));
        let end = seconds + lasting;
        while seconds < end - 1e-9 {
            seconds += 0.05;
            pose *= step;
            bench.advance_to(Stamp::from_secs(seconds), &Transform::assume(pose));
            assert!(finite(bench.truth()), "{name}: {:?}", bench.truth());
            if let Some(shape) = hal::ShapeSensor::poll(&mut bench).unwrap() {
                let points = shape.points.iter().map(|p| p.position.coords());
                let tip = [
                    shape.tip.position.coords(),
                    shape.tip.direction.into_inner(),
                ];
                let sound = points.chain(tip).all(|p| p.iter().all(|x| x.is_finite()));
                assert!(sound, "{name}: {shape:?}");
            }
            let marker = bench.poll_marker().map(|m| m.position.coords());
            assert!(marker.is_none_or(|m| m.iter().all(|x| x.is_finite())));
        }
    }
    bench
}

#[test]
fn the_ends_of_every_range_can_be_simulated() {
    for (key, lowest, highest) in RANGES {
        for x in [lowest, highest] {
            let mut tables = [false, true]
                .map(|last| with(&harsh(), key, last, x))
                .to_vec();
            tables.dedup();
            for table in tables {
                match settings(table) {
                    Ok(settings) => {
                        let name = format!("{key} = {x}");
                        ride(&settings, 5, &name);
                        if CONTINUUM.iter().any(|read| key.starts_with(read)) {
                            ride_continuum(&settings, 5, &name);
                        }
                    }
                    Err(e) => assert!(matches!(e, SettingsError::Inconsistent { .. }), "{e}"),
                }
            }
        }
    }
}

#[test]
fn any_mixture_of_allowed_settings_can_be_simulated() {
    for seed in 0..40 {
        let mut dice = Dice(seed);
        let mut table = harsh();
        for (key, lowest, highest) in RANGES {
            let (share, off) = (0.5 * (dice.throw() + 1.0), dice.throw() < 0.0);
            let x = if lowest > 0.0 {
                lowest * (highest / lowest).powf(share)
            } else if off {
                0.0
            } else if lowest == 0.0 {
                highest * 1e-3f64.powf(share)
            } else {
                lowest + share * (highest - lowest)
            };
            // One that contradicts those before it is left as it was.
            let tried = with(&table, key, dice.throw() < 0.0, x);
            if settings(tried.clone()).is_ok() {
                table = tried;
            }
        }
        let settings = settings(table).unwrap();
        let name = format!("{settings:?}");
        ride(&settings, seed, &name);
        if seed < 10 {
            ride_continuum(&settings, seed, &name);
        }
    }
}

#[test]
fn the_ends_of_every_camera_range_can_be_photographed() {
    let shown = ride(&Settings::preset("paper").unwrap(), 2, "paper");
    let needle = &shown.truth().needle;
    let table = Table::try_from(CameraSettings::paper()).unwrap();
    let place = crate::support::standing();
    for (key, lowest, highest) in CAMERA_RANGES {
        for x in [lowest, highest] {
            let changed = with(&table, key, false, x);
            let settings = CameraSettings::default().overridden(changed).unwrap();
            let mut rig = match StereoRig::new(&settings, &place, 3) {
                Ok(rig) => rig,
                Err(RigError::Settings(SettingsError::OutOfRange { key: other, .. })) => {
                    assert_ne!(other, key, "{x}");
                    continue;
                }
                // A fisheye's distortion or too few views: said, not drawn.
                Err(_) => continue,
            };
            rig.expose(needle);
            rig.advance_to(Stamp::from_secs(10.0));
            let pair = rig.poll().unwrap();
            if x < 1.0 || key != "delivery.drop_probability" {
                let image = pair.unwrap().left.image;
                let size = (image.width(), image.height());
                assert_eq!(size, (settings.width_px, settings.height_px));
            }
            for board in phantom::camera::calibration_boards(rig.truth(), 2, 1) {
                // Refused or drawn.
                let _ = rig.board_pair(&board, 0);
            }
        }
    }
}
