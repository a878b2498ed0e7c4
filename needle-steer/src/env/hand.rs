//! A phantom that is moved by hand.

use core::time::Duration;

use hal::frame::{NeedleBase, World};
use hal::{SensedShape, ShapeSensor, Stamp, Transform, Twist};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use phantom::{Bench, Draw, Setup, Truth};

use crate::config::{Config, PlantKind};

/// An invalid move.
#[derive(Debug, thiserror::Error)]
pub enum HandError {
    /// The bench refused it.
    #[error(
        "refused: time must not run backwards, nor be an hour ahead, and a pose must be finite, within \
         100 m; the phantom is at {0:.6} s"
    )]
    Refused(f64),
}

/// The phantom of a configuration, its base in nobody's hand but the caller's. Its fast sensor
/// reports in World.
#[derive(Debug)]
pub struct Hand {
    bench: Bench,
    base: Isometry3<f64>,
    period: f64,
}

impl Hand {
    /// The phantom that `settings` and `seed` say, by the physics of `config`'s plant, the tip on the
    /// surface of its tissue. The springs model is no phantom: its place is taken by the rod.
    ///
    /// # Errors
    /// A setting outside its range, or a place that is no pose.
    pub fn new(
        config: &Config,
        settings: &phantom::Settings,
        seed: u64,
    ) -> Result<Self, phantom::SettingsError> {
        let base = config.world_from_start_base();
        let setup = Setup {
            world_from_phantom: config.world_from_entry(),
            world_from_base: Transform::assume(base),
            left_from_world: Transform::identity(),
            seed,
        };
        Ok(Self {
            bench: match config.run.plant {
                PlantKind::Continuum => Bench::continuum(settings, &setup)?,
                PlantKind::Phantom | PlantKind::Springs => Bench::new(settings, &setup)?,
            },
            base,
            period: settings.sensor.rate_hz.recip(),
        })
    }

    /// Moves the base to `world_from_base`, reached at `now`, on a straight screw.
    ///
    /// # Errors
    /// A time that runs backwards or far ahead, or what is no pose; nothing has changed.
    pub fn advance(
        &mut self,
        world_from_base: &Isometry3<f64>,
        now: Stamp,
    ) -> Result<(), HandError> {
        let pose: Transform<World, NeedleBase> = Transform::assume(*world_from_base);
        self.bench.advance_to(now, &pose);
        if self.bench.refused() {
            return Err(HandError::Refused(self.now().as_secs()));
        }
        self.base = *world_from_base;
        Ok(())
    }

    /// Moves the base by `twist` (of its origin, in World) until the sensor's exposure number
    /// `exposure`.
    ///
    /// # Errors
    /// As [`Hand::advance`].
    pub fn drive(&mut self, twist: &Twist, exposure: u64) -> Result<(), HandError> {
        let now = Stamp::ZERO + Duration::from_secs_f64(exposure as f64 * self.period);
        let dt = now.secs_since(self.now());
        let turn = UnitQuaternion::from_scaled_axis(twist.angular * dt);
        let pose = Isometry3::from_parts(
            Translation3::from(self.base.translation.vector + twist.linear * dt),
            turn * self.base.rotation,
        );
        self.advance(&pose, now)
    }

    /// The newest measurement that has arrived and was not yet returned, in World.
    pub fn sense(&mut self) -> Option<SensedShape> {
        self.bench.poll().ok().flatten()
    }

    /// Pose of the base in World, as it was asked for.
    pub const fn base(&self) -> &Isometry3<f64> {
        &self.base
    }

    /// Its clock.
    pub const fn now(&self) -> Stamp {
        self.bench.now()
    }

    /// Time between two exposures of the sensor \[s\].
    pub const fn period(&self) -> f64 {
        self.period
    }

    /// Ground truth at the last exposure.
    pub fn truth(&self) -> &Truth {
        self.bench.truth()
    }

    /// What chance gave this phantom.
    pub const fn draw(&self) -> &Draw {
        self.bench.draw()
    }
}
