//! The tip along the needle's axis, from the fall of its darkness.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

use super::background::Background;
use super::curve::{Curve2, normal, weights_and_slopes};
use super::section::{beside, mass};
use super::silhouette::{Falloff, TipView, WHOLE};
use super::taper;
use core::hint::black_box;
use hal::GrayImage;
use nalgebra::Vector2;

/// Most stations along the axis.
const STATIONS: usize = 96;

/// Where the tip was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TipFix {
    /// O ahead of the curve's end, along its tangent \[px\].
    pub shift: f64,
    /// Its standard deviation by noise and misfit \[px\].
    pub sigma: f64,
    /// Misfit relative to the shaft's darkness.
    pub misfit: f64,
    /// How the bevel is turned, as given or found.
    pub side: f64,
    /// What [`super::silhouette::leaning`] is of this tip; nothing without a bevel.
    pub leaning: Option<f64>,
}

/// How the tip is sought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TipSearch {
    /// Width of the shaft \[px\].
    pub width: f64,
    /// Farthest shift either way \[px\].
    pub reach: f64,
    /// Length of the bevel in the image \[px\].
    pub bevel_px: f64,
    /// How the bevel is turned, if known: see [`TipView::side`]; the sign does not matter.
    pub side: Option<f64>,
    /// See [`TipView::rim_px`].
    pub rim_px: f64,
    /// Blur of the image \[px\].
    pub blur: f64,
    /// The tip tapers in a way that is not known: see [`taper`].
    pub tapers: bool,
}

/// Darkness summed across the needle, by distance from the curve's end.
struct Run {
    start: f64,
    /// Distance of the stations: a pixel, more where there are too many pixels \[px\].
    step: f64,
    masses: [f64; STATIONS],
    /// First moments about the axis.
    moments: [f64; STATIONS],
    count: usize,
}

fn run(
    image: &GrayImage,
    background: &Background,
    curve: &Curve2,
    search: &TipSearch,
) -> Option<Run> {
    let speed = curve.derivative(1.0).norm();
    let tangent = curve.derivative(1.0) / speed;
    let tip = curve.tip();
    let across = (0.5 * search.width + 1.5).round();
    let behind = behind(search.reach, curve).floor();
    let ahead = (search.reach + search.bevel_px + 3.0 * search.blur + 2.0).ceil();
    let step = ((behind + ahead) / (STATIONS - 1) as f64).max(1.0);
    let count = (((behind + ahead) / step) as usize + 1).min(STATIONS);
    let mut run = Run {
        start: -behind,
        step,
        masses: [0.0; STATIONS],
        moments: [0.0; STATIONS],
        count,
    };
    let mut stations = [(Vector2::zeros(), Vector2::zeros()); STATIONS];
    let mut read = 0.0;
    for (k, station) in stations.iter_mut().enumerate().take(count) {
        let u = run.place(k);
        let (centre, direction) = if u < 0.0 {
            let (row, slopes) = weights_and_slopes(curve.control_points().len(), 1.0 + u / speed);
            (curve.sum(&row), curve.sum(&slopes).normalize())
        } else {
            (tip + tangent * u, tangent)
        };
        *station = (centre, normal(&direction));
    }
    for (centre, aside) in stations.iter().take(count) {
        let far = across + 2.5;
        read += background.touch(image, centre - aside * far, *aside, 2.0 * far);
    }
    black_box(read);
    let places = run.masses.iter_mut().zip(&mut run.moments);
    for ((value, moment), (centre, aside)) in places.zip(stations).take(count) {
        let even = beside(image, background, centre, aside, across + 1.5)?;
        let darkness = mass(image, background, centre, aside, across as usize, even)?;
        [*value, *moment] = darkness.map(|darkness| darkness / even);
    }
    Some(run)
}

/// How far behind the end of `curve` the shaft is compared with it \[px\].
pub(super) fn behind(reach: f64, curve: &Curve2) -> f64 {
    (reach + 8.0).min(0.8 * curve.derivative(1.0).norm())
}

/// Finds the tip near the end of `curve`; nothing where no fall of the darkness fits.
pub(super) fn find(
    image: &GrayImage,
    background: &Background,
    curve: &Curve2,
    search: &TipSearch,
) -> Option<TipFix> {
    if search.tapers {
        return taper::find(image, background, curve, search.width, search.reach);
    }
    let run = run(image, background, curve, search)?;
    let fit = |side: f64| fit(&run, search, side.abs());
    let fix = match search.side {
        Some(side) => fit(side),
        None if search.bevel_px < 1.0 => fit(1.0),
        None => [0.0, 0.3, 0.6, 0.85, 1.0]
            .into_iter()
            .filter_map(fit)
            .min_by(|a, b| a.misfit.total_cmp(&b.misfit)),
    }?;
    Some(TipFix {
        leaning: run.leaning(fix.shift, search),
        ..fix
    })
}

impl Run {
    /// Station `k` ahead of the curve's end \[px\].
    fn place(&self, k: usize) -> f64 {
        self.start + self.step * k as f64
    }

    /// See [`TipFix::leaning`]; O is `shift` ahead of the curve's end.
    fn leaning(&self, shift: f64, search: &TipSearch) -> Option<f64> {
        /// Where the shaft just behind O is measured \[px\].
        const SHAFT: [f64; 2] = [-8.0, -2.0];
        /// Shortest bevel whose turn can be seen \[px\].
        const SHORTEST: f64 = 3.0;
        if search.bevel_px < SHORTEST {
            return None;
        }
        let sum = |from: f64, to: f64| {
            let mut sum = [0.0; 3];
            for k in 0..self.count {
                let ahead = self.place(k) - shift;
                // A station stands for the pixels around it; at the ends it counts by its part within.
                let half = 0.5 * self.step;
                let share = (ahead - from + half)
                    .min(to - ahead + half)
                    .clamp(0.0, self.step);
                sum[0] += share;
                sum[1] += share * self.masses[k];
                sum[2] += share * self.moments[k];
            }
            sum
        };
        let [stations, mass, moment] = sum(SHAFT[0], SHAFT[1]);
        if stations < 3.0 || mass <= 0.0 {
            return None;
        }
        let beside = moment / mass;
        let end = search.bevel_px + 3.0 * search.blur;
        let [_, tail, turned] = sum(WHOLE * search.bevel_px, end);
        let unit = 0.25 * mass / stations * search.width * search.bevel_px;
        Some((turned - beside * tail) / unit)
    }
}

fn fit(run: &Run, search: &TipSearch, side: f64) -> Option<TipFix> {
    let view = TipView {
        bevel_px: search.bevel_px,
        side,
        rim_px: search.rim_px,
    };
    let falloff = Falloff::new(&view, search.blur);
    let masses = run.masses.get(..run.count)?;
    let yy: f64 = masses.iter().map(|y| y * y).sum();
    // Sums of the stations before each: behind the fall-off the silhouette is 1.
    let mut before = [0.0; STATIONS + 1];
    for (k, y) in masses.iter().enumerate() {
        before[k + 1] = before[k] + y;
    }
    let falling = |shift: f64| {
        let [from, to] = falloff.span().map(|u| (u + shift - run.start) / run.step);
        let to = (to.max(0.0) as usize + 2).min(run.count);
        (from as usize).min(to)..to
    };
    // Amplitude and misfit at one shift; the amplitude enters linearly.
    let judge = |shift: f64| {
        let falling = falling(shift);
        let (mut ss, mut sy) = (falling.start as f64, before[falling.start]);
        for k in falling {
            let (s, _) = falloff.at(run.place(k) - shift);
            ss += s * s;
            sy += s * masses[k];
        }
        let amplitude = if ss > 0.0 { sy / ss } else { 0.0 };
        (amplitude, yy - amplitude * sy)
    };
    let mut best = (0.0, f64::INFINITY);
    let mut shift = -search.reach;
    while shift <= search.reach {
        let (amplitude, misfit) = judge(shift);
        if amplitude > 0.0 && misfit < best.1 {
            best = (shift, misfit);
        }
        shift += 0.5;
    }
    let mut shift = best.0;
    let mut slopes = 0.0;
    for _ in 0..4 {
        let (amplitude, _) = judge(shift);
        let (mut gradient, mut curvature) = (0.0, 0.0);
        for k in falling(shift) {
            let (s, slope) = falloff.at(run.place(k) - shift);
            gradient += -amplitude * slope * (masses[k] - amplitude * s);
            curvature += (amplitude * slope).powi(2);
        }
        if curvature <= 0.0 {
            return None;
        }
        slopes = curvature;
        let step = (gradient / curvature).clamp(-0.5, 0.5);
        shift += step;
        if step.abs() < 1e-4 {
            break;
        }
    }
    let (amplitude, squares) = judge(shift);
    // The shaft must be as dark as a needle: an empty run fits anything.
    if amplitude < 0.1 * search.width || shift.abs() > search.reach + 0.5 {
        return None;
    }
    let scatter = (squares.max(0.0) / (masses.len() - 2) as f64).sqrt();
    Some(TipFix {
        shift,
        sigma: scatter / slopes.sqrt(),
        misfit: scatter / amplitude,
        side,
        leaning: None,
    })
}
