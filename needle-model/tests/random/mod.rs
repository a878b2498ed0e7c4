//! Random needles in equilibrium: bent paths, moved and tilted bases, stiff and soft tissue.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use needle_model::{Needle, Spring, TipLoad};
use proptest::prelude::*;

/// What an equilibrium is made of.
#[derive(Debug, Clone)]
pub(crate) struct State {
    pub(crate) needle: Needle,
    pub(crate) base: Isometry3<f64>,
    pub(crate) springs: Vec<Spring>,
    pub(crate) load: TipLoad,
}

/// A needle that has cut a curved, twisted path from a surface somewhere, the base since moved
/// sideways by up to 6 mm, tilted by up to 6 degrees, turned and retracted.
pub(crate) fn state() -> impl Strategy<Value = State> {
    let path = (0_usize..=24, -3.0..3.0, -3.0..3.0, -2.0..2.0);
    let base = (-6e-3..6e-3, -6e-3..6e-3, -0.1..0.1, -0.1..0.1, -3.0..3.0);
    let world = (-3.0..3.0, -1.5..1.5, -3.0..3.0);
    let tissue = (3.3..5.3, -0.02..0.02, 0.1e-3..2.4e-3);
    (path, base, world, tissue).prop_map(|(path, base, world, tissue)| {
        let needle = Needle::biopsy();
        let pitch = 2.5e-3;
        let (count, bend_x, bend_y, twist) = path;
        let inserted = pitch * count.saturating_sub(1) as f64 + tissue.2;
        // 2 mm spare: a base moved sideways by centimetres takes up to that much length.
        let free = needle.length() - 2e-3 - if count == 0 { 0.0 } else { inserted };
        let k_t = 10_f64.powf(tissue.0);
        let world = Isometry3::from_parts(
            Translation3::new(0.3, -0.1, 0.4),
            UnitQuaternion::from_euler_angles(world.0, world.1, world.2),
        );
        let springs = (0..count)
            .map(|i| {
                let s = pitch * i as f64;
                let curve = Vector3::new(
                    bend_x * s * s / 2.0 + twist * 20.0 * s * s * s,
                    bend_y * s * s / 2.0 - twist * 25.0 * s * s * s,
                    s,
                );
                let stiffness = k_t
                    * pitch
                    * if i + 1 == count {
                        0.5 + tissue.2 / pitch
                    } else {
                        1.0
                    };
                Spring {
                    rest: (world * Point3::from(curve)).coords,
                    stiffness,
                }
            })
            .collect();
        let local = Isometry3::from_parts(
            Translation3::new(base.0, base.1, -free),
            UnitQuaternion::from_euler_angles(base.2, base.3, 0.0)
                * UnitQuaternion::from_euler_angles(0.0, 0.0, base.4),
        );
        let load = TipLoad {
            force: tissue.1,
            bending: tissue.1 * 3e-4,
        };
        State {
            needle,
            base: world * local,
            springs,
            load,
        }
    })
}
