//! A field's distortion from a needle in air: its guide at known places, its tip measured.

use std::path::Path;

use nalgebra::{DMatrix, Vector3};

use super::column::IN_AIR;
use super::table::{Row, Table, TableError};
use crate::distortion::{DistortionMap, Smooth, basis, scaled, terms};
use crate::statistics::median;

/// Highest degrees that are tried, across and along.
const HIGHEST: (usize, usize) = (4, 8);
/// Parts of the table of which each is foretold from the others.
const PARTS: usize = 5;
/// A polynomial of fewer terms is taken where it leaves at most so many times what the best leaves.
const AS_GOOD: f64 = 1.02;
/// Weight that keeps terms which the places do not tell apart at zero, over the mean weight of a term.
const RIDGE: f64 = 1e-9;
/// Least numbers of rows, of places across and of depths.
const LEAST: (usize, usize, usize) = (40, 6, 3);
/// Places nearer than this are one \[m\].
const SAME: f64 = 0.5e-3;

/// A table that makes no map.
#[derive(Debug, thiserror::Error)]
pub enum DistortionError {
    /// It cannot be read.
    #[error(transparent)]
    Table(#[from] TableError),
    /// It is too small.
    #[error(
        "{file}: {rows} rows, {across} places of the guide and {depths} depths; a map needs at least {}, {} and {}: \
         record more places in air",
        LEAST.0, LEAST.1, LEAST.2
    )]
    Few {
        /// The file.
        file: String,
        /// Rows.
        rows: usize,
        /// Places across.
        across: usize,
        /// Depths.
        depths: usize,
    },
}

/// How the needle lies in its guide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lie {
    /// The tip is where the guide's place and the depth say, its axis along the insertion.
    Exact,
    /// By how much it lies aside and points aside is not known: the mean of place and axis is not the
    /// field's.
    Fitted,
}

/// One row: errors of a measured place and axis.
struct Place {
    measured_mm: Vector3<f64>,
    /// Number of the guide's place across.
    column: usize,
    error_mm: Vector3<f64>,
    error_mrad: Vector3<f64>,
}

/// Fits the map of a table: guide's places, depth, and the tip measured there.
///
/// # Errors
/// See [`DistortionError`].
pub fn map_of(file: &Path, lie: Lie) -> Result<DistortionMap, DistortionError> {
    let table = Table::read_of(file, &IN_AIR)?;
    table.require(&[
        "depth", "tip_x", "tip_y", "tip_z", "axis_x", "axis_y", "axis_z",
    ])?;
    let rows: Vec<Row<'_>> = table.rows().collect();
    let axes = rows.iter().map(axis).collect::<Result<Vec<_>, _>>()?;
    let mean = axes.iter().sum::<Vector3<f64>>();
    let along = mean.iamax();
    let inward = Vector3::ith(along, mean[along].signum());
    let names = ["guide_x", "guide_y", "guide_z"];
    let across = [(along + 1) % 3, (along + 2) % 3].map(|i| names[i]);
    table.require(&across)?;
    let mut columns: Vec<[f64; 2]> = Vec::new();
    let mut depths: Vec<f64> = Vec::new();
    let mut places = Vec::new();
    let mut noise = Vec::new();
    for (row, axis) in rows.iter().zip(&axes) {
        let depth = row.number("depth")?;
        let guide = [row.number(across[0])?, row.number(across[1])?];
        let mut there = inward * depth.abs();
        there[(along + 1) % 3] = guide[0];
        there[(along + 2) % 3] = guide[1];
        if table.has(names[along]) {
            there[along] += row.number(names[along])?;
        }
        let near = |other: &[f64; 2]| (0..2).all(|i| (other[i] - guide[i]).abs() < SAME);
        let column = columns.iter().position(near).unwrap_or_else(|| {
            columns.push(guide);
            columns.len() - 1
        });
        if !depths.iter().any(|other| (other - depth).abs() < SAME) {
            depths.push(depth);
        }
        let tip = row.vector(["tip_x", "tip_y", "tip_z"])?;
        noise.extend(
            ["sd_x", "sd_y", "sd_z"]
                .iter()
                .filter_map(|name| row.optional(name)),
        );
        places.push(Place {
            measured_mm: tip * 1e3,
            column,
            error_mm: (tip - there) * 1e3,
            error_mrad: (axis - inward) * 1e3,
        });
    }
    if places.len() < LEAST.0 || columns.len() < LEAST.1 || depths.len() < LEAST.2 {
        return Err(DistortionError::Few {
            file: table.file().display().to_string(),
            rows: places.len(),
            across: columns.len(),
            depths: depths.len(),
        });
    }
    if lie == Lie::Fitted {
        take_off_lie(&mut places, &inward);
    }
    Ok(fitted(&places, along, depths.len(), &noise))
}

/// The measured axis of a row, of length one.
fn axis(row: &Row<'_>) -> Result<Vector3<f64>, TableError> {
    let axis = row.vector(["axis_x", "axis_y", "axis_z"])?;
    axis.try_normalize(0.5).ok_or_else(|| {
        row.problem(
            "axis_x",
            "expected a direction of length 1, found a shorter one; remove the row",
        )
    })
}

/// Takes off what a straight needle that lies aside in its guide does: the mean of the axes and, along
/// that, of the places.
fn take_off_lie(places: &mut [Place], inward: &Vector3<f64>) {
    let count = places.len() as f64;
    let aside = places.iter().map(|p| p.error_mrad).sum::<Vector3<f64>>() / count;
    let surface = places
        .iter()
        .map(|p| inward.dot(&p.measured_mm))
        .fold(f64::MAX, f64::min);
    for place in &mut *places {
        let depth = inward.dot(&place.measured_mm) - surface;
        place.error_mrad -= aside;
        place.error_mm -= aside * (1e-3 * depth);
    }
    let mean = places.iter().map(|p| p.error_mm).sum::<Vector3<f64>>() / count;
    for place in places {
        place.error_mm -= mean;
    }
}

fn fitted(places: &[Place], along: usize, depths: usize, noise: &[f64]) -> DistortionMap {
    let corner = |pick: fn(f64, f64) -> f64| -> [f64; 3] {
        let all = places.iter().map(|place| place.measured_mm);
        let found = all.reduce(|a, b| a.zip_map(&b, pick)).unwrap_or_default();
        found.into()
    };
    let (min_mm, max_mm) = (corner(f64::min), corner(f64::max));
    let values: Vec<Vec<f64>> = places
        .iter()
        .map(|place| {
            let at = scaled(&place.measured_mm, &min_mm, &max_mm, along);
            basis(&at, HIGHEST.0, HIGHEST.1)
        })
        .collect();
    let smooth = |error: fn(&Place) -> Vector3<f64>, components: f64| {
        // Between depths nothing was measured: a polynomial through all of them could do anything there.
        Fit::new(places, &values, error).best(components, depths.saturating_sub(2))
    };
    DistortionMap {
        along,
        min_mm,
        max_mm,
        places: places.len(),
        noise_mm: if noise.is_empty() {
            0.0
        } else {
            median(noise) * 1e3
        },
        place_mm: smooth(|place| place.error_mm, 3.0),
        // Along itself an axis has no error.
        axis_mrad: smooth(|place| place.error_mrad, 2.0),
    }
}

/// Sums of products over a part of the places: of the terms with each other, with the errors, and of
/// the errors with themselves.
#[derive(Clone)]
struct Sums {
    terms: DMatrix<f64>,
    right: DMatrix<f64>,
    square: f64,
    count: usize,
}

struct Fit {
    parts: Vec<Sums>,
    whole: Sums,
    terms: Vec<[usize; 3]>,
}

impl Fit {
    fn new(places: &[Place], values: &[Vec<f64>], error: fn(&Place) -> Vector3<f64>) -> Self {
        let terms: Vec<[usize; 3]> = terms(HIGHEST.0, HIGHEST.1).collect();
        let size = terms.len();
        let none = Sums {
            terms: DMatrix::zeros(size, size),
            right: DMatrix::zeros(size, 3),
            square: 0.0,
            count: 0,
        };
        let mut parts = vec![none.clone(); PARTS];
        for (place, values) in places.iter().zip(values) {
            // Whole columns are left out: neighbours along one would tell each other.
            let part = &mut parts[place.column % PARTS];
            let (row, error) = (DMatrix::from_row_slice(1, size, values), error(place));
            part.terms.gemm_tr(1.0, &row, &row, 1.0);
            part.right += row.transpose() * error.transpose();
            part.square += error.norm_squared();
            part.count += 1;
        }
        let mut whole = none;
        for part in &parts {
            whole.terms += &part.terms;
            whole.right += &part.right;
            whole.square += part.square;
            whole.count += part.count;
        }
        Self {
            parts,
            whole,
            terms,
        }
    }

    /// Coefficients of the terms `used` on the whole less a part; none where places do not tell.
    fn solve(&self, used: &[usize], less: Option<&Sums>) -> Option<DMatrix<f64>> {
        let pick = |of: fn(&Sums) -> &DMatrix<f64>| {
            let whole = of(&self.whole);
            less.map_or_else(|| whole.clone(), |part| whole - of(part))
                .select_rows(used)
        };
        let mut terms = pick(|sums| &sums.terms).select_columns(used);
        let ridge = RIDGE * terms.trace() / used.len() as f64;
        for i in 0..used.len() {
            terms[(i, i)] += ridge;
        }
        Some(terms.cholesky()?.solve(&pick(|sums| &sums.right)))
    }

    /// Root mean square error per component with which the parts are foretold from the others.
    fn left(&self, used: &[usize], components: f64) -> Option<f64> {
        let mut square = 0.0;
        for part in &self.parts {
            let by = self.solve(used, Some(part))?;
            let terms = part.terms.select_rows(used).select_columns(used);
            let right = part.right.select_rows(used);
            square += part.square - 2.0 * by.dot(&right) + by.dot(&(terms * &by));
        }
        Some((square.max(0.0) / (self.whole.count as f64 * components)).sqrt())
    }

    /// The polynomial that foretells best, or one of fewer terms that is as good.
    fn best(&self, components: f64, most_along: usize) -> Smooth {
        let mut tried = Vec::new();
        for across in 0..=HIGHEST.0 {
            for along in 0..=HIGHEST.1.min(most_along) {
                let used: Vec<usize> = terms(across, along)
                    .filter_map(|term| self.terms.iter().position(|other| *other == term))
                    .collect();
                // Three places a term at least.
                if 3 * used.len() > self.whole.count {
                    continue;
                }
                if let Some(left) = self.left(&used, components) {
                    tried.push((left, across, along, used));
                }
            }
        }
        let least = tried.iter().map(|t| t.0).fold(f64::INFINITY, f64::min);
        let before = (self.whole.square / (self.whole.count as f64 * components)).sqrt();
        let chosen = tried
            .into_iter()
            .filter(|t| t.0 <= AS_GOOD * least)
            .min_by_key(|t| t.3.len());
        let solved = chosen.and_then(|chosen| Some((self.solve(&chosen.3, None)?, chosen)));
        let Some((by, (left, degree_across, degree_along, _))) = solved else {
            return Smooth {
                degree_across: 0,
                degree_along: 0,
                before,
                left: before,
                coefficients: vec![[0.0; 3]],
            };
        };
        Smooth {
            degree_across,
            degree_along,
            before,
            left,
            coefficients: by.row_iter().map(|row| [row[0], row[1], row[2]]).collect(),
        }
    }
}
