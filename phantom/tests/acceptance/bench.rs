//! Bench: sensor, robot flaws, second plants.

use hal::frame::{NeedleBase, World};
use hal::{SensedShape, ShapeSensor, Stamp, Transform};
use nalgebra::{Isometry3, Vector3};
use phantom::experiment::{Passing, default_setup};
use phantom::{Bench, Plant, Settings, SettingsError, Truth};

use crate::support::ideal;

/// Inserts at 1 mm/s with a call every `period` \[s\]; every delivered shape with its arrival.
fn insert(bench: &mut Bench, seconds: f64, period: f64) -> Vec<(Stamp, SensedShape)> {
    let base = default_setup(&Settings::default(), 1).world_from_base;
    let mut shapes = Vec::new();
    let mut now = 0.0;
    while now < seconds - 1e-9 {
        now = (now + period).min(seconds);
        let way = Isometry3::translation(0.0, 0.0, now * 1e-3);
        let pose = Transform::assume(base.isometry() * way);
        bench.advance_to(Stamp::from_secs(now), &pose);
        let shape = ShapeSensor::poll(bench).unwrap();
        shapes.extend(shape.map(|s| (bench.now(), s)));
    }
    shapes
}

fn bench(settings: &Settings, seed: u64) -> Bench {
    Bench::new(settings, &default_setup(settings, seed)).unwrap()
}

#[test]
fn without_flaws_the_sensor_tells_the_truth() {
    let settings = ideal("");
    let mut bench = bench(&settings, 1);
    let shapes = insert(&mut bench, 30.0, 1.0 / 30.0);
    let (_, shape) = shapes.last().unwrap();
    let truth = bench.truth();
    assert_eq!(shape.stamp, truth.stamp);
    let left = default_setup(&settings, 1).left_from_world;
    let expected = left * truth.needle.world_from_tip.origin();
    assert!((shape.tip.position.coords() - expected.coords()).norm() < 1e-12);
    let axis = left.rotate(&truth.direction());
    assert!((shape.tip.direction.into_inner() - axis).norm() < 1e-12);
    // 30 mm of shaft, from the surface on, every 2.5 mm, O apart.
    assert!(
        (12..=13).contains(&shape.points.len()),
        "{}",
        shape.points.len()
    );
    for pair in shape.points.windows(2) {
        let gap = (pair[1].position.coords() - pair[0].position.coords()).norm();
        assert!((gap - 2.5e-3).abs() < 1e-8, "{gap}");
    }
}

#[test]
fn noise_latency_and_drops_are_as_set() {
    let settings = ideal(
        "sensor = { latency_ms = 50, drop_fraction = 0.1, noise_mm = 0.05, direction_noise_deg = 0.1 }",
    );
    let mut noisy = bench(&settings, 4);
    let mut clear = bench(&ideal(""), 4);
    let shapes = insert(&mut noisy, 60.0, 0.005);
    let truths = insert(&mut clear, 60.0, 1.0 / 30.0);
    let mut sums = [0.0; 2];
    let mut count = 0.0;
    for (arrival, shape) in &shapes {
        let delay = arrival.secs_since(shape.stamp);
        assert!((0.05..0.0551).contains(&delay), "{delay}");
        let Some((_, truth)) = truths.iter().find(|(_, t)| t.sequence == shape.sequence) else {
            continue;
        };
        count += 1.0;
        let off = shape.tip.position.coords() - truth.tip.position.coords();
        sums[0] += off.norm_squared() / 3.0;
        let turn = shape.tip.direction.into_inner() - truth.tip.direction.into_inner();
        sums[1] += turn.norm_squared() / 2.0;
    }
    let [position, angle] = sums.map(|s: f64| (s / count).sqrt());
    // 1600 shapes: 1.4 % standard error of a sigma per axis; five of them.
    assert!((position / 0.05e-3 - 1.0).abs() < 0.05, "{position}");
    assert!((angle / 0.1f64.to_radians() - 1.0).abs() < 0.07, "{angle}");
    let expected = 0.9 * 1800.0;
    assert!(
        (count - expected).abs() < 5.0 * (1800.0f64 * 0.09).sqrt(),
        "{count}"
    );
}

#[test]
fn the_bias_is_constant_through_a_run_and_differs_between_runs() {
    let settings = ideal("sensor.bias_mm = 0.15");
    let bias = |seed| {
        let shapes = insert(&mut bench(&settings, seed), 2.0, 0.1);
        let truths = insert(&mut bench(&ideal(""), seed), 2.0, 0.1);
        let offs: Vec<_> = shapes
            .iter()
            .zip(&truths)
            .map(|(a, b)| a.1.tip.position.coords() - b.1.tip.position.coords())
            .collect();
        assert!(offs.iter().all(|o| (o - offs[0]).norm() < 1e-12));
        offs[0]
    };
    assert!((bias(1) - bias(2)).norm() > 1e-6);
    let mean_square: f64 = (1..=60).map(|s| bias(s).norm_squared() / 3.0).sum::<f64>() / 60.0;
    // 180 numbers: 5 % standard error.
    assert!(
        (mean_square.sqrt() / 0.15e-3 - 1.0).abs() < 0.2,
        "{mean_square}"
    );
}

#[test]
fn the_period_of_the_calls_does_not_matter() {
    let settings = Settings::preset("paper").unwrap();
    let tip = |period| {
        let mut bench = bench(&settings, 2);
        insert(&mut bench, 20.0, period);
        bench.truth().tip()
    };
    // Servo lag is exact for a steady motion; poses at the exposures differ by rounding.
    let gap = (tip(0.016) - tip(1.0 / 30.0)).norm();
    assert!(gap < 1e-9, "{gap}");
}

#[test]
fn tilt_turns_the_insertion_with_the_needle() {
    let settings = ideal("spread.tilt_deg = 0.5\ntip.cut_angle_deg = 0");
    let mut bench = bench(&settings, 3);
    insert(&mut bench, 40.0, 0.1);
    let draw = *bench.draw();
    let truth = bench.truth();
    let tilt = draw.tilt[0].hypot(draw.tilt[1]);
    let down = -Vector3::z();
    assert!((truth.direction().angle(&down) - tilt).abs() < 1e-6);
    // Nothing pushes sideways: the tissue is not stretched.
    assert!(truth.max_stretch < 1e-6, "{}", truth.max_stretch);
    let start = Vector3::new(0.4, 0.0, 0.25);
    let way = truth.tip() - start;
    assert!((way.norm() - 0.04).abs() < 1e-6 && way.angle(&truth.direction()) < 1e-6);
}

#[test]
fn mounting_and_kinematic_errors_move_the_needle_as_set() {
    let settings = ideal(
        "robot = { kinematic_mm = 0.2, kinematic_deg = 0.08, holder_offset_mm = 0.1, holder_tilt_deg = 0.1 }",
    );
    let nominal = *default_setup(&settings, 1).world_from_base.isometry();
    let mut squares = [0.0; 2];
    let runs = 60u32;
    for seed in 1..=u64::from(runs) {
        let bench = bench(&settings, seed);
        let actual = bench.truth().world_from_base;
        let error = nominal.inverse() * actual.isometry();
        squares[0] += error.translation.vector.z.powi(2) / f64::from(runs);
        squares[1] += error.rotation.scaled_axis().x.powi(2) / f64::from(runs);
    }
    let [along, turn] = squares.map(f64::sqrt);
    // Along the needle only the kinematic error acts; sigma 0.2 mm, sixty runs: 9 %.
    assert!((along / 0.2e-3 - 1.0).abs() < 0.3, "{along}");
    let expected = 0.08f64.hypot(0.1).to_radians();
    assert!((turn / expected - 1.0).abs() < 0.3, "{turn}");
}

/// A rigid needle without tissue: the simplest second plant.
struct Rigid(Truth);

impl Plant for Rigid {
    fn advance(&mut self, world_from_base: &Transform<World, NeedleBase>, stamp: Stamp) {
        self.reset(world_from_base);
        self.0.stamp = stamp;
        self.0.needle.stamp = stamp;
    }

    fn truth(&self) -> &Truth {
        &self.0
    }

    fn reset(&mut self, world_from_base: &Transform<World, NeedleBase>) {
        self.0 = Truth::straight(world_from_base, 0.126, 50, 0.7e-3, 24f64.to_radians());
    }
}

#[test]
fn another_plant_stands_behind_the_trait() {
    let settings = ideal("");
    let setup = default_setup(&settings, 1);
    let mut bench = Bench::with_plant(&settings, &setup, |base| -> Result<_, SettingsError> {
        let plant: Box<dyn Plant> = Box::new(Rigid(Truth::straight(
            base,
            0.126,
            50,
            0.7e-3,
            24f64.to_radians(),
        )));
        Ok(plant)
    })
    .unwrap();
    let target = Vector3::new(0.401, 0.0, 0.2405);
    let mut passing = Passing::new(target);
    assert_eq!(passing.observe(bench.truth()), None);
    assert!(!insert(&mut bench, 10.0, 0.1).is_empty());
    // The rigid needle passes one millimetre beside it.
    assert!((passing.observe(bench.truth()).unwrap() - 1e-3).abs() < 1e-9);
}
