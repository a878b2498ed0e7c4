//! How shifts of wavelengths make curvature.

use nalgebra::{Matrix2, Matrix2xX, MatrixXx2, Vector2};
use phantom::FibreArea;

use super::FibreError;
use crate::config::Fbg;

/// Relative shift of a wavelength per strain: one less the photo-elastic coefficient of silica, 0.22.
const PER_STRAIN: f64 = 0.78;
/// Least singular value of a matrix over its largest: below, one direction of bending is not told.
const LEAST_SPAN: f64 = 1e-3;

/// An active area: gratings of all channels at one place along the needle.
#[derive(Clone, Debug, PartialEq)]
pub struct Area {
    /// Distance from the tip \[m\].
    pub from_tip: f64,
    /// Turn of the needle about x and y of the fibres' frame per length, by the shifts less what they
    /// have in common \[1/m/nm\].
    pub matrix: Matrix2xX<f64>,
    /// Trust in its curvature; 1 in the mean of the areas.
    pub weight: f64,
}

/// All areas of a needle.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The needle's serial number; empty where none is given.
    pub serial: String,
    /// Fibres, or cores of one.
    pub channels: usize,
    /// The channel on the needle's axis, where there is one: it tells what all have in common. Without
    /// it their mean does.
    pub central: Option<usize>,
    /// The areas, from the base to the tip.
    pub areas: Vec<Area>,
}

impl Calibration {
    /// Fibres evenly around the needle, the first on the x axis of their frame, areas as the
    /// configuration has them.
    pub(super) fn nominal(fbg: &Fbg) -> Self {
        let per_turn = PER_STRAIN * fbg.wavelength_nm * fbg.radius_mm * 1e-3;
        let angle = |k: usize| core::f64::consts::TAU * k as f64 / fbg.fibres as f64;
        // A needle that turns by (kx, ky) about x and y stretches a fibre at (x, y) by y kx - x ky.
        let sensitivity = MatrixXx2::from_fn(fbg.fibres, |k, axis| {
            per_turn
                * if axis == 0 {
                    angle(k).sin()
                } else {
                    -angle(k).cos()
                }
        });
        let inverse =
            Matrix2::from_diagonal_element(1.0 / (0.5 * fbg.fibres as f64 * per_turn * per_turn));
        let matrix = inverse * sensitivity.transpose();
        let mut from_tip: Vec<f64> = fbg.areas_mm.iter().map(|mm| mm * 1e-3).collect();
        from_tip.sort_by(|a, b| b.total_cmp(a));
        Self {
            serial: String::new(),
            channels: fbg.fibres,
            central: None,
            areas: from_tip
                .into_iter()
                .map(|from_tip| Area {
                    from_tip,
                    matrix: matrix.clone(),
                    weight: 1.0,
                })
                .collect(),
        }
    }

    /// What `fbg` says: its file, or fibres without one.
    ///
    /// # Errors
    /// The file cannot be used.
    pub fn of(fbg: &Fbg) -> Result<Self, FibreError> {
        if fbg.calibration.is_empty() {
            return Ok(Self::nominal(fbg));
        }
        super::file::read(fbg.calibration.as_ref(), fbg.locations_from)
    }

    /// Turn per length about x and y of the fibres' frame in area `area`, by the shifts of its channels;
    /// nothing where a channel was not read.
    pub(super) fn curvature(&self, area: usize, shifts: &[f64]) -> Option<Vector2<f64>> {
        let own = shifts.chunks_exact(self.channels).nth(area)?;
        let common = match self.central {
            Some(central) => *own.get(central)?,
            None => own.iter().sum::<f64>() / own.len() as f64,
        };
        let outer = own.iter().enumerate();
        let outer = outer.filter(|(channel, _)| Some(*channel) != self.central);
        let columns = self.areas.get(area)?.matrix.column_iter();
        let turn: Vector2<f64> = (columns.zip(outer))
            .map(|(column, (_, shift))| column * (shift - common))
            .sum();
        turn.iter().all(|x| x.is_finite()).then_some(turn)
    }

    /// Variance of each component of an area's curvature for independent errors of `sigma` in every
    /// wavelength \[1/m2\].
    pub(super) fn variance(&self, area: &Area, sigma_nm: f64) -> f64 {
        let mut square = self.on_all(area).norm_squared();
        if self.central.is_some() {
            square += area.matrix.column_sum().norm_squared();
        }
        0.5 * square * sigma_nm * sigma_nm
    }

    /// An area's matrix for shifts with what they have in common.
    fn on_all(&self, area: &Area) -> Matrix2xX<f64> {
        let mut matrix = area.matrix.clone();
        if self.central.is_none() {
            let mean = matrix.column_mean();
            for mut column in matrix.column_iter_mut() {
                column -= mean;
            }
        }
        matrix
    }

    /// Whether an area's matrix tells both directions of bending.
    pub(super) fn spans(&self, area: &Area) -> bool {
        let matrix = self.on_all(area);
        let values = (&matrix * matrix.transpose()).symmetric_eigenvalues();
        values.min() > values.max() * LEAST_SPAN * LEAST_SPAN
    }

    /// Fibres that this calibration is right for, for a simulation.
    pub(crate) fn simulated(&self) -> Vec<FibreArea> {
        let of = |area: &Area| {
            let matrix = self.on_all(area);
            let square: Matrix2<f64> = &matrix * matrix.transpose();
            let inverse = square.try_inverse().unwrap_or_else(Matrix2::zeros);
            let mut rows = (0..matrix.ncols()).map(|k| {
                let row = inverse.transpose() * matrix.column(k);
                [row.x, row.y]
            });
            let sensitivity = (0..self.channels)
                .map(|channel| match self.central {
                    Some(central) if central == channel => [0.0; 2],
                    _ => rows.next().unwrap_or_default(),
                })
                .collect();
            FibreArea {
                from_tip: area.from_tip,
                sensitivity,
            }
        };
        self.areas.iter().map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shifts(calibration: &Calibration, turn: Vector2<f64>, common: f64) -> Vec<f64> {
        calibration
            .simulated()
            .iter()
            .flat_map(|area| &area.sensitivity)
            .map(|by| Vector2::from(*by).dot(&turn) + common)
            .collect()
    }

    #[test]
    fn curvature_comes_back_and_warmth_does_not_count() {
        let turn = Vector2::new(1.5, -0.7);
        for fibres in 3..=5 {
            let fbg = Fbg {
                fibres,
                ..Fbg::default()
            };
            let nominal = Calibration::nominal(&fbg);
            let mut central = nominal.clone();
            (central.central, central.channels) = (Some(0), fibres + 1);
            for calibration in [nominal, central] {
                let shifts = shifts(&calibration, turn, 0.3);
                for area in 0..calibration.areas.len() {
                    let found = calibration.curvature(area, &shifts).unwrap();
                    assert!((found - turn).norm() < 1e-9, "{found}");
                }
            }
        }
    }

    /// Bending by 2 per metre about x stretches a fibre on the side of +y: by 2 times 0.25 mm.
    #[test]
    fn a_fibre_is_stretched_on_the_outer_side() {
        let fbg = Fbg {
            fibres: 4,
            ..Fbg::default()
        };
        let calibration = Calibration::nominal(&fbg);
        let sensitivity = &calibration.simulated()[0].sensitivity;
        let expected = 0.78 * 1550.0 * 0.25e-3;
        assert!(
            (sensitivity[1][0] - expected).abs() < 1e-9,
            "{sensitivity:?}"
        );
        assert!(
            (sensitivity[0][1] + expected).abs() < 1e-9,
            "{sensitivity:?}"
        );
    }

    #[test]
    fn noise_is_carried_over() {
        let calibration = Calibration::nominal(&Fbg::default());
        let sigma: f64 = 2e-3;
        // Of three fibres: 2/3 of the square of noise over sensitivity.
        let expected = 2.0 / 3.0 * (sigma / (0.78 * 1550.0 * 0.25e-3)).powi(2);
        let found = calibration.variance(&calibration.areas[0], sigma);
        assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
    }
}
