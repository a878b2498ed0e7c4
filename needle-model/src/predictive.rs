//! Where the tip will be: the needle held on the path it has cut, and that path growing.
//!
//! The tissue's reference is the cut path c; the needle minimises
//! 1/2 EI |w''|^2 - 1/2 P |w'|^2 + 1/2 K |w - c|^2 with the holder clamped and **the tip on its path**.
//! The path grows by dc/dd = tip slope + bevel vector + direction bias - C_t (tip reaction). All in
//! the plane across an axis from the entry towards the target (small slopes), linear, so one roll-out
//! also gives the exact rates by a base pivot about the entry, a base shift and the bevel.
//!
//! The instantaneous Jacobian of eq. (12) lets the tip move through the tissue; over part of every
//! insertion its sign is opposite to that of the effect on the path.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use thiserror::Error;

use crate::bed::{COLUMNS, Clamp, Held, Row, Span};
use crate::needle::Needle;
use crate::tissue::Tissue;

/// Points of the path nearer to each other than this are skipped \[m\].
const LEAST_SPACING: f64 = 0.5e-3;
/// Least depth for a prediction \[m\].
const LEAST_DEPTH: f64 = 0.1e-3;

/// How the path grows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathLaw {
    /// Angle gamma between tip axis and path at full bevel \[rad\].
    pub bevel_angle: f64,
    /// Direction bias b of the path, now \[rad\], in the axes of the prediction's frame.
    pub bias: Vector2<f64>,
    /// Depth over which the bias decays \[m\]; infinite for never.
    pub bias_decay: f64,
    /// Tip compliance C_t \[rad/N\].
    pub tip_compliance: f64,
    /// Axial compression P \[N\].
    pub axial_load: f64,
}

impl Default for PathLaw {
    /// gamma of a 7.6 mm miss at K_T = 1e4 N/m2 in \[Chevrie2016\]'s first experiment; no bias, rigid
    /// tip, no axial load.
    fn default() -> Self {
        Self {
            bevel_angle: 1.75_f64.to_radians(),
            bias: Vector2::zeros(),
            bias_decay: 60e-3,
            tip_compliance: 0.0,
            axial_load: 0.0,
        }
    }
}

/// Why there is no prediction.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum PredictionError {
    /// A value out of its range.
    #[error("prediction: {name} out of range, got {value}")]
    Value {
        /// Its name.
        name: &'static str,
        /// Offending value, in SI units.
        value: f64,
    },
    /// A point of the path that is not finite or not beyond the one before.
    #[error("prediction: point {index} of the path is not finite")]
    Path {
        /// Offending point.
        index: usize,
    },
    /// The needle is not in the tissue, or hardly.
    #[error("prediction: the path is only {depth_m} m deep")]
    OutsideTissue {
        /// Depth of the path along the axis \[m\].
        depth_m: f64,
    },
    /// The holder is not before the entry point.
    #[error("prediction: the holder is {free_length_m} m before the entry point")]
    HolderInside {
        /// Distance from holder to entry along the axis \[m\].
        free_length_m: f64,
    },
    /// The path or the needle on it grows beyond all numbers.
    #[error(
        "prediction: it grows without bounds (tip compliance {tip_compliance_rad_per_n} rad/N)"
    )]
    Unbounded {
        /// Tip compliance \[rad/N\].
        tip_compliance_rad_per_n: f64,
    },
    /// The axial load buckles the needle.
    #[error("prediction: the axial load {axial_load_n} N buckles the needle")]
    Buckled {
        /// Axial load \[N\].
        axial_load_n: f64,
    },
}

/// The needle on its path, ready to be rolled out.
#[derive(Debug, Clone)]
pub struct Prediction {
    world_from_frame: Isometry3<f64>,
    stiffness: f64,
    tissue: Tissue,
    law: PathLaw,
    /// Holder: (x, y) and slopes; distance to the entry.
    holder: [Vector2<f64>; 2],
    free_length: f64,
    entry: f64,
    span: Span,
    depth: f64,
    tip: Vector2<f64>,
}

/// Rates of the tip slope by base motion, with the tip held \[rad/m, 1, 1\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Authority {
    /// By a shift of the base across the axis.
    pub shift: f64,
    /// By a tilt of the base about itself.
    pub tilt: f64,
    /// By a pivot of the base about the entry point.
    pub pivot: f64,
}

/// Prediction at the target depth. Lateral vectors are (x, y) in the prediction's frame.
///
/// For base pivot a (about the entry, as slopes), base shift z, and bevel fraction u (|u| <= 1) held
/// from now on, the tip passes the target depth at
/// `free + a_pivot a + a_shift z + bevel u`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rollout {
    /// Tip position without further base motion across the axis and without bevel \[m\].
    pub free: Vector2<f64>,
    /// Rate by the pivot about the entry \[m/rad\].
    pub a_pivot: f64,
    /// Rate by the shift of the base \[m/m\].
    pub a_shift: f64,
    /// Reach of the full bevel, G \[m\].
    pub bevel: f64,
    /// Slope of the free path at the target depth.
    pub slope: Vector2<f64>,
    /// Lateral force of the free path on the tip at the target depth \[N\].
    pub reaction: Vector2<f64>,
}

/// A frame at `entry` with z towards `target` and x, y as near as possible to those of `like`.
pub fn prediction_frame(
    entry: &Vector3<f64>,
    target: &Vector3<f64>,
    like: &Isometry3<f64>,
) -> Option<Isometry3<f64>> {
    let axis = (target - entry).try_normalize(1e-9)?;
    let turn = UnitQuaternion::rotation_between(&(like * Vector3::z()), &axis)?;
    Some(Isometry3::from_parts(
        Translation3::from(*entry),
        turn * like.rotation,
    ))
}

impl Prediction {
    /// The needle with its holder at `world_from_base` on the cut `path` (World points \[m\] from the
    /// entry to the tip O), in `world_from_frame`: origin on the entry, z the prediction's axis.
    ///
    /// # Errors
    /// [`PredictionError`].
    pub fn new(
        needle: &Needle,
        tissue: &Tissue,
        law: PathLaw,
        world_from_frame: &Isometry3<f64>,
        world_from_base: &Isometry3<f64>,
        path: impl IntoIterator<Item = Vector3<f64>>,
    ) -> Result<Self, PredictionError> {
        let checks = [
            ("bevel_angle", law.bevel_angle, law.bevel_angle.is_finite()),
            ("bias", law.bias.x, law.bias.iter().all(|v| v.is_finite())),
            ("bias_decay", law.bias_decay, law.bias_decay > 0.0),
            (
                "tip_compliance",
                law.tip_compliance,
                law.tip_compliance.is_finite(),
            ),
            (
                "axial_load",
                law.axial_load,
                law.axial_load.is_finite() && law.axial_load >= 0.0,
            ),
        ];
        if let Some((name, value, _)) = checks.into_iter().find(|(.., good)| !good) {
            return Err(PredictionError::Value { name, value });
        }
        let frame_from_world = world_from_frame.inverse();
        let base = frame_from_world * world_from_base;
        let axis = base * Vector3::z();
        let position = base.translation.vector;
        if !(axis.z > 0.1) {
            return Err(PredictionError::Value {
                name: "base axis along the frame's z",
                value: axis.z,
            });
        }

        let stiffness = needle.bending_stiffness();
        let mut span: Option<Span> = None;
        let (mut entry, mut last): (Option<Vector3<f64>>, Vector3<f64>) = (None, Vector3::zeros());
        let mut pending: Option<Vector3<f64>> = None;
        let grow = |from: &Vector3<f64>, to: &Vector3<f64>, span: &mut Option<Span>| {
            let middle = world_from_frame * Point3::from((from + to) / 2.0);
            let k = tissue.stiffness_at(tissue.depth(&middle.coords));
            let (c0, c1) = ([from.x, from.y, 0.0, 0.0, 0.0], [to.x, to.y, 0.0, 0.0, 0.0]);
            let element = Span::element(stiffness, law.axial_load, k, to.z - from.z, &c0, &c1);
            *span = Some(
                span.as_ref()
                    .map_or(element, |before| before.join(&element)),
            );
        };
        for (index, point) in path.into_iter().enumerate() {
            if !point.iter().all(|v| v.is_finite()) {
                return Err(PredictionError::Path { index });
            }
            let point = (frame_from_world * Point3::from(point)).coords;
            if entry.is_none() {
                entry = Some(point);
                last = point;
            } else if point.z - last.z >= LEAST_SPACING {
                grow(&last, &point, &mut span);
                last = point;
                pending = None;
            } else {
                pending = Some(point);
            }
        }
        // The tip itself, even when near the point before.
        if let Some(point) = pending.filter(|point| point.z - last.z >= LEAST_DEPTH) {
            grow(&last, &point, &mut span);
            last = point;
        }
        let (Some(entry), Some(span)) = (entry, span) else {
            return Err(PredictionError::OutsideTissue { depth_m: 0.0 });
        };
        let free_length = entry.z - position.z;
        if !(free_length > LEAST_DEPTH) {
            return Err(PredictionError::HolderInside {
                free_length_m: free_length,
            });
        }
        Ok(Self {
            world_from_frame: *world_from_frame,
            stiffness,
            tissue: tissue.clone(),
            law,
            holder: [position.xy(), axis.xy() / axis.z],
            free_length,
            entry: entry.z,
            span,
            depth: last.z - entry.z,
            tip: last.xy(),
        })
    }

    /// Depth of the tip along the axis, from the first point of the path \[m\].
    pub const fn depth(&self) -> f64 {
        self.depth
    }

    /// Coordinate of the first point of the path along the frame's z \[m\].
    pub const fn entry_depth(&self) -> f64 {
        self.entry
    }

    /// The prediction's frame in World.
    pub const fn world_from_frame(&self) -> &Isometry3<f64> {
        &self.world_from_frame
    }

    /// Columns (x, y, pivot, shift, bevel) of the holder after an advance along its axis.
    fn base(&self, advance: f64) -> [Row; 2] {
        let [position, slope] = self.holder;
        let now = position + slope * advance;
        [
            [now.x, now.y, advance - self.free_length, 1.0, 0.0],
            [slope.x, slope.y, 1.0, 0.0, 0.0],
        ]
    }

    fn hold(&self, span: &Span, advance: f64, tip: &Row) -> Result<Held, PredictionError> {
        let free_length_m = self.free_length - advance;
        if !(free_length_m > 0.0) {
            return Err(PredictionError::HolderInside { free_length_m });
        }
        let axial_load_n = self.law.axial_load;
        Clamp::new(self.stiffness, axial_load_n, free_length_m)
            .and_then(|clamp| span.hold(&clamp, &self.base(advance), tip))
            .ok_or(PredictionError::Buckled { axial_load_n })
    }

    /// Refuses what has grown beyond all numbers.
    fn bounded(&self, rows: &[Row]) -> Result<(), PredictionError> {
        if rows.iter().flatten().all(|x| x.is_finite()) {
            return Ok(());
        }
        let tip_compliance_rad_per_n = self.law.tip_compliance;
        Err(PredictionError::Unbounded {
            tip_compliance_rad_per_n,
        })
    }

    /// Direction of the path relative to the tip axis: its columns after an advance.
    fn growth(&self, held: &Held, advance: f64) -> Row {
        let bias = self.law.bias * (-advance / self.law.bias_decay).exp();
        let drive = [bias.x, bias.y, 0.0, 0.0, self.law.bevel_angle];
        std::array::from_fn(|c| {
            held.slope[c] + drive[c] - self.law.tip_compliance * held.reaction[c]
        })
    }

    /// Rolls the path out to `target_depth` \[m\] along the axis from the first point of the path, in
    /// steps of at most `step` \[m\] (1-1.5 mm), second order in the step.
    ///
    /// # Errors
    /// [`PredictionError`]: a step that is not positive, a target that is not finite or that the
    /// holder would have to pass the entry to reach. A target already passed gives the present tip.
    pub fn roll_out(&self, target_depth: f64, step: f64) -> Result<Rollout, PredictionError> {
        if !(step.is_finite() && step > 1e-6) {
            return Err(PredictionError::Value {
                name: "step",
                value: step,
            });
        }
        if !target_depth.is_finite() {
            return Err(PredictionError::Value {
                name: "target_depth",
                value: target_depth,
            });
        }
        let way = target_depth - self.depth;
        if way >= self.free_length {
            return Err(PredictionError::HolderInside {
                free_length_m: self.free_length - way,
            });
        }
        let mut span = self.span;
        let mut tip: Row = [self.tip.x, self.tip.y, 0.0, 0.0, 0.0];
        let mut held = self.hold(&span, 0.0, &tip)?;
        if way > 0.0 {
            let steps = (way / step).ceil();
            let h = way / steps;
            let mut done = 0.0;
            while done < steps {
                let advance = done * h;
                let middle =
                    Vector3::new(tip[0], tip[1], self.entry + self.depth + advance + h / 2.0);
                let middle = self.world_from_frame * Point3::from(middle);
                let k = self.tissue.stiffness_at(self.tissue.depth(&middle.coords));
                let grown = |rate: &Row| -> (Span, Row) {
                    let end = std::array::from_fn(|c| tip[c] + h * rate[c]);
                    let element =
                        Span::element(self.stiffness, self.law.axial_load, k, h, &tip, &end);
                    (span.join(&element), end)
                };
                let rate = self.growth(&held, advance);
                let (trial, end) = grown(&rate);
                let ahead = self.growth(&self.hold(&trial, advance + h, &end)?, advance + h);
                let mean = std::array::from_fn(|c| f64::midpoint(rate[c], ahead[c]));
                let (next, end) = grown(&mean);
                (span, tip) = (next, end);
                held = self.hold(&span, advance + h, &tip)?;
                done += 1.0;
            }
        }
        self.bounded(&[tip, held.slope, held.reaction])?;
        let [x, y, a_pivot, a_shift, bevel] = tip;
        Ok(Rollout {
            free: Vector2::new(x, y),
            a_pivot,
            a_shift,
            bevel,
            slope: Vector2::new(held.slope[0], held.slope[1]),
            reaction: Vector2::new(held.reaction[0], held.reaction[1]),
        })
    }

    /// Tip slope and lateral force of the path on the tip \[N\], now, in the prediction's frame.
    ///
    /// # Errors
    /// [`PredictionError::Buckled`], [`PredictionError::Unbounded`].
    pub fn tip_now(&self) -> Result<(Vector2<f64>, Vector2<f64>), PredictionError> {
        let held = self.hold(&self.span, 0.0, &[self.tip.x, self.tip.y, 0.0, 0.0, 0.0])?;
        self.bounded(&[held.slope, held.reaction])?;
        let pair = |row: Row| Vector2::new(row[0], row[1]);
        Ok((pair(held.slope), pair(held.reaction)))
    }

    /// Authority of the base over the tip slope, now.
    ///
    /// # Errors
    /// [`PredictionError::Buckled`], [`PredictionError::Unbounded`].
    pub fn authority(&self) -> Result<Authority, PredictionError> {
        let axial_load_n = self.law.axial_load;
        let buckled = PredictionError::Buckled { axial_load_n };
        let clamp = Clamp::new(self.stiffness, axial_load_n, self.free_length).ok_or(buckled)?;
        // Columns 2..5 carry no path load: pivot, shift, tilt.
        let (mut position, mut slope) = ([0.0; COLUMNS], [0.0; COLUMNS]);
        position[2] = -self.free_length;
        position[3] = 1.0;
        slope[2] = 1.0;
        slope[4] = 1.0;
        let held = self
            .span
            .hold(&clamp, &[position, slope], &[0.0; COLUMNS])
            .ok_or(buckled)?;
        self.bounded(&[held.slope])?;
        Ok(Authority {
            pivot: held.slope[2],
            shift: held.slope[3],
            tilt: held.slope[4],
        })
    }
}
