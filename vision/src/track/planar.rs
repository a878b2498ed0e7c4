//! One image's curve and its Kalman filter.
//!
//! The curve is a graph over its chord: the control points are spread evenly along the chord, so
//! that each has one degree of freedom, across it; the tip has a second one, along it, with the
//! insertion speed beside. Normals then measure the control points linearly, and nothing
//! slides along the curve unobserved.

use hal::GrayImage;
use nalgebra::{Matrix2, Point2, Vector2};

use super::across::crossing;
use super::polynomial::{Covariance, MAX_POINTS, Values, basis, basis_slope, dot, resampling};
use super::settings::TrackSettings;
use super::tip::{Profile, TipMark, TipModel};

/// Innovation gate: 99.9 % of a Gaussian.
const GATE: f64 = 3.29;

/// The curve in one image: a point at x along the chord lies y(x) across it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Graph {
    pub origin: Point2<f64>,
    pub axis: Vector2<f64>,
    pub length: f64,
    pub n: usize,
    pub y: Values,
    pub cov: Covariance,
}

impl Graph {
    pub(super) fn straight(base: Point2<f64>, tip: Point2<f64>, n: usize, sigma: f64) -> Self {
        let chord = tip - base;
        let length = chord.norm().max(1e-6);
        Self {
            origin: base,
            axis: chord / length,
            length,
            n,
            y: [0.0; MAX_POINTS],
            cov: Covariance::identity() * sigma * sigma,
        }
    }

    pub(super) fn across(&self) -> Vector2<f64> {
        Vector2::new(-self.axis.y, self.axis.x)
    }

    pub(super) fn height(&self, x: f64) -> f64 {
        dot(&basis(self.n, x / self.length), &self.y)
    }

    pub(super) fn slope(&self, x: f64) -> f64 {
        dot(&basis_slope(self.n, x / self.length), &self.y) / self.length
    }

    pub(super) fn point(&self, x: f64) -> Point2<f64> {
        self.origin + self.axis * x + self.across() * self.height(x)
    }

    /// Unit tangent towards the tip.
    pub(super) fn tangent(&self, x: f64) -> Vector2<f64> {
        (self.axis + self.across() * self.slope(x)).normalize()
    }

    pub(super) fn local(&self, p: Point2<f64>) -> (f64, f64) {
        let d = p - self.origin;
        (d.dot(&self.axis), d.dot(&self.across()))
    }

    fn map(&mut self, m: &Covariance) {
        let y = nalgebra::SVector::<f64, MAX_POINTS>::from(self.y);
        self.y = (m * y).into();
        self.cov = m * self.cov * m.transpose();
    }

    /// Spreads the control points over `base..tip` of the present chord.
    pub(super) fn spread(&mut self, base: f64, tip: f64) {
        let (n, length) = (self.n, self.length);
        let m = resampling(n, |t| (base + t * (tip - base)) / length);
        self.map(&m);
        self.origin += self.axis * base;
        self.length = tip - base;
    }

    /// Turns the chord back through base and tip when it has turned away.
    fn straighten(&mut self) {
        let turn = (self.y[self.n - 1] - self.y[0]) / self.length;
        if turn.abs() < 0.03 && self.y[0].abs() < 0.02 * self.length {
            return;
        }
        let (from, to) = (self.point(0.0), self.point(self.length));
        let mut next = Self::straight(from, to, self.n, 0.0);
        let last = (self.n - 1) as f64;
        let mut place = [0.0; MAX_POINTS];
        for i in 0..self.n {
            let wanted = next.length * i as f64 / last;
            let mut x = self.length * i as f64 / last;
            for _ in 0..4 {
                let along = next.local(self.point(x)).0;
                x += (wanted - along) / self.tangent(x).dot(&next.axis).max(0.2);
            }
            place[i] = x / self.length;
            next.y[i] = next.local(self.point(x)).1;
        }
        let m = resampling(self.n, |t| {
            let i = (t * last).round();
            (0..self.n).find(|&k| k as f64 == i).map_or(t, |k| place[k])
        });
        next.cov = m * self.cov * m.transpose();
        *self = next;
    }

    /// The same curve on another number of control points.
    fn set_points(&mut self, n: usize, sigma: f64) {
        let mut m = Covariance::zeros();
        for i in 0..n {
            let l = basis(self.n, i as f64 / (n - 1) as f64);
            for j in 0..self.n {
                m[(i, j)] = l[j];
            }
        }
        self.map(&m);
        for i in 0..n {
            self.cov[(i, i)] += sigma * sigma;
        }
        self.n = n;
    }
}

/// A point of the shaft that was seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mark {
    pub x: f64,
    pub y: f64,
    pub px: Point2<f64>,
    pub sigma: f64,
    pub contrast: f64,
    /// Tukey's weight, 0 for outliers.
    pub weight: f64,
}

/// Whether and how the tip was measured in the newest image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TipState {
    Measured,
    /// Seen where it cannot be, by prediction.
    Gated,
    Unseen,
}

/// The tracker of one image.
#[derive(Clone, Debug)]
pub(super) struct Planar {
    pub graph: Graph,
    /// Variance of the tip along the chord \[px2\], of its speed \[px2/s2\], and between.
    pub tip_cov: Matrix2<f64>,
    pub speed: f64,
    pub marks: Vec<Mark>,
    pub contrast: Option<f64>,
    pub width: f64,
    pub blur: f64,
    pub model: TipModel,
    pub tip_state: TipState,
    /// Images in a row in which the tip was gated, and where it was then.
    gated: (u32, f64),
    pub survivors: f64,
    /// Mean squared innovation of the shaft in units of its variance.
    pub innovation: f64,
    misfit: u32,
    /// What the polynomial cannot follow, squared \[px2\].
    pub bend: f64,
    profile: Profile,
    scratch: Vec<f64>,
}

impl Planar {
    pub(super) fn new(settings: &TrackSettings) -> Self {
        let nowhere = Graph::straight(Point2::origin(), Point2::new(1.0, 0.0), 4, 1.0);
        Self {
            graph: nowhere,
            tip_cov: Matrix2::identity(),
            speed: 0.0,
            marks: Vec::with_capacity(settings.normals),
            contrast: None,
            width: 3.0,
            blur: 1.0,
            model: TipModel::new(),
            tip_state: TipState::Unseen,
            gated: (0, 0.0),
            survivors: 0.0,
            innovation: 0.0,
            misfit: 0,
            bend: 0.0,
            profile: Profile::new(),
            scratch: Vec::with_capacity(settings.normals),
        }
    }

    /// Starts on a straight line, known to about `sigma`.
    pub(super) fn start(&mut self, base: Point2<f64>, tip: Point2<f64>, n: usize, sigma: f64) {
        self.graph = Graph::straight(base, tip, n, sigma);
        self.tip_cov = Matrix2::new(sigma * sigma, 0.0, 0.0, 900.0);
        self.speed = 0.0;
        self.contrast = None;
        self.gated = (0, 0.0);
        self.misfit = 0;
        self.bend = 0.0;
        self.tip_state = TipState::Unseen;
    }

    /// Time update. `advance`: the tip along the curve \[px\], where odometry knows it.
    pub(super) fn predict(&mut self, dt: f64, advance: Option<f64>, settings: &TrackSettings) {
        let frames = (dt * 30.0).clamp(0.2, 15.0);
        let f = Matrix2::new(1.0, dt, 0.0, 1.0);
        let drift = settings.tip_drift_px.powi(2) * frames;
        let step = if let Some(step) = advance {
            self.tip_cov[(0, 0)] += drift;
            self.speed = step / dt.max(1e-3);
            self.tip_cov[(0, 1)] = 0.0;
            self.tip_cov[(1, 0)] = 0.0;
            step
        } else {
            self.tip_cov = f * self.tip_cov * f.transpose();
            self.tip_cov[(0, 0)] += drift;
            // Speeds change by a few pixels a second from image to image.
            self.tip_cov[(1, 1)] += 9.0 * frames;
            self.speed * dt
        };
        let tip = (self.graph.length + step).max(4.0 * self.width);
        self.graph.spread(0.0, tip);
        let q = settings.lateral_drift_px.powi(2) * frames;
        for i in 0..self.graph.n {
            self.graph.cov[(i, i)] += q;
        }
        self.graph.straighten();
    }

    /// Measurement update; false when the shaft is not seen.
    pub(super) fn update(
        &mut self,
        image: &GrayImage,
        settings: &TrackSettings,
        wide: f64,
    ) -> bool {
        let search = settings.search_widths * self.width * wide;
        self.look(image, settings.normals, search);
        let n = self.graph.n;
        let enough = settings.min_survivors * settings.normals as f64;
        if (self.marks.len() as f64) < enough || !self.reject(n) {
            self.survivors = self.marks.len() as f64 / settings.normals as f64;
            self.tip_state = TipState::Unseen;
            return false;
        }
        let alive = self.marks.iter().filter(|m| m.weight > 0.1).count() as f64;
        self.survivors = alive / settings.normals as f64;
        if alive < enough {
            self.tip_state = TipState::Unseen;
            return false;
        }
        self.correct();
        self.raise_order(settings);
        self.note_contrast();
        true
    }

    fn look(&mut self, image: &GrayImage, normals: usize, search: f64) {
        self.marks.clear();
        let end = (self.graph.length - 0.6 * self.width).max(0.5 * self.graph.length);
        for i in 0..normals {
            let x = end * (i as f64 + 0.5) / normals as f64;
            let tangent = self.graph.tangent(x);
            let normal = Vector2::new(-tangent.y, tangent.x);
            let centre = self.graph.point(x);
            let size = (self.width, self.blur);
            let found = crossing(image, centre, normal, size, search, self.contrast);
            if let Some(c) = found {
                let px = centre + normal * c.offset;
                let (x, y) = self.graph.local(px);
                self.marks.push(Mark {
                    x,
                    y,
                    px,
                    sigma: c.sigma,
                    contrast: c.contrast,
                    weight: 1.0,
                });
            }
        }
    }

    /// Tukey's biweight about a polynomial of `n` points; false if it cannot be fitted.
    fn reject(&mut self, n: usize) -> bool {
        let mut scale = f64::INFINITY;
        for iteration in 0..6 {
            // Huber's weights first, that the start decides nothing.
            let mut a = Covariance::identity() * 1e-9;
            let mut g = [0.0; MAX_POINTS];
            for m in &self.marks {
                if m.weight <= 0.0 {
                    continue;
                }
                let l = basis(n, m.x / self.graph.length);
                let w = m.weight / (m.sigma * m.sigma + 0.01);
                let e = m.y - dot(&l, &self.graph.y);
                for i in 0..n {
                    g[i] += w * l[i] * e;
                    for j in 0..n {
                        a[(i, j)] += w * l[i] * l[j];
                    }
                }
            }
            let Some(c) = a.cholesky() else { return false };
            let step: Values = c.solve(&nalgebra::SVector::from(g)).into();
            self.scratch.clear();
            for m in &self.marks {
                let l = basis(n, m.x / self.graph.length);
                self.scratch
                    .push(m.y - dot(&l, &self.graph.y) - dot(&l, &step));
            }
            let residuals = &mut self.scratch;
            let mut k = 0;
            for m in &mut self.marks {
                let e = residuals[k].abs();
                k += 1;
                m.weight = if iteration < 3 {
                    let s = if scale.is_finite() { scale } else { 1.0 };
                    (1.5 * s / e.max(1e-9)).min(1.0)
                } else {
                    let z = e / (4.685 * scale.hypot(m.sigma));
                    if z < 1.0 { (1.0 - z * z).powi(2) } else { 0.0 }
                };
            }
            for r in residuals.iter_mut() {
                *r = r.abs();
            }
            let middle = residuals.len() / 2;
            residuals.select_nth_unstable_by(middle, f64::total_cmp);
            scale = (1.4826 * residuals[middle]).max(0.05);
        }
        true
    }

    /// Scalar Kalman updates with the surviving marks.
    fn correct(&mut self) {
        let n = self.graph.n;
        let (mut sum, mut count) = (0.0, 0.0);
        for m in self.marks.iter().filter(|m| m.weight > 0.1) {
            let l = basis(n, m.x / self.graph.length);
            let l = nalgebra::SVector::<f64, MAX_POINTS>::from(l);
            let r = self.variance(m);
            let pl = self.graph.cov * l;
            let s = l.dot(&pl) + r;
            let y = nalgebra::SVector::<f64, MAX_POINTS>::from(self.graph.y);
            let e = m.y - l.dot(&y);
            sum += e * e / s;
            count += 1.0;
            self.graph.y = (y + pl * (e / s)).into();
            self.graph.cov -= pl * pl.transpose() / s;
        }
        self.innovation = sum / f64::max(count, 1.0);
    }

    /// Variance of a mark: its own, and where the polynomial cannot follow the needle its misfit,
    /// the more the further from the tip, where it matters least.
    pub(super) fn variance(&self, m: &Mark) -> f64 {
        let far = 4.0 * (1.0 - m.x / self.graph.length).clamp(0.0, 1.0);
        m.sigma * m.sigma / m.weight + self.bend * far * far
    }

    /// Four points do not do when neighbouring residuals agree: then a fifth and sixth.
    fn raise_order(&mut self, settings: &TrackSettings) {
        let (mut square, mut pairs, mut count, mut last) = (0.0, 0.0, 0.0, None);
        for m in self.marks.iter().filter(|m| m.weight > 0.1) {
            let e = m.y - self.graph.height(m.x);
            square += e * e;
            if let Some(p) = last {
                pairs += p * e;
            }
            last = Some(e);
            count += 1.0;
        }
        let together: f64 = pairs / f64::max(count, 1.0);
        let bent = together > 0.04_f64.powi(2) && together > 0.35 * square / f64::max(count, 1.0);
        let seen = if bent { together } else { 0.0 };
        self.bend += 0.3 * (seen - self.bend);
        self.misfit = if bent {
            self.misfit + 1
        } else {
            self.misfit.saturating_sub(1)
        };
        if self.misfit >= 2 && self.graph.n < MAX_POINTS.max(settings.control_points) {
            self.graph.set_points(self.graph.n + 1, 0.5);
            self.misfit = 0;
            self.correct();
        }
    }

    fn note_contrast(&mut self) {
        self.scratch.clear();
        let alive = self.marks.iter().filter(|m| m.weight > 0.1);
        self.scratch.extend(alive.map(|m| m.contrast));
        let middle = self.scratch.len() / 2;
        if let Some(m) = self.scratch.get(middle).copied() {
            self.scratch.select_nth_unstable_by(middle, f64::total_cmp);
            let seen = self.scratch.get(middle).copied().unwrap_or(m);
            self.contrast = Some(self.contrast.map_or(seen, |c| c + 0.2 * (seen - c)));
        }
    }

    /// The tip along the tangent at the predicted tip, with the model as built.
    pub(super) fn look_for_tip(&mut self, image: &GrayImage, search: f64) -> Option<TipMark> {
        let graph = self.graph;
        let at = graph.length;
        let (end, tangent) = (graph.point(at), graph.tangent(at));
        let along = tangent.dot(&graph.axis);
        let normal = Vector2::new(-tangent.y, tangent.x);
        let place = |v: f64| {
            if v >= 0.0 {
                (end + tangent * v, normal)
            } else {
                (graph.point(at + v * along), normal)
            }
        };
        let contrast = self.contrast?;
        self.profile
            .locate(image, place, &self.model, contrast, search)
    }

    /// Takes a measured tip, if the prediction allows it or has been contradicted long enough.
    pub(super) fn take_tip(&mut self, mark: Option<TipMark>, systematic: f64, patience: u32) {
        let Some(mark) = mark else {
            self.tip_state = TipState::Unseen;
            return;
        };
        let along = self.graph.tangent(self.graph.length).dot(&self.graph.axis);
        let innovation = mark.offset * along;
        let r = (mark.sigma * along).powi(2) + systematic * systematic;
        let s = self.tip_cov[(0, 0)] + r;
        if innovation.abs() > GATE * s.sqrt() + 0.3 {
            let same = (innovation - self.gated.1).abs() < 1.5 + 0.2 * self.width;
            self.gated = (if same { self.gated.0 + 1 } else { 1 }, innovation);
            // Beyond a bubble that merges with the tip: only a clear jump is believed.
            let clear = innovation.abs() > 2.0 * self.width
                && mark.misfit < 0.1
                && self.continuous(innovation);
            if self.gated.0 < patience || !clear {
                self.tip_state = TipState::Gated;
                return;
            }
            self.tip_cov[(0, 0)] = innovation * innovation;
        }
        self.gated = (0, 0.0);
        let s = self.tip_cov[(0, 0)] + r;
        let gain = self.tip_cov.column(0) / s;
        let step = gain[0] * innovation;
        self.speed += gain[1] * innovation;
        let row = self.tip_cov.row(0).into_owned();
        self.tip_cov -= gain * row;
        self.graph
            .spread(0.0, (self.graph.length + step).max(2.0 * self.width));
        self.tip_state = TipState::Measured;
    }

    /// Whether the shaft's end agrees with a jump: seen up to the prediction if it grew, unseen
    /// beyond the new tip if it shrank.
    fn continuous(&self, innovation: f64) -> bool {
        let end = self.graph.length + innovation.min(0.0);
        let beyond = self
            .marks
            .iter()
            .filter(|m| m.weight > 0.1 && m.x > end + self.width)
            .count();
        innovation > 0.0 || beyond < 3
    }

    /// Places the tip where the other image says it is.
    pub(super) fn set_tip(&mut self, px: Point2<f64>, variance: f64) {
        let (x, _) = self.graph.local(px);
        if x > 2.0 * self.width {
            self.graph.spread(0.0, x);
            self.tip_cov[(0, 0)] = variance;
        }
    }

    /// The tip's pixel.
    pub(super) fn tip(&self) -> Point2<f64> {
        self.graph.point(self.graph.length)
    }

    /// Its covariance \[px2\].
    pub(super) fn tip_covariance(&self, systematic: f64) -> Matrix2<f64> {
        let g = &self.graph;
        let l = nalgebra::SVector::<f64, MAX_POINTS>::from(basis(g.n, 1.0));
        let lateral = (l.transpose() * g.cov * l)[(0, 0)] + systematic * systematic;
        let t = g.axis + g.across() * g.slope(g.length);
        t * t.transpose() * self.tip_cov[(0, 0)] + g.across() * g.across().transpose() * lateral
    }
}
