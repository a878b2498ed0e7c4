//! Does the free needle bear what it is pushed with? Before the tissue it is a strut: Euler's load.

use core::f64::consts::PI;

use phantom::Settings;

use crate::config::{Backend, Config, NeedleSupport, PlantKind};
use crate::rig::Demand;

/// First root of tan x = x squared: Euler's load of a strut that is clamped at one end and pinned at
/// the other, over E I / L^2 \[1\].
const CLAMPED_PINNED: f64 = 20.19;
/// Step along the insertion \[m\].
const STEP: f64 = 1e-3;
/// Shortest free length that is told apart from none \[m\].
const SHORTEST: f64 = 1e-3;

/// What is asked of the free needle where it is worst, and what it bears.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strut {
    /// What holds it.
    pub support: NeedleSupport,
    /// Depth of the tip \[m\].
    pub depth: f64,
    /// Needle in air there \[m\].
    pub free: f64,
    /// Euler's load of it, clamped by what holds it and kept aside by the tissue \[N\].
    pub bears: f64,
    /// Force of cutting \[N\].
    pub cutting: f64,
    /// Friction along the shaft; zero where nothing is known of it \[N\].
    pub friction: f64,
    /// Outer diameter \[m\].
    diameter: f64,
}

impl Strut {
    /// The needle of `config` on its way to the target; nothing where nothing resists it.
    pub fn of(config: &Config) -> Option<Self> {
        if config.run.plant == PlantKind::Springs || config.run.dry_run_air {
            return None;
        }
        let known = config
            .is_simulated()
            .then(|| config.phantom_settings().ok());
        let world = known.flatten();
        let needle = Shaft::of(config, world.as_ref());
        let depth = Demand::of(config).depth;
        let steps = (depth / STEP).ceil();
        let mut worst: Option<Self> = None;
        let mut k = 0.0;
        while k <= steps {
            let depth = (k * STEP).min(depth);
            let (cutting, friction) = world
                .as_ref()
                .map_or((config.estimator.axial_load_n, 0.0), |world| {
                    asked(world, depth, config.run.plant)
                });
            let free = match config.needle.support {
                NeedleSupport::Base => needle.length - depth,
                NeedleSupport::Guide => needle.gap,
            };
            if free > SHORTEST {
                let one = Self {
                    support: config.needle.support,
                    depth,
                    free,
                    bears: CLAMPED_PINNED * needle.bending / (free * free),
                    cutting,
                    friction,
                    diameter: needle.diameter,
                };
                if worst.is_none_or(|worst| one.load() > worst.load()) {
                    worst = Some(one);
                }
            }
            k += 1.0;
        }
        worst
    }

    /// What is asked over what is borne.
    pub fn load(&self) -> f64 {
        (self.cutting + self.friction) / self.bears
    }

    /// That it buckles, with what to do about it; nothing where it does not.
    pub fn problem(&self) -> Option<String> {
        let load = self.load();
        if load <= 1.0 {
            return None;
        }
        let (held, remedy) = match self.support {
            NeedleSupport::Base => (
                "held at its base",
                "a guide near the tissue ([needle] support = \"guide\", guide_gap_mm)",
            ),
            NeedleSupport::Guide => (
                "from its guide to the tissue",
                "a guide nearer to the tissue ([needle] guide_gap_mm)",
            ),
        };
        let friction = if self.friction > 0.0 {
            format!(" and {:.2} N of friction", self.friction)
        } else {
            String::new()
        };
        Some(format!(
            "the needle buckles in air: {:.0} mm of it, {held}, bear {:.2} N (Euler: clamped there, kept aside by the \
             tissue), and {:.0} mm deep {:.2} N to cut{friction} are asked of it. Remedies: {remedy}, at most \
             {:.0} mm of it in air, or a stiffer needle ({:.2} mm thick of the same make)",
            self.free * 1e3,
            self.bears,
            self.depth * 1e3,
            self.cutting,
            (self.free / load.sqrt() * 1e3).floor(),
            // Bending stiffness goes with the fourth power; rounded up.
            (self.diameter * load.powf(0.25) * 1e5).ceil() / 1e2
        ))
    }
}

/// The needle that is pushed: in simulation the simulated one.
struct Shaft {
    length: f64,
    gap: f64,
    diameter: f64,
    bending: f64,
}

impl Shaft {
    fn of(config: &Config, world: Option<&Settings>) -> Self {
        let told = &config.needle;
        let (length, outer, inner, young, gap) = world.map_or(
            (
                told.length_mm,
                told.outer_diameter_mm,
                told.inner_diameter_mm,
                told.young_modulus_gpa,
                told.guide_gap_mm,
            ),
            |world| {
                let n = &world.needle;
                (
                    n.length_mm,
                    n.outer_diameter_mm,
                    n.inner_diameter_mm,
                    n.young_gpa,
                    world.guide.gap_mm,
                )
            },
        );
        let [outer, inner] = [outer, inner].map(|d| d * 1e-3);
        Self {
            length: length * 1e-3,
            gap: gap * 1e-3,
            diameter: outer,
            bending: young * 1e9 * PI / 64.0 * (outer.powi(4) - inner.powi(4)),
        }
    }
}

/// Force of cutting and friction of the phantom with the tip `depth` \[m\] deep \[N\].
fn asked(world: &Settings, depth: f64, plant: PlantKind) -> (f64, f64) {
    let surface = plant == PlantKind::Continuum && depth < STEP;
    let punctures = world.tissue.layers.iter().filter_map(|layer| {
        let there = (depth - layer.from_mm * 1e-3).abs() < STEP;
        there.then_some(layer.puncture_n)
    });
    let at_surface = if surface {
        world.continuum.puncture_n
    } else {
        0.0
    };
    let cutting = punctures.fold(world.tip.cutting_n.max(at_surface), f64::max);
    let friction = &world.friction;
    let along = friction.shaft_n_m * friction.static_ratio * depth + world.entry.grip_n;
    (cutting, along)
}

impl Config {
    /// Whether the needle goes into a simulated world of this program.
    pub(crate) fn is_simulated(&self) -> bool {
        match self.run.backend {
            Backend::Sim => true,
            Backend::Viper => self.viper.emulate,
            Backend::Ros => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config;

    fn of(overrides: &[&str]) -> Strut {
        let overrides: Vec<String> = overrides.iter().map(|&o| o.to_owned()).collect();
        Strut::of(&config::load(None, &overrides).unwrap()).unwrap()
    }

    const SOLID: &str = "needle.inner_diameter_mm=0.0";

    #[test]
    fn a_thin_needle_of_nitinol_held_at_its_base_is_told_to_buckle() {
        for young in [
            "needle.young_modulus_gpa=60.0",
            "needle.young_modulus_gpa=80.0",
        ] {
            let thin = of(&["needle.outer_diameter_mm=0.5", SOLID, young]);
            let problem = thin.problem().unwrap();
            assert!(problem.contains("support = \"guide\""), "{problem}");
            let thick = of(&["needle.outer_diameter_mm=0.65", SOLID, young]);
            assert_eq!(thick.problem(), None, "{thick:?}");
        }
        assert_eq!(of(&[]).problem(), None);
        // 2.33 N of the paper's needle, all of it in air.
        let paper = of(&["phantom.friction.shaft_n_m=0.0"]);
        assert!(
            (paper.bears - 2.33).abs() < 0.02 && paper.depth == 0.0,
            "{paper:?}"
        );
    }

    #[test]
    fn the_remedies_that_are_told_are_remedies() {
        let thin = [
            "needle.outer_diameter_mm=0.5",
            SOLID,
            "needle.young_modulus_gpa=60.0",
        ];
        let with = |more: &[&str]| of(&[&thin[..], more].concat());
        let strut = with(&[]);
        assert!(strut.problem().is_some());
        let guided = with(&[
            "needle.support=guide",
            "needle.guide_gap_mm=25.0",
            "needle.length_mm=150.0",
        ]);
        assert_eq!(guided.problem(), None, "{guided:?}");
        let short = (strut.free / strut.load().sqrt() * 1e3).floor();
        let short = with(&[&format!("needle.length_mm={short}"), "target.depth_mm=60"]);
        assert!(
            short.load() <= 1.0 || short.depth > strut.depth,
            "{short:?}"
        );
        let thick = (strut.diameter * strut.load().powf(0.25) * 1e5).ceil() / 1e2;
        let thick = of(&[thin[2], SOLID, &format!("needle.outer_diameter_mm={thick}")]);
        assert_eq!(thick.problem(), None, "{thick:?}");
    }

    #[test]
    fn a_model_and_air_ask_nothing() {
        for plant in ["run.plant=springs", "run.dry_run_air=true"] {
            let config = config::load(None, &[plant.to_owned()]).unwrap();
            assert_eq!(Strut::of(&config), None);
        }
    }
}
