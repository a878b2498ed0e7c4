//! Fibre Bragg gratings as a sensor of the needle's shape: shifts of wavelengths to curvature
//! ([`Calibration`]), curvature to shape ([`FibreShape`]), placed at the base's pose by the encoders.
//!
//! The shape hangs on the base: what arm and holder err by, the fibres cannot see. Everything behind
//! `Fibres` takes what comes of it for a shape as any other sensor's.

mod calibration;
mod file;
mod shape;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use hal::frame::{ArmBase, LeftCamera, World};
use hal::{
    Arm, ArmDescription, ArmState, Error, FibreSensor, Position, RateCommand, SensedPoint,
    SensedShape, SensedTip, ShapeSensor, Stamp, Transform, WavelengthShifts,
};
use nalgebra::{Isometry3, Matrix3, Point3, Unit, Vector3};
use robots::kinematics::Chain;

pub use calibration::{Area, Calibration};
pub use shape::{Bent, FibreShape};

use crate::config::Config;
use crate::odometry::Odometry;

/// Poses kept: more than a second at any arm's rate.
const POSES: usize = 256;
/// Time over which the needle's spin is told \[s\]: a few periods of an arm.
const SPIN: f64 = 0.05;
/// Standard deviation of the tip along its axis \[m\]: a needle does not get longer, and how far it is bent is
/// known to a few hundredths of a millimetre of its shortening.
const ALONG: f64 = 0.1e-3;

/// Fibres that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FibreError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is no JSON.
    #[error("{}: not JSON: {problem}", file.display())]
    Text {
        /// The file.
        file: PathBuf,
        /// What is wrong, with line and column.
        problem: String,
    },
    /// A value.
    #[error("{}: key `{key}`: {problem}", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// The key, with those above it.
        key: String,
        /// What was found, what was expected and what helps.
        problem: String,
    },
    /// An area that the configuration gives.
    #[error("key `{key}`: {problem}")]
    Config {
        /// The key.
        key: &'static str,
        /// What was found and what was expected.
        problem: String,
    },
}

/// Fibres in the needle of one rig: how they make a shape, and where the base is.
#[derive(Clone, Debug)]
pub(crate) struct Fibres {
    shape: Arc<FibreShape>,
    poses: Arc<Mutex<Odometry>>,
    /// By how much the needle follows the encoders late, and the standard deviation of that \[s\].
    lag: (f64, f64),
    /// A point of the surface, and the direction into the tissue.
    surface: (Point3<f64>, Unit<Vector3<f64>>),
}

impl Fibres {
    /// What `config` says of them.
    ///
    /// # Errors
    /// The calibration cannot be used.
    pub(crate) fn new(config: &Config) -> Result<Self, FibreError> {
        Ok(Self {
            shape: Arc::new(FibreShape::of(config)?),
            poses: Arc::new(Mutex::new(Odometry::new(POSES))),
            lag: (config.fbg.lag_ms * 1e-3, config.fbg.lag_sigma_ms * 1e-3),
            surface: (config.entry(), config.inward()),
        })
    }

    /// From wavelengths to shapes.
    pub(crate) fn shape(&self) -> &Arc<FibreShape> {
        &self.shape
    }

    /// The arm, telling where the needle's base is.
    pub(crate) fn on(
        &self,
        arm: Box<dyn Arm>,
        chain: Chain,
        world_from_arm_base: Transform<World, ArmBase>,
    ) -> Box<dyn Arm> {
        Box::new(Telling {
            arm,
            chain,
            world_from_arm_base,
            poses: Arc::clone(&self.poses),
        })
    }

    /// What `sensor` reads, as shapes in the stereo frame.
    pub(crate) fn eyes(
        &self,
        sensor: Box<dyn FibreSensor>,
        left_from_world: &Transform<LeftCamera, World>,
    ) -> Box<dyn ShapeSensor> {
        Box::new(FibreEyes {
            sensor,
            fibres: self.clone(),
            left_from_world: *left_from_world,
            bent: Bent::default(),
        })
    }
}

/// An arm that notes the pose of the needle's base at every reading.
struct Telling {
    arm: Box<dyn Arm>,
    chain: Chain,
    world_from_arm_base: Transform<World, ArmBase>,
    poses: Arc<Mutex<Odometry>>,
}

impl Arm for Telling {
    fn description(&self) -> &ArmDescription {
        self.arm.description()
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        let state = self.arm.state()?;
        let base = self.world_from_arm_base.isometry() * self.chain.forward(&state.positions);
        let mut poses = self.poses.lock().unwrap_or_else(PoisonError::into_inner);
        poses.push(state.stamp, base);
        Ok(state)
    }

    fn enable(&mut self) -> Result<(), Error> {
        self.arm.enable()
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        self.arm.command(command)
    }

    fn stop(&mut self) -> Result<(), Error> {
        self.arm.stop()
    }

    fn reset(&mut self) -> Result<(), Error> {
        self.arm.reset()
    }

    fn explanation(&self) -> Option<String> {
        self.arm.explanation()
    }
}

/// Fibres as a sensor of shapes.
struct FibreEyes {
    sensor: Box<dyn FibreSensor>,
    fibres: Fibres,
    left_from_world: Transform<LeftCamera, World>,
    bent: Bent,
}

impl FibreEyes {
    /// The shape of a reading; nothing where a grating was not read or the base's pose is not known.
    fn place(&mut self, reading: &WavelengthShifts) -> Option<SensedShape> {
        let poses = &self.fibres.poses;
        let lag = self.fibres.lag;
        let then = Stamp::from_secs((reading.stamp.as_secs() - lag.0).max(0.0));
        let (base, spin) = {
            let poses = poses.lock().unwrap_or_else(PoisonError::into_inner);
            let before = Stamp::from_secs((then.as_secs() - SPIN).max(0.0));
            let base = poses.at(then)?;
            let turn = poses.at(before)?.rotation.inverse() * base.rotation;
            (base, turn.scaled_axis().z / SPIN)
        };
        let bent = &mut self.bent;
        let shape = &self.fibres.shape;
        shape.bend(&reading.shifts_nm, spin * lag.1, bent)?;
        let left_from_base = self.left_from_world.isometry() * base;
        let place = |p: &Point3<f64>| Position::new(left_from_base * p);
        let (surface, inward) = &self.fibres.surface;
        let inside = |p: &Point3<f64>| inward.dot(&(base * p - surface)) >= 0.0;
        let visible = bent.points.iter().filter(|(p, _)| inside(p));
        // Errors of points are the same few areas' errors. No way of moving them together counts for
        // more than it may where each counts for its share alone.
        let share = (visible.clone().count() as f64).sqrt();
        let points = visible.map(|(p, sigma)| SensedPoint {
            position: place(p),
            sigma: sigma * share,
        });
        let direction = Unit::new_normalize(left_from_base * bent.direction.into_inner());
        Some(SensedShape {
            stamp: reading.stamp,
            sequence: reading.sequence,
            points: points.collect(),
            tip: SensedTip {
                position: place(&bent.tip),
                covariance: spread(bent.tip_sigma, &direction),
                direction,
                direction_sigma: bent.direction_sigma,
            },
        })
    }
}

/// Covariance of a tip that is known to `across` beside `axis`, and well along it. Those who read the mean of
/// three axes find `across` in it, so across there stands a little more.
fn spread(across: f64, axis: &Vector3<f64>) -> Matrix3<f64> {
    let along = across.min(ALONG).powi(2);
    let more = 0.5 * (3.0 * across * across - along);
    Matrix3::from_diagonal_element(more) + axis * axis.transpose() * (along - more)
}

impl ShapeSensor for FibreEyes {
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        let reading = self.sensor.poll()?;
        Ok(reading.and_then(|reading| self.place(&reading)))
    }
}

/// Where fibres that are read without noise show the tip, of a needle with its base at `base` \[m\].
pub(crate) fn shown(
    shape: &FibreShape,
    shifts: &[f64],
    base: &Isometry3<f64>,
) -> Option<Point3<f64>> {
    let mut bent = Bent::default();
    shape.bend(shifts, 0.0, &mut bent)?;
    Some(base * bent.tip)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{SensorKind, TargetKind};
    use crate::outcome::{Ended, Summary};
    use crate::run::simulate;

    /// An insertion to an aligned target by fibres at `areas_mm` from the tip.
    fn inserted(areas_mm: Vec<f64>, calibration: String) -> Summary {
        let mut config = Config::default();
        config.run.sensor = SensorKind::Fbg;
        config.run.seed = 1001;
        config.target.kind = TargetKind::Aligned;
        config.fbg.areas_mm = areas_mm;
        config.fbg.calibration = calibration;
        simulate(&config).unwrap()
    }

    /// Areas close to each other show the tip but for errors of calibration.
    #[test]
    fn an_insertion_by_fibres_ends_where_they_show_the_target() {
        let dense = (0..12).map(|k| 5.0 + 10.0 * f64::from(k)).collect();
        let summary = inserted(dense, String::new());
        assert_eq!(summary.ended, Ended::TargetPassed);
        let less_bias = summary.true_error_less_bias_mm.unwrap();
        // Of targets that passed, 95 % were measured within 0.51 mm (docs/REAL_NEEDLES.md).
        assert!(less_bias < 0.6, "{less_bias}");
    }

    #[test]
    fn a_calibration_is_read_from_its_file_which_errors_name() {
        let name = format!("fibres-{}.json", std::process::id());
        let file = std::env::temp_dir().join(name);
        let text = |last: &str| {
            let rows = "[[0.0, 1.9, -1.9], [-2.2, 1.1, 1.1]]";
            format!(
                "{{\"length\": 126, \"# channels\": 3, \"# active areas\": 4, \"Sensor Locations\": \
                 {{\"1\": 26, \"2\": 61, \"3\": 96, \"4\": 116}}, \"Calibration Matrices\": {{\"26\": {rows}, \
                 \"61\": {rows}, \"96\": {rows}, \"{last}\": {rows}}}}}"
            )
        };
        std::fs::write(&file, text("116")).unwrap();
        let shown = file.display().to_string();
        assert_eq!(
            inserted(vec![10.0], shown.clone()).ended,
            Ended::TargetPassed
        );
        let mut config = Config::default();
        config.fbg.calibration.clone_from(&shown);
        std::fs::write(&file, text("115")).unwrap();
        let error = Fibres::new(&config).unwrap_err().to_string();
        assert!(
            error.contains(&shown) && error.contains("no matrix"),
            "{error}"
        );
        std::fs::write(&file, text("116")).unwrap();
        config.needle.length_mm = 90.0;
        let error = Fibres::new(&config).unwrap_err().to_string();
        assert!(error.contains("needle.length_mm"), "{error}");
        std::fs::remove_file(&file).unwrap();
    }
}
