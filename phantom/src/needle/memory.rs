//! The state before a step, to come back to when the step fails.

use nalgebra::{Isometry3, Vector3};

use super::{Recent, RodPlant};
use crate::medium::Contact;
use crate::motion::Placement;
use crate::path::CutPath;
use crate::skin::Skin;
use crate::twist::Twist;

/// What a step changes before it is known to have an equilibrium. The path itself is cut and
/// aged afterwards; until then only its ray and its placement change.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    nodes: Vec<Vector3<f64>>,
    clamp: Vector3<f64>,
    twist: Twist,
    torque: Vec<f64>,
    contact: Contact,
    ray: Option<Vector3<f64>>,
    placement: Placement,
    pose: Isometry3<f64>,
    seconds: f64,
    cutting: f64,
    recent: Recent,
    skin: Skin,
}

impl Memory {
    pub(super) fn of(plant: &RodPlant) -> Self {
        Self {
            nodes: plant.rod.nodes.clone(),
            clamp: plant.rod.clamp,
            twist: plant.twist.clone(),
            torque: plant.rod.torque.clone(),
            contact: plant.contact.clone(),
            ray: plant.path.as_ref().map(CutPath::heading),
            placement: plant.placement,
            pose: plant.pose,
            seconds: plant.seconds,
            cutting: plant.cutting,
            recent: plant.recent,
            skin: plant.skin,
        }
    }
}

impl RodPlant {
    /// Takes note of the present state, in the buffers of the last note.
    pub(super) fn remember(&mut self) {
        let Some(mut memory) = self.memory.take() else {
            self.memory = Some(Box::new(Memory::of(self)));
            return;
        };
        memory.nodes.copy_from_slice(&self.rod.nodes);
        memory.clamp = self.rod.clamp;
        memory.twist.copy_from(&self.twist);
        memory.torque.copy_from_slice(&self.rod.torque);
        memory.contact.copy_from(&self.contact);
        memory.ray = self.path.as_ref().map(CutPath::heading);
        memory.placement = self.placement;
        memory.pose = self.pose;
        memory.seconds = self.seconds;
        memory.cutting = self.cutting;
        memory.recent = self.recent;
        memory.skin = self.skin;
        self.memory = Some(memory);
    }

    /// Goes back to the state last taken note of.
    pub(super) fn recall(&mut self) {
        let Some(memory) = self.memory.take() else {
            return;
        };
        self.rod.nodes.copy_from_slice(&memory.nodes);
        self.rod.clamp = memory.clamp;
        self.twist.copy_from(&memory.twist);
        self.rod.torque.copy_from_slice(&memory.torque);
        self.contact.copy_from(&memory.contact);
        self.placement = memory.placement;
        self.pose = memory.pose;
        self.seconds = memory.seconds;
        self.cutting = memory.cutting;
        self.recent = memory.recent;
        self.skin = memory.skin;
        if let Some(path) = &mut self.path {
            if self.settings.motion.moves() {
                path.place(&self.placement);
            }
            if let Some(ray) = memory.ray {
                path.aim(ray);
            }
        }
        self.memory = Some(memory);
    }
}
