//! Ground truth.

use hal::frame::{NeedleBase, NeedleTip, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Vector3};

use crate::view::NeedleView;

/// Something that ended the regular course of an insertion; reported, never hidden in numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The shaft had no stable equilibrium near its shape and gave way.
    Buckling,
    /// Bending stress beyond yield \[Pa\]; a real shaft would stay bent.
    Yielding {
        /// Largest bending stress \[Pa\].
        stress_pa: f64,
    },
    /// The tissue tore and its path stays displaced.
    Tearing {
        /// Depth along the path of the worst place \[m\].
        depth_m: f64,
        /// By how much the path moved there \[m\].
        by_m: f64,
    },
    /// The cutting edge left the tissue.
    PulledOut,
    /// The cutting edge entered the tissue, through a fresh surface or (`reused`) an old hole.
    Entered {
        /// Whether an existing hole was found.
        reused: bool,
    },
    /// No equilibrium was found, not even in smaller steps: the shape is out of balance (the last
    /// Newton step tells how far) and nothing was cut.
    Unconverged {
        /// Length of the last step \[m\].
        last_step_m: f64,
        /// Whether the shape was broken, so that needle and base stayed where they were.
        held: bool,
    },
    /// A pose or a time was not finite, ran backwards or jumped farther than can be simulated;
    /// it was ignored.
    Refused,
}

/// Force and moment, in World, about the point that the owner names.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force \[N\].
    pub force: Vector3<f64>,
    /// Moment \[N m\].
    pub moment: Vector3<f64>,
}

/// The whole hidden state of the needle and the tissue at one instant. A law never sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Instant of this state.
    pub stamp: Stamp,
    /// The needle's shape and material tip frame.
    pub needle: NeedleView,
    /// True pose of the needle's base.
    pub world_from_base: Transform<World, NeedleBase>,
    /// What the holder exerts on the needle, about the base's origin.
    pub base_wrench: Wrench,
    /// Twist of the tip against the base \[rad\]; negative where it lags a right-handed turn.
    pub torsion: f64,
    /// Lateral force of the tissue on the tip, in World \[N\].
    pub tip_force: Vector3<f64>,
    /// Lateral force of all the tissue on the shaft, across the needle at the entry, in World
    /// \[N\]: what the shaft carries there.
    pub entry_force: Vector3<f64>,
    /// Displacement of the tissue from its cut path at the entry \[m\].
    pub entry_stretch: f64,
    /// Mean displacement over the inserted shaft \[m\]: the true d_m.
    pub mean_stretch: f64,
    /// Largest displacement \[m\].
    pub max_stretch: f64,
    /// The cut path in World, from the entry to the deepest cut \[m\]; empty before the entry.
    pub cut_path: Vec<Vector3<f64>>,
    /// Distance of the cutting edge along the path from the entry \[m\]; less than the path's
    /// length after a retraction.
    pub depth: f64,
    /// What happened during the last `advance`.
    pub events: Vec<Event>,
}

impl Truth {
    /// Notes an event; one of a kind per `advance`, the first.
    pub(crate) fn note(&mut self, event: Event) {
        let kind = core::mem::discriminant(&event);
        if !self
            .events
            .iter()
            .any(|e| core::mem::discriminant(e) == kind)
        {
            self.events.push(event);
        }
    }

    /// The straight, free needle at `world_from_base`.
    pub fn straight(
        world_from_base: &Transform<World, NeedleBase>,
        length: f64,
        elements: usize,
        outer_diameter: f64,
        bevel_angle: f64,
    ) -> Self {
        let pose = world_from_base.isometry();
        let axis = pose.rotation * Vector3::z();
        let base = pose.translation.vector;
        let spacing = length / elements as f64;
        let tip = Isometry3::from_parts((base + axis * length).into(), pose.rotation);
        Self {
            stamp: Stamp::ZERO,
            needle: NeedleView {
                stamp: Stamp::ZERO,
                centreline: (0..=elements)
                    .map(|i| base + axis * (spacing * i as f64))
                    .collect(),
                world_from_tip: Transform::assume(tip),
                outer_diameter,
                bevel_angle,
                entry_arc: length,
            },
            world_from_base: *world_from_base,
            base_wrench: Wrench::default(),
            torsion: 0.0,
            tip_force: Vector3::zeros(),
            entry_force: Vector3::zeros(),
            entry_stretch: 0.0,
            mean_stretch: 0.0,
            max_stretch: 0.0,
            cut_path: Vec::new(),
            depth: 0.0,
            events: Vec::new(),
        }
    }

    /// The tip O in World \[m\].
    pub fn tip(&self) -> Vector3<f64> {
        self.needle.world_from_tip.origin().coords()
    }

    /// The tip axis in World.
    pub fn direction(&self) -> Vector3<f64> {
        self.needle.world_from_tip.rotate(&Vector3::z())
    }

    /// Distance of `target` (World \[m\]) from the tip axis \[m\], and how far it lies ahead of
    /// O along that axis \[m\].
    pub fn miss(&self, target: &Vector3<f64>) -> Miss {
        let offset = target - self.tip();
        let axis = self.direction();
        let axial = axis.dot(&offset);
        Miss {
            lateral: (offset - axis * axial).norm(),
            axial,
        }
    }

    /// The tip frame.
    pub fn world_from_tip(&self) -> &Transform<World, NeedleTip> {
        &self.needle.world_from_tip
    }
}

/// Where a target lies, seen from the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Miss {
    /// Distance from the tip axis \[m\].
    pub lateral: f64,
    /// Distance ahead of O along the axis \[m\].
    pub axial: f64,
}
