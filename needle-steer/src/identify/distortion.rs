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

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;

    use super::*;

    const HEADER: &str =
        "depth_mm,guide_x_mm,guide_z_mm,tip_x_mm,tip_y_mm,tip_z_mm,axis_x,axis_y,axis_z\n";

    /// A guide along -y at 6 x 6 places and 5 depths, whose tip lies (1, 2, 3) mm aside and errs by
    /// `error` \[mm\] of place.
    fn table(error: impl Fn(f64, f64, f64) -> [f64; 3]) -> String {
        let mut text = HEADER.to_owned();
        for depth in [0.0, 20.0, 40.0, 60.0, 80.0] {
            for x in 0..6 {
                for z in 0..6 {
                    let (x, z) = (f64::from(x) * 5.0, f64::from(z) * 5.0);
                    let e = error(x, depth, z);
                    let tip = [1.0 + x + e[0], 2.0 - depth + e[1], 3.0 + z + e[2]];
                    writeln!(
                        text,
                        "{depth},{x},{z},{},{},{},0.02,-0.9996,0.02",
                        tip[0], tip[1], tip[2]
                    )
                    .unwrap();
                }
            }
        }
        text
    }

    fn read(text: &str, name: &str, lie: Lie) -> Result<DistortionMap, DistortionError> {
        let file = std::env::temp_dir().join(format!("{name}-{}.csv", std::process::id()));
        std::fs::write(&file, text).unwrap();
        let map = map_of(&file, lie);
        std::fs::remove_file(&file).unwrap();
        map
    }

    #[test]
    fn a_smooth_field_is_found_and_how_the_needle_lies_is_not_taken_for_one() {
        // Bent by 20 mrad per axis along the needle as the axis says, and by a parabola of 2 mm.
        let bent = |x: f64, depth: f64, _: f64| {
            let aside = 0.02 * depth;
            [aside + 2.0 * (x / 25.0 - 0.5).powi(2), 0.0, aside]
        };
        let map = read(&table(bent), "smooth", Lie::Fitted).unwrap();
        assert_eq!(map.along, 1);
        assert!(map.place_mm.left < 0.02, "{:?}", map.place_mm.left);
        assert!(map.place_mm.before > 0.05, "{:?}", map.place_mm.before);
        let at = |x: f64| map.of_place(&nalgebra::Point3::new(x, -0.03, 0.012)).x;
        // The parabola's end over its middle, 0.5 mm.
        // With the guide at 25 and at 12.5 mm, where depth bends by 0.64 mm and the tip lies 1 mm aside.
        let rise = at(27.14e-3) - at(14.14e-3);
        assert!((rise - 0.5e-3).abs() < 0.05e-3, "{rise}");
        // Exact: the lie is the field's.
        let exact = read(&table(bent), "exact", Lie::Exact).unwrap();
        assert!(exact.place_mm.before > 2.0);
    }

    #[test]
    fn what_is_wrong_is_named_with_file_row_and_column() {
        let none = |_: f64, _: f64, _: f64| [0.0; 3];
        let good = table(none);
        let problem = |text: &str| {
            let refused = read(text, "wrong", Lie::Fitted).unwrap_err();
            refused.to_string()
        };
        let broken = good.replacen("20,0,0,", "20,0,x,", 1);
        let told = problem(&broken);
        assert!(
            told.contains(".csv:38: guide_z_mm: expected a finite number"),
            "{told}"
        );
        let told = problem(&good.replacen("guide_x_mm", "guide_x", 1));
        assert!(
            told.contains(".csv:1: column `guide_x` has no unit"),
            "{told}"
        );
        let told = problem(&good.replacen("axis_x", "axes_x", 1));
        assert!(told.contains("did you mean `axis_x`?"), "{told}");
        let told = problem(&good.replacen("guide_x_mm", "_guide_x_mm", 1));
        assert!(told.contains("the columns guide_x_m are missing"), "{told}");
        let told = problem(&good.replacen("0.02,-0.9996,0.02", "0.0,-0.1,0.0", 1));
        assert!(
            told.contains(":2: axis_x: expected a direction of length 1"),
            "{told}"
        );
        let few: String = good
            .lines()
            .take(30)
            .flat_map(|line| [line, "\n"])
            .collect();
        let told = problem(&few);
        assert!(told.contains("29 rows"), "{told}");
    }
}
