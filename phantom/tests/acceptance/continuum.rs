//! The plant `continuum`: its needle, its tissue and its bevel.

use core::f64::consts::TAU;

use hal::{Stamp, Transform};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use phantom::{ContinuumPlant, Event, Plant, RodPlant, Settings};

use crate::support::{Dice, EI, finite, ideal, standing};

/// Way of O to the surface at the start \[m\]; the edge is ahead of it.
const BACK: f64 = 2e-3;

/// A plant whose base is moved in the phantom frame.
struct Bed<P> {
    plant: P,
    world_from_phantom: Isometry3<f64>,
    pose: Isometry3<f64>,
    seconds: f64,
}

impl<P: Plant> Bed<P> {
    fn new(
        length: f64,
        make: impl FnOnce(&Isometry3<f64>, &Transform<hal::frame::World, hal::frame::NeedleBase>) -> P,
    ) -> Self {
        let world_from_phantom = standing();
        let pose = Isometry3::translation(0.0, 0.0, -length - BACK);
        let plant = make(
            &world_from_phantom,
            &Transform::assume(world_from_phantom * pose),
        );
        Self {
            plant,
            world_from_phantom,
            pose,
            seconds: 0.0,
        }
    }

    fn go(&mut self, step: &Isometry3<f64>) {
        self.pose *= step;
        self.seconds += 0.05;
        self.plant.advance(
            &Transform::assume(self.world_from_phantom * self.pose),
            Stamp::from_secs(self.seconds),
        );
    }

    fn insert(&mut self, way: f64, step: f64) {
        for _ in 0..steps(way.abs() / step) {
            self.go(&Isometry3::translation(0.0, 0.0, step.copysign(way)));
        }
    }

    /// Turns the base about the entry by `degrees`, and answers how far the tip goes aside \[m\].
    fn pivot(&mut self, degrees: f64) -> f64 {
        let before = self.tip().0;
        for _ in 0..40 {
            let turn = Isometry3::rotation(Vector3::y() * (degrees.to_radians() / 40.0));
            let step = self.pose.inverse() * turn * self.pose;
            self.go(&step);
        }
        (self.tip().0 - before).x
    }

    /// The tip and its axis in the phantom frame.
    fn tip(&self) -> (Vector3<f64>, Vector3<f64>) {
        let from_world = self.world_from_phantom.inverse();
        let truth = self.plant.truth();
        (
            (from_world * nalgebra::Point3::from(truth.tip())).coords,
            from_world.rotation * truth.direction(),
        )
    }
}

fn steps(x: f64) -> u32 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a few thousand"
    )]
    let n = x.round() as u32;
    n
}

fn bed(settings: &Settings, seed: u64) -> Bed<ContinuumPlant> {
    Bed::new(settings.needle.length_mm * 1e-3, |phantom, base| {
        ContinuumPlant::new(settings, phantom, base, seed).unwrap()
    })
}

fn cutting(changes: &str) -> Settings {
    ideal(&format!("[tip]\ncutting_n = 0.4\n{changes}"))
}

/// Deflection 80 mm deep \[m\].
fn deflection(settings: &Settings) -> f64 {
    let mut bed = bed(settings, 1);
    bed.insert(0.080, 0.1e-3);
    bed.tip().0.xy().norm()
}

/// The bevel's direction is -y.
#[test]
fn it_steers_to_where_its_bevel_points() {
    let mut bed = bed(&cutting(""), 1);
    bed.insert(0.080, 0.1e-3);
    let (tip, axis) = bed.tip();
    println!("80 mm deep: {:.2} mm aside", -tip.y * 1e3);
    assert!(tip.y < -2e-3 && tip.x.abs() < 1e-6, "{tip}");
    assert!(axis.y < -0.03, "{axis}");
    assert!(bed.plant.truth().events.is_empty());
    let blunt = "[continuum]\nface_pressure_ratio = 0\nedge_offset_ratio = 0";
    let straight = deflection(&cutting(blunt));
    assert!(straight < 1e-9, "{straight}");
}

/// Sharper bevels steer more: with 15, 30, 45 and 60 degrees in gel the deflection fell with the
/// angle, while the force of insertion hardly changed (doi 10.1016/j.jmbbm.2020.103896).
#[test]
fn sharper_bevels_steer_more() {
    let by_angle = [15.0, 30.0, 45.0, 60.0]
        .map(|angle| deflection(&cutting(&format!("[needle]\nbevel_deg = {angle}"))) * 1e3);
    println!("deflection at 15, 30, 45, 60 deg: {by_angle:.2?} mm");
    assert!(
        by_angle.windows(2).all(|w| w[0] > 1.1 * w[1]),
        "{by_angle:?}"
    );
}

/// Stiffer gel presses harder on the bevel: needles bend more in it (Misra et al., IJRR 29(13), 2010).
#[test]
fn stiffer_tissue_bends_it_more() {
    let by_stiffness = [5e3, 1e4, 2e4, 4e4]
        .map(|k| deflection(&cutting(&format!("[tissue]\nstiffness_n_m2 = {k}"))) * 1e3);
    println!("deflection at 5, 10, 20, 40 kN/m2: {by_stiffness:.2?} mm");
    assert!(
        by_stiffness.windows(2).all(|w| w[1] > 1.1 * w[0]),
        "{by_stiffness:?}"
    );
}

/// A tip load P on an elastic foundation whose path follows the tip bends the path by P lambda / EI;
/// the slit beside the axis adds 2 r / lambda^2. A half-space is no such foundation, but near it.
#[test]
fn its_curvature_is_near_that_of_a_load_on_a_foundation() {
    let settings = cutting("");
    let mut bed = bed(&settings, 1);
    let mut slope = [0.0; 2];
    for (slope, way) in slope.iter_mut().zip([0.070 + BACK, 0.030]) {
        bed.insert(way, 0.1e-3);
        *slope = -bed.tip().1.y;
    }
    let found = (slope[1] - slope[0]) / 0.030;
    let radius: f64 = 0.35e-3;
    let load =
        14.0 * 1e4 / 2.46 * core::f64::consts::PI * radius.powi(2) / 24.0_f64.to_radians().tan();
    let wave = (4.0 * EI / 1e4).powf(0.25);
    let expected = load * wave / EI + 2.0 * 0.3 * radius / wave.powi(2);
    println!("curvature {found:.3} 1/m, on a foundation {expected:.3} 1/m");
    assert!((found / expected - 1.0).abs() < 0.3, "{found} {expected}");
}

/// Curvature left at a duty cycle, relative to that without spin: one whole turn in the spinning
/// part of every 3 mm.
fn duty(settings: &Settings, share: f64) -> f64 {
    let mut bed = bed(settings, 1);
    let (step, cycle) = (0.05e-3, 60_u32);
    let spinning = steps(share * f64::from(cycle));
    for i in 0..27 * cycle {
        let spins = i % cycle < spinning;
        let turn = if spins {
            TAU / f64::from(spinning)
        } else {
            0.0
        };
        bed.go(&Isometry3::new(Vector3::z() * step, Vector3::z() * turn));
    }
    bed.tip().0.xy().norm()
}

/// Photographed needles (LARA, Universidade de Brasilia) bend by 1 - (0.604 DC + 0.322): by 0.911,
/// 0.733, 0.555, 0.376 and 0.198 of what they do without spin.
#[test]
fn duty_cycles_leave_what_photographed_needles_keep() {
    let settings = cutting("");
    let free = duty(&settings, 0.0);
    for share in [0.1, 0.3, 0.5, 0.7, 0.9] {
        let left = duty(&settings, share) / free;
        let kept = (1.0 - (0.604 * share + 0.322)) / (1.0 - 0.322);
        println!("duty cycle {share}: {left:.3} left, photographs {kept:.3}");
        assert!((left - kept).abs() < 0.12, "{share}: {left} {kept}");
    }
}

/// The tip is on no path: what it presses on holds it, and drawn back nothing does; the rod's is held.
#[test]
fn its_tip_is_not_held() {
    let settings = cutting("");
    let length = settings.needle.length_mm * 1e-3;
    let mut pressing = bed(&settings, 1);
    pressing.insert(0.020 + BACK, 0.1e-3);
    let mut free = bed(&settings, 1);
    free.insert(0.020 + BACK, 0.1e-3);
    free.insert(-0.003, 0.1e-3);
    let mut held = Bed::new(length, |phantom, base| {
        RodPlant::new(&settings, phantom, base, 1).unwrap()
    });
    held.insert(0.020 + BACK, 0.1e-3);
    let moved = [pressing.pivot(2.0), free.pivot(2.0), held.pivot(2.0)].map(|x| x.abs() * 1e3);
    println!("2 degrees about the entry move the tip by {moved:.4?} mm: pressing, free, the rod's");
    assert!(
        moved[0] > 3.0 * moved[2] && moved[1] > 1.5 * moved[0],
        "{moved:?}"
    );
}

/// The surface is pressed in until it breaks; then the base pushes against cutting and friction.
#[test]
fn it_presses_before_it_cuts() {
    let settings =
        cutting("[continuum]\npuncture_n = 0.8\nindent_n_m = 400\n[friction]\nshaft_n_m = 10");
    let mut bed = bed(&settings, 1);
    let push = |bed: &Bed<ContinuumPlant>| {
        let truth = bed.plant.truth();
        truth
            .world_from_base
            .rotate(&Vector3::z())
            .dot(&truth.base_wrench.force)
    };
    let (mut most, mut broken, mut way) = (0.0_f64, None, 0.0);
    while way < 0.050 + BACK - 1e-9 {
        bed.insert(0.05e-3, 0.05e-3);
        way += 0.05e-3;
        let entered = |e: &Event| matches!(e, Event::Entered { .. });
        if bed.plant.truth().events.iter().any(entered) {
            assert!(broken.replace(way).is_none());
        }
        if broken.is_none() {
            most = most.max(push(&bed));
        }
    }
    // The edge, ahead of O, met the surface before.
    let bevel = 0.7e-3 / 24.0_f64.to_radians().tan();
    let dent = broken.unwrap() - (BACK - bevel);
    let force = push(&bed);
    println!(
        "breaks {:.2} mm deep at {most:.3} N; 50 mm deep {force:.3} N",
        dent * 1e3
    );
    // In steps of 20 mN, the force of the step before.
    assert!((most - 0.8).abs() < 0.045, "{most}");
    assert!((dent - 2e-3).abs() < 0.11e-3, "{dent}");
    let expected = 0.4 + 10.0 * (0.050 + bevel);
    assert!((force / expected - 1.0).abs() < 0.01, "{force} {expected}");
}

/// Between holder and tissue nothing acts on the shaft: its bending there is that of the holder's
/// force and moment. The tissue's force across it at the entry is the same force.
#[test]
fn its_forces_balance() {
    let mut bed = bed(&cutting("[friction]\nshaft_n_m = 10"), 1);
    bed.insert(0.040 + BACK, 0.1e-3);
    bed.pivot(1.5);
    for _ in 0..40 {
        bed.go(&Isometry3::translation(0.1e-3, 0.05e-3, 0.0));
    }
    let truth = bed.plant.truth();
    let wrench = truth.base_wrench;
    let line = &truth.needle.centreline;
    let spacing = 0.126 / 252.0;
    for at in [40, 80, 120_usize] {
        let reach = 12;
        let [a, b, c] = [at - reach, at, at + reach].map(|i| line[i]);
        let h = spacing * reach as f64;
        let bent = (c - a).normalize().cross(&((c - b * 2.0 + a) / (h * h))) * EI;
        let held = wrench.moment + (line[0] - b).cross(&wrench.force);
        println!(
            "bent by {:.4} N mm, held by {:.4}",
            bent.norm() * 1e3,
            held.norm() * 1e3
        );
        assert!(
            (held + bent).norm() < 0.03 * wrench.moment.norm(),
            "{bent} {held}"
        );
    }
    assert!(wrench.moment.norm() > 1e-4);
    let lost = (wrench.force + truth.entry_force).norm();
    let push = truth
        .world_from_base
        .rotate(&Vector3::z())
        .dot(&wrench.force);
    assert!((lost / push - 1.0).abs() < 0.01, "{lost} {push}");
}

/// Round and back along a hole that is there, without friction, nothing is gained: the work of the
/// base is what is stored.
#[test]
fn a_way_round_gains_no_energy() {
    let settings = ideal("[continuum]\nindent_n_m = 5e4");
    let mut bed = bed(&settings, 1);
    bed.insert(0.040 + BACK, 0.1e-3);
    bed.insert(-0.003, 0.1e-3);
    let start = bed.plant.stored_energy();
    let (mut work, mut most) = (0.0, 0.0_f64);
    for (aside, along) in [
        (6.0, 0.0),
        (0.0, -10.0),
        (-12.0, 0.0),
        (0.0, 10.0),
        (6.0, 0.0),
    ] {
        for _ in 0..200 {
            let step = Vector3::new(aside, 0.0, along) * (1e-3 / 200.0);
            let before = bed.plant.truth().base_wrench.force;
            bed.go(&Isometry3::translation(step.x, step.y, step.z));
            let after = bed.plant.truth().base_wrench.force;
            let way = bed.world_from_phantom.rotation * step;
            work += 0.5 * (before + after).dot(&way);
            most = most.max(bed.plant.stored_energy());
        }
    }
    let gained = bed.plant.stored_energy() - start;
    println!(
        "work {:.3} uJ, stored in the end {:.3} uJ, at most {:.3} uJ",
        work * 1e6,
        gained * 1e6,
        most * 1e6
    );
    assert!(most > 100e-6, "{most}");
    assert!(
        (work - gained).abs() < 0.02 * most,
        "{work} {gained} {most}"
    );
}

/// Beyond the threshold of the tissue the path moves, so that nothing is stretched farther.
#[test]
fn tissue_tears_where_it_is_stretched_too_far() {
    let settings = cutting("[tissue]\ntear_mm = 1.0");
    let mut bed = bed(&settings, 1);
    bed.insert(0.040 + BACK, 0.1e-3);
    assert!(bed.plant.truth().max_stretch < 1e-3);
    let mut torn = false;
    for _ in 0..100 {
        bed.go(&Isometry3::translation(0.05e-3, 0.0, 0.0));
        torn |= bed
            .plant
            .truth()
            .events
            .iter()
            .any(|e| matches!(e, Event::Tearing { .. }));
        assert!(bed.plant.truth().max_stretch < 1.05e-3);
    }
    assert!(torn);
    let entry =
        bed.world_from_phantom.inverse() * nalgebra::Point3::from(bed.plant.truth().cut_path[0]);
    assert!(entry.x > 1e-4, "{entry}");
}

#[test]
fn it_is_deterministic_and_hardly_depends_on_the_step() {
    for preset in ["paper", "harsh"] {
        let settings = Settings::preset(preset).unwrap();
        let run = |step: f64| {
            let mut bed = bed(&settings, 3);
            bed.seconds = 0.0;
            for _ in 0..steps(0.060 / step) {
                bed.pose *= Isometry3::translation(0.0, 0.0, step);
                bed.seconds += step / 1e-3;
                bed.plant.advance(
                    &Transform::assume(bed.world_from_phantom * bed.pose),
                    Stamp::from_secs(bed.seconds),
                );
                let bad = |e: &Event| matches!(e, Event::Unconverged { .. } | Event::Buckling);
                let events = &bed.plant.truth().events;
                assert!(!events.iter().any(bad), "{preset}: {events:?}");
            }
            bed.plant.truth().clone()
        };
        assert_eq!(run(0.1e-3), run(0.1e-3));
        let [coarse, fine] = [0.1e-3, 0.025e-3].map(|step| run(step).tip());
        let apart = (coarse - fine).norm();
        println!(
            "{preset}: a quarter of the step moves the tip by {:.1} um",
            apart * 1e6
        );
        assert!(apart < 30e-6, "{preset}: {apart}");
    }
}

/// The tip of a pulled-out needle is where its base is; it enters anew through another hole.
#[test]
fn it_comes_out_and_enters_anew() {
    let mut bed = bed(&Settings::preset("paper").unwrap(), 2);
    bed.insert(0.020, 0.1e-3);
    let mut left = false;
    for _ in 0..300 {
        bed.insert(-0.1e-3, 0.1e-3);
        left |= bed.plant.truth().events.contains(&Event::PulledOut);
    }
    assert!(left);
    let truth = bed.plant.truth();
    assert!(truth.cut_path.is_empty() && truth.depth < 1e-12 && truth.max_stretch < 1e-12);
    assert!(bed.tip().0.xy().norm() < 1e-9, "{}", bed.tip().0);
    bed.insert(0.030, 0.1e-3);
    assert!(bed.plant.truth().depth > 5e-3);
}

#[test]
fn nasty_motions_stay_finite() {
    for seed in 0..6 {
        let mut dice = Dice(seed);
        let mut bed = bed(&Settings::preset("harsh").unwrap(), seed);
        bed.insert(0.020, 0.1e-3);
        for _ in 0..150 {
            let way = Vector3::new(dice.throw(), dice.throw(), dice.throw()) * 1e-3;
            let turn = Vector3::new(dice.throw(), dice.throw(), 20.0 * dice.throw()) * 0.01;
            bed.go(&Isometry3::new(way, turn));
            assert!(finite(bed.plant.truth()), "{seed}: {:?}", bed.plant.truth());
        }
        bed.insert(-0.060, 0.1e-3);
        assert!(finite(bed.plant.truth()));
        let before = bed.plant.truth().tip();
        for turned in [f64::NAN, 2.0] {
            let mut leap = bed.pose;
            leap.rotation *= UnitQuaternion::from_scaled_axis(Vector3::x() * turned);
            bed.plant.advance(
                &Transform::assume(bed.world_from_phantom * leap),
                Stamp::from_secs(1e3),
            );
            assert_eq!(bed.plant.truth().events, [Event::Refused]);
            assert_eq!(bed.plant.truth().tip(), before);
        }
    }
}

/// What it cannot be is refused by name.
#[test]
fn a_guide_and_a_needle_that_points_away_are_refused() {
    let place = standing();
    let upright = Isometry3::translation(0.0, 0.0, -0.13);
    let away = upright * UnitQuaternion::from_scaled_axis(Vector3::x() * 1.6);
    let guided = ideal("[guide]\ngap_mm = 30");
    for (settings, base, key) in [
        (&guided, upright, "guide.gap_mm"),
        (&ideal(""), away, "world_from_base"),
    ] {
        let base = Transform::assume(place * base);
        let error = ContinuumPlant::new(settings, &place, &base, 1).unwrap_err();
        assert!(error.to_string().starts_with(key), "{error}");
    }
}
