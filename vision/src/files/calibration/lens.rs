//! Which lens model a file's labels and coefficients mean.

use crate::camera::{Distortion, LensModel};

/// What a label says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Label {
    Model(LensModel),
    /// No distortion at all.
    None,
    /// Nothing about the lens.
    Neutral,
}

/// Understands a label; an unknown one is not supported.
fn label(text: &str) -> Option<Label> {
    let name = super::node::plain(text);
    let name = match name.strip_prefix("pinhole") {
        Some(rest) if !rest.is_empty() => rest.to_owned(),
        _ => name,
    };
    Some(match name.as_str() {
        "pinhole" | "perspective" | "rectilinear" | "standard" | "camera" | "stereo" => {
            Label::Neutral
        }
        "radtan" | "radialtangential" => Label::Model(LensModel::RadTan),
        "plumbbob" | "brownconrady" | "brown" | "opencv5" | "radtan5" => {
            Label::Model(LensModel::PlumbBob)
        }
        "rationalpolynomial" | "rational" | "opencv8" | "radtan8" | "fullopencv" => {
            Label::Model(LensModel::RationalPolynomial)
        }
        "equidistant" | "equi" | "fisheye" | "opencvfisheye" | "kannalabrandt"
        | "kannalabrandt4" | "kannalabrandt8" | "kb4" | "kb8" => {
            Label::Model(LensModel::Equidistant)
        }
        "none" | "nodistortion" | "ideal" | "rectified" => Label::None,
        _ => return None,
    })
}

/// The distortion that labels and coefficients mean; else what is not supported.
pub(super) fn distortion(labels: &[&str], coefficients: &[f64]) -> Result<Distortion, String> {
    let mut model = None;
    for text in labels {
        match label(text) {
            Some(Label::Model(m)) => model = Some(m),
            Some(Label::None) if coefficients.iter().all(|&c| c == 0.0) => {}
            Some(Label::None) => {
                return Err(format!(
                    "the model is `{text}`, but the coefficients are not zero"
                ));
            }
            Some(Label::Neutral) => {}
            None => {
                return Err(format!(
                    "the model `{text}` is not supported; supported are plumb_bob (radtan), \
                     rational_polynomial, equidistant (fisheye): calibrate again with one of them"
                ));
            }
        }
    }
    let at = |k: usize| coefficients.get(k).copied().unwrap_or(0.0);
    let beyond = |from: usize| {
        let rest = coefficients.iter().enumerate().skip(from);
        rest.map(|(k, c)| (k, *c)).find(|(_, c)| *c != 0.0)
    };
    if model == Some(LensModel::Equidistant) {
        return match beyond(4) {
            None => Ok(Distortion::equidistant([at(0), at(1), at(2), at(3)])),
            Some((k, c)) => Err(format!(
                "coefficient {} is {c}: an equidistant lens has four, k1 k2 k3 k4",
                k + 1
            )),
        };
    }
    // Under Kalibr's name some write five or eight coefficients.
    if model == Some(LensModel::RadTan) && beyond(4).is_none() {
        return Ok(Distortion::radtan(core::array::from_fn(at)));
    }
    if let Some((k, c)) = beyond(8) {
        let name = ["s1", "s2", "s3", "s4", "tau_x", "tau_y"]
            .get(k - 8)
            .copied()
            .unwrap_or("a further coefficient");
        return Err(format!(
            "{name} = {c}: a thin prism or a tilted sensor is not supported; calibrate without \
             CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL"
        ));
    }
    let rational = beyond(5).is_some() || model == Some(LensModel::RationalPolynomial);
    Ok(if rational {
        Distortion::rational(core::array::from_fn(at))
    } else {
        Distortion::from_array(core::array::from_fn(at))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_honoured_and_unknown_ones_refused_by_name() {
        let four = [-0.1, 0.2, 0.01, 0.02];
        let model = |labels: &[&str]| distortion(labels, &four).map(|d| d.model);
        assert_eq!(model(&["pinhole", "radtan"]), Ok(LensModel::RadTan));
        assert_eq!(model(&["plumb_bob"]), Ok(LensModel::PlumbBob));
        let five = distortion(&["radtan"], &[-0.1, 0.2, 0.01, 0.02, 0.03]).unwrap();
        assert_eq!((five.model, five.k3), (LensModel::PlumbBob, 0.03));
        for name in ["equidistant", "fisheye", "KannalaBrandt8", "pinhole-equi"] {
            assert_eq!(model(&[name]), Ok(LensModel::Equidistant), "{name}");
        }
        for name in ["MEI", "omni", "ds", "eucm", "fov", "ATAN"] {
            assert!(model(&[name]).unwrap_err().contains(name));
        }
        assert!(model(&["none"]).is_err());
    }

    #[test]
    fn fourteen_coefficients_are_rational_up_to_k6_and_refused_beyond() {
        let mut c = [0.0; 14];
        (c[0], c[7]) = (-0.08, 0.034);
        let d = distortion(&[], &c).unwrap();
        assert_eq!((d.model, d.k6), (LensModel::RationalPolynomial, 0.034));
        c[8] = 0.001;
        assert!(distortion(&[], &c).unwrap_err().contains("s1 = 0.001"));
        assert_eq!(
            distortion(&[], &[0.1; 5]).unwrap().model,
            LensModel::PlumbBob
        );
        assert!(distortion(&["equidistant"], &[0.1; 5]).is_err());
    }
}
