//! The ground truth: a rod in tissue, stepped along its base's motion.

mod publish;

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::draw::Draw;
use crate::medium::{Contact, Hold, Medium};
use crate::motion::Placement;
use crate::path::CutPath;
use crate::plant::Plant;
use crate::rod::{Rod, Section};
use crate::settings::{Settings, SettingsError};
use crate::tissue::Tissue;
use crate::truth::{Event, Truth};
use crate::twist::{Sliding, Twist};

/// Longest way of the base in one equilibrium \[m\].
const LONGEST_STEP: f64 = 0.1e-3;
/// Largest turn of the base in one equilibrium \[rad\].
const LARGEST_TURN: f64 = 0.27;
/// Longest time in one equilibrium of moving tissue \[s\].
const LONGEST_WAIT: f64 = 0.05;
/// Farthest jump of the base in one `advance`: beyond it the pose is refused \[m, rad\].
const FARTHEST_JUMP: f64 = 0.2;
/// An old hole is found again within this distance of its entry \[m\].
const HOLE_REACH: f64 = 0.35e-3;
/// Elastic travel over which the cutting force builds up \[m\].
const CUTTING_TRAVEL: f64 = 20e-6;

/// What extrapolates the tip's direction to the middle of a step.
#[derive(Clone, Copy, Debug, Default)]
struct Recent {
    direction: Vector3<f64>,
    force: Vector3<f64>,
    advance: f64,
}

/// The discrete rod in tissue with a cut path: the ground truth of every experiment.
#[derive(Clone, Debug)]
pub struct RodPlant {
    settings: Settings,
    draw: Draw,
    world_from_phantom: Isometry3<f64>,
    tissue: Tissue,
    radius: f64,
    bevel_angle: f64,
    pub(crate) rod: Rod,
    twist: Twist,
    pub(crate) contact: Contact,
    pub(crate) path: Option<CutPath>,
    parked: Option<CutPath>,
    placement: Placement,
    /// Pose of the base in the phantom frame.
    pose: Isometry3<f64>,
    seconds: f64,
    fixed: Vec<Vector3<f64>>,
    axial: Vec<f64>,
    touching: Vec<f64>,
    cutting: f64,
    recent: Recent,
    iterations: u64,
    truth: Truth,
}

impl RodPlant {
    /// The run `seed` of `settings`: tissue with its nominal entry at the origin of the phantom
    /// frame (z into the gel), the needle straight from `world_from_base`. A needle whose tip
    /// is already below the surface has cut its way there straight.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(
        settings: &Settings,
        world_from_phantom: &Isometry3<f64>,
        world_from_base: &Transform<World, NeedleBase>,
        seed: u64,
    ) -> Result<Self, SettingsError> {
        settings.validate()?;
        let draw = Draw::new(settings, seed);
        let tissue = Tissue::new(settings, &draw, seed);
        let n = &settings.needle;
        let section = Section::tube(
            n.outer_diameter_mm * 1e-3,
            n.inner_diameter_mm * 1e-3,
            n.young_gpa * 1e9,
            n.shear_gpa * 1e9,
        );
        let (length, elements) = (n.length_mm * 1e-3, n.elements);
        let diameter = n.outer_diameter_mm * 1e-3;
        let bevel_angle = n.bevel_deg.to_radians();
        let rod = Rod::straight(section, length, elements, Vector3::zeros(), Vector3::z());
        let truth = Truth::straight(world_from_base, length, elements, diameter, bevel_angle);
        let mut plant = Self {
            settings: settings.clone(),
            draw,
            world_from_phantom: *world_from_phantom,
            tissue,
            radius: 0.5 * diameter,
            bevel_angle,
            twist: Twist::straight(&rod, Vector3::x()),
            contact: Contact::new(elements + 1),
            path: None,
            parked: None,
            placement: Placement::at_rest(),
            pose: Isometry3::identity(),
            seconds: 0.0,
            fixed: vec![Vector3::zeros(); elements + 1],
            axial: vec![0.0; elements],
            touching: vec![0.0; elements],
            cutting: 0.0,
            recent: Recent::default(),
            iterations: 0,
            rod,
            truth,
        };
        plant.reset(world_from_base);
        Ok(plant)
    }

    /// What chance gave this run.
    pub fn draw(&self) -> &Draw {
        &self.draw
    }

    /// Newton steps since construction or reset, a measure of work.
    pub fn iterations(&self) -> u64 {
        self.iterations
    }

    /// Present position in World of the tissue that is at `material` (phantom frame) while the
    /// tissue is at rest \[m\]: a marker. The needle's push on it is not modelled (the bed is
    /// local: a point off the shaft does not feel it).
    pub fn marker(&self, material: &Vector3<f64>) -> Vector3<f64> {
        (self.world_from_phantom * nalgebra::Point3::from(self.placement.phantom_of(material)))
            .coords
    }

    /// Energy stored in the bent and twisted shaft and in the displaced tissue \[J\].
    pub fn stored_energy(&self) -> f64 {
        let contact = &self.contact;
        let law = &self.tissue.law;
        let mut energy =
            self.rod.energy() + 0.5 * contact.tip_force.norm_squared() / self.settings.tip.hold_n_m;
        if let Some(path) = &self.path {
            for i in contact.first..contact.feet.len() {
                let bed = path.bed(&contact.feet[i]);
                let density = law.relaxing_energy(&contact.displacement[i], &bed.crept);
                energy += contact.weight[i] * bed.stiffness * density;
            }
        }
        energy
    }

    fn bevel_length(&self) -> f64 {
        2.0 * self.radius / self.bevel_angle.tan()
    }

    /// Position and direction of the cutting edge in the phantom frame.
    fn edge(&self) -> (Vector3<f64>, Vector3<f64>) {
        let direction = self.rod.direction(self.rod.edges() - 1);
        let o = self.rod.nodes[self.rod.edges()];
        (o + direction * self.bevel_length(), direction)
    }

    /// One equilibrium at `pose`, `dt` seconds later.
    fn step(&mut self, pose: &Isometry3<f64>, dt: f64) {
        self.seconds += dt;
        if self.settings.motion.moves() {
            self.placement = Placement::at(&self.settings.motion, self.seconds);
            if let Some(path) = &mut self.path {
                path.place(&self.placement);
            }
        }
        let before = self.edge();
        let bevel_before = self.bevel_direction(&before.1);
        self.predict(pose);
        let advance = self.slide();
        self.rub(pose, advance);
        self.aim(&before.1, &bevel_before, advance);
        self.equilibrate();
        self.cut(advance);
        self.age(dt);
    }

    /// Slides the shape along itself with the base, and sideways where it is free.
    fn predict(&mut self, pose: &Isometry3<f64>) {
        let motion = pose.translation.vector - self.rod.nodes[0];
        let axis = pose.rotation * Vector3::z();
        let along = axis.dot(&motion);
        let across = motion - axis * along;
        let edges = self.rod.edges();
        let free = self.contact.first.clamp(edges / 8, edges) as f64;
        self.rod.nodes[0] += motion;
        let mut ahead = axis;
        for i in 1..=edges {
            let here = if i < edges {
                (self.rod.nodes[i + 1] - self.rod.nodes[i]) / self.rod.edge
            } else {
                ahead
            };
            ahead = here;
            let share = (1.0 - i as f64 / free).max(0.0);
            self.rod.nodes[i] += here * along + across * share;
        }
        self.rod.clamp = axis;
        self.pose = *pose;
    }

    /// How far the prediction slides through the tissue \[m\].
    fn slide(&self) -> f64 {
        let Some(path) = &self.path else {
            return 0.0;
        };
        // Against the last equilibrium, so that a motion of the tissue counts too.
        let last = &self.contact.edge;
        path.locate(&self.edge().0, last.segment).arc - last.arc
    }

    /// Friction along and around the shaft, and the force of cutting.
    fn rub(&mut self, pose: &Isometry3<f64>, advance: f64) {
        self.fixed.fill(Vector3::zeros());
        self.axial.fill(advance);
        for i in 0..self.touching.len() {
            self.touching[i] = self.contact.weight[i + 1];
        }
        let sliding = Sliding {
            axial: &self.axial,
            contact: &self.touching,
            radius: self.radius,
        };
        let director = pose.rotation * Vector3::x();
        self.twist.advance(
            &mut self.rod,
            director,
            &sliding,
            &self.settings.friction,
            &mut self.fixed,
        );
        self.cutting = (self.cutting + advance).clamp(0.0, CUTTING_TRAVEL);
        let at_end = self
            .path
            .as_ref()
            .is_some_and(|p| self.contact.edge.arc >= p.length() - CUTTING_TRAVEL);
        if at_end && self.cutting > 0.0 {
            let (edge, direction) = self.edge();
            let depth = self.placement.material_of(&edge).z;
            let force = self.tissue.cutting_force(depth) * self.cutting / CUTTING_TRAVEL;
            if let Some(last) = self.fixed.last_mut() {
                *last -= direction * force;
            }
        }
    }

    fn bevel_direction(&self, tangent: &Vector3<f64>) -> Vector3<f64> {
        // -y = -(z x x).
        self.twist.tip_director(tangent).cross(tangent)
    }

    /// Points the path's ray where the tissue will be cut: the tip's direction at the middle
    /// of the step, turned by the cut angle in the bevel's direction there.
    fn aim(&mut self, direction: &Vector3<f64>, bevel_before: &Vector3<f64>, advance: f64) {
        let force = self.contact.tip_force;
        let half = if self.recent.advance > 0.0 && advance > 0.0 {
            0.5 * (advance / self.recent.advance).min(2.0)
        } else {
            0.0
        };
        let middle = (direction + (direction - self.recent.direction) * half).normalize();
        let force_middle = force + (force - self.recent.force) * half;
        self.recent = Recent {
            direction: *direction,
            force,
            advance,
        };
        let edges = self.rod.edges();
        let bevel_after = self.bevel_direction(&self.rod.direction(edges - 1));
        let across = |v: Vector3<f64>| v - middle * middle.dot(&v);
        let bevel = across(bevel_before + bevel_after);
        let bevel = bevel / bevel.norm().max(1e-9);
        let Some(path) = &mut self.path else {
            return;
        };
        let depth = self.placement.material_of(&path.end()).z + 0.5 * advance;
        let tissue = &self.tissue;
        let mut turn = bevel * tissue.cut_angle(depth) + across(tissue.direction_noise(depth));
        turn -= across(force_middle) * tissue.compliance;
        if tissue.moment_compliance > 0.0 {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a few edges"
            )]
            let back = ((2.0 * self.radius / self.bevel_angle.tan() / self.rod.edge) as usize)
                .clamp(1, edges - 1);
            let moment = self.rod.bending_moment(edges - back).cross(&middle);
            turn += across(moment) * tissue.moment_compliance;
        }
        let angle = turn.norm();
        path.aim(if angle > 0.0 {
            middle * angle.cos() + turn * (angle.sin() / angle)
        } else {
            middle
        });
    }

    fn equilibrate(&mut self) {
        let hold = Hold {
            stiffness: self.settings.tip.hold_n_m,
            reach: self.bevel_length(),
            fade: self.bevel_length(),
        };
        let solution = self.rod.relax(&mut Medium {
            path: self.path.as_ref(),
            law: self.tissue.law,
            hold,
            contact: &mut self.contact,
            fixed: &self.fixed,
            edge_length: self.rod.edge,
        });
        self.iterations += u64::from(solution.iterations);
        if !solution.stable {
            self.report(Event::Buckling);
        }
        if !solution.converged {
            self.report(Event::Unconverged {
                last_step_m: solution.last_step,
            });
        }
    }

    /// Extends the path to where the cutting edge went, or begins or leaves it.
    fn cut(&mut self, advance: f64) {
        let (edge, direction) = self.edge();
        let material = self.placement.material_of(&edge);
        match &mut self.path {
            Some(path) => {
                let ahead = self.contact.edge.arc - path.length();
                if ahead > 0.0 {
                    path.cut(ahead, self.tissue.stiffness(material.z), &self.placement);
                } else if self.contact.edge.arc < 0.0 && advance <= 0.0 {
                    self.parked = self.path.take();
                    self.contact.clear(self.rod.nodes.len());
                    self.report(Event::PulledOut);
                }
            }
            None if material.z > 0.0 && direction.z > 0.05 => {
                let entry = edge - direction * (material.z / direction.z);
                let old = self
                    .parked
                    .take()
                    .filter(|p| p.enters_near(&entry, HOLE_REACH));
                let reused = old.is_some();
                let mut path = old.unwrap_or_else(|| {
                    let surface = self.tissue.stiffness(0.0);
                    let mut fresh =
                        CutPath::starting_at(entry, direction, surface, &self.placement);
                    let depth = material.z / direction.z;
                    let pieces = (depth / LONGEST_STEP).ceil().clamp(1.0, 4e3);
                    let mut cut = 0.0;
                    while cut < depth * (1.0 - 1e-9) {
                        cut += depth / pieces;
                        let stiffness = self.tissue.stiffness(cut * direction.z);
                        fresh.cut(depth / pieces, stiffness, &self.placement);
                    }
                    fresh
                });
                if reused {
                    path.place(&self.placement);
                }
                self.contact.edge = path.locate(&edge, 0);
                self.path = Some(path);
                self.report(Event::Entered { reused });
            }
            None => {}
        }
    }

    /// Relaxation and tearing.
    fn age(&mut self, dt: f64) {
        let relaxes = self.tissue.law.relaxed > 0.0;
        let overstretched = self.tissue.tear.is_finite()
            && self
                .contact
                .displacement
                .iter()
                .any(|u| u.norm_squared() > self.tissue.tear * self.tissue.tear);
        let Some(path) = &mut self.path else {
            return;
        };
        if !relaxes && !overstretched {
            return;
        }
        let creep = if relaxes {
            -(-dt / self.tissue.relaxation).exp_m1()
        } else {
            0.0
        };
        let contact = &self.contact;
        let last = contact.feet.len() - 1;
        let mut i = contact.first.min(last);
        let torn = path.age(creep, self.tissue.tear, &self.placement, |arc| {
            if contact.first > last || arc > contact.feet[last].arc {
                return Vector3::zeros();
            }
            while i < last && contact.feet[i].arc < arc {
                i += 1;
            }
            if i == contact.first {
                return contact.displacement[i];
            }
            let (a, b) = (contact.feet[i - 1].arc, contact.feet[i].arc);
            let share = if b > a { (arc - a) / (b - a) } else { 1.0 };
            contact.displacement[i - 1].lerp(&contact.displacement[i], share)
        });
        if let Some((depth_m, by_m)) = torn {
            self.report(Event::Tearing { depth_m, by_m });
        }
    }
}

impl Plant for RodPlant {
    fn advance(&mut self, world_from_base: &Transform<World, NeedleBase>, stamp: Stamp) {
        self.truth.events.clear();
        let pose = self.world_from_phantom.inverse() * world_from_base.isometry();
        let from = self.pose;
        let way = (pose.translation.vector - from.translation.vector).norm();
        let turn = from.rotation.angle_to(&pose.rotation);
        let dt = stamp.secs_since(self.truth.stamp);
        if !(way.is_finite() && turn.is_finite() && way < FARTHEST_JUMP && dt >= 0.0) {
            self.report(Event::Refused);
            return;
        }
        let mut steps = (way / LONGEST_STEP).max(turn / LARGEST_TURN);
        if self.settings.motion.moves() || self.tissue.law.relaxed > 0.0 {
            steps = steps.max((dt / LONGEST_WAIT).min(2e3));
        }
        let steps = steps.ceil().max(1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "bounded by the checks above"
        )]
        let count = steps as u32;
        let screw = (from.rotation.inverse() * pose.rotation).scaled_axis();
        for i in 1..=count {
            let share = f64::from(i) / steps;
            let target = if i == count {
                pose
            } else {
                let place = from
                    .translation
                    .vector
                    .lerp(&pose.translation.vector, share);
                let turned = from.rotation * UnitQuaternion::from_scaled_axis(screw * share);
                Isometry3::from_parts(place.into(), turned)
            };
            self.step(&target, dt / steps);
        }
        self.publish(stamp, world_from_base);
    }

    fn truth(&self) -> &Truth {
        &self.truth
    }

    fn reset(&mut self, world_from_base: &Transform<World, NeedleBase>) {
        let n = &self.settings.needle;
        let length = n.length_mm * 1e-3;
        self.pose = self.world_from_phantom.inverse() * world_from_base.isometry();
        let axis = self.pose.rotation * Vector3::z();
        let base = self.pose.translation.vector;
        self.rod = Rod::straight(self.rod.section, length, n.elements, base, axis);
        self.twist = Twist::straight(&self.rod, self.pose.rotation * Vector3::x());
        self.contact = Contact::new(n.elements + 1);
        self.path = None;
        self.parked = None;
        self.placement = Placement::at_rest();
        self.seconds = 0.0;
        self.cutting = 0.0;
        self.iterations = 0;
        self.recent = Recent {
            direction: axis,
            ..Recent::default()
        };
        self.truth = Truth::straight(
            world_from_base,
            length,
            n.elements,
            2.0 * self.radius,
            self.bevel_angle,
        );
        self.cut(0.0);
        self.fixed.fill(Vector3::zeros());
        self.equilibrate();
        self.publish(Stamp::ZERO, world_from_base);
    }
}
