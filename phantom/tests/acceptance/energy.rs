//! No energy is created.

use hal::frame::{NeedleBase, World};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use phantom::{Plant, RodPlant, Settings, Wrench};

use crate::support::{Rig, ideal};

/// Work of the base on the needle, by the trapezoidal rule.
struct Meter {
    pose: Isometry3<f64>,
    wrench: Wrench,
    work: f64,
    /// Largest drop of (work - stored energy): energy out of nothing.
    created: f64,
    dissipated: f64,
    peak: f64,
}

impl Meter {
    fn new(rig: &Rig) -> Self {
        let truth = rig.truth();
        Self {
            pose: *truth.world_from_base.isometry(),
            wrench: truth.base_wrench,
            work: 0.0,
            created: 0.0,
            dissipated: -rig.plant.stored_energy(),
            peak: 0.0,
        }
    }

    fn look(&mut self, plant: &RodPlant, base: &hal::Transform<World, NeedleBase>) {
        let (pose, wrench) = (*base.isometry(), plant.truth().base_wrench);
        let way = pose.translation.vector - self.pose.translation.vector;
        let turn = (pose.rotation * self.pose.rotation.inverse()).scaled_axis();
        self.work += 0.5 * (wrench.force + self.wrench.force).dot(&way)
            + 0.5 * (wrench.moment + self.wrench.moment).dot(&turn);
        self.pose = pose;
        self.wrench = wrench;
        let stored = plant.stored_energy();
        self.peak = self.peak.max(stored);
        let dissipated = self.work - stored;
        self.created = self.created.max(self.dissipated - dissipated);
        self.dissipated = self.dissipated.max(dissipated);
    }
}

/// Insert 60 mm, move sideways, turn by 2 rad, move back, withdraw.
fn cycle(settings: &Settings) -> Meter {
    let mut rig = Rig::new(settings, 1);
    let mut meter = Meter::new(&rig);
    let start = rig.pose;
    let mut pose = start;
    let mut go = |pose, seconds, steps| {
        rig.go_with(pose, seconds, steps, |plant, base| meter.look(plant, base));
    };
    pose.translation.vector.z += 0.06;
    go(pose, 60.0, 1200);
    pose.translation.vector.x += 1e-3;
    go(pose, 1.0, 60);
    pose.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.0);
    go(pose, 1.0, 60);
    pose.translation.vector.x -= 1e-3;
    go(pose, 1.0, 60);
    pose.translation.vector.z -= 0.06;
    go(pose, 60.0, 1200);
    meter
}

#[test]
fn an_insert_rotate_withdraw_cycle_creates_no_energy() {
    for (name, changes, tolerance) in [
        // Conservative but for the cut: whatever is created is an error of the simulation.
        ("linear", "tip.cut_angle_deg = 1.75", 0.005),
        (
            "nonlinear, relaxing, slit",
            "tissue = { stiffening = 0.1, relaxed_fraction = 0.2, slit_gap_um = 20 }",
            0.02,
        ),
        // The cut's elastic travel (4 uJ) is not counted as stored but comes back.
        (
            "friction",
            "friction.shaft_n_m = 10\ntip.cutting_n = 0.4",
            0.06,
        ),
    ] {
        let meter = cycle(&ideal(changes));
        println!(
            "{name}: work {:.4} mJ over the cycle, peak stored {:.4} mJ, created at most {:.5} mJ",
            meter.work * 1e3,
            meter.peak * 1e3,
            meter.created * 1e3
        );
        assert!(meter.work > -tolerance * meter.peak, "{name}");
        assert!(meter.created < tolerance * meter.peak, "{name}");
    }
}
