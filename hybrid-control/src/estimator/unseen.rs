//! What a sensor of the tip alone leaves open: how the support truly lies, how stiff the tissue is,
//! and by how much the sensor errs. Points of the shaft would tell; without them the tip's own
//! answers have to.

use nalgebra::{Isometry3, SMatrix, SVector, Vector2};

use super::filter::{N, correct};
use super::moment::clamp_of;
use super::rod::RodConstants;
use super::{ASIDE, Estimator, planar};
use crate::settings::EstimatorSettings;

/// Numbers that are left open: shift of the support (2) \[m\], its pivot about the entry (2) \[rad\],
/// error of the measured place (2) \[m\] and of the measured axis (2) \[rad\], log K.
const M: usize = 9;
const SHIFT: usize = 0;
const PIVOT: usize = 2;
const PLACE: usize = 4;
const AXIS: usize = 6;
const STIFFNESS: usize = 8;
/// Both together.
const ALL: usize = N + M;

/// Standard deviation of the tip beside the support's axis at the surface: a needle's own
/// straightness \[m\].
const STRAIGHT: f64 = 0.1e-3;
/// Change of the stiffness for a derivative \[1\].
const STIFFER: f64 = 1.05;

/// Farthest that log K goes from its prior, in standard deviations of that.
const FARTHEST: f64 = 3.0;

/// A sensor of the tip that shows no shaft: its lasting errors, slow in space, as of an
/// electromagnetic tracker in a distorted field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipSensor {
    /// Standard deviation of the lasting error of the place, per axis \[m\].
    pub place_bias: f64,
    /// The same of the axis \[rad\].
    pub axis_bias: f64,
    /// Way over which these errors change: their correlation falls by e \[m\].
    pub length: f64,
}

/// Derivatives of the tip's slope.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SlopeBy {
    /// By the tip's own position \[1/m\].
    pub(crate) position: f64,
    /// By a shift of the support \[1/m\].
    pub(crate) shift: f64,
    /// By a pivot of the support about the entry.
    pub(crate) pivot: f64,
    /// By the logarithm of the stiffness.
    pub(crate) stiffness: Vector2<f64>,
}

impl SlopeBy {
    /// By what is left open.
    fn unseen(&self) -> SMatrix<f64, 2, M> {
        let mut by = SMatrix::zeros();
        for i in 0..2 {
            by[(i, SHIFT + i)] = self.shift;
            by[(i, PIVOT + i)] = self.pivot;
            by[(i, STIFFNESS)] = self.stiffness[i];
        }
        by
    }
}

/// State and covariance of what is left open, and its covariance with a filter's own state.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Unseen {
    sensor: TipSensor,
    x: SVector<f64, M>,
    p: SMatrix<f64, M, M>,
    cross: SMatrix<f64, N, M>,
    log_sigma: f64,
}

impl Unseen {
    pub(crate) fn new(sensor: &TipSensor, s: &EstimatorSettings) -> Self {
        let shift = s.base_shift_sigma_mm * 1e-3;
        let pivot = s.base_tilt_sigma_deg.to_radians();
        let sigmas = [
            shift,
            shift,
            pivot,
            pivot,
            sensor.place_bias,
            sensor.place_bias,
            sensor.axis_bias,
            sensor.axis_bias,
            s.stiffness_sigma,
        ];
        let p = SMatrix::from_diagonal(&SVector::from(sigmas.map(|sigma| sigma * sigma)));
        // The tip starts on the support's axis, at the entry.
        let mut cross = SMatrix::zeros();
        for i in 0..2 {
            cross[(i, SHIFT + i)] = shift * shift;
        }
        Self {
            sensor: *sensor,
            x: SVector::zeros(),
            p,
            cross,
            log_sigma: s.stiffness_sigma,
        }
    }

    /// Variance of the tip's place at the start \[m2\].
    pub(crate) fn start_variance(&self) -> f64 {
        self.p[(SHIFT, SHIFT)] + STRAIGHT * STRAIGHT
    }

    fn pair(&self, at: usize) -> Vector2<f64> {
        Vector2::new(self.x[at], self.x[at + 1])
    }

    /// Shift of the support \[m\] and its pivot about the entry \[rad\].
    pub(crate) fn support(&self) -> (Vector2<f64>, Vector2<f64>) {
        (self.pair(SHIFT), self.pair(PIVOT))
    }

    /// Error of the measured place \[m\].
    pub(crate) fn place(&self) -> Vector2<f64> {
        self.pair(PLACE)
    }

    /// Error of the measured axis \[rad\].
    pub(crate) fn axis(&self) -> Vector2<f64> {
        self.pair(AXIS)
    }

    /// Logarithm of the stiffness over its prior, and its standard deviation.
    pub(crate) fn log_stiffness(&self) -> (f64, f64) {
        (
            self.x[STIFFNESS],
            self.p[(STIFFNESS, STIFFNESS)].max(0.0).sqrt(),
        )
    }

    /// What is left of the sensor's errors after a way \[m\].
    pub(crate) fn lasting(&self, way: f64) -> f64 {
        (-way.max(0.0) / self.sensor.length).exp()
    }

    /// Standard deviation of the error of the place after a way, as it is not known now \[m\].
    pub(crate) fn place_sigma(&self, way: f64) -> f64 {
        let left = self.lasting(way).powi(2);
        let now = 0.5 * (self.p[(PLACE, PLACE)] + self.p[(PLACE + 1, PLACE + 1)]);
        (left * now.max(0.0) + (1.0 - left) * self.sensor.place_bias.powi(2)).sqrt()
    }

    fn joint(&self, own: &SMatrix<f64, N, N>) -> SMatrix<f64, ALL, ALL> {
        let mut joint = SMatrix::<f64, ALL, ALL>::zeros();
        joint.fixed_view_mut::<N, N>(0, 0).copy_from(own);
        joint.fixed_view_mut::<N, M>(0, N).copy_from(&self.cross);
        joint
            .fixed_view_mut::<M, N>(N, 0)
            .copy_from(&self.cross.transpose());
        joint.fixed_view_mut::<M, M>(N, N).copy_from(&self.p);
        joint
    }

    /// Takes its part of the joint covariance; answers the filter's own.
    fn split(&mut self, joint: &SMatrix<f64, ALL, ALL>) -> SMatrix<f64, N, N> {
        self.cross = joint.fixed_view::<N, M>(0, N).into_owned();
        self.p = joint.fixed_view::<M, M>(N, N).into_owned();
        joint.fixed_view::<N, N>(0, 0).into_owned()
    }

    /// The tip cuts on by `advance` \[m\]; `f`: the filter's own transition. Answers its covariance,
    /// without its own noise.
    pub(crate) fn propagate(
        &mut self,
        own: &SMatrix<f64, N, N>,
        f: &SMatrix<f64, N, N>,
        by: &SlopeBy,
        advance: f64,
    ) -> SMatrix<f64, N, N> {
        let lasts = self.lasting(advance);
        let mut all = SMatrix::<f64, ALL, ALL>::identity();
        all.fixed_view_mut::<N, N>(0, 0).copy_from(f);
        all.fixed_view_mut::<2, M>(0, N)
            .copy_from(&(by.unseen() * advance));
        for i in PLACE..STIFFNESS {
            all[(N + i, N + i)] = lasts;
            self.x[i] *= lasts;
        }
        let mut joint = all * self.joint(own) * all.transpose();
        let renewed = 1.0 - lasts * lasts;
        for i in 0..2 {
            joint[(N + PLACE + i, N + PLACE + i)] += renewed * self.sensor.place_bias.powi(2);
            joint[(N + AXIS + i, N + AXIS + i)] += renewed * self.sensor.axis_bias.powi(2);
        }
        self.split(&joint)
    }

    /// Takes in a measurement of the place, or of the slope; see [`correct`].
    pub(crate) fn correct(
        &mut self,
        (x, p): (&mut SVector<f64, N>, &mut SMatrix<f64, N, N>),
        h: &SMatrix<f64, 2, N>,
        slope_by: Option<&SlopeBy>,
        innovation: &Vector2<f64>,
        sigma: f64,
    ) -> Option<f64> {
        let mut all = SMatrix::<f64, 2, ALL>::zeros();
        all.fixed_view_mut::<2, N>(0, 0).copy_from(h);
        let errs = if let Some(by) = slope_by {
            all.fixed_view_mut::<2, M>(0, N).copy_from(&by.unseen());
            AXIS
        } else {
            PLACE
        };
        for i in 0..2 {
            all[(i, N + errs + i)] = 1.0;
        }
        let mut state = SVector::<f64, ALL>::zeros();
        state.fixed_rows_mut::<N>(0).copy_from(x);
        state.fixed_rows_mut::<M>(N).copy_from(&self.x);
        let mut joint = self.joint(p);
        let likelihood = correct(&mut state, &mut joint, &all, innovation, sigma)?;
        x.copy_from(&state.fixed_rows::<N>(0));
        self.x.copy_from(&state.fixed_rows::<M>(N));
        let most = FARTHEST * self.log_sigma;
        self.x[STIFFNESS] = self.x[STIFFNESS].clamp(-most, most);
        *p = self.split(&joint);
        Some(likelihood)
    }
}

impl Estimator {
    /// Takes over what the tip has told of support and tissue, where it alone is measured.
    pub(super) fn adopt_unseen(&mut self, base: &Isometry3<f64>) {
        let m = &mut self.measured;
        let Some(unseen) = m.filter.ruling().unseen() else {
            return;
        };
        self.stiffness.adopt(&mut self.constants, unseen);
        m.clamp = clamp_of(base, self.start.guide_gap, &self.stiffness);
        let (deepest, aside) = self.straight;
        m.straight &=
            m.path.tip_depth() < deepest && (base.translation.vector.xy() - aside).norm() < ASIDE;
        if m.straight {
            m.lay_straight();
            return;
        }
        let more = RodConstants {
            bed: self.constants.bed * STIFFER,
            ..self.constants
        };
        m.rod.solve(&self.constants, &m.clamp, &m.path);
        self.stiffer.solve(&more, &m.clamp, &m.path);
        m.slope_by_stiffness =
            (planar(&self.stiffer.tip_slope()) - planar(&m.rod.tip_slope())) / STIFFER.ln();
    }
}

#[cfg(test)]
mod tests {
    use hal::Stamp;
    use nalgebra::{Point3, Unit, Vector3};

    use super::*;
    use crate::estimator::{Observation, Start};
    use crate::view::Entry;

    const LENGTH: f64 = 0.2;
    const GAP: f64 = 25e-3;
    /// The guide truly points so far aside \[rad\].
    const ASKEW: f64 = 10e-3;

    /// The estimator after 5 mm through a guide that is askew, by a sensor whose place is off by `off`
    /// \[m\].
    fn inserted(sensor: TipSensor, off: f64) -> Estimator {
        let at = |depth: f64| Isometry3::translation(0.0, 0.0, depth - LENGTH);
        let start = Start {
            length: LENGTH,
            bending_stiffness: 2e-2,
            cutting_edge: 0.0,
            guide_gap: Some(GAP),
            tip_sensor: Some(sensor),
            advance_by_tip: false,
            entry: Entry {
                point: Point3::origin(),
                inward: Vector3::z_axis(),
            },
            world_from_base: at(0.0),
        };
        let settings = EstimatorSettings {
            stiffness_n_m2: 2e5,
            ..EstimatorSettings::default()
        };
        let mut estimator = Estimator::new(&settings, &start).unwrap();
        for k in 0..200_u32 {
            let depth = 5e-3 * f64::from(k) / 200.0;
            estimator.observe(&Observation {
                stamp: Stamp::from_secs(0.025 * f64::from(k)),
                world_from_base: at(depth),
                position: Point3::new(ASKEW * depth + off, 0.0, depth),
                position_sigma: 0.1e-3,
                direction: Unit::new_normalize(Vector3::new(ASKEW, 0.0, 1.0)),
                direction_sigma: 3e-3,
                shaft: &[],
                carried: false,
            });
        }
        estimator
    }

    #[test]
    fn the_tip_tells_how_the_support_lies_and_the_sensor_errs() {
        let sensor = TipSensor {
            place_bias: 0.6e-3,
            axis_bias: 1e-3,
            length: 25e-3,
        };
        let estimator = inserted(sensor, 0.5e-3);
        let filter = estimator.measured.filter.ruling();
        let unseen = filter.unseen().unwrap();
        let (_, pivot) = unseen.support();
        // Neighbouring axes share their errors: against half a degree of the base they count for more
        // than half.
        assert!((0.5 * ASKEW..ASKEW).contains(&pivot.x), "{pivot}");
        // 0.6 mm of the field against 0.2 mm of the base, a priori.
        let place = unseen.place().x;
        assert!((0.35e-3..0.5e-3).contains(&place), "{place}");
        // Together they are where it was measured.
        let shown = filter.position().x + place - ASKEW * 5e-3;
        assert!((shown - 0.5e-3).abs() < 0.05e-3, "{shown}");
    }

    #[test]
    fn an_axis_that_may_err_tells_less_of_the_support() {
        let sensor = TipSensor {
            place_bias: 0.6e-3,
            axis_bias: 20e-3,
            length: 25e-3,
        };
        let estimator = inserted(sensor, 0.0);
        let unseen = estimator.measured.filter.ruling().unseen().unwrap();
        let (_, pivot) = unseen.support();
        assert!(pivot.x.abs() < 0.3 * ASKEW, "{pivot}");
        assert!(
            (unseen.axis().x - ASKEW).abs() < 0.4 * ASKEW,
            "{}",
            unseen.axis()
        );
    }
}
