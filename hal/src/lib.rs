//! Vocabulary of the system: frames, twists, joints, images, time, device traits.
