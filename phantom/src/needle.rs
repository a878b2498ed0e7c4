//! The ground truth: a rod in tissue, stepped along its base's motion.

mod cutting;
mod equilibrium;
mod memory;
mod publish;

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::draw::Draw;
use crate::medium::Contact;
use crate::motion::Placement;
use crate::path::CutPath;
use crate::plant::{Plant, between};
use crate::resistance::Resistance;
use crate::rod::{Rod, Section};
use crate::settings::{Settings, SettingsError, is_pose, placed};
use crate::skin::Skin;
use crate::tissue::Tissue;
use crate::truth::{Event, Truth};
use crate::twist::Twist;
use memory::Memory;

/// Longest way of the base in one equilibrium \[m\].
const LONGEST_STEP: f64 = 0.1e-3;
/// Largest turn of the base in one equilibrium \[rad\].
const LARGEST_TURN: f64 = 0.27;
/// Longest time in one equilibrium of moving tissue \[s\].
const LONGEST_WAIT: f64 = 0.05;
/// Farthest jump of the base in one `advance`: beyond it the pose is refused \[m, rad\].
const FARTHEST_JUMP: f64 = 0.2;
/// How often a step is halved; how many halvings are allowed at once, and anew in every call.
const MOST_HALVINGS: u32 = 4;
const MOST_RETRIES: u32 = 60;
const RETRIES_A_CALL: u32 = 4;
/// Steps of one call in which the needle stays where it was; the rest of the way is then one step.
const MOST_IN_VAIN: u32 = 4;
/// The tip leaves its prediction by less, unless the shaft snaps into another shape \[m\].
const LARGEST_JUMP: f64 = 5e-3;
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
    resistance: Resistance,
    skin: Skin,
    iterations: u64,
    memory: Option<Box<Memory>>,
    retries: u32,
    truth: Truth,
}

impl RodPlant {
    /// The run `seed` of `settings`: tissue with its nominal entry at the origin of the phantom
    /// frame (z into the gel), the needle straight from `world_from_base`. A needle whose tip
    /// is already below the surface has cut its way there straight.
    ///
    /// # Errors
    /// A setting outside its range, or a place that is no pose.
    pub fn new(
        settings: &Settings,
        world_from_phantom: &Isometry3<f64>,
        world_from_base: &Transform<World, NeedleBase>,
        seed: u64,
    ) -> Result<Self, SettingsError> {
        settings.validate()?;
        placed("world_from_phantom", world_from_phantom)?;
        placed("world_from_base", world_from_base.isometry())?;
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
            resistance: Resistance::new(elements + 1),
            skin: Skin::new(&settings.entry),
            iterations: 0,
            memory: None,
            retries: MOST_RETRIES,
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
        (self.world_from_phantom * Point3::from(self.placement.phantom_of(material))).coords
    }

    /// Present place in World of the hole in the skin \[m\], where there is a skin and a needle
    /// through it.
    pub fn hole(&self) -> Option<Vector3<f64>> {
        let hole = self.skin.hole()?;
        Some((self.world_from_phantom * Point3::from(hole)).coords)
    }

    /// Energy stored in the bent and twisted shaft and in the displaced tissue \[J\].
    pub fn stored_energy(&self) -> f64 {
        let contact = &self.contact;
        let law = &self.tissue.law;
        let mut energy = self.rod.energy()
            + self.skin.energy()
            + 0.5 * contact.tip_force.norm_squared() / self.settings.tip.hold_n_m;
        if let Some(path) = &self.path {
            for i in contact.first..contact.feet.len() {
                let bed = path.bed(&contact.feet[i]);
                let density = law.relaxing_energy(&contact.displacement[i], &bed.crept);
                energy += contact.weight[i] * bed.stiffness * density;
            }
        }
        energy
    }

    /// Moves the base to `pose`, reached `dt` seconds later; in halves where no equilibrium is
    /// found near the last one. False where the needle had to be held as it was.
    fn step(&mut self, pose: &Isometry3<f64>, dt: f64, halvings: u32) -> bool {
        self.remember();
        let from = self.pose;
        let advance = self.slide_to(pose, dt);
        let predicted = self.rod.nodes[self.rod.edges()];
        let solution = self.equilibrate();
        let sound = self.rod.is_sound() && self.twist.is_finite();
        let jump = (self.rod.nodes[self.rod.edges()] - predicted).norm();
        let found = solution.converged && sound;
        if !(found && jump < LARGEST_JUMP) && halvings < MOST_HALVINGS && self.retries > 0 {
            self.retries -= 1;
            self.recall();
            self.step(&between(&from, pose, 0.5), 0.5 * dt, halvings + 1);
            return self.step(pose, 0.5 * dt, halvings + 1);
        }
        if found {
            if !solution.stable || jump > LARGEST_JUMP {
                self.report(Event::Buckling);
            }
            self.cut(advance);
        } else {
            // A shape out of balance cuts nothing; a broken one is not even kept.
            if !sound {
                self.recall();
                self.seconds += dt;
                // The path has torn since: were it torn by the same displacement at every step, it
                // would run away from a needle that stands.
                if let Some(path) = &self.path {
                    self.contact.follow(path, &self.rod.nodes);
                }
            }
            self.report(Event::Unconverged {
                last_step_m: solution.last_step,
                held: !sound,
            });
        }
        // What gives way under load does so even there, or where the needle was held: it is the
        // way back to balance. A shape that just leapt out of balance is left a chance first.
        if found || !sound || jump < LARGEST_JUMP {
            self.age(dt);
            self.skin.yield_to_shaft(&self.placement);
        }
        sound
    }

    /// Everything of a step up to its equilibrium; how far the prediction slides \[m\].
    fn slide_to(&mut self, pose: &Isometry3<f64>, dt: f64) -> f64 {
        self.seconds += dt;
        if self.settings.motion.moves() {
            self.placement = Placement::at(&self.settings.motion, self.seconds);
            if let Some(path) = &mut self.path {
                path.place(&self.placement);
            }
            self.skin.place(&self.placement);
        }
        let before = self.edge();
        let bevel_before = self.bevel_direction(&before.1);
        self.predict(pose);
        let advance = self.slide();
        self.rub(pose, advance);
        self.aim(&before.1, &bevel_before, advance);
        advance
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
        if !(is_pose(world_from_base.isometry()) && way < FARTHEST_JUMP && dt >= 0.0) {
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
        // A shape that stays out of balance must not cost every call the full search.
        self.retries = (self.retries + RETRIES_A_CALL).min(MOST_RETRIES);
        let (mut done, mut in_vain) = (0, 0);
        while done < count {
            let next = if in_vain < MOST_IN_VAIN {
                done + 1
            } else {
                count
            };
            let target = if next == count {
                pose
            } else {
                between(&from, &pose, f64::from(next) / steps)
            };
            let moved = self.step(&target, dt * f64::from(next - done) / steps, 0);
            in_vain += u32::from(!moved);
            done = next;
        }
        self.publish(stamp, world_from_base);
    }

    fn truth(&self) -> &Truth {
        &self.truth
    }

    fn tissue_at(&self, rest: &Vector3<f64>) -> Vector3<f64> {
        let material = self.world_from_phantom.inverse() * Point3::from(*rest);
        self.marker(&material.coords)
    }

    fn rest_of(&self, place: &Vector3<f64>) -> Vector3<f64> {
        let now = self.world_from_phantom.inverse() * Point3::from(*place);
        let material = self.placement.material_of(&now.coords);
        (self.world_from_phantom * Point3::from(material)).coords
    }

    fn reset(&mut self, world_from_base: &Transform<World, NeedleBase>) {
        if !is_pose(world_from_base.isometry()) {
            self.truth.events.clear();
            self.report(Event::Refused);
            return;
        }
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
        self.skin = Skin::new(&self.settings.entry);
        self.retries = MOST_RETRIES;
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
        let _ = self.equilibrate();
        self.publish(Stamp::ZERO, world_from_base);
    }
}
