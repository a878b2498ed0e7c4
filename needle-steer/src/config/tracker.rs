//! Keys of the table `tracker`.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// Who sends the tip over OpenIGTLink.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrackerSource {
    /// Nobody: the tip is the phantom's, or comes over ROS.
    #[default]
    None,
    /// A program that connects to the run (`igtl.serve`).
    Clients,
    /// A server, as PLUS is one; the run connects to it.
    Server,
}

/// A tracker over OpenIGTLink, for the sensor `em`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tracker {
    /// Who sends the tip.
    pub source: TrackerSource,
    /// Address and port of the server.
    pub address: String,
    /// Name of the device whose `TRANSFORM` is the sensor's pose in the tracker's frame.
    pub device: String,
    /// Origin of the tracker's frame in World \[mm\].
    pub position_mm: [f64; 3],
    /// Its roll, pitch, yaw \[deg\].
    pub rpy_deg: [f64; 3],
    /// The needle's tip in the sensor's own frame \[mm\].
    pub tip_mm: [f64; 3],
    /// The needle's axis there, out of the tip.
    pub axis: [f64; 3],
    /// Standard deviation of the tip's place, the field's distortion included, per axis \[mm\].
    pub sigma_mm: f64,
    /// The same of its axis \[mrad\].
    pub axis_sigma_mrad: f64,
    /// Time from a measurement to its message, as far as it is always there \[ms\].
    pub delay_ms: f64,
}

impl Default for Tracker {
    fn default() -> Self {
        Self {
            source: TrackerSource::None,
            address: "127.0.0.1:18944".into(),
            device: "NeedleTipToTracker".into(),
            position_mm: [0.0; 3],
            rpy_deg: [0.0; 3],
            tip_mm: [0.0; 3],
            axis: [0.0, 0.0, 1.0],
            sigma_mm: 0.32,
            axis_sigma_mrad: 8.0,
            delay_ms: 0.0,
        }
    }
}

impl Tracker {
    /// Whether the tip comes over OpenIGTLink.
    pub fn is_used(&self) -> bool {
        self.source != TrackerSource::None
    }

    /// Pose of the tracker's frame in World \[m\].
    pub fn world_from_tracker(&self) -> Isometry3<f64> {
        let [x, y, z] = self.position_mm.map(|v| v * 1e-3);
        let [roll, pitch, yaw] = self.rpy_deg.map(f64::to_radians);
        Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        )
    }
}
