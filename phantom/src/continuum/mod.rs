//! A plant of its own kind: a bevel that cuts by a balance of forces, in tissue that is not local.
//!
//! Tissue is an elastic half-space with a free surface (`kernel`): what the shaft does to it in one
//! place moves it everywhere. The needle is an inextensible beam (`beam`) that ends at the cutting
//! edge. Its tip is on no path; these forces act on it:
//!
//! * The tissue is pressed ahead of the edge, by `indent_n_m`, until the force cuts it
//!   (`tip.cutting_n`; at the surface `continuum.puncture_n`): the cut lags behind the edge. It
//!   resists the edge aside by the same stiffness, which is less than the shaft's bed has.
//! * The pressure on the bevel's face, `face_pressure_ratio` times the shear modulus, pushes the tip
//!   aside. Of two bevels the sharper one has the larger face: `p pi d^2/4 cot(bevel)`.
//! * The edge, beside the axis, cuts where it is; the path's end follows it over one bevel length,
//!   so that a tip pressed aside cuts its way there.
//! * The slit remembers the directions in which it was cut over `slit_memory_mm` (`tip`), and leads
//!   push and edge by their mean: a bevel that spins for a short while does not lose its direction.

mod beam;
mod kernel;
mod publish;
mod step;
mod tip;

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{DMatrix, Isometry3, Point3, Vector3};

use crate::draw::{Draw, Fields};
use crate::motion::Placement;
use crate::plant::{Plant, between};
use crate::settings::{Settings, SettingsError, is_pose, placed};
use crate::truth::{Event, Truth};
use beam::{Beam, STEEPEST};
use kernel::{HalfSpace, Source};
use tip::Cut;

/// Length of the beam's edges \[m\], and how many there are at most: long needles have longer ones.
const EDGE: f64 = 2e-3;
const MOST_EDGES: f64 = 128.0;
/// Longest way of the base, and largest turn, in one equilibrium \[m, rad\].
const LONGEST_STEP: f64 = 0.1e-3;
const LARGEST_TURN: f64 = 0.15;
/// Longest time in one equilibrium of moving tissue \[s\].
const LONGEST_WAIT: f64 = 0.05;
/// Steps of one `advance` at most.
const MOST_STEPS: f64 = 4e3;
/// Farthest jump of the base in one `advance` \[m\].
const FARTHEST_JUMP: f64 = 0.2;
/// Stiffness per length that a needle of wave length 29 mm and radius 0.35 mm meets, over the
/// half-space's shear modulus: 8 pi / (2 ln(2 lambda / r)), by the kernel's integral over the wave
/// length.
const STIFFNESS_OF_SHEAR: f64 = 2.46;

/// A needle in a half-space.
#[derive(Clone, Debug)]
pub struct ContinuumPlant {
    settings: Settings,
    draw: Draw,
    fields: Fields,
    world_from_phantom: Isometry3<f64>,
    space: HalfSpace,
    beam: Beam,
    /// Pose of the base in the phantom frame.
    pose: Isometry3<f64>,
    placement: Placement,
    seconds: f64,
    cut: Cut,
    /// Pieces of shaft in the tissue and their first node, deepest last.
    sources: Vec<Source>,
    first: usize,
    /// Stiffness of the tissue against displacements of these nodes \[N/m\].
    stiffness: DMatrix<f64>,
    /// Lateral forces on them by the tissue \[N\], and its displacements \[m\].
    held: Vec<Vector3<f64>>,
    displaced: Vec<Vector3<f64>>,
    /// Axial force of the tissue that resists the entering of a bent shaft \[N\].
    entering: f64,
    /// All forces on the needle but the holder's, and those at its tip \[N\].
    loads: Vector3<f64>,
    face: Vector3<f64>,
    /// Whether the last step found no equilibrium.
    unbalanced: bool,
    /// Axial slide of the shaft against its friction, from -1 to 1.
    slid: f64,
    /// Twist of the tip against the base \[rad\].
    torsion: f64,
    truth: Truth,
}

impl ContinuumPlant {
    /// The run `seed` of `settings`: tissue with its nominal entry at the origin of the phantom
    /// frame (z into the gel), the needle straight from `world_from_base`. A needle whose tip
    /// is already below the surface has cut its way there straight.
    ///
    /// # Errors
    /// A setting outside its range, a guide, a place that is no pose, or a needle that does not
    /// point into the tissue.
    pub fn new(
        settings: &Settings,
        world_from_phantom: &Isometry3<f64>,
        world_from_base: &Transform<World, NeedleBase>,
        seed: u64,
    ) -> Result<Self, SettingsError> {
        settings.validate()?;
        placed("world_from_phantom", world_from_phantom)?;
        placed("world_from_base", world_from_base.isometry())?;
        if settings.guide.gap_mm > 0.0 {
            return Err(SettingsError::Inconsistent {
                key: "guide.gap_mm",
                expected: "the plant `continuum` holds its needle at the base alone: 0",
            });
        }
        let pose = world_from_phantom.inverse() * world_from_base.isometry();
        if !points_inward(&pose) {
            return Err(SettingsError::Inconsistent {
                key: "world_from_base",
                expected: "the needle must point into the tissue, within 58 degrees of its normal",
            });
        }
        let draw = Draw::new(settings, seed);
        let n = &settings.needle;
        let (outer, inner) = (n.outer_diameter_mm * 1e-3, n.inner_diameter_mm * 1e-3);
        let area = core::f64::consts::PI / 64.0 * (outer.powi(4) - inner.powi(4));
        let bevel = n.bevel_deg.to_radians();
        let whole = n.length_mm * 1e-3 + outer / bevel.tan();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "needles are a few metres long at most"
        )]
        let edges = (whole / EDGE).round().clamp(8.0, MOST_EDGES) as usize;
        let (base, axis) = (Vector3::zeros(), Vector3::z());
        let mut plant = Self {
            settings: settings.clone(),
            draw,
            fields: Fields::draw(settings, seed),
            world_from_phantom: *world_from_phantom,
            space: HalfSpace {
                shear: draw.stiffness / STIFFNESS_OF_SHEAR,
                radius: 0.5 * outer,
            },
            beam: Beam::straight(n.young_gpa * 1e9 * area, whole, edges, base, axis),
            pose,
            placement: Placement::at_rest(),
            seconds: 0.0,
            cut: Cut::default(),
            sources: Vec::new(),
            first: edges + 1,
            stiffness: DMatrix::zeros(0, 0),
            held: Vec::new(),
            displaced: Vec::new(),
            entering: 0.0,
            loads: Vector3::zeros(),
            face: Vector3::zeros(),
            unbalanced: false,
            slid: 0.0,
            torsion: 0.0,
            truth: Truth::straight(world_from_base, whole, n.elements, outer, bevel),
        };
        plant.reset(world_from_base);
        Ok(plant)
    }

    /// What chance gave this run.
    pub fn draw(&self) -> &Draw {
        &self.draw
    }

    /// Energy stored in the bent shaft and in the displaced tissue \[J\].
    pub fn stored_energy(&self) -> f64 {
        let tissue: f64 = self
            .held
            .iter()
            .zip(&self.displaced)
            .map(|(f, u)| -0.5 * f.dot(u))
            .sum();
        self.beam.energy() + tissue
    }

    /// Length of the bevel \[m\].
    fn bevel_length(&self) -> f64 {
        2.0 * self.space.radius / self.settings.needle.bevel_deg.to_radians().tan()
    }

    /// Length from the base to the cutting edge \[m\].
    fn length(&self) -> f64 {
        self.beam.edge * self.beam.across.len() as f64
    }

    /// Length of shaft and bevel in the tissue \[m\].
    fn inserted(&self) -> f64 {
        self.sources.iter().map(|s| s.length).sum()
    }

    fn report(&mut self, event: Event) {
        self.truth.note(event);
    }
}

/// Whether a beam from this base goes into the tissue by slopes that it can have.
fn points_inward(pose: &Isometry3<f64>) -> bool {
    let axis = pose.rotation * Vector3::z();
    axis.z > 0.0 && axis.xy().norm() < STEEPEST
}

impl Plant for ContinuumPlant {
    fn advance(&mut self, world_from_base: &Transform<World, NeedleBase>, stamp: Stamp) {
        self.truth.events.clear();
        let pose = self.world_from_phantom.inverse() * world_from_base.isometry();
        let from = self.pose;
        let way = (pose.translation.vector - from.translation.vector).norm();
        let turn = from.rotation.angle_to(&pose.rotation);
        let dt = stamp.secs_since(self.truth.stamp);
        let possible = is_pose(world_from_base.isometry()) && points_inward(&pose);
        if !(possible && way < FARTHEST_JUMP && dt >= 0.0) {
            self.report(Event::Refused);
            return;
        }
        let mut steps = (way / LONGEST_STEP).max(turn / LARGEST_TURN);
        if self.settings.motion.moves() {
            steps = steps.max(dt / LONGEST_WAIT);
        }
        let steps = steps.ceil().clamp(1.0, MOST_STEPS);
        let mut done = 0.0;
        while done < steps {
            done += 1.0;
            self.step(&between(&from, &pose, done / steps), dt / steps);
        }
        self.pose = pose;
        self.publish(stamp, world_from_base);
    }

    fn truth(&self) -> &Truth {
        &self.truth
    }

    fn tissue_at(&self, rest: &Vector3<f64>) -> Vector3<f64> {
        let material = self.world_from_phantom.inverse() * Point3::from(*rest);
        let now = self.placement.phantom_of(&material.coords);
        (self.world_from_phantom * Point3::from(now)).coords
    }

    fn rest_of(&self, place: &Vector3<f64>) -> Vector3<f64> {
        let now = self.world_from_phantom.inverse() * Point3::from(*place);
        let material = self.placement.material_of(&now.coords);
        (self.world_from_phantom * Point3::from(material)).coords
    }

    fn reset(&mut self, world_from_base: &Transform<World, NeedleBase>) {
        let pose = self.world_from_phantom.inverse() * world_from_base.isometry();
        if !(is_pose(world_from_base.isometry()) && points_inward(&pose)) {
            self.truth.events.clear();
            self.report(Event::Refused);
            return;
        }
        self.pose = pose;
        let axis = pose.rotation * Vector3::z();
        let base = pose.translation.vector;
        let (edges, whole) = (self.beam.across.len(), self.length());
        self.beam = Beam::straight(self.beam.bending, whole, edges, base, axis);
        self.placement = Placement::at_rest();
        self.seconds = 0.0;
        self.entering = 0.0;
        self.unbalanced = false;
        self.slid = 0.0;
        self.torsion = 0.0;
        let n = &self.settings.needle;
        self.truth = Truth::straight(
            world_from_base,
            n.length_mm * 1e-3,
            n.elements,
            2.0 * self.space.radius,
            n.bevel_deg.to_radians(),
        );
        self.cut = Cut::straight(&self.edge(), &axis, &self.bevel_direction());
        self.step(&pose, 0.0);
        self.publish(Stamp::ZERO, world_from_base);
    }
}
