//! Exact area coverage of polygons.
//!
//! Every edge adds, in each row it crosses, the area to its right within each pixel; a running
//! sum along the row then yields the signed coverage. It is exact for straight edges, linear
//! (weighted polygons add up, shared edges cancel), and costs only the pixels an edge touches.

use super::lens::Pixel;

/// A plane of floats over the image in which only the columns `spans[y]` of row `y` may be
/// non-zero, so that clearing and reading it cost only what was drawn.
#[derive(Clone, Debug)]
pub(super) struct SparsePlane {
    width: usize,
    height: usize,
    stride: usize,
    values: Vec<f32>,
    spans: Vec<(usize, usize)>,
    rows: (usize, usize),
}

const NO_SPAN: (usize, usize) = (usize::MAX, 0);

impl SparsePlane {
    pub(super) fn new(width: usize, height: usize) -> Self {
        // Two columns beyond the image take what edges spill to their right.
        let stride = width + 2;
        Self {
            width,
            height,
            stride,
            values: vec![0.0; stride * height],
            spans: vec![NO_SPAN; height],
            rows: NO_SPAN,
        }
    }

    /// Width and height \[px\].
    pub(super) const fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Rows that may hold something: `first..end`.
    pub(super) fn rows(&self) -> core::ops::Range<usize> {
        self.rows.0.min(self.rows.1)..self.rows.1
    }

    /// Columns of row `y` that may hold something.
    pub(super) fn span(&self, y: usize) -> core::ops::Range<usize> {
        let (a, b) = self.spans[y];
        a.min(b)..b.min(self.width)
    }

    /// All columns of row `y`, spilled ones included.
    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.stride..(y + 1) * self.stride]
    }

    /// Columns of row `y`, opened for writing in `span`.
    pub(super) fn open(&mut self, y: usize, span: core::ops::Range<usize>) -> &mut [f32] {
        self.touch(y, span.start, span.end);
        &mut self.values[y * self.stride + span.start..y * self.stride + span.end]
    }

    pub(super) fn clear(&mut self) {
        for y in self.rows() {
            let (a, b) = self.spans[y];
            if a < b {
                self.values[y * self.stride + a..y * self.stride + b].fill(0.0);
            }
            self.spans[y] = NO_SPAN;
        }
        self.rows = NO_SPAN;
    }

    fn touch(&mut self, y: usize, start: usize, end: usize) {
        let span = &mut self.spans[y];
        span.0 = span.0.min(start);
        span.1 = span.1.max(end);
        self.rows.0 = self.rows.0.min(y);
        self.rows.1 = self.rows.1.max(y + 1);
    }

    /// Adds a closed polygon, weighted, negative if it runs anticlockwise on the screen; call
    /// [`Self::resolve`] afterwards.
    pub(super) fn polygon(&mut self, mut vertices: impl Iterator<Item = Pixel>, weight: f64) {
        let Some(first) = vertices.next() else { return };
        let mut previous = first;
        for vertex in vertices {
            self.edge(previous, vertex, weight);
            previous = vertex;
        }
        self.edge(previous, first, weight);
    }

    /// Adds a closed polygon with weight one.
    pub(super) fn outline(&mut self, vertices: &mut dyn Iterator<Item = Pixel>) {
        self.polygon(vertices, 1.0);
    }

    /// Turns the differences left by [`Self::polygon`] into coverage.
    pub(super) fn resolve(&mut self) {
        for y in self.rows() {
            let (a, b) = self.spans[y];
            let mut sum = 0.0;
            for value in &mut self.values[y * self.stride + a.min(b)..y * self.stride + b] {
                sum += *value;
                *value = sum;
            }
        }
    }

    fn edge(&mut self, from: Pixel, to: Pixel, weight: f64) {
        // From here on pixel i covers [i, i + 1).
        let (mut p, mut q, mut sign) = (
            [from[0] + 0.5, from[1] + 0.5],
            [to[0] + 0.5, to[1] + 0.5],
            -weight,
        );
        if p[1] > q[1] {
            core::mem::swap(&mut p, &mut q);
            sign = -sign;
        }
        let (w, h) = (self.width as f64, self.height as f64);
        let crosses = p[1] < q[1] && p[1] < h && q[1] > 0.0;
        if !crosses || !(p[0] + q[0]).is_finite() {
            return;
        }
        let slope = (q[0] - p[0]) / (q[1] - p[1]);
        let at = |y: f64| p[0] + slope * (y - p[1]);
        let (top, bottom) = (p[1].max(0.0), q[1].min(h));
        // Cut where the edge leaves the image sideways.
        let mut cuts = [top, bottom, bottom, bottom];
        if slope != 0.0 {
            let left = (p[1] - p[0] / slope).clamp(top, bottom);
            let right = (p[1] + (w - p[0]) / slope).clamp(top, bottom);
            cuts = [top, left.min(right), left.max(right), bottom];
        }
        for pair in cuts.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            if b > a && at(0.5 * (a + b)) < w {
                self.strip(at(a).clamp(0.0, w), a, at(b).clamp(0.0, w), b, sign);
            } else if b > a {
                self.reach_right_border(a, b);
            }
        }
    }

    /// What lies left of an edge beyond the right border is covered up to the border.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "coordinates were clipped to the image"
    )]
    fn reach_right_border(&mut self, top: f64, bottom: f64) {
        for y in top as usize..(bottom.ceil() as usize).min(self.height) {
            self.touch(y, self.width, self.width);
        }
    }

    /// An edge inside the image, downwards.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "coordinates were clipped to the image"
    )]
    fn strip(&mut self, x_top: f64, top: f64, x_bottom: f64, bottom: f64, sign: f64) {
        let slope = (x_bottom - x_top) / (bottom - top);
        let mut y = top;
        let mut x = x_top;
        let mut row = (top as usize).min(self.height - 1);
        while y < bottom && row < self.height {
            let y_next = bottom.min((row + 1) as f64);
            let x_next = (x_top + slope * (y_next - top)).clamp(0.0, self.width as f64);
            self.within_row(row, x.min(x_next), x.max(x_next), sign * (y_next - y));
            (x, y, row) = (x_next, y_next, row + 1);
        }
    }

    /// The part of an edge within one row: `d` is its signed height.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "coordinates were clipped to the image; coverage needs no double precision"
    )]
    fn within_row(&mut self, row: usize, x0: f64, x1: f64, d: f64) {
        let i0 = x0 as usize;
        let i1 = (x1.ceil() as usize).max(i0 + 1);
        self.touch(row, i0, i1 + 1);
        let cells = &mut self.values[row * self.stride + i0..=row * self.stride + i1];
        if cells.len() == 2 {
            let middle = 0.5 * (x0 + x1) - i0 as f64;
            cells[0] += (d * (1.0 - middle)) as f32;
            cells[1] += (d * middle) as f32;
            return;
        }
        // Area to the right of the edge accumulated up to and including each cell.
        let per_column = 1.0 / (x1 - x0);
        let mut before = 0.0;
        for (k, cell) in cells.iter_mut().enumerate() {
            let left = (i0 + k) as f64;
            let covered = |x: f64| {
                // Integral over [left, x] of the fraction of the edge to the left of x.
                let a = (x.clamp(x0, x1) - x0) * per_column;
                0.5 * a * a / per_column + (x - x1).max(0.0)
            };
            let area = covered(left + 1.0) - covered(left.max(x0));
            *cell += (d * (area - before)) as f32;
            before = area;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn total(plane: &SparsePlane) -> f64 {
        plane
            .rows()
            .map(|y| {
                plane.row(y)[..plane.width]
                    .iter()
                    .map(|v| f64::from(*v))
                    .sum::<f64>()
            })
            .sum()
    }

    #[test]
    fn a_triangle_covers_its_area_and_its_centroid() {
        let corners: [Pixel; 3] = [[3.2, 2.9], [40.7, 11.3], [9.1, 33.6]];
        let mut plane = SparsePlane::new(64, 48);
        plane.polygon(corners.into_iter(), 1.0);
        plane.resolve();
        let area = 0.5
            * ((corners[1][0] - corners[0][0]) * (corners[2][1] - corners[0][1])
                - (corners[2][0] - corners[0][0]) * (corners[1][1] - corners[0][1]));
        assert!((total(&plane) - area).abs() < 1e-3, "{}", total(&plane));
        for axis in 0..2 {
            let mut moment = 0.0;
            for y in plane.rows() {
                for x in plane.span(y) {
                    moment += f64::from(plane.row(y)[x]) * [x as f64, y as f64][axis];
                }
            }
            let centroid = corners.iter().map(|c| c[axis]).sum::<f64>() / 3.0;
            // Within a pixel coverage sits at the pixel's centre; over a whole shape that
            // discretisation leaves less than this.
            assert!((moment / area - centroid).abs() < 0.02, "axis {axis}");
        }
    }

    #[test]
    fn what_lies_outside_does_not_count_and_clearing_clears() {
        let mut plane = SparsePlane::new(20, 10);
        let square = [[-7.5, -4.5], [9.25, -4.5], [9.25, 30.0], [-7.5, 30.0]];
        plane.polygon(square.into_iter(), 1.0);
        let right = [[15.25, 2.0], [90.0, 2.0], [90.0, 4.0], [15.25, 4.0]];
        plane.polygon(right.into_iter(), 1.0);
        plane.resolve();
        assert!((total(&plane) - (9.75 * 10.0 + 4.25 * 2.0)).abs() < 1e-4);
        plane.clear();
        assert!(plane.values.iter().all(|v| *v == 0.0));
        assert_eq!(plane.rows().len(), 0);
    }

    #[test]
    fn orientation_gives_the_sign_and_shared_edges_cancel() {
        let mut plane = SparsePlane::new(16, 16);
        let one = [[2.1, 2.3], [8.4, 3.0], [7.7, 12.9], [1.2, 11.8]];
        let two = [[8.4, 3.0], [13.3, 2.2], [14.0, 13.0], [7.7, 12.9]];
        plane.polygon(one.into_iter(), 1.0);
        plane.polygon(two.into_iter(), 1.0);
        let hull = [one[0], one[1], two[1], two[2], one[2], one[3]];
        plane.polygon(hull.into_iter(), -1.0);
        plane.resolve();
        for y in plane.rows() {
            for x in plane.span(y) {
                assert!(plane.row(y)[x].abs() < 1e-5);
            }
        }
    }
}
