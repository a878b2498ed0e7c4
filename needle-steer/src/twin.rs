//! The same-model column: the controller's own springs model as the plant.
//!
//! A law judged against its own equations scores better than it deserves. The difference to the
//! phantom's column is what the phantom's other physics costs.

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use needle_model::{Bevel, Insertion, InsertionSettings, RestPoint, Tissue};
use phantom::{Draw, Event, Plant, Truth, Wrench};

use crate::config::Config;
use crate::springs::{SpringsError, needle};

/// Distance of the model's start from the surface \[m\]: a flawed robot may hold the tip inside.
const CLEARANCE: f64 = 2e-3;
/// Points of the centre line, as the phantom has them.
const ELEMENTS: usize = 252;

/// A needle of [`needle_model`] in uniform tissue.
#[derive(Debug)]
pub struct TwinPlant {
    fresh: Insertion,
    insertion: Insertion,
    /// Error of the bevel's azimuth in its holder.
    mounting: UnitQuaternion<f64>,
    truth: Truth,
}

impl TwinPlant {
    /// The needle of `config` with what chance gave this run.
    ///
    /// # Errors
    /// The model refuses needle, tissue or start.
    pub fn new(
        config: &Config,
        draw: &Draw,
        nominal_cut_angle: f64,
        world_from_base: &Transform<World, NeedleBase>,
    ) -> Result<Self, SpringsError> {
        let mounting = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), draw.azimuth);
        let start = *world_from_base.isometry() * mounting;
        let outside = start * Isometry3::translation(0.0, 0.0, -CLEARANCE);
        let diameter = config.needle.outer_diameter_mm * 1e-3;
        let bevel = config.needle.bevel_deg.to_radians();
        let mut insertion = Insertion::new(
            needle(config)?,
            Bevel::plane_cut(bevel, diameter)?,
            Tissue::uniform(
                config.entry().coords,
                config.inward().into_inner(),
                draw.stiffness,
            )?,
            InsertionSettings {
                // With this convention eq. (3) bends the needle as far as the paper measured: the
                // aligned miss is 6.3 mm in the median, the phantom's 6.2 mm.
                rest_point: RestPoint::CuttingEdge,
                load_scale: draw.cut_angle / nominal_cut_angle,
                ..InsertionSettings::default()
            },
            &outside,
        )?;
        let fresh = insertion.clone();
        insertion.insert(&start, None)?;
        let length = config.needle.length_mm * 1e-3;
        let mut plant = Self {
            fresh,
            insertion,
            mounting,
            truth: Truth::straight(world_from_base, length, ELEMENTS, diameter, bevel),
        };
        plant.publish(world_from_base, Stamp::ZERO, Vec::new());
        Ok(plant)
    }

    fn publish(
        &mut self,
        world_from_base: &Transform<World, NeedleBase>,
        stamp: Stamp,
        events: Vec<Event>,
    ) {
        let model = self.insertion.equilibrium();
        let t = &mut self.truth;
        let spacing = (model.free_length() + model.inserted_length()) / ELEMENTS as f64;
        t.needle.centreline.clear();
        t.needle
            .centreline
            .extend((0..=ELEMENTS).map(|i| model.point(spacing * i as f64)));
        t.needle.stamp = stamp;
        t.needle.world_from_tip = Transform::assume(model.world_from_tip());
        t.needle.entry_arc = model.free_length();
        t.stamp = stamp;
        t.world_from_base = *world_from_base;
        let wrench = model.base_wrench();
        t.base_wrench = Wrench {
            force: wrench.fixed_rows::<3>(0).into_owned(),
            moment: wrench.fixed_rows::<3>(3).into_owned(),
        };
        t.entry_force = model.entry_force();
        t.entry_stretch = model.entry_stretch().norm();
        t.mean_stretch = model.mean_stretch();
        t.max_stretch = model.max_stretch();
        t.depth = model.inserted_length();
        t.cut_path.clear();
        t.cut_path.extend(model.springs().iter().map(|s| s.rest));
        t.events = events;
    }
}

impl Plant for TwinPlant {
    fn advance(&mut self, world_from_base: &Transform<World, NeedleBase>, stamp: Stamp) {
        let base = *world_from_base.isometry() * self.mounting;
        let events = match self.insertion.insert(&base, None) {
            Ok(()) => Vec::new(),
            // The needle stays where it was.
            Err(_) => vec![Event::Refused],
        };
        self.publish(world_from_base, stamp, events);
    }

    fn truth(&self) -> &Truth {
        &self.truth
    }

    fn reset(&mut self, world_from_base: &Transform<World, NeedleBase>) {
        self.insertion = self.fresh.clone();
        let base = *world_from_base.isometry() * self.mounting;
        let events = match self.insertion.insert(&base, None) {
            Ok(()) => Vec::new(),
            Err(_) => vec![Event::Refused],
        };
        self.publish(world_from_base, Stamp::ZERO, events);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_cuts_towards_its_bevel_and_keeps_its_length() {
        let config = Config::default();
        let settings = phantom::Settings::preset("ideal").unwrap();
        let draw = Draw::new(&settings, 1);
        let nominal = settings.tip.cut_angle_deg.to_radians();
        let start = config.world_from_start_base();
        let at = |depth: f64| Transform::assume(start * Isometry3::translation(0.0, 0.0, depth));
        let mut plant = TwinPlant::new(&config, &draw, nominal, &at(0.0)).unwrap();
        assert!(plant.truth().depth < 1e-9);
        for k in 1_u32..=400 {
            let k = f64::from(k);
            plant.advance(&at(k * 1e-4), Stamp::from_secs(0.1 * k));
            let events = &plant.truth().events;
            assert!(events.is_empty(), "{events:?}");
        }
        let truth = plant.truth();
        assert!((truth.depth - 0.04).abs() < 1e-3, "{}", truth.depth);
        // The bevel direction is -y of the needle.
        let tip = start.inverse() * nalgebra::Point3::from(truth.tip());
        assert!(tip.y < -0.3e-3 && tip.x.abs() < 1e-6, "{tip}");
        let line = &truth.needle.centreline;
        let length: f64 = line.windows(2).map(|p| (p[1] - p[0]).norm()).sum();
        assert!((length - 0.126).abs() < 1e-5, "{length}");
        assert!((line.last().unwrap() - truth.tip()).norm() < 1e-9);
        plant.reset(&at(0.0));
        assert!(plant.truth().depth < 1e-9);
    }
}
