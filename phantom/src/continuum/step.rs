//! One step: slide, equilibrium, cut.

use nalgebra::{DMatrix, Isometry3, UnitQuaternion, Vector2, Vector3};

use super::ContinuumPlant;
use super::beam::{Beam, Loads};
use super::kernel::Source;
use super::tip::Cut;
use crate::motion::Placement;
use crate::truth::Event;

/// Least force of cutting \[N\]: the bevel's face is loaded by what the edge cuts with.
const LEAST_CUTTING: f64 = 1e-2;
/// Shortest piece of shaft that counts as entered \[m\].
const LEAST_PIECE: f64 = 1e-9;

/// What acts on the shaft during one equilibrium.
struct Tissue<'a> {
    /// On the last two nodes.
    face: [Vector3<f64>; 2],
    /// Along the hole, on every node in the tissue \[N\].
    axial: &'a [f64],
    cut: &'a Cut,
    placement: &'a Placement,
    stiffness: &'a DMatrix<f64>,
    /// The same with what holds the edge, the last node, to the tissue that it presses on.
    seated: &'a DMatrix<f64>,
    seat: f64,
    /// Where the edge is beside the axis \[m\].
    beside: Vector3<f64>,
    first: usize,
    /// Directions of the hole at the nodes at first: a node that passes a corner of the path
    /// meanwhile would never come to rest.
    along: Vec<Vector3<f64>>,
    /// What the tissue did at the last evaluation.
    held: Vec<Vector3<f64>>,
    displaced: Vec<Vector3<f64>>,
    seating: Vector3<f64>,
    loads: Vector3<f64>,
}

impl Tissue<'_> {
    /// Where the tissue at a node's depth rests, and the direction along which it does not hold.
    fn rest(&self, node: &Vector3<f64>) -> Option<(Vector3<f64>, Vector3<f64>)> {
        match &self.cut.dent {
            Some(dent) => Some((*dent, Vector3::z())),
            None => self.cut.at(self.placement.material_of(node).z),
        }
    }
}

impl Loads for Tissue<'_> {
    fn forces(&mut self, beam: &Beam, forces: &mut [Vector3<f64>]) {
        let last = beam.across.len();
        forces.fill(Vector3::zeros());
        forces[last - 1] += self.face[0];
        forces[last] += self.face[1];
        let count = self.stiffness.nrows();
        self.displaced.clear();
        self.held.clear();
        for (i, node) in beam.nodes[self.first.min(last + 1)..].iter().enumerate() {
            let (place, direction) = self.rest(node).unwrap_or((*node, Vector3::z()));
            if i == self.along.len() {
                self.along.push(direction);
            }
            let along = self.along[i];
            let off = node - self.placement.phantom_of(&place);
            self.displaced.push(off - along * along.dot(&off));
        }
        for i in 0..count {
            let mut force = Vector3::zeros();
            for j in 0..count {
                force -= self.displaced[j] * self.stiffness[(i, j)];
            }
            // The slope of the stored energy: the shaft slides freely along its hole.
            let along = self.along[i];
            force -= along * along.dot(&force);
            self.held.push(force);
            // The tissue resists along its hole, not along the shaft: it is no follower.
            forces[self.first + i] += force - along * self.axial[i];
        }
        self.seating = self
            .displaced
            .last()
            .map_or_else(Vector3::zeros, |u| -(u + self.beside) * self.seat);
        forces[last] += self.seating;
        self.loads = forces.iter().sum();
    }

    fn stiffness(&self) -> (usize, &DMatrix<f64>) {
        (self.first, self.seated)
    }
}

impl ContinuumPlant {
    pub(super) fn tip_axis(&self) -> Vector3<f64> {
        self.beam.direction(self.beam.across.len() - 1)
    }

    /// The tip's axis in the tissue at rest, pointing inwards.
    fn tip_axis_at_rest(&self) -> Vector3<f64> {
        let last = self.beam.nodes.len() - 1;
        let [a, b] = [last - 1, last].map(|i| self.placement.material_of(&self.beam.nodes[i]));
        let axis = (b - a).normalize();
        Vector3::new(axis.x, axis.y, axis.z.max(0.1))
    }

    /// The end of the bevel on the needle's axis, in the phantom frame \[m\].
    pub(super) fn edge(&self) -> Vector3<f64> {
        self.beam.nodes[self.beam.nodes.len() - 1]
    }

    /// The tip frame: the base's, turned the shortest way and by the torsion.
    pub(super) fn tip_rotation(&self) -> UnitQuaternion<f64> {
        let from = self.pose.rotation * Vector3::z();
        let bend = UnitQuaternion::rotation_between(&from, &self.tip_axis()).unwrap_or_default();
        bend * self.pose.rotation
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.torsion)
    }

    /// Where the bevel steers to, across the tip's axis.
    pub(super) fn bevel_direction(&self) -> Vector3<f64> {
        self.tip_rotation() * -Vector3::y()
    }

    /// Force on the bevel's face across the needle \[N\] at a depth \[m\], while it cuts.
    fn face_force(&self, depth: f64) -> f64 {
        let s = &self.settings;
        let nominal = s.tip.cut_angle_deg.to_radians();
        // The population's spread of the tip's steering, whatever the tip.
        let drawn = if nominal > 0.0 {
            self.draw.cut_angle / nominal
        } else {
            1.0
        };
        let uneven = 1.0 + s.tip.field_cv * self.fields.cut.at(depth);
        let area = core::f64::consts::PI * self.space.radius * self.space.radius;
        let pressure = s.continuum.face_pressure_ratio * self.space.shear * drawn * uneven;
        pressure * area / s.needle.bevel_deg.to_radians().tan()
    }

    /// Where the middle of the cutting edge is beside the axis \[m\].
    fn edge_beside(&self) -> Vector3<f64> {
        self.cut.lead() * (self.settings.continuum.edge_offset_ratio * self.space.radius)
    }

    fn cutting_force(&self) -> f64 {
        self.settings.tip.cutting_n.max(LEAST_CUTTING)
    }

    pub(super) fn step(&mut self, pose: &Isometry3<f64>, dt: f64) {
        let before = self.placement.material_of(&self.edge());
        self.seconds += dt;
        if self.settings.motion.moves() {
            self.placement = Placement::at(&self.settings.motion, self.seconds);
        }
        self.twist(pose);
        self.pose = *pose;
        self.enter();
        if !self.balance() {
            return;
        }
        let way = self.placement.material_of(&self.edge()) - before;
        let advance = way.dot(&self.tip_axis_at_rest());
        let rubbed = self.settings.friction.presliding_um * 1e-6;
        self.slid = (self.slid + advance / rubbed).clamp(-1.0, 1.0);
        self.press(advance);
        self.tear();
    }

    /// Friction against turning twists the shaft; sliding along frees it.
    fn twist(&mut self, pose: &Isometry3<f64>) {
        let axis = self.pose.rotation * Vector3::z();
        let turned = (pose.rotation * self.pose.rotation.inverse())
            .scaled_axis()
            .dot(&axis);
        let slid = (pose.translation.vector - self.pose.translation.vector).dot(&axis);
        let (n, f) = (&self.settings.needle, &self.settings.friction);
        let girth = self.space.radius * turned;
        let way = slid.hypot(girth);
        if way <= 0.0 {
            return;
        }
        let inside = self.inserted();
        let free = self.length() - inside;
        let inner = n.inner_diameter_mm / n.outer_diameter_mm;
        let polar = 0.5 * core::f64::consts::PI * self.space.radius.powi(4) * (1.0 - inner.powi(4));
        let rigidity = n.shear_gpa * 1e9 * polar;
        let torque = f.shaft_n_m * self.space.radius;
        let most = torque * inside * (0.5 * inside + free.max(0.0)) / rigidity;
        let bound = most * girth.abs() / way;
        self.torsion = (self.torsion - turned).clamp(-bound, bound);
    }

    /// Which pieces of the shaft are in the tissue, and how stiff it is against them.
    fn enter(&mut self) {
        let base = self.pose.translation.vector;
        self.beam.clamp = self.pose.rotation * Vector3::z();
        self.beam.place(&base);
        self.sources.clear();
        let last = self.beam.nodes.len() - 1;
        self.first = last + 1;
        if self.cut.dent.is_some() {
            self.first = last;
            self.stiffness = DMatrix::from_element(1, 1, self.settings.continuum.indent_n_m);
            return;
        }
        let half = 0.5 * self.beam.edge;
        if self.cut.inside() {
            for i in (1..=last).rev() {
                let place = self.placement.material_of(&self.beam.nodes[i]);
                let steep = self.beam.direction(i - 1).z.max(0.1);
                let after = if i == last { 0.0 } else { half };
                let length = (place.z / steep + after).min(half + after);
                if length < LEAST_PIECE {
                    break;
                }
                self.sources.push(Source { place, length });
                self.first = i;
            }
            self.sources.reverse();
        }
        let flexible = self.space.flexibility(&self.sources, self.beam.edge);
        let n = flexible.nrows();
        self.stiffness = flexible
            .cholesky()
            .map_or_else(|| DMatrix::zeros(n, n), |factors| factors.inverse());
    }

    /// Finds the equilibrium; whether there is one. A shape that is none goes with its base as it was.
    fn balance(&mut self) -> bool {
        let rubbing = self.slid * self.settings.friction.shaft_n_m;
        let mut axial: Vec<f64> = self.sources.iter().map(|s| rubbing * s.length).collect();
        axial.resize(self.stiffness.nrows(), 0.0);
        if let Some(entry) = axial.first_mut() {
            *entry += self.entering;
        }
        if let Some(tip) = axial.last_mut() {
            *tip += self.cut.pressed;
        }
        let depth = self.placement.material_of(&self.edge()).z;
        // The face is loaded as far as the edge presses on tissue that it is in.
        let loaded = if self.cut.inside() {
            (self.cut.pressed / self.cutting_force()).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let across = {
            let (lead, axis) = (self.cut.lead(), self.tip_axis());
            lead - axis * axis.dot(&lead)
        };
        let pressing = self.face_force(depth) * loaded;
        let mut face = across * pressing;
        // Tissue that is pressed ahead resists the edge aside as it does along.
        let seat = self.settings.continuum.indent_n_m * loaded;
        let mut seated = self.stiffness.clone();
        if let Some(corner) = seated.nrows().checked_sub(1) {
            seated[(corner, corner)] += seat;
        }
        // It acts in the middle of the bevel.
        let behind = (0.5 * self.bevel_length() / self.beam.edge).min(1.0);
        let shape = self.beam.across.clone();
        let mut tissue = Tissue {
            face: [face * behind, face * (1.0 - behind)],
            axial: &axial,
            cut: &self.cut,
            placement: &self.placement,
            stiffness: &self.stiffness,
            seated: &seated,
            seat,
            beside: self.edge_beside(),
            first: self.first,
            along: Vec::new(),
            held: Vec::new(),
            displaced: Vec::new(),
            seating: Vector3::zeros(),
            loads: Vector3::zeros(),
        };
        let base = self.pose.translation.vector;
        let found = self.beam.settle(&base, &mut tissue, self.unbalanced);
        self.unbalanced = !found.converged;
        if found.converged {
            face += tissue.seating;
            self.face = face;
            let (held, displaced, loads) = (tissue.held, tissue.displaced, tissue.loads);
            (self.held, self.displaced, self.loads) = (held, displaced, loads);
            self.entering = if self.sources.is_empty() {
                0.0
            } else {
                let whole = self.beam.edge;
                self.space.entering(&self.sources, whole, &self.held)
            };
        } else {
            self.beam.across = shape;
            self.beam.place(&base);
            self.report(Event::Unconverged {
                last_step_m: found.last * self.beam.edge,
                held: true,
            });
        }
        if !found.stable {
            self.report(Event::Buckling);
        }
        found.converged
    }

    /// The edge presses on, and cuts where the force suffices.
    fn press(&mut self, advance: f64) {
        let edge = self.placement.material_of(&self.edge());
        let (indent, puncture) = {
            let c = &self.settings.continuum;
            (c.indent_n_m, c.puncture_n)
        };
        let cutting = self.cutting_force();
        let Some(end) = self.cut.end().copied() else {
            if edge.z <= 0.0 {
                self.cut.leave();
                return;
            }
            let axis = self.tip_axis_at_rest();
            self.cut.dent.get_or_insert(edge - axis * (edge.z / axis.z));
            self.cut.pressed = edge.z * indent;
            if self.cut.pressed > cutting.max(puncture) {
                let bevel = self.bevel_direction();
                let bottom = (edge.z - cutting / indent).max(0.5 * edge.z);
                self.cut.enter(&axis, &bevel, bottom);
                self.cut.pressed = cutting;
                self.report(Event::Entered { reused: false });
            }
            return;
        };
        if edge.z < 0.0 {
            self.cut.leave();
            self.report(Event::PulledOut);
            return;
        }
        // Drawn back from the end of its cut the edge presses on nothing.
        let ahead = edge.z - end.z;
        let most = cutting + advance.abs() * indent;
        self.cut.pressed = (ahead * indent).clamp(0.0, most);
        let way = ahead - cutting / indent;
        if way > 0.0 {
            self.cut.pressed = cutting;
            self.cut_on(way, &edge, &end);
        }
    }

    /// The path goes on from its end by `way` \[m\] of depth.
    fn cut_on(&mut self, way: f64, edge: &Vector3<f64>, end: &Vector3<f64>) {
        let axis = self.tip_axis_at_rest();
        let c = &self.settings.continuum;
        let bevel = self.bevel_direction();
        let sharp = edge + self.edge_beside();
        self.cut.split(&bevel, way, c.slit_memory_mm * 1e-3);
        let slope = axis.xy() / axis.z;
        let noise = self.settings.tip.direction_noise_deg.to_radians();
        let [x, y] = &self.fields.direction;
        let wander = Vector2::new(x.at(end.z), y.at(end.z)) * noise;
        let off = sharp.xy() - slope * (sharp.z - end.z) - end.xy();
        let follow = -(-way / self.bevel_length()).exp_m1();
        let next = end.xy() + (slope + wander) * way + off * follow;
        self.cut.go_on(&next.push(end.z + way));
    }

    /// Tissue displaced beyond the threshold tears: the path moves until it is not.
    fn tear(&mut self) {
        let most = self.settings.tissue.tear_mm * 1e-3;
        if most <= 0.0 || !self.cut.inside() || self.sources.is_empty() {
            return;
        }
        let torn = |u: &Vector3<f64>| (1.0 - most / u.norm().max(most)) * u;
        let excess: Vec<Vector3<f64>> = self.displaced.iter().map(torn).collect();
        let worst =
            (0..excess.len()).max_by(|&a, &b| excess[a].norm().total_cmp(&excess[b].norm()));
        let Some(worst) = worst.filter(|&i| excess[i].norm() > 0.0) else {
            return;
        };
        let aside: Vec<(f64, Vector2<f64>)> = (0..excess.len())
            .map(|i| {
                let node = self.beam.nodes[self.first + i];
                let place = self.placement.material_of(&node);
                let moved = place - self.placement.material_of(&(node - excess[i]));
                (place.z, moved.xy())
            })
            .collect();
        self.cut.displace(|depth| {
            let next = aside.partition_point(|(z, _)| *z < depth);
            let (Some(&(z, by)), Some(&(before, was))) =
                (aside.get(next), aside.get(next.wrapping_sub(1)))
            else {
                return aside[next.min(aside.len() - 1)].1;
            };
            was.lerp(&by, (depth - before) / (z - before))
        });
        self.report(Event::Tearing {
            depth_m: aside[worst].0,
            by_m: excess[worst].norm(),
        });
    }
}
