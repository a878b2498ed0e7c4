//! One run's tissue as a function of depth.

use nalgebra::Vector3;

use crate::draw::{Draw, Fields};
use crate::medium::LateralLaw;
use crate::settings::{Layer, Settings};

/// Distance over which a layer's properties change into the next one's \[m\].
const LAYER_BLEND: f64 = 0.5e-3;
/// Depth over which the force to puncture a membrane builds up \[m\].
const PUNCTURE_TRAVEL: f64 = 1e-3;

/// The tissue of one run, in SI units.
#[derive(Clone, Debug)]
pub(crate) struct Tissue {
    stiffness: f64,
    stiffness_cv: f64,
    cut_angle: f64,
    cut_cv: f64,
    noise: f64,
    cutting: f64,
    layers: Vec<Layer>,
    fields: Fields,
    /// C_t \[rad/N\].
    pub(crate) compliance: f64,
    /// C_m \[rad/(N m)\].
    pub(crate) moment_compliance: f64,
    pub(crate) law: LateralLaw,
    /// Time constant of relaxation \[s\].
    pub(crate) relaxation: f64,
    /// Tear threshold \[m\], infinite where there is none.
    pub(crate) tear: f64,
}

impl Tissue {
    pub(crate) fn new(settings: &Settings, draw: &Draw, seed: u64) -> Self {
        let (tissue, tip) = (&settings.tissue, &settings.tip);
        let diameter = settings.needle.outer_diameter_mm * 1e-3;
        Self {
            stiffness: draw.stiffness,
            stiffness_cv: tissue.field_cv,
            cut_angle: draw.cut_angle,
            cut_cv: tip.field_cv,
            noise: tip.direction_noise_deg.to_radians(),
            cutting: tip.cutting_n,
            layers: tissue.layers.clone(),
            fields: Fields::draw(settings, seed),
            compliance: tip.compliance_deg_n.to_radians(),
            moment_compliance: tip.moment_compliance_deg_nm.to_radians(),
            law: LateralLaw {
                stiffening: tissue.stiffening / (diameter * diameter),
                relaxed: tissue.relaxed_fraction,
                gap: tissue.slit_gap_um * 1e-6,
            },
            relaxation: tissue.relaxation_s,
            tear: if tissue.tear_mm > 0.0 {
                tissue.tear_mm * 1e-3
            } else {
                f64::INFINITY
            },
        }
    }

    fn layered(&self, depth: f64, ratio: impl Fn(&Layer) -> f64) -> f64 {
        let mut value = 1.0;
        for layer in &self.layers {
            let share = ((depth - layer.from_mm * 1e-3) / LAYER_BLEND + 0.5).clamp(0.0, 1.0);
            value += share * (ratio(layer) - value);
        }
        value
    }

    /// Stiffness per length at `depth` \[m\] \[N/m2\]. The field enters as an exponent, so that
    /// it stays positive.
    pub(crate) fn stiffness(&self, depth: f64) -> f64 {
        let field = if self.stiffness_cv > 0.0 {
            (self.stiffness_cv * self.fields.stiffness.at(depth)).exp()
        } else {
            1.0
        };
        self.stiffness * field * self.layered(depth, |l| l.stiffness_ratio)
    }

    /// Cut angle at `depth` \[m\] \[rad\].
    pub(crate) fn cut_angle(&self, depth: f64) -> f64 {
        let field = 1.0 + self.cut_cv * self.fields.cut.at(depth);
        self.cut_angle * field * self.layered(depth, |l| l.cut_ratio)
    }

    /// Noise of the path's direction at `depth` \[m\], across the phantom's z \[rad\].
    pub(crate) fn direction_noise(&self, depth: f64) -> Vector3<f64> {
        let [x, y] = &self.fields.direction;
        Vector3::new(x.at(depth), y.at(depth), 0.0) * self.noise
    }

    /// Axial force against the advancing tip at `depth` \[m\] \[N\].
    pub(crate) fn cutting_force(&self, depth: f64) -> f64 {
        let puncture = self.layers.iter().fold(0.0, |force: f64, layer| {
            let travel = (depth - layer.from_mm * 1e-3) / PUNCTURE_TRAVEL + 1.0;
            if (0.0..1.0).contains(&travel) {
                force.max(travel * layer.puncture_n)
            } else {
                force
            }
        });
        self.cutting.max(puncture)
    }
}
