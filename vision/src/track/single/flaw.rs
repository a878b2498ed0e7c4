//! What can be wrong with the needle in one image.

/// What is wrong with the needle in one image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flaw {
    /// Too few normals agree on a shaft.
    Shaft {
        /// Normals that show one where the others do.
        agree: usize,
        /// Normals looked along.
        of: usize,
    },
    /// No tip fits near the predicted one.
    Tip,
    /// What is seen of the needle is too short to be tracked.
    Short,
}

impl Flaw {
    /// Nothing to look at.
    pub(super) const NOTHING: Self = Self::Shaft { agree: 0, of: 0 };
}
