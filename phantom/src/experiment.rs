//! The paper's uncontrolled insertion and its score.

use hal::frame::{LeftCamera, NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::bench::{Bench, Setup};
use crate::settings::{Settings, SettingsError, within};
use crate::truth::Truth;

/// Distance of the target ahead of O at the start \[m\] (paper).
pub const TARGET_DISTANCE: f64 = 0.08;
/// Shift of the shifted target \[m\] (paper).
pub const TARGET_SHIFT: f64 = 0.01;

/// Watches O's plane pass a target.
#[derive(Clone, Copy, Debug)]
pub struct Passing {
    target: Vector3<f64>,
    before: Option<(f64, f64)>,
    lateral: Option<f64>,
}

impl Passing {
    /// Watches `target` (World \[m\]).
    pub const fn new(target: Vector3<f64>) -> Self {
        Self {
            target,
            before: None,
            lateral: None,
        }
    }

    /// The target has moved to `target` (World \[m\]).
    pub const fn follow(&mut self, target: Vector3<f64>) {
        self.target = target;
    }

    /// Takes note of a state; the target's distance from the tip axis at the moment O's plane
    /// passed it \[m\], once it has, linear between states.
    pub fn observe(&mut self, truth: &Truth) -> Option<f64> {
        if self.lateral.is_none() {
            let miss = truth.miss(&self.target);
            if miss.axial <= 0.0 {
                let (axial, lateral) = self.before.unwrap_or((miss.axial, miss.lateral));
                let share = if axial > miss.axial {
                    axial / (axial - miss.axial)
                } else {
                    0.0
                };
                self.lateral = Some(lateral + share * (miss.lateral - lateral));
            }
            self.before = Some((miss.axial, miss.lateral));
        }
        self.lateral
    }
}

/// The laboratory's default places: gel entry at (0.40, 0, 0.25) m, z into the gel downwards;
/// the needle straight down with O on the surface.
pub fn default_setup(settings: &Settings, seed: u64) -> Setup {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI);
    let world_from_phantom = Isometry3::from_parts(Vector3::new(0.40, 0.0, 0.25).into(), down);
    let length = settings.needle.length_mm * 1e-3;
    Setup {
        world_from_phantom,
        world_from_base: Transform::assume(
            world_from_phantom * Isometry3::translation(0.0, 0.0, -length),
        ),
        left_from_world: default_left_from_world(&world_from_phantom),
        seed,
    }
}

/// A stereo frame 0.5 m from the gel's centre, looking at it horizontally.
fn default_left_from_world(world_from_phantom: &Isometry3<f64>) -> Transform<LeftCamera, World> {
    let centre = world_from_phantom * Point3::new(0.0, 0.0, 0.05);
    let eye = world_from_phantom * Point3::new(0.5, 0.0, 0.05);
    let up = world_from_phantom.rotation * -Vector3::z();
    let looking = Isometry3::face_towards(&eye, &centre, &-up);
    Transform::assume(looking.inverse())
}

/// What an uncontrolled insertion missed by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncontrolled {
    /// Distance of the aligned target from the tip axis when O's plane passed it \[m\]; infinite
    /// where it never did.
    pub aligned: f64,
    /// The same for the target shifted by 1 cm in the nominal bevel direction \[m\].
    pub shifted: f64,
    /// Largest tissue displacement at the end \[m\].
    pub max_stretch: f64,
}

/// Inserts without control: straight by this run's pre-insertion; then the targets are defined
/// 80 mm ahead of O on the holder's nominal z through O, and 1 cm beside it in the nominal
/// bevel direction; straight on along the holder's z until O's plane has passed both.
/// `period` is the plant's step \[s\], `speed` the insertion's \[m/s\].
///
/// # Errors
/// A setting outside its range, or a speed that is not from 1e-4 to 0.1 m/s.
pub fn uncontrolled(
    settings: &Settings,
    seed: u64,
    speed: f64,
    period: f64,
) -> Result<Uncontrolled, SettingsError> {
    within("speed", speed, 1e-4, 0.1)?;
    let mut settings = settings.clone();
    settings.sensor.rate_hz = 1.0 / period;
    let setup = default_setup(&settings, seed);
    let mut bench = Bench::new(&settings, &setup)?;
    let pre_insertion = bench.draw().pre_insertion;
    let start = *setup.world_from_base.isometry();
    let base = |inserted: f64| -> Transform<World, NeedleBase> {
        Transform::assume(start * Isometry3::translation(0.0, 0.0, inserted))
    };
    let mut step = 0u64;
    let mut advance = |bench: &mut Bench| {
        step += 1;
        let seconds = step as f64 * period;
        bench.advance_to(Stamp::from_secs(seconds), &base(seconds * speed));
        seconds * speed
    };
    while advance(&mut bench) < pre_insertion {}
    let tip = bench.truth().tip();
    let aligned = tip + start.rotation * Vector3::z() * TARGET_DISTANCE;
    let shifted = aligned - start.rotation * Vector3::y() * TARGET_SHIFT;
    let mut passings = [Passing::new(aligned), Passing::new(shifted)];
    let longest = pre_insertion + TARGET_DISTANCE + 3.0 * TARGET_SHIFT;
    let mut score = [f64::INFINITY; 2];
    loop {
        let inserted = advance(&mut bench);
        let mut passed = true;
        for (passing, score) in passings.iter_mut().zip(&mut score) {
            match passing.observe(bench.truth()) {
                Some(lateral) => *score = lateral,
                None => passed = false,
            }
        }
        if passed || inserted > longest {
            break;
        }
    }
    Ok(Uncontrolled {
        aligned: score[0],
        shifted: score[1],
        max_stretch: bench.truth().max_stretch,
    })
}
