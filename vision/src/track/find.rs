//! The needle in a whole image: dark ridges of its width on scan lines, chained into curves.

use hal::GrayImage;
use nalgebra::Point2;

/// Lines that a chain may miss.
const MISSES: usize = 4;
/// Ridges kept per scan line.
const KEPT: usize = 10;

/// A ridge on a scan line.
#[derive(Clone, Copy, Debug)]
struct Ridge {
    at: f32,
    strength: f32,
    score: f32,
    slope: f32,
    from: Option<(u16, u16)>,
    used: bool,
}

/// A curve that may be the needle.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    /// From where it comes in to where it ends \[px\].
    pub points: Vec<Point2<f64>>,
    /// Summed darkness.
    pub score: f64,
}

/// Working memory, reused.
#[derive(Clone, Debug, Default)]
pub(super) struct Finder {
    lines: Vec<Vec<Ridge>>,
}

impl Finder {
    /// The best curves of either course, darkest first.
    pub(super) fn find(&mut self, image: &GrayImage, width: f64) -> Vec<Candidate> {
        let mut found = Vec::new();
        for down in [true, false] {
            let stride = stride(width);
            self.scan(image, width, stride, down);
            for _ in 0..3 {
                let Some(c) = self.best_chain(image, stride, down) else {
                    break;
                };
                found.push(c);
            }
        }
        found.sort_by(|a: &Candidate, b| b.score.total_cmp(&a.score));
        found.truncate(4);
        found
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "widths are small and positive"
    )]
    fn scan(&mut self, image: &GrayImage, width: f64, stride: usize, down: bool) {
        let (w, h) = (image.width(), image.height());
        let (count, long) = if down {
            (h / stride, w)
        } else {
            (w / stride, h)
        };
        let core = ((0.5 * width - 0.5).round().max(0.0)) as usize;
        let gap = ((0.35 * width).ceil() as usize).max(2);
        let reach = core + gap + 2;
        self.lines.resize_with(count, Vec::new);
        self.lines.truncate(count);
        let mut sums = vec![0_i32; long + 1];
        let pixels = image.pixels();
        for (k, line) in self.lines.iter_mut().enumerate() {
            line.clear();
            let c = k * stride + stride / 2;
            for i in 0..long {
                let g = if down {
                    pixels[c * w + i]
                } else {
                    pixels[i * w + c]
                };
                sums[i + 1] = sums[i] + i32::from(g);
            }
            if long <= 2 * reach + 2 {
                continue;
            }
            let n = i32::try_from(2 * core + 1).unwrap_or(1);
            // Twice the flank of two samples against the core, in grey levels times 2 n.
            let response = |i: usize| {
                let middle = sums[i + core + 1] - sums[i - core];
                let l = sums[i - core - gap] - sums[i - core - gap - 2];
                let r = sums[i + core + gap + 3] - sums[i + core + gap + 1];
                l.min(r) * n - 2 * middle
            };
            let least = 2 * n * 8;
            let mut i = reach;
            while i + reach + 1 < long {
                let r = response(i);
                if r < least {
                    i += 1;
                    continue;
                }
                let (mut best, mut at) = (r, i);
                while i + reach + 1 < long {
                    let r = response(i);
                    if r < least {
                        break;
                    }
                    if r > best {
                        (best, at) = (r, i);
                    }
                    i += 1;
                }
                line.push(Ridge {
                    at: at as f32,
                    strength: best as f32 / (2 * n) as f32,
                    score: 0.0,
                    slope: 0.0,
                    from: None,
                    used: false,
                });
            }
            line.sort_by(|a, b| b.strength.total_cmp(&a.strength));
            line.truncate(KEPT);
        }
    }

    /// The smooth chain with most darkness (dynamic programming over the lines).
    #[expect(clippy::cast_possible_truncation, reason = "few lines, few ridges")]
    fn best_chain(&mut self, image: &GrayImage, stride: usize, down: bool) -> Option<Candidate> {
        let mut best: Option<(usize, usize, f32)> = None;
        for k in 0..self.lines.len() {
            let (before, rest) = self.lines.split_at_mut(k);
            for (i, ridge) in rest[0].iter_mut().enumerate() {
                ridge.from = None;
                ridge.score = ridge.strength;
                if ridge.used {
                    continue;
                }
                for gap in 1..=MISSES.min(k) {
                    let step = (gap * stride) as f32;
                    for (j, p) in before[k - gap].iter().enumerate() {
                        let slope = (ridge.at - p.at) / step;
                        if p.used || slope.abs() > 1.15 {
                            continue;
                        }
                        let turn = if p.from.is_some() {
                            (slope - p.slope).abs() * step
                        } else {
                            0.0
                        };
                        // A turn of more than two pixels on the way is another thing.
                        if turn > 2.5 + 0.1 * step {
                            continue;
                        }
                        let score =
                            p.score + ridge.strength * (1.0 - 0.15 * turn) - 4.0 * (gap - 1) as f32;
                        if score > ridge.score {
                            ridge.score = score;
                            ridge.slope = if p.from.is_some() {
                                0.5 * (slope + p.slope)
                            } else {
                                slope
                            };
                            ridge.from = Some(((k - gap) as u16, j as u16));
                        }
                    }
                }
                if best.is_none_or(|b| ridge.score > b.2) {
                    best = Some((k, i, ridge.score));
                }
            }
        }
        let (mut k, mut i, score) = best?;
        let mut points = Vec::new();
        loop {
            let ridge = &mut self.lines[k][i];
            ridge.used = true;
            let c = (k * stride + stride / 2) as f64;
            let at = f64::from(ridge.at);
            points.push(if down {
                Point2::new(at, c)
            } else {
                Point2::new(c, at)
            });
            match ridge.from {
                Some((a, b)) => (k, i) = (usize::from(a), usize::from(b)),
                None => break,
            }
        }
        if points.len() < 4 {
            return None;
        }
        // The needle comes in from the image's nearer border.
        let (first, last) = (points[0], points[points.len() - 1]);
        if border(image, first) > border(image, last) {
            points.reverse();
        }
        Some(Candidate {
            points,
            score: f64::from(score),
        })
    }
}

fn stride(width: f64) -> usize {
    if width > 4.0 { 8 } else { 5 }
}

/// Distance from the image's border.
fn border(image: &GrayImage, p: Point2<f64>) -> f64 {
    let (w, h) = (image.width() as f64, image.height() as f64);
    p.x.min(w - p.x).min(p.y).min(h - p.y)
}
