//! Kalibr's `camchain` YAML.

use core::fmt::Write as _;

use super::digits;
use crate::camera::{LensModel, StereoRig};

/// Both cameras as Kalibr writes them; `None` where it has no model for a lens: it knows the
/// equidistant one, and Brown-Conrady without k3.
pub fn camchain(rig: &StereoRig) -> Option<String> {
    let mut text = String::new();
    for (k, camera) in [&rig.left, &rig.right].into_iter().enumerate() {
        let d = &camera.distortion;
        let mut coefficients = d.coefficients();
        coefficients.truncate(4);
        let model = match d.model {
            LensModel::RadTan => "radtan",
            LensModel::PlumbBob if d.k3 == 0.0 => "radtan",
            LensModel::Equidistant => "equidistant",
            _ => return None,
        };
        let _ = writeln!(text, "cam{k}:");
        if k == 1 {
            text += "  T_cn_cnm1:\n";
            let m = rig.right_from_left.to_homogeneous();
            for row in m.row_iter() {
                let _ = writeln!(text, "  - [{}]", joined(row.iter().copied()));
            }
        }
        let _ = writeln!(text, "  camera_model: pinhole");
        let _ = writeln!(text, "  distortion_model: {model}");
        let _ = writeln!(text, "  distortion_coeffs: [{}]", joined(coefficients));
        let focal = [camera.fx, camera.fy, camera.cx, camera.cy];
        let _ = writeln!(text, "  intrinsics: [{}]", joined(focal));
        let _ = writeln!(text, "  resolution: [{}, {}]", camera.width, camera.height);
    }
    Some(text)
}

fn joined(values: impl IntoIterator<Item = f64>) -> String {
    let words: Vec<String> = values.into_iter().map(digits).collect();
    words.join(", ")
}
