//! Mechanics of a flexible bevel-tip needle in soft tissue.
