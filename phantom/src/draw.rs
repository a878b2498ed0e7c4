//! What one run of the population is.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

use crate::field::Field;
use crate::settings::Settings;

/// Purposes of random streams; each has its own, so that switching one flaw on or off changes
/// no other.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Purpose {
    Stiffness = 1,
    CutAngle,
    Azimuth,
    Tilt,
    PreInsertion,
    StiffnessField,
    CutField,
    DirectionField,
    Sensor,
    SensorDrops,
    SensorBias,
    Kinematics,
    Holder,
    Marker,
    MarkerDrops,
    MarkerBias,
    Distortion,
    Coil,
    InAir,
    Hand,
    Fibres,
    FibreNoise,
    FibreDrops,
}

/// The generator of `seed` for one purpose.
pub(crate) fn stream(seed: u64, purpose: Purpose) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(purpose as u64);
    rng
}

/// A standard normal number.
pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Uniform in [0, 1).
pub(crate) fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// Log-normal factor of median 1 whose standard deviation over mean is `cv`.
fn factor(rng: &mut ChaCha8Rng, cv: f64) -> f64 {
    ((1.0 + cv * cv).ln().sqrt() * normal(rng)).exp()
}

/// What [`SpreadSettings`](crate::settings::SpreadSettings) left to chance, for one seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draw {
    /// Stiffness per length \[N/m2\].
    pub stiffness: f64,
    /// Cut angle gamma_0 \[rad\].
    pub cut_angle: f64,
    /// Azimuth of the bevel in its holder, about the needle's z \[rad\].
    pub azimuth: f64,
    /// Tilt about the nominal x and y axes of the holder \[rad\].
    pub tilt: [f64; 2],
    /// Straight insertion before the experiment \[m\].
    pub pre_insertion: f64,
}

impl Draw {
    /// The run that `seed` stands for.
    pub fn new(settings: &Settings, seed: u64) -> Self {
        let spread = &settings.spread;
        let rng = |purpose| stream(seed, purpose);
        let mut tilt = rng(Purpose::Tilt);
        let tilt_sigma = spread.tilt_deg.to_radians();
        let [least, most] = spread.pre_insertion_mm;
        let share = uniform(&mut rng(Purpose::PreInsertion));
        Self {
            stiffness: settings.tissue.stiffness_n_m2
                * factor(&mut rng(Purpose::Stiffness), spread.stiffness_cv),
            cut_angle: settings.tip.cut_angle_deg.to_radians()
                * factor(&mut rng(Purpose::CutAngle), spread.cut_angle_cv),
            azimuth: spread.azimuth_deg.to_radians() * normal(&mut rng(Purpose::Azimuth)),
            tilt: [
                tilt_sigma * normal(&mut tilt),
                tilt_sigma * normal(&mut tilt),
            ],
            pre_insertion: (least + share * (most - least)) * 1e-3,
        }
    }
}

/// Random fields along depth.
#[derive(Clone, Debug)]
pub(crate) struct Fields {
    pub(crate) stiffness: Field,
    pub(crate) cut: Field,
    pub(crate) direction: [Field; 2],
}

impl Fields {
    pub(crate) fn draw(settings: &Settings, seed: u64) -> Self {
        let field =
            |purpose, length_mm: f64| Field::draw(&mut stream(seed, purpose), length_mm * 1e-3);
        let mut direction = stream(seed, Purpose::DirectionField);
        let noise_length = settings.tip.direction_noise_length_mm * 1e-3;
        Self {
            stiffness: field(Purpose::StiffnessField, settings.tissue.field_length_mm),
            cut: field(Purpose::CutField, settings.tip.field_length_mm),
            direction: [
                Field::draw(&mut direction, noise_length),
                Field::draw(&mut direction, noise_length),
            ],
        }
    }
}
