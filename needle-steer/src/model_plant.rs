//! The controller's own model in the place of needle and tissue: what a dry run in air inserts.

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use needle_model::{Insertion, InsertionSettings, RestPoint};
use phantom::{Event, Plant, Truth, Wrench};

use crate::config::Config;
use crate::springs::{SpringsError, insertion};

/// Elements of the centreline; 0.5 mm each for the default needle.
const ELEMENTS: usize = 252;

/// The needle model as a plant: it bends and cuts as the controller believes.
#[derive(Debug)]
pub struct ModelPlant {
    config: Config,
    insertion: Insertion,
    truth: Truth,
}

impl ModelPlant {
    /// The straight needle at `world_from_base`.
    ///
    /// # Errors
    /// The model refuses the configuration or the start.
    pub fn new(
        config: &Config,
        world_from_base: &Transform<World, NeedleBase>,
    ) -> Result<Self, SpringsError> {
        let mut plant = Self {
            config: config.clone(),
            insertion: insertion(config, world_from_base.isometry(), cutting())?,
            truth: straight(config, world_from_base),
        };
        plant.advance(world_from_base, Stamp::ZERO);
        Ok(plant)
    }

    /// Writes the model's state into the truth.
    fn report(&mut self) {
        let needle = self.insertion.equilibrium();
        let spacing = self.config.needle.length_mm * 1e-3 / ELEMENTS as f64;
        let truth = &mut self.truth;
        let view = &mut truth.needle;
        for (i, point) in view.centreline.iter_mut().enumerate() {
            *point = needle.point(spacing * i as f64);
        }
        view.world_from_tip = Transform::assume(needle.world_from_tip());
        view.entry_arc = needle.free_length();
        truth.world_from_base = Transform::assume(*needle.world_from_base());
        let wrench = needle.base_wrench();
        truth.base_wrench = Wrench {
            force: wrench.fixed_rows::<3>(0).into(),
            moment: wrench.fixed_rows::<3>(3).into(),
        };
        truth.entry_force = needle.entry_force();
        truth.entry_stretch = needle.entry_stretch().norm();
        truth.mean_stretch = needle.mean_stretch();
        truth.max_stretch = needle.max_stretch();
        truth.depth = needle.inserted_length();
        truth.cut_path.clear();
        truth
            .cut_path
            .extend(needle.springs().iter().map(|spring| spring.rest));
    }
}

/// No tip is measured: the path is where the model's bevel cuts, at its edge.
fn cutting() -> InsertionSettings {
    InsertionSettings {
        rest_point: RestPoint::CuttingEdge,
        ..InsertionSettings::default()
    }
}

fn straight(config: &Config, world_from_base: &Transform<World, NeedleBase>) -> Truth {
    let needle = &config.needle;
    Truth::straight(
        world_from_base,
        needle.length_mm * 1e-3,
        ELEMENTS,
        needle.outer_diameter_mm * 1e-3,
        needle.bevel_deg.to_radians(),
    )
}

impl Plant for ModelPlant {
    fn advance(&mut self, world_from_base: &Transform<World, NeedleBase>, stamp: Stamp) {
        self.truth.events.clear();
        self.truth.stamp = stamp;
        self.truth.needle.stamp = stamp;
        let before = self.truth.world_from_base.origin().coords();
        // On failure the model stays where it was, and says so.
        if self
            .insertion
            .insert(world_from_base.isometry(), None)
            .is_err()
        {
            let last_step_m = (world_from_base.origin().coords() - before).norm();
            self.truth.events.push(Event::Unconverged {
                last_step_m,
                held: true,
            });
        }
        self.report();
    }

    fn truth(&self) -> &Truth {
        &self.truth
    }

    fn reset(&mut self, world_from_base: &Transform<World, NeedleBase>) {
        // The configuration made a needle before; a start it refuses leaves the old one.
        if let Ok(fresh) = insertion(&self.config, world_from_base.isometry(), cutting()) {
            self.insertion = fresh;
        }
        self.truth = straight(&self.config, world_from_base);
        self.report();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Vector3};

    #[test]
    fn the_model_cuts_towards_its_bevel_and_keeps_its_length() {
        let config = Config::default();
        let start = config.world_from_start_base();
        let at = |depth: f64| Transform::assume(start * Isometry3::translation(0.0, 0.0, depth));
        let mut plant = ModelPlant::new(&config, &at(0.0)).unwrap();
        assert!(plant.truth().depth < 1e-9);
        for k in 1_u32..=400 {
            let k = f64::from(k);
            plant.advance(&at(k * 1e-4), Stamp::from_secs(0.1 * k));
            assert!(
                plant.truth().events.is_empty(),
                "{:?}",
                plant.truth().events
            );
        }
        let truth = plant.truth();
        assert!((truth.depth - 0.04).abs() < 1e-3, "{}", truth.depth);
        // The bevel direction is -y of the needle.
        let tip = start.inverse() * nalgebra::Point3::from(truth.tip());
        assert!(tip.y < -0.3e-3 && tip.x.abs() < 1e-6, "{tip}");
        let length: f64 = truth
            .needle
            .centreline
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).norm())
            .sum();
        assert!((length - 0.126).abs() < 1e-5, "{length}");
        let last: Vector3<f64> = *truth.needle.centreline.last().unwrap();
        assert!((last - truth.tip()).norm() < 1e-9);
        plant.reset(&at(0.0));
        assert!(plant.truth().depth < 1e-9);
    }
}
