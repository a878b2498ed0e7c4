//! One insertion: plant, sensor with latency and drops, estimator, law, in lockstep.

use std::collections::VecDeque;

use hal::Stamp;
use hybrid_control::{
    Entry, Estimator, EstimatorSettings, LawSettings, Limits, Observation, RollTravel, Springs,
    Start, Target, View, law_by_name, target_ahead,
};
use nalgebra::{
    Isometry3, Matrix6, Point3, RowVector6, Unit, UnitQuaternion, Vector2, Vector3, Vector6,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::plant::{Plant, World};
use crate::rod::{self, Bed, LENGTH};

const CONTROL_DT: f64 = 1.0 / 30.0;
const SUBSTEPS: usize = 3;
const RANGE: f64 = 2.0 * core::f64::consts::PI;

pub(crate) struct Outcome {
    /// Distance of the target from the true tip axis when O passes it \[m\].
    pub(crate) error: f64,
    pub(crate) mean_stretch: f64,
    pub(crate) max_stretch: f64,
    pub(crate) duration: f64,
    pub(crate) base_tilt: f64,
    pub(crate) base_shift: f64,
    pub(crate) ended: &'static str,
}

pub(crate) struct Case<'a> {
    pub(crate) law: &'a str,
    pub(crate) world: World,
    /// Lateral offset of the target in the phantom frame \[m\].
    pub(crate) offset: Vector2<f64>,
    pub(crate) laws: &'a LawSettings,
    pub(crate) estimator: &'a EstimatorSettings,
    pub(crate) trace: bool,
}

struct Reading {
    stamp: f64,
    base: Isometry3<f64>,
    tip: Point3<f64>,
    axis: Vector3<f64>,
    shaft: Vec<(Point3<f64>, f64)>,
}

fn noise(rng: &mut ChaCha8Rng, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| {
        let x: f64 = StandardNormal.sample(rng);
        x * sigma
    })
}

/// The springs model's view, from a free-tip rod of the tests on the estimator's path.
fn springs(plant: &Plant, base: &Isometry3<f64>, stiffness: f64) -> Springs {
    let frame = plant.world_from_phantom;
    let solve = |pose: &Isometry3<f64>| {
        let b = frame.inverse() * pose;
        let axis = b.rotation * Vector3::z();
        let slope = Vector2::new(axis.x / axis.z, axis.y / axis.z);
        let o = b.translation.vector;
        let depth = (o.z + LENGTH).max(1e-3);
        let path = |z: f64| plant.path(z);
        let bed = Bed {
            stiffness: &|_| stiffness,
            path: &path,
            axial: 0.0,
            free_tip_force: Some(Vector2::zeros()),
        };
        let s = rod::equilibrium(o.z, depth, o.xy(), slope, &bed);
        let (mut sum, mut n) = (0.0, 0.0);
        for (z, w) in s.z.iter().zip(&s.w) {
            if *z >= 0.0 {
                sum += (w - plant.path(*z)).norm();
                n += 1.0;
            }
        }
        let tip = frame * Point3::new(s.tip().x, s.tip().y, depth);
        let t = s.tip_slope();
        let axis = frame.rotation * Vector3::new(t.x, t.y, 1.0);
        let bend =
            UnitQuaternion::rotation_between(&(pose.rotation * Vector3::z()), &axis).unwrap();
        (
            Isometry3::from_parts(tip.coords.into(), bend * pose.rotation),
            sum / f64::max(n, 1.0),
        )
    };
    let (world_from_tip, mean_stretch) = solve(base);
    let mut j = Matrix6::zeros();
    let mut j_d = RowVector6::zeros();
    let h = 1e-5;
    for k in 0..6 {
        let mut v = Vector6::zeros();
        v[k] = 1.0;
        let (tip, d) = solve(&hal::Twist::from_vector(&v).integrate(base, h));
        let dv = (tip.translation.vector - world_from_tip.translation.vector) / h;
        let dw = (tip.rotation * world_from_tip.rotation.inverse()).scaled_axis() / h;
        j.fixed_view_mut::<3, 1>(0, k).copy_from(&dv);
        j.fixed_view_mut::<3, 1>(3, k).copy_from(&dw);
        j_d[k] = (d - mean_stretch) / h;
    }
    Springs {
        world_from_tip,
        j_tip_base: j,
        mean_stretch,
        j_mean_stretch: j_d,
        entry_stretch: 0.0,
        entry_force: 0.0,
    }
}

pub(crate) fn insert(case: &Case<'_>) -> Outcome {
    let mut plant = Plant::new(&case.world);
    let mut rng = ChaCha8Rng::seed_from_u64(case.world.seed ^ 0x5eed);
    let mut law = law_by_name(case.law, case.laws).unwrap();
    let limits = Limits::default();
    let frame = plant.world_from_phantom;
    let mut base = plant.start();
    let entry = Entry {
        point: frame.translation.vector.into(),
        inward: Unit::new_normalize(frame.rotation * Vector3::z()),
    };
    let start = Start {
        length: LENGTH,
        bending_stiffness: rod::EI,
        // On the study plant the tip itself cuts.
        cutting_edge: 0.0,
        guide_gap: None,
        tip_sensor: None,
        advance_by_tip: false,
        entry,
        world_from_base: base,
    };
    let mut estimator = Estimator::new(case.estimator, &start).unwrap();
    let mut queue: VecDeque<Reading> = VecDeque::new();
    let (mut time, mut roll) = (0.0, 0.0);
    let pre = 2e-3 + 6e-3 * rng.random::<f64>();
    let mut target: Option<Point3<f64>> = None;
    let (mut tilt_most, mut shift_most) = (0.0_f64, 0.0_f64);
    let mut ended = "timeout";
    let needs_springs = matches!(case.law, "paper" | "paper-verbatim" | "base-only");
    while time < 400.0 {
        // World and sensor.
        plant.step(&base);
        let (tip, axis) = plant.true_tip();
        let sigma = 0.05e-3 * case.world.noise;
        let direction_sigma = 0.1_f64.to_radians() * case.world.noise;
        if rng.random::<f64>() >= case.world.drops {
            let shaft = plant
                .visible()
                .into_iter()
                .map(|p| (p + noise(&mut rng, sigma), sigma))
                .collect();
            let axis = (axis + noise(&mut rng, direction_sigma)).normalize();
            queue.push_back(Reading {
                stamp: time,
                base,
                tip: tip + noise(&mut rng, sigma),
                axis,
                shaft,
            });
        }
        while queue
            .front()
            .is_some_and(|r| r.stamp + case.world.latency <= time + 1e-9)
        {
            let r = queue.pop_front().unwrap();
            estimator.observe(&Observation {
                stamp: Stamp::from_secs(r.stamp),
                world_from_base: r.base,
                position: r.tip,
                position_sigma: sigma,
                direction: Unit::new_normalize(r.axis),
                direction_sigma,
                shaft: &r.shaft,
                carried: false,
            });
        }
        let now = Stamp::from_secs(time);
        let filtered = estimator.predict(now, &base);
        if target.is_none() && plant.depth >= pre {
            // On the holder's nominal z through O, 80 mm ahead of it.
            let local = frame.inverse() * tip;
            target = Some(
                frame
                    * Point3::new(
                        local.x + case.offset.x,
                        local.y + case.offset.y,
                        local.z + 80e-3,
                    ),
            );
            law.reset();
        }
        let twist = if let Some(goal) = target {
            let mut true_pose = Isometry3::translation(tip.x, tip.y, tip.z);
            true_pose.rotation =
                UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap_or(frame.rotation);
            if target_ahead(&true_pose, &goal) <= 0.0 {
                ended = "target passed";
                break;
            }
            let view = View {
                time: now,
                dt: CONTROL_DT,
                tip: filtered,
                target: Target {
                    position: goal,
                    velocity: Vector3::zeros(),
                },
                entry,
                depth: plant.depth,
                world_from_base: base,
                springs: needs_springs.then(|| springs(&plant, &base, estimator.stiffness().0)),
                shape: &[],
                estimator: &estimator,
                roll_travel: RollTravel {
                    positive: RANGE - roll,
                    negative: RANGE + roll,
                },
                freedom: hybrid_control::Freedom::full(),
                limits: &limits,
                insertion_speed: 1e-3,
            };
            let decision = law.decide(&view);
            if case.trace && ((time * 30.0).round() as u64).is_multiple_of(60) {
                let r = &decision.report;
                let m = r.predicted_miss * 1e3;
                println!(
                    "t {time:5.1} z {:5.1} err {:6.3} miss {:6.2} {:6.2} short {:6.2} A {:6.3} G {:5.2} mode {:?} K {:6.0} g {:5.2} az {:5.1} b {:5.2} est {:6.3} stretch {:5.2} {:?}",
                    plant.depth * 1e3,
                    hybrid_control::lateral_error(&true_pose, &goal) * 1e3,
                    m.x,
                    m.y,
                    r.shortfall * 1e3,
                    r.base_authority * 1.745e1,
                    r.bevel_authority * 1e3,
                    r.mode,
                    estimator.stiffness().0,
                    estimator.natural_curvature(),
                    estimator.bevel_azimuth().to_degrees(),
                    estimator.disturbance().norm().to_degrees(),
                    (filtered.world_from_tip.translation.vector - tip.coords).norm() * 1e3,
                    plant.last_stretch * 1e3,
                    r.limits
                );
            }
            decision.twist
        } else {
            hal::Twist {
                linear: base.rotation * Vector3::z() * 1e-3,
                angular: Vector3::zeros(),
            }
        };
        let z = base.rotation * Vector3::z();
        roll += twist.angular.dot(&z) * CONTROL_DT;
        assert!(
            roll.abs() <= RANGE + 1e-9,
            "{} leaves the roll's travel",
            case.law
        );
        assert!(twist.is_finite());
        for _ in 0..SUBSTEPS {
            base = twist.integrate(&base, CONTROL_DT / SUBSTEPS as f64);
            if z.dot(&entry.inward) > 0.0 {
                plant.step(&base);
            }
        }
        time += CONTROL_DT;
        let local = frame.inverse() * base;
        tilt_most = tilt_most.max((local.rotation * Vector3::z()).angle(&Vector3::z()));
        shift_most = shift_most.max(local.translation.vector.xy().norm());
    }
    let (tip, axis) = plant.true_tip();
    let away = target.map_or(Vector3::zeros(), |t| t - tip);
    Outcome {
        error: (away - axis * axis.dot(&away)).norm(),
        mean_stretch: plant.mean_stretch(),
        max_stretch: plant.max_stretch,
        duration: time,
        base_tilt: tilt_most,
        base_shift: shift_most,
        ended,
    }
}
