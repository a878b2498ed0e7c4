//! The tissue: a plane surface and layers of lateral stiffness per unit length of needle.

use nalgebra::{Unit, Vector3};
use thiserror::Error;

/// A layer of tissue, from `from_depth` down to the next one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layer {
    /// Depth of the layer's upper face below the surface \[m\].
    pub from_depth: f64,
    /// Lateral stiffness per length of needle K_T \[N/m2\].
    pub stiffness: f64,
}

/// A half space of tissue in layers parallel to its surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Tissue {
    surface_point: Vector3<f64>,
    inward: Unit<Vector3<f64>>,
    layers: Vec<Layer>,
}

/// Why a tissue was refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TissueError {
    /// Surface point or normal not finite, or normal of zero length.
    #[error("tissue surface needs a finite point and a finite, non-zero inward normal")]
    Surface,
    /// No layer given, or the first does not start at the surface.
    #[error("the first tissue layer must start at depth 0")]
    FirstLayer,
    /// Layers not in order of depth.
    #[error("tissue layer {index} starts at {from_depth_m} m, not below the one before")]
    LayerOrder {
        /// Offending layer.
        index: usize,
        /// Its depth \[m\].
        from_depth_m: f64,
    },
    /// Stiffness not finite or not positive.
    #[error(
        "tissue layer {index}: stiffness must be finite and positive, got {stiffness_n_per_m2}"
    )]
    Stiffness {
        /// Offending layer.
        index: usize,
        /// Offending stiffness \[N/m2\].
        stiffness_n_per_m2: f64,
    },
}

impl Tissue {
    /// K_T at the start of each experiment of \[Chevrie2016\] (gelatin) \[N/m2\].
    pub const GELATIN_STIFFNESS: f64 = 1e4;

    /// Tissue below the plane through `surface_point` with normal `inward`, in `layers` from the
    /// surface down.
    ///
    /// # Errors
    /// [`TissueError`] names what is not finite, not positive or out of order.
    pub fn layered(
        surface_point: Vector3<f64>,
        inward: Vector3<f64>,
        layers: Vec<Layer>,
    ) -> Result<Self, TissueError> {
        let normal = Unit::try_new(inward, 1e-12)
            .filter(|n| n.iter().chain(surface_point.iter()).all(|v| v.is_finite()))
            .ok_or(TissueError::Surface)?;
        if layers.first().is_none_or(|layer| layer.from_depth != 0.0) {
            return Err(TissueError::FirstLayer);
        }
        for (index, layer) in layers.iter().enumerate() {
            if index > 0 && !(layer.from_depth > layers[index - 1].from_depth) {
                return Err(TissueError::LayerOrder {
                    index,
                    from_depth_m: layer.from_depth,
                });
            }
            if !(layer.stiffness.is_finite() && layer.stiffness > 0.0) {
                let stiffness_n_per_m2 = layer.stiffness;
                return Err(TissueError::Stiffness {
                    index,
                    stiffness_n_per_m2,
                });
            }
        }
        Ok(Self {
            surface_point,
            inward: normal,
            layers,
        })
    }

    /// Tissue of one stiffness \[N/m2\]; see [`Tissue::layered`].
    ///
    /// # Errors
    /// As [`Tissue::layered`].
    pub fn uniform(
        surface_point: Vector3<f64>,
        inward: Vector3<f64>,
        stiffness: f64,
    ) -> Result<Self, TissueError> {
        Self::layered(
            surface_point,
            inward,
            vec![Layer {
                from_depth: 0.0,
                stiffness,
            }],
        )
    }

    /// Depth of a world point below the surface \[m\]; negative outside.
    pub fn depth(&self, point: &Vector3<f64>) -> f64 {
        self.inward.dot(&(point - self.surface_point))
    }

    /// Unit normal of the surface, into the tissue.
    pub fn inward(&self) -> Vector3<f64> {
        self.inward.into_inner()
    }

    /// A point of the surface \[m\].
    pub fn surface_point(&self) -> Vector3<f64> {
        self.surface_point
    }

    /// K_T at `depth` \[N/m2\]; the first layer's above the surface.
    pub fn stiffness_at(&self, depth: f64) -> f64 {
        let below = self
            .layers
            .iter()
            .rev()
            .find(|layer| layer.from_depth <= depth);
        below.unwrap_or(&self.layers[0]).stiffness
    }

    /// The layers, from the surface down.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Every stiffness times `factor` (ignored unless finite and positive).
    pub fn scale_stiffness(&mut self, factor: f64) {
        if factor.is_finite() && factor > 0.0 {
            for layer in &mut self.layers {
                layer.stiffness *= factor;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_are_found_by_depth() {
        let layer = |from_depth, stiffness| Layer {
            from_depth,
            stiffness,
        };
        let layers = vec![layer(0.0, 1e4), layer(0.02, 5e4)];
        let tissue = Tissue::layered(Vector3::z() * 0.1, Vector3::z(), layers).unwrap();
        let at = |z| tissue.stiffness_at(tissue.depth(&Vector3::new(0.3, 0.0, z)));
        assert_eq!((at(0.05), at(0.11), at(0.13)), (1e4, 1e4, 5e4));
    }

    #[test]
    fn bad_tissues_are_named() {
        let (o, z) = (Vector3::zeros(), Vector3::z());
        assert_eq!(Tissue::uniform(o, o, 1e4), Err(TissueError::Surface));
        assert_eq!(Tissue::layered(o, z, vec![]), Err(TissueError::FirstLayer));
        assert!(matches!(
            Tissue::uniform(o, z, -1.0),
            Err(TissueError::Stiffness { .. })
        ));
        let layers = vec![
            Layer {
                from_depth: 0.0,
                stiffness: 1.0
            };
            2
        ];
        assert!(matches!(
            Tissue::layered(o, z, layers),
            Err(TissueError::LayerOrder { .. })
        ));
    }
}
