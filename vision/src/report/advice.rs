//! What the figures mean for the next session with the board.

use crate::calibrate::StereoCalibration;

/// One line of advice.
#[derive(Clone, Debug, PartialEq)]
pub struct Advice {
    /// Whether it says that something is as it should be.
    pub good: bool,
    /// The line.
    pub text: String,
}

/// Judges a calibration by what good ones look like.
pub fn advice(c: &StereoCalibration) -> Vec<Advice> {
    let mut lines = Vec::new();
    let mut line = |good: bool, text: String| lines.push(Advice { good, text });
    let rms = c.joint_rms_px;
    if rms <= 0.3 {
        line(true, format!("Joint RMS {rms:.3} px: good (at most 0.3)."));
    } else {
        line(
            false,
            format!(
                "Joint RMS {rms:.3} px: above 0.3. Look for blur, motion, a bent board or a \
                 wrong square size."
            ),
        );
    }
    let pairs = c.views.len();
    if pairs < 12 {
        line(
            false,
            format!("{pairs} pairs: take 12 to 20, the sigmas fall with the square root."),
        );
    } else {
        line(true, format!("{pairs} pairs: enough."));
    }
    for (side, name) in ["left", "right"].into_iter().enumerate() {
        let share = coverage(c, side) * 100.0;
        let good = share >= 70.0;
        let hint = if good {
            "good"
        } else {
            "bring the board to the borders and corners of the image: the distortion is not \
             known where no board was"
        };
        line(
            good,
            format!("Corners cover {share:.0} % of the {name} image: {hint}."),
        );
    }
    let sigmas = c.sigmas();
    let right = c.rig.left.distortion.model.used().len();
    let focal = 100.0 * (sigmas[0] / c.rig.left.fx).max(sigmas[right] / c.rig.right.fx);
    line(
        focal <= 0.1,
        format!(
            "Focal lengths known to {focal:.3} % (one sigma; 0.1 % is the aim{}).",
            if focal <= 0.1 {
                ""
            } else {
                ": tilt the board more, 20 to 45 degrees, about both axes"
            }
        ),
    );
    let turn = sigmas.rows(sigmas.len() - 3, 3).norm() * 1e3;
    line(
        turn <= 0.5,
        format!(
            "Relative orientation known to {turn:.2} mrad (0.5 mrad costs 0.13 mm at the needle \
             with cameras 90 degrees apart, 0.25 mm with 30)."
        ),
    );
    for v in &c.views {
        let pull = v
            .influence
            .intrinsics_sigmas
            .max(v.influence.extrinsics_sigmas);
        if pull > 5.0 {
            line(
                false,
                format!(
                    "{} and {} alone move a parameter by {pull:.1} sigmas: take more pairs like \
                     them, or check them.",
                    v.left_name, v.right_name
                ),
            );
        }
    }
    if !c.rejected.is_empty() {
        line(
            false,
            format!("{} rejections: see the list below.", c.rejected.len()),
        );
    }
    lines
}

/// Share of an eight by six grid of the image in which a corner was seen.
fn coverage(c: &StereoCalibration, side: usize) -> f64 {
    const GRID: (usize, usize) = (8, 6);
    let camera = [c.rig.left, c.rig.right][side];
    let mut seen = [false; GRID.0 * GRID.1];
    for v in &c.views {
        for p in v.corners[side].iter().filter(|p| p.x.is_finite()) {
            let cell = |x: f64, size: usize, n: usize| {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a share of the image; below zero saturates"
                )]
                let k = (x / size as f64 * n as f64) as usize;
                k.min(n - 1)
            };
            seen[cell(p.y, camera.height, GRID.1) * GRID.0 + cell(p.x, camera.width, GRID.0)] =
                true;
        }
    }
    seen.iter().filter(|&&s| s).count() as f64 / seen.len() as f64
}
