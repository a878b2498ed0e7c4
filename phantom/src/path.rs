//! The cut path: the tissue's memory of where the cutting edge went.

mod tear;

use nalgebra::Vector3;

pub(crate) use tear::{Rip, Tear};

use crate::motion::Placement;

/// Distance between stored points of the path \[m\]. The chord of the tightest path
/// (2 deg per millimetre) leaves its arc by 0.3 um.
const SPACING: f64 = 0.25e-3;

/// The nearest place of the path to a point.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Foot {
    /// Segment; the last one is the ray ahead of the path's end.
    pub(crate) segment: usize,
    /// Fraction of the segment, 0 on the ray and before the entry.
    pub(crate) fraction: f64,
    /// Arc length from the entry \[m\]; negative outside.
    pub(crate) arc: f64,
    /// Position \[m\].
    pub(crate) point: Vector3<f64>,
    /// Direction of the path, into the tissue.
    pub(crate) tangent: Vector3<f64>,
}

/// A point of the tissue on the path.
#[derive(Clone, Copy, Debug)]
struct Station {
    /// Where the tissue was cut, in the material frame \[m\]; tearing moves it.
    rest: Vector3<f64>,
    /// Displacement to which the relaxing part has crept \[m\].
    crept: Vector3<f64>,
    /// Stiffness per length before relaxation \[N/m2\].
    stiffness: f64,
}

/// The path from the entry to the deepest cut, and the ray along which it goes on.
#[derive(Clone, Debug)]
pub(crate) struct CutPath {
    stations: Vec<Station>,
    /// Arc length of every station \[m\].
    arcs: Vec<f64>,
    /// Present positions of the stations in the phantom frame \[m\].
    points: Vec<Vector3<f64>>,
    /// Directions of the segments; the last one is the ray's.
    tangents: Vec<Vector3<f64>>,
}

/// Properties of the tissue at a foot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bed {
    /// Stiffness per length \[N/m2\] and its rise along the path \[N/m3\].
    pub(crate) stiffness: f64,
    pub(crate) slope: f64,
    /// Displacement to which the relaxing part has crept \[m\].
    pub(crate) crept: Vector3<f64>,
}

impl CutPath {
    /// A path that starts at `entry` (phantom frame) and goes on along `direction`.
    pub(crate) fn starting_at(
        entry: Vector3<f64>,
        direction: Vector3<f64>,
        stiffness: f64,
        placement: &Placement,
    ) -> Self {
        Self {
            stations: vec![Station {
                rest: placement.material_of(&entry),
                crept: Vector3::zeros(),
                stiffness,
            }],
            arcs: vec![0.0],
            points: vec![entry],
            tangents: vec![direction],
        }
    }

    /// Arc length of the whole path \[m\].
    pub(crate) fn length(&self) -> f64 {
        self.arcs.last().copied().unwrap_or(0.0)
    }

    /// Present positions of the path's points \[m\].
    pub(crate) fn points(&self) -> &[Vector3<f64>] {
        &self.points
    }

    /// Where the path ends \[m\].
    pub(crate) fn end(&self) -> Vector3<f64> {
        self.points[self.points.len() - 1]
    }

    /// Direction in which the next cut goes.
    pub(crate) fn aim(&mut self, direction: Vector3<f64>) {
        let last = self.tangents.len() - 1;
        self.tangents[last] = direction;
    }

    /// Direction of the path at its end.
    pub(crate) fn heading(&self) -> Vector3<f64> {
        self.tangents[self.tangents.len() - 1]
    }

    /// Cuts `advance` \[m\] along the ray; `stiffness` is the tissue's there.
    pub(crate) fn cut(&mut self, advance: f64, stiffness: f64, placement: &Placement) {
        let last = self.points.len() - 1;
        let end = self.points[last] + advance * self.heading();
        let station = Station {
            rest: placement.material_of(&end),
            crept: Vector3::zeros(),
            stiffness,
        };
        let ray = self.heading();
        if last > 0 && self.arcs[last] - self.arcs[last - 1] < SPACING {
            let crept = self.stations[last].crept;
            self.stations[last] = Station { crept, ..station };
            self.points[last] = end;
            let chord = end - self.points[last - 1];
            self.arcs[last] = self.arcs[last - 1] + chord.norm();
            self.tangents[last - 1] = chord.normalize();
        } else {
            self.stations.push(station);
            self.points.push(end);
            self.arcs.push(self.arcs[last] + advance);
            self.tangents.push(ray);
        }
    }

    /// Moves the path with the tissue.
    pub(crate) fn place(&mut self, placement: &Placement) {
        for (point, station) in self.points.iter_mut().zip(&self.stations) {
            *point = placement.phantom_of(&station.rest);
        }
        self.measure();
    }

    fn measure(&mut self) {
        for i in 1..self.points.len() {
            let chord = self.points[i] - self.points[i - 1];
            let length = chord.norm();
            self.arcs[i] = self.arcs[i - 1] + length;
            // Stations that fell together keep their direction.
            if length > 1e-9 {
                self.tangents[i - 1] = chord / length;
            }
        }
    }

    /// The nearest place of the path to `point`, searched from segment `hint` outwards.
    #[inline]
    pub(crate) fn locate(&self, point: &Vector3<f64>, hint: usize) -> Foot {
        let ray = self.tangents.len() - 1;
        let mut segment = hint.min(ray);
        let mut came_from = usize::MAX;
        loop {
            let start = self.points[segment];
            let tangent = self.tangents[segment];
            let mut along = tangent.dot(&(point - start));
            let mut length = 0.0;
            if segment < ray {
                length = self.arcs[segment + 1] - self.arcs[segment];
                if along > length {
                    if came_from != segment + 1 {
                        came_from = segment;
                        segment += 1;
                        continue;
                    }
                    along = length;
                }
            }
            if along < 0.0 && segment > 0 {
                if came_from != segment - 1 {
                    came_from = segment;
                    segment -= 1;
                    continue;
                }
                along = 0.0;
            }
            let fraction = if length > 0.0 {
                (along / length).max(0.0)
            } else {
                0.0
            };
            return Foot {
                segment,
                fraction,
                arc: self.arcs[segment] + along,
                point: start + along * tangent,
                tangent,
            };
        }
    }

    /// The place of the straight line through `segment` that is nearest to `point`.
    pub(crate) fn project(&self, point: &Vector3<f64>, segment: usize) -> Foot {
        let segment = segment.min(self.tangents.len() - 1);
        let (start, tangent) = (self.points[segment], self.tangents[segment]);
        let along = tangent.dot(&(point - start));
        let length = self
            .arcs
            .get(segment + 1)
            .map_or(0.0, |end| end - self.arcs[segment]);
        Foot {
            segment,
            fraction: if length > 0.0 {
                (along / length).clamp(0.0, 1.0)
            } else {
                0.0
            },
            arc: self.arcs[segment] + along,
            point: start + along * tangent,
            tangent,
        }
    }

    /// The tissue at `foot`.
    #[inline]
    pub(crate) fn bed(&self, foot: &Foot) -> Bed {
        let a = &self.stations[foot.segment];
        match self.stations.get(foot.segment + 1) {
            Some(b) => {
                let rise = b.stiffness - a.stiffness;
                let length = self.arcs[foot.segment + 1] - self.arcs[foot.segment];
                Bed {
                    stiffness: a.stiffness + foot.fraction * rise,
                    slope: if length > 0.0 { rise / length } else { 0.0 },
                    crept: a.crept + foot.fraction * (b.crept - a.crept),
                }
            }
            None => Bed {
                stiffness: a.stiffness,
                slope: 0.0,
                crept: a.crept,
            },
        }
    }

    /// Whether `point` lies within `reach` \[m\] of the entry.
    pub(crate) fn enters_near(&self, point: &Vector3<f64>, reach: f64) -> bool {
        (self.points[0] - point).norm() < reach
    }
}
