//! The springs model as the cycle uses it: moved by odometry, fed with measured tips, scaled by
//! the estimated stiffness.

use hal::telemetry::ModelReport;
use hybrid_control::view::Springs;
use nalgebra::{Isometry3, Point3, RowVector6, Translation3, Vector3};
use needle_model::{
    Bevel, BevelError, Insertion, InsertionError, InsertionSettings, Needle, NeedleError,
    Sensitivities, TangentError, Tissue, TissueError,
};

use crate::config::Config;
use crate::guide::Guide;

/// Distance of the model's start from the surface \[m\]: where the needle rests against it, its
/// encoders may place the tip just inside.
const CLEARANCE: f64 = 1e-3;
/// Relative change of the stiffness below which the model is left alone.
const SMALL_CHANGE: f64 = 1e-3;

/// A needle, tissue or bevel of the configuration that the model refuses.
#[derive(Debug, thiserror::Error)]
pub enum SpringsError {
    /// The needle.
    #[error(transparent)]
    Needle(#[from] NeedleError),
    /// The bevel.
    #[error(transparent)]
    Bevel(#[from] BevelError),
    /// The tissue.
    #[error(transparent)]
    Tissue(#[from] TissueError),
    /// The start, or a step of the insertion.
    #[error(transparent)]
    Insertion(#[from] InsertionError),
    /// The equilibrium has no derivatives.
    #[error(transparent)]
    Tangent(#[from] TangentError),
}

/// The needle of the configuration.
///
/// # Errors
/// Its dimensions make no needle.
pub fn needle(config: &Config) -> Result<Needle, NeedleError> {
    let n = &config.needle;
    Needle::new(
        n.length_mm * 1e-3,
        n.outer_diameter_mm * 1e-3,
        n.inner_diameter_mm * 1e-3,
        n.young_modulus_gpa * 1e9,
    )
}

/// Length of the bevel: from O to the cutting edge \[m\].
pub fn bevel_length(config: &Config) -> f64 {
    config.needle.outer_diameter_mm * 1e-3 / config.needle.bevel_deg.to_radians().tan()
}

/// The straight needle of the configuration with its base at `world_from_base`, drawn back a little
/// from the tissue.
///
/// # Errors
/// The model refuses the configuration or the start.
pub fn insertion(
    config: &Config,
    world_from_base: &Isometry3<f64>,
) -> Result<Insertion, SpringsError> {
    let mut outside = world_from_base * Isometry3::translation(0.0, 0.0, -CLEARANCE);
    let mut needle = needle(config)?;
    if let Some(guide) = Guide::of(config) {
        let guided = guide.at(&outside);
        outside = guided.world_from_exit;
        needle = needle.with_length(guided.length)?;
    }
    Ok(Insertion::new(
        needle,
        Bevel::plane_cut(
            config.needle.bevel_deg.to_radians(),
            config.needle.outer_diameter_mm * 1e-3,
        )?,
        Tissue::uniform(
            config.entry().coords,
            config.inward().into_inner(),
            config.estimator.stiffness_n_m2,
        )?,
        InsertionSettings {
            pitch: config.tissue.spring_spacing_mm * 1e-3,
            ..InsertionSettings::default()
        },
        &outside,
    )?)
}

/// The present equilibrium with its derivatives.
///
/// # Errors
/// The equilibrium has none.
pub fn converged(
    insertion: &mut Insertion,
    sensitivities: &mut Sensitivities,
) -> Result<Springs, TangentError> {
    let needle = insertion.equilibrium_mut();
    needle.sensitivities(sensitivities)?;
    let gradient = sensitivities.mean_stretch(needle);
    Ok(Springs {
        world_from_tip: needle.world_from_tip(),
        j_tip_base: sensitivities.tip_jacobian(),
        mean_stretch: needle.mean_stretch(),
        j_mean_stretch: RowVector6::from_iterator(gradient.iter().take(6).copied()),
        entry_stretch: needle.entry_stretch().norm(),
        entry_force: needle.entry_force().norm(),
    })
}

/// The controller's springs model.
#[derive(Debug)]
pub struct SpringsModel {
    guide: Option<Guide>,
    /// The straight needle in front of the tissue.
    fresh: Insertion,
    start_stiffness: f64,
    insertion: Insertion,
    sensitivities: Sensitivities,
    stiffness: f64,
}

impl SpringsModel {
    /// The straight needle at `world_from_base`, its tip at the surface.
    ///
    /// # Errors
    /// The model refuses the configuration or the start.
    pub fn new(config: &Config, world_from_base: &Isometry3<f64>) -> Result<Self, SpringsError> {
        let insertion = insertion(config, world_from_base)?;
        let stiffness = config.estimator.stiffness_n_m2;
        Ok(Self {
            guide: Guide::of(config),
            fresh: insertion.clone(),
            start_stiffness: stiffness,
            insertion,
            sensitivities: Sensitivities::default(),
            stiffness,
        })
    }

    /// Moves the model to the present: base by odometry, tip by measurement, stiffness by
    /// estimation; answers the converged state with its derivatives.
    ///
    /// # Errors
    /// No equilibrium; the model stays where it was.
    pub fn update(
        &mut self,
        world_from_base: &Isometry3<f64>,
        measured_tip: Option<Vector3<f64>>,
        stiffness: f64,
    ) -> Result<Springs, SpringsError> {
        let factor = stiffness / self.stiffness;
        if factor.is_finite() && factor > 0.0 && (factor - 1.0).abs() > SMALL_CHANGE {
            self.insertion.rescale(factor, 1.0)?;
            self.stiffness = stiffness;
        }
        let Some(guide) = self.guide else {
            self.insertion.insert(world_from_base, measured_tip)?;
            return Ok(converged(&mut self.insertion, &mut self.sensitivities)?);
        };
        let guided = guide.at(world_from_base);
        self.insertion
            .insert_through(&guided.world_from_exit, guided.length, measured_tip)?;
        let mut springs = converged(&mut self.insertion, &mut self.sensitivities)?;
        let by_base = guided.exit_by_base();
        springs.j_tip_base *= by_base;
        springs.j_mean_stretch *= by_base;
        Ok(springs)
    }

    /// Forgets the rest points: what was laid while the tissue's motion was taken for cutting is no
    /// path. The needle is inserted anew, straight, through a tip measured at `tip`.
    ///
    /// # Errors
    /// No equilibrium; the model stays as it was.
    pub fn begin_anew(
        &mut self,
        world_from_base: &Isometry3<f64>,
        tip: &Vector3<f64>,
    ) -> Result<(), SpringsError> {
        let length = self.insertion.equilibrium().free_length()
            + self.insertion.equilibrium().inserted_length();
        let guided = self.guide.map(|guide| guide.at(world_from_base));
        let held = guided.map_or(*world_from_base, |guided| guided.world_from_exit);
        let axis = held.rotation * Vector3::z();
        let off = tip - (held.translation.vector + axis * length);
        let aside = Translation3::from(off - axis * axis.dot(&off)) * held;
        let mut insertion = self.fresh.clone();
        insertion.rescale(self.stiffness / self.start_stiffness, 1.0)?;
        match guided {
            Some(guided) => insertion.insert_through(&aside, guided.length, None)?,
            None => insertion.insert(&aside, None)?,
        }
        self.insertion = insertion;
        Ok(())
    }

    /// Length of needle in the tissue \[m\].
    pub fn depth(&self) -> f64 {
        self.insertion.equilibrium().inserted_length()
    }

    /// Fills the model's part of the telemetry.
    pub fn report(&self, report: &mut ModelReport) {
        let needle = self.insertion.equilibrium();
        report.shape.clear();
        for segment in needle.segments() {
            let pieces = (segment.length / 4e-3).ceil().max(1.0);
            let mut piece = 0.0;
            while piece < pieces {
                report
                    .shape
                    .push(segment.position(segment.length * piece / pieces));
                piece += 1.0;
            }
        }
        report.shape.push(needle.tip_position());
        report.spring_points.clear();
        report
            .spring_points
            .extend(needle.spring_points().map(|(point, _)| point));
        report.rest_points.clear();
        report
            .rest_points
            .extend(needle.springs().iter().map(|spring| spring.rest));
        report.mean_stretch = needle.mean_stretch();
        report.max_stretch = needle.max_stretch();
        report.entry_stretch = needle.entry_stretch().norm();
        report.entry_force = needle.entry_force().norm();
        let convergence = needle.convergence();
        report.iterations = u32::try_from(convergence.iterations).unwrap_or(u32::MAX);
        report.residual = convergence.residual;
    }
}

/// Root mean square distance of measured points of the `shaft` from the model's `shape`, a polyline
/// \[m\]; NaN without points or shape. Both in one frame.
pub(crate) fn shaft_off(shape: &[Vector3<f64>], shaft: &[(Point3<f64>, f64)]) -> f64 {
    let squares = shaft.iter().map(|(point, _)| {
        let to_piece = |ends: &[Vector3<f64>]| {
            let (from, along) = (ends[0], ends[1] - ends[0]);
            let offset = point.coords - from;
            let share = offset.dot(&along) / along.norm_squared();
            (offset - along * share.clamp(0.0, 1.0)).norm_squared()
        };
        shape.windows(2).map(to_piece).fold(f64::INFINITY, f64::min)
    });
    let mean = squares.sum::<f64>() / shaft.len() as f64;
    if mean.is_finite() {
        mean.sqrt()
    } else {
        f64::NAN
    }
}

/// The model's part of the telemetry while it has no equilibrium: its figures are unknown.
pub(crate) fn report_failure(report: &mut ModelReport) {
    report.mean_stretch = f64::NAN;
    report.max_stretch = f64::NAN;
    report.entry_stretch = f64::NAN;
    report.entry_force = f64::NAN;
    report.residual = f64::NAN;
    report.shaft_off = f64::NAN;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shaft_beside_the_model_is_measured_across_it() {
        let shape = [0.0, 4e-3, 8e-3].map(|z| Vector3::new(0.0, 0.0, z));
        let shaft = [1e-3, 5e-3, 7e-3].map(|z| (Point3::new(3e-4, -4e-4, z), 1e-4));
        assert!((shaft_off(&shape, &shaft) - 5e-4).abs() < 1e-12);
        assert!(shaft_off(&shape, &[]).is_nan() && shaft_off(&[], &shaft).is_nan());
    }

    fn guided() -> Config {
        let mut config = Config::default();
        config.needle.support = crate::config::NeedleSupport::Guide;
        config.needle.guide_gap_mm = 30.0;
        config
    }

    /// Its tip after a straight insertion by 40 mm and a shift of the base by 0.5 mm.
    fn shifted(config: &Config) -> (SpringsModel, Isometry3<f64>, Springs) {
        let mut base = config.world_from_start_base();
        let mut model = SpringsModel::new(config, &base).unwrap();
        for _ in 0..40 {
            base *= Translation3::new(0.0, 0.0, 1e-3);
            model.update(&base, None, 2e4).unwrap();
        }
        base *= Translation3::new(5e-4, 0.0, 0.0);
        let springs = model.update(&base, None, 2e4).unwrap();
        (model, base, springs)
    }

    /// Place and axis across, in the frame of the base at the start.
    fn across(config: &Config, springs: &Springs) -> [f64; 2] {
        let tip = config.world_from_start_base().inverse() * springs.world_from_tip;
        [tip.translation.x, (tip.rotation * Vector3::z()).x]
    }

    #[test]
    fn a_needle_in_a_guide_answers_as_a_shorter_one_clamped_at_its_exit() {
        let mut straight = guided();
        // Beyond the bevel's load there is nothing that differs by the way of inserting.
        straight.needle.bevel_deg = 89.0;
        let (_, _, through) = shifted(&straight);
        let mut short = straight.clone();
        short.needle.support = crate::config::NeedleSupport::Base;
        short.needle.length_mm = 70.0;
        let (_, _, clamped) = shifted(&short);
        let (a, b) = (across(&straight, &through), across(&short, &clamped));
        let long = Config {
            needle: crate::config::Needle {
                length_mm: 126.0,
                ..short.needle.clone()
            },
            ..short
        };
        let far = across(&long, &shifted(&long).2);
        assert!((a[1] - b[1]).abs() < 0.03 * b[1].abs(), "{a:?} {b:?}");
        assert!((far[1] - b[1]).abs() > 0.1 * b[1].abs(), "{far:?} {b:?}");
    }

    #[test]
    fn derivatives_in_a_guide_are_those_of_the_base() {
        let config = guided();
        let (mut model, base, springs) = shifted(&config);
        let step = 1e-5;
        // Shift across and a turn of the base; positions in World.
        for column in [0, 1, 3, 4] {
            let mut twist = nalgebra::Vector6::zeros();
            twist[column] = step;
            let turn = Vector3::new(twist[3], twist[4], twist[5]);
            let moved = Isometry3::from_parts(
                Translation3::from(base.translation.vector + twist.fixed_rows::<3>(0)),
                nalgebra::UnitQuaternion::from_scaled_axis(turn) * base.rotation,
            );
            let before = model.update(&base, None, 2e4).unwrap().world_from_tip;
            let after = model.update(&moved, None, 2e4).unwrap().world_from_tip;
            let found = (after.translation.vector - before.translation.vector) / step;
            let said = springs.j_tip_base.fixed_view::<3, 1>(0, column);
            assert!(
                (found - said).norm() < 0.05 * said.norm().max(0.02),
                "{column}: {found} {said}"
            );
        }
    }
}
