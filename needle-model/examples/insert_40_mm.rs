//! Inserts a biopsy needle 40 mm deep without turning it: how far its bevel makes it bend, and how
//! well the equilibrium balances.
//!
//! `cargo run --release -p needle-model --example insert_40_mm`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use nalgebra::{Isometry3, Vector3};
use needle_model::{Bevel, Insertion, InsertionSettings, Needle, Tissue};

/// Forces on a spring that do not balance, at most \[N\]: the solver's last step of up to 10 nm against a
/// spring of 25 N/m (2.5 mm of 1e4 N/m2), with room to spare.
const BALANCED: f64 = 1e-6;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let needle = Needle::biopsy();
    println!(
        "needle: {:.0} mm long, {:.2} mm thick, E I = {:.2e} N m2",
        needle.length() * 1e3,
        needle.outer_diameter() * 1e3,
        needle.bending_stiffness(),
    );
    // World: z into the tissue, whose surface is z = 0. The holder is straight above.
    let tissue = Tissue::uniform(Vector3::zeros(), Vector3::z(), 1e4)?;
    let bevel = Bevel::plane_cut(24_f64.to_radians(), needle.outer_diameter())?;
    let base_at = |depth: f64| Isometry3::translation(0.0, 0.0, depth - needle.length());
    let settings = InsertionSettings::default();
    let mut insertion = Insertion::new(needle, bevel, tissue, settings, &base_at(0.0))?;

    println!("depth [mm]  springs  tip aside [mm]  imbalance [N]");
    for mm in 1..=40 {
        insertion.insert(&base_at(f64::from(mm) * 1e-3), None)?;
        let equilibrium = insertion.equilibrium();
        let residuals = equilibrium.residuals();
        assert!(residuals.shear < BALANCED, "{residuals:?}");
        if mm % 10 == 0 {
            println!(
                "{mm:10}  {:7}  {:14.3}  {:13.1e}",
                equilibrium.springs().len(),
                equilibrium.tip_position().xy().norm() * 1e3,
                residuals.shear,
            );
        }
    }
    let tip = insertion.equilibrium().tip_position();
    // The needle bends in its bevel's direction, -y of the tip.
    println!("tip: x {:.3} mm, y {:.3} mm", tip.x * 1e3, tip.y * 1e3);
    assert!(tip.y < -0.1e-3 && tip.x.abs() < 1e-9);
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}
