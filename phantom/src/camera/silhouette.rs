//! From the needle in space to polygons in the image.
//!
//! The shaft is a tube: at each node of the centreline its outline passes through the two points
//! at one radius across both the tangent and the line of sight. The tip is the convex hull of
//! the bevel's elliptic face with the shaft's end, so that any azimuth comes out right. Each
//! point is projected exactly; errors left are of order (radius / distance)^2 and of the chords.
//!
//! Three images of the needle can be seen: directly through the gel; mirrored in the underside
//! of the gel's surface, where light from below is totally reflected; and above the surface,
//! through the wall's free part. Each is clipped to where it is visible.

use nalgebra::{Isometry3, Point3, Vector3};

use super::lens::Pixel;
use super::view::{Through, View};
use crate::NeedleView;

/// Which image of the needle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Path {
    Direct,
    Mirrored,
    Above,
}

/// A vertex of an outline: its pixel, and two functions that are negative where it is hidden.
#[derive(Clone, Copy, Debug)]
struct Vertex {
    pixel: Pixel,
    in_medium: f64,
    in_window: f64,
}

/// Points of the bevel's ellipse; its chords stay within 0.03 % of the radius.
const ELLIPSE: usize = 128;
/// Margin around the image beyond which nothing is projected \[px\].
const MARGIN_PX: f64 = 64.0;
/// Depth below which the mirror image is never sought \[m\].
const MIRROR_REACH: f64 = 0.03;

/// Working memory, reused from exposure to exposure.
#[derive(Clone, Debug, Default)]
pub(super) struct Silhouette {
    nodes: Vec<Vector3<f64>>,
    left: Vec<Vertex>,
    right: Vec<Vertex>,
    cap: Vec<Vertex>,
    hull: Vec<(f64, f64, Vertex)>,
    outline: Vec<Vertex>,
    clipped: Vec<Vertex>,
}

impl Silhouette {
    /// Hands every visible outline to `draw`: the polygon, and the visible pieces of the
    /// shaft's two sides (left, right) from which a highlight can be interpolated.
    pub(super) fn trace(
        &mut self,
        view: &View,
        needle: &NeedleView,
        mut draw: impl FnMut(&mut dyn Iterator<Item = Pixel>),
        mut sides: impl FnMut(Pixel, Pixel, Pixel, Pixel, f64),
    ) {
        for path in [Path::Direct, Path::Mirrored, Path::Above] {
            if !self.outline(view, needle, path) {
                continue;
            }
            clip(&mut self.outline, &mut self.clipped, |v| v.in_medium);
            clip(&mut self.outline, &mut self.clipped, |v| v.in_window);
            draw(&mut self.outline.iter().map(|v| v.pixel));
            let visible = |v: &Vertex| v.in_medium >= 0.0 && v.in_window >= 0.0;
            let from_tip = self.left.len();
            for (k, (l, r)) in self.left.windows(2).zip(self.right.windows(2)).enumerate() {
                if l.iter().chain(r).all(visible) {
                    let place = (from_tip - k) as f64;
                    sides(l[0].pixel, r[0].pixel, l[1].pixel, r[1].pixel, place);
                }
            }
        }
    }

    /// Builds one image's closed outline; false if nothing of it can be seen.
    fn outline(&mut self, view: &View, needle: &NeedleView, path: Path) -> bool {
        self.place_nodes(view, needle, path);
        self.left.clear();
        self.right.clear();
        self.outline.clear();
        let Some((first, last)) = self.visible_nodes(view, path) else {
            return false;
        };
        let camera_from_tip = view.camera_from_world() * needle.world_from_tip.isometry();
        let axis = camera_from_tip.rotation * Vector3::z();
        let axis = if path == Path::Mirrored {
            view.mirrored(&axis) - view.mirrored(&Vector3::zeros())
        } else {
            axis
        };
        let end = self.nodes.len() - 1;
        for i in first..=last {
            let node = self.nodes[i];
            let tangent = if i == end {
                axis
            } else {
                self.nodes[i + 1] - self.nodes[i.saturating_sub(1)]
            };
            let Some(sight) = view.sight(&node, through(path)) else {
                continue;
            };
            let Some(across) = tangent.cross(&sight.behind).try_normalize(0.0) else {
                continue;
            };
            let offset = 0.5 * needle.outer_diameter * across;
            if let (Some(l), Some(r)) = (
                vertex(view, &(node - offset), path),
                vertex(view, &(node + offset), path),
            ) {
                self.left.push(l);
                self.right.push(r);
            }
        }
        if last == end {
            self.round_the_tip(view, needle, &camera_from_tip, path);
        }
        self.outline.extend_from_slice(&self.left);
        if last == end {
            self.outline.extend_from_slice(&self.cap);
        }
        self.outline.extend(self.right.iter().rev());
        !self.left.is_empty()
    }

    /// Nodes in the camera's frame, ending at O.
    fn place_nodes(&mut self, view: &View, needle: &NeedleView, path: Path) {
        let tip = needle.world_from_tip.isometry().translation.vector;
        let shaft = &needle.centreline;
        // The polyline's own end gives way to the tip frame's origin, which it should equal.
        let kept = shaft
            .iter()
            .rposition(|p| (p - tip).norm() > 1e-5)
            .map_or(0, |i| i + 1);
        self.nodes.clear();
        self.nodes
            .extend(shaft[..kept].iter().chain([&tip]).map(|p| {
                let p = (view.camera_from_world() * Point3::from(*p)).coords;
                if path == Path::Mirrored {
                    view.mirrored(&p)
                } else {
                    p
                }
            }));
    }

    /// First and last node to draw: those that can be seen in the image, with neighbours.
    fn visible_nodes(&self, view: &View, path: Path) -> Option<(usize, usize)> {
        let (width, height) = view.size();
        let seen = |p: &Vector3<f64>| {
            let h = view.height_above_gel(p);
            let near = match path {
                Path::Direct => h < 2e-3,
                Path::Mirrored => (-2e-3..MIRROR_REACH).contains(&h),
                Path::Above => h > -2e-3,
            };
            near && view
                .sight(p, through(path))
                .and_then(|s| view.pixel(&s.in_air))
                .is_some_and(|[x, y]| {
                    (-MARGIN_PX..width + MARGIN_PX).contains(&x)
                        && (-MARGIN_PX..height + MARGIN_PX).contains(&y)
                })
        };
        let first = self.nodes.iter().position(seen)?;
        let last = self.nodes.iter().rposition(seen)?;
        Some((
            first.saturating_sub(1),
            (last + 1).min(self.nodes.len() - 1),
        ))
    }

    /// Fills `cap` with the outline beyond O, from the left side to the right one.
    fn round_the_tip(
        &mut self,
        view: &View,
        needle: &NeedleView,
        camera_from_tip: &Isometry3<f64>,
        path: Path,
    ) {
        self.cap.clear();
        self.hull.clear();
        let (Some(&l), Some(&r)) = (self.left.last(), self.right.last()) else {
            return;
        };
        let chord = [r.pixel[0] - l.pixel[0], r.pixel[1] - l.pixel[1]];
        let radius = 0.5 * needle.outer_diameter;
        let bevel_length = needle.bevel_length();
        let mut ahead = 0.0;
        let mut place = |v: Vertex| {
            let d = [v.pixel[0] - l.pixel[0], v.pixel[1] - l.pixel[1]];
            let along = d[0] * chord[0] + d[1] * chord[1];
            let beyond = d[1] * chord[0] - d[0] * chord[1];
            ahead += beyond;
            (along, beyond, v)
        };
        for k in 0..ELLIPSE {
            let (sin, cos) = (core::f64::consts::TAU * k as f64 / ELLIPSE as f64).sin_cos();
            let z = 0.5 * bevel_length * (1.0 - sin);
            let p = (camera_from_tip * Point3::new(radius * cos, radius * sin, z)).coords;
            let p = if path == Path::Mirrored {
                view.mirrored(&p)
            } else {
                p
            };
            if let Some(v) = vertex(view, &p, path) {
                self.hull.push(place(v));
            }
        }
        self.hull.push((0.0, 0.0, l));
        let squared = chord[0] * chord[0] + chord[1] * chord[1];
        self.hull.push((squared, 0.0, r));
        let sign = if ahead < 0.0 { -1.0 } else { 1.0 };
        self.hull
            .sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        // The upper hull (Andrew's monotone chain); `kept` entries at the front are its stack.
        let mut kept = 0;
        for i in 0..self.hull.len() {
            let c = self.hull[i];
            while kept >= 2 {
                let (a, b) = (self.hull[kept - 2], self.hull[kept - 1]);
                let turn = (b.0 - a.0) * sign * (c.1 - a.1) - sign * (b.1 - a.1) * (c.0 - a.0);
                if turn < 0.0 {
                    break;
                }
                kept -= 1;
            }
            self.hull[kept] = c;
            kept += 1;
        }
        self.cap.extend(self.hull[..kept].iter().map(|h| h.2));
    }
}

fn through(path: Path) -> Through {
    match path {
        Path::Direct | Path::Mirrored => Through::Gel,
        Path::Above => Through::FreeWall,
    }
}

/// Projects a point of the outline (already mirrored, if it is).
fn vertex(view: &View, point: &Vector3<f64>, path: Path) -> Option<Vertex> {
    let sight = view.sight(point, through(path))?;
    let height = view.height_above_gel(point);
    let window = view.height_above_gel(&sight.inner);
    let (in_medium, in_window) = match path {
        Path::Direct => (-height, -window),
        Path::Mirrored => (height, -window),
        Path::Above => (height, window),
    };
    Some(Vertex {
        pixel: view.pixel(&sight.in_air)?,
        in_medium,
        in_window,
    })
}

/// Sutherland-Hodgman: keeps the part of `polygon` where `inside` is not negative. Edges that
/// run back and forth along the cut enclose nothing.
fn clip(polygon: &mut Vec<Vertex>, spare: &mut Vec<Vertex>, inside: impl Fn(&Vertex) -> f64) {
    spare.clear();
    let Some(mut a) = polygon.last().copied() else {
        return;
    };
    for &b in polygon.iter() {
        let (fa, fb) = (inside(&a), inside(&b));
        if (fa < 0.0) != (fb < 0.0) {
            let t = fa / (fa - fb);
            let mix = |p: f64, q: f64| p + t * (q - p);
            spare.push(Vertex {
                pixel: [mix(a.pixel[0], b.pixel[0]), mix(a.pixel[1], b.pixel[1])],
                in_medium: mix(a.in_medium, b.in_medium),
                in_window: mix(a.in_window, b.in_window),
            });
        }
        if fb >= 0.0 {
            spare.push(b);
        }
        a = b;
    }
    core::mem::swap(polygon, spare);
}
