//! Asymmetric grids of circles: rows of discs, every other one shifted by half their distance.

mod blobs;

use std::collections::BTreeMap;

use hal::GrayImage;
use nalgebra::{Point2, Vector2};

use super::BoardSize;
use super::board::BoardNotFound;
use super::find::levels;
use crate::homography::{homography, map};
use blobs::{Blob, blobs, centre};

/// A disc further than this from where its neighbours put it is another one, in parts of their
/// distance.
const NEAR: f64 = 0.3;
/// Greatest ratio of the areas of neighbouring discs.
const AREAS: f64 = 1.8;
/// Greatest part of the neighbours' distance by which a disc departs from a plane behind a
/// pinhole: a lens's distortion.
const BENT: f64 = 0.35;
/// Discs from which a grid is grown until one is whole.
const SEEDS: usize = 40;
/// Entries of the change from a grown grid's axes to the board's: its axes are short vectors of
/// the same lattice.
const ENTRIES: core::ops::RangeInclusive<i32> = -2..=2;

/// Places of a board's discs: column and row of each, row by row, in steps of a row.
fn places(size: BoardSize) -> impl Iterator<Item = (i32, i32)> {
    size.indices().filter_map(|(col, row)| {
        let x = i32::try_from(2 * col + row % 2).ok()?;
        Some((x, i32::try_from(row).ok()?))
    })
}

/// Finds an asymmetric grid of dark circles on bright ground, or of bright ones on dark, and their
/// centres row by row \[px\], as OpenCV orders them. A circle's centre is that of its ellipse.
///
/// # Errors
/// No grid of exactly this size.
pub fn detect_circles(
    image: &GrayImage,
    size: BoardSize,
) -> Result<Vec<Point2<f64>>, BoardNotFound> {
    if size.cols < 2 || size.rows < 3 {
        return Err(BoardNotFound::TooSmall {
            cols: size.cols,
            rows: size.rows,
        });
    }
    let mut most = (0, 0);
    for inverted in [false, true] {
        let turned;
        let ground = if inverted {
            turned = negative(image);
            &turned
        } else {
            image
        };
        for scaled in levels(ground) {
            let discs = blobs(&scaled.image);
            let grown = match grid(&discs, size) {
                Ok(found) => found,
                Err(seen) => {
                    most = most.max((seen, discs.len()));
                    continue;
                }
            };
            let factor = 2.0_f64.powi(scaled.steps);
            let refine = |k: usize| {
                let blob = Blob {
                    at: scaled.in_whole(&discs[k].at),
                    area: discs[k].area * factor * factor,
                    spread: discs[k].spread * factor * factor,
                };
                centre(ground, &blob)
            };
            return Ok(grown.into_iter().map(refine).collect());
        }
    }
    Err(BoardNotFound::NoCircles {
        expected: size.count(),
        found: most.0,
        discs: most.1,
    })
}

fn negative(image: &GrayImage) -> GrayImage {
    let mut out = image.clone();
    for v in out.pixels_mut() {
        *v = 255 - *v;
    }
    out
}

/// The discs of the board in its order; else the most that hung together.
fn grid(discs: &[Blob], size: BoardSize) -> Result<Vec<usize>, usize> {
    if discs.len() < size.count() {
        return Err(discs.len());
    }
    let sum = discs.iter().fold(Vector2::zeros(), |s, d| s + d.at.coords);
    let middle = Point2::from(sum / discs.len() as f64);
    let mut seeds: Vec<usize> = (0..discs.len()).collect();
    seeds.sort_by(|&a, &b| {
        let distance = |k: usize| (discs[k].at - middle).norm();
        distance(a).total_cmp(&distance(b))
    });
    let mut most = 0;
    for seed in seeds.into_iter().take(SEEDS) {
        let Some(axes) = axes(discs, seed) else {
            continue;
        };
        let grown = grow(discs, seed, axes);
        most = most.max(grown.len());
        if grown.len() == size.count()
            && let Some(found) = ordered(discs, &grown, axes, size)
        {
            return Ok(found);
        }
    }
    Err(most)
}

/// Two neighbours of a disc that span its lattice: the nearest, and the nearest across.
fn axes(discs: &[Blob], seed: usize) -> Option<[Vector2<f64>; 2]> {
    let mut around: Vec<Vector2<f64>> = (0..discs.len())
        .filter(|&k| k != seed && alike(&discs[k], &discs[seed]))
        .map(|k| discs[k].at - discs[seed].at)
        .collect();
    around.sort_by(|a, b| a.norm().total_cmp(&b.norm()));
    let first = *around.first()?;
    // Thirty degrees and more: not the next but one in the same direction.
    let across = around
        .iter()
        .skip(1)
        .find(|v| v.perp(&first).abs() > 0.5 * v.norm() * first.norm())?;
    Some([first, *across])
}

fn alike(a: &Blob, b: &Blob) -> bool {
    a.area < AREAS * b.area && b.area < AREAS * a.area
}

type Labels = BTreeMap<(i32, i32), usize>;

/// Everything that hangs together with a disc, each where its neighbours put it.
fn grow(discs: &[Blob], seed: usize, axes: [Vector2<f64>; 2]) -> Labels {
    let mut labels = Labels::from([((0, 0), seed)]);
    let mut taken = vec![false; discs.len()];
    taken[seed] = true;
    // Nearest first, each with the axes as they were there.
    let mut queue = std::collections::VecDeque::from([((0, 0), seed, axes)]);
    while let Some(((m, n), k, axes)) = queue.pop_front() {
        for (axis, sign) in [(0, 1), (1, 1), (0, -1), (1, -1)] {
            let label = if axis == 0 {
                (m + sign, n)
            } else {
                (m, n + sign)
            };
            if labels.contains_key(&label) {
                continue;
            }
            let step = axes[axis] * f64::from(sign);
            let guess = discs[k].at + step;
            let next = (0..discs.len())
                .filter(|&j| !taken[j] && alike(&discs[j], &discs[k]))
                .map(|j| (j, (discs[j].at - guess).norm()))
                .filter(|(_, miss)| *miss < NEAR * step.norm())
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((next, _)) = next else { continue };
            taken[next] = true;
            labels.insert(label, next);
            let mut there = axes;
            there[axis] = (discs[next].at - discs[k].at) * f64::from(sign);
            queue.push_back((label, next, there));
        }
    }
    labels
}

/// The discs in the board's order, where the grown labels are exactly the board's in other axes.
fn ordered(
    discs: &[Blob],
    grown: &Labels,
    axes: [Vector2<f64>; 2],
    size: BoardSize,
) -> Option<Vec<usize>> {
    // The lattice's own axes: one step right and down, one right and up.
    let diagonal = |(x, y): (i32, i32)| ((x + y).div_euclid(2), (x - y).div_euclid(2));
    let wanted: Vec<(i32, i32)> = places(size).map(diagonal).collect();
    let low = |all: &mut dyn Iterator<Item = (i32, i32)>| {
        all.fold((i32::MAX, i32::MAX), |l, p| (l.0.min(p.0), l.1.min(p.1)))
    };
    let origin = low(&mut wanted.iter().copied());
    // Seen from the front, x turns to y as in the image.
    let turn = if axes[0].perp(&axes[1]) > 0.0 { -1 } else { 1 };
    let mut best: Option<(f64, Vec<usize>)> = None;
    for entries in changes().filter(|[a, b, c, d]| a * d - b * c == turn) {
        let [a, b, c, d] = entries;
        let change = |(m, n): (i32, i32)| (a * m + b * n, c * m + d * n);
        let first = low(&mut grown.keys().map(|&p| change(p)));
        let moved: Labels = grown
            .iter()
            .map(|(&p, &k)| {
                let (u, v) = change(p);
                ((u - first.0 + origin.0, v - first.1 + origin.1), k)
            })
            .collect();
        let Some(order) = wanted
            .iter()
            .map(|p| moved.get(p).copied())
            .collect::<Option<Vec<usize>>>()
        else {
            continue;
        };
        // With an even number of rows two ends are alike: the first is the upper left one.
        let corner = order
            .first()
            .map_or(0.0, |&k| discs[k].at.x + discs[k].at.y);
        if flat(discs, &order, size) && best.as_ref().is_none_or(|(least, _)| corner < *least) {
            best = Some((corner, order));
        }
    }
    best.map(|(_, order)| order)
}

/// All changes of axes with small entries.
fn changes() -> impl Iterator<Item = [i32; 4]> {
    ENTRIES.flat_map(|a| {
        ENTRIES.flat_map(move |b| ENTRIES.flat_map(move |c| ENTRIES.map(move |d| [a, b, c, d])))
    })
}

/// Whether every disc lies where a lens images a plane.
fn flat(discs: &[Blob], order: &[usize], size: BoardSize) -> bool {
    let plane: Vec<Point2<f64>> = places(size)
        .map(|(x, y)| Point2::new(f64::from(x), f64::from(y)))
        .collect();
    let seen: Vec<Point2<f64>> = order.iter().map(|&k| discs[k].at).collect();
    let Some(h) = homography(&plane, &seen) else {
        return false;
    };
    plane.iter().zip(&seen).all(|(p, at)| {
        let here = map(&h, p);
        let step = (map(&h, &(p + Vector2::new(1.0, 1.0))) - here).norm();
        (here - at).norm() < BENT * step
    })
}
