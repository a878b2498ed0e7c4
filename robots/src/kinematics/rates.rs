//! From the twist of the tip to joint rates, also at singularities.

use hal::guarded::Tool;
use hal::telemetry::Limit;
use hal::{Joints, Twist};
use nalgebra::{Isometry3, Matrix6, SymmetricEigen, Vector6};

use super::chain::{Chain, Jacobian};

/// How twists become joint rates near singularities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateSettings {
    /// Length by which linear velocities are divided to compare with angular ones \[m\].
    pub length: f64,
    /// Directions of motion with a smaller singular value than this are damped \[1\].
    pub threshold: f64,
}

/// Twists beyond this are scaled down to it \[m/s, rad/s\].
const HUGE: f64 = 1e6;

impl Default for RateSettings {
    fn default() -> Self {
        Self {
            length: 0.1,
            threshold: 0.05,
        }
    }
}

/// Joint rates for a twist.
#[derive(Clone, Debug, PartialEq)]
pub struct TwistRates {
    /// Joint rates within the speed limits \[rad/s\].
    pub rates: Joints,
    /// The twist that they give: the one wanted, scaled, unless a singularity took a
    /// direction away.
    pub realised: Twist,
    /// Smallest singular value of the Jacobian, linear velocities divided by
    /// [`RateSettings::length`] \[1\].
    pub dexterity: f64,
    /// Limits that made `realised` differ from what was wanted.
    pub limits: Vec<Limit>,
}

impl Chain {
    /// Joint rates for the twist of the tip's origin, along the axes of the base. An arm of
    /// seven joints takes the smallest rates that do it. Twists and positions that are not
    /// finite give standstill, and so do settings that are no positive length and no threshold.
    ///
    /// Directions of motion whose singular value s is below the threshold t are damped:
    /// 1/s becomes s / (s^2 + t^2 - s t), which has no step at t and vanishes in the
    /// singularity. So rates stay below about the twist over t, whatever the pose; then all of
    /// them are scaled into the speed limits of the joints.
    pub fn rates(&self, q: &Joints, twist: &Twist, settings: &RateSettings) -> TwistRates {
        let jacobian = self.jacobian(q);
        let mut out = TwistRates {
            rates: q.zeroed(),
            realised: Twist::zero(),
            dexterity: 0.0,
            limits: Vec::new(),
        };
        let usable = settings.length.is_finite()
            && settings.length > 0.0
            && settings.threshold.is_finite()
            && settings.threshold >= 0.0;
        let size = twist.to_vector().amax();
        if !(q.is_finite() && twist.is_finite() && usable) {
            return out;
        }
        // Far beyond all limits, only the direction counts; the squares have to stay numbers.
        let twist = if size > HUGE {
            Twist::from_vector(&(twist.to_vector() * (HUGE / size)))
        } else {
            *twist
        };
        let weight = weights(settings.length);
        let weighted = weigh(&jacobian, &weight);
        let modes = modes(&weighted);
        let wanted = modes.eigenvectors.transpose() * twist.to_vector().component_mul(&weight);
        let mut amounts = Vector6::zeros();
        out.dexterity = f64::INFINITY;
        for k in 0..6 {
            let squared = modes.eigenvalues[k].max(0.0);
            let s = squared.sqrt();
            out.dexterity = out.dexterity.min(s);
            let t = settings.threshold;
            let damping = if s < t { t * (t - s) } else { 0.0 };
            let gain = squared + damping;
            if gain > 0.0 {
                amounts[k] = wanted[k] / gain;
            }
        }
        if out.dexterity < settings.threshold {
            out.limits.push(Limit::Singularity);
        }
        let rates = weighted.transpose() * (modes.eigenvectors * amounts);

        let mut scale = 1.0;
        let mut slowest = None;
        for (i, (limit, rate)) in (0_u8..).zip(self.limits().iter().zip(rates.iter())) {
            let share = limit.velocity / rate.abs();
            if share < scale {
                (scale, slowest) = (share, Some(i));
            }
        }
        out.limits.extend(slowest.map(Limit::JointVelocity));
        for (out, rate) in out.rates.iter_mut().zip(rates.iter()) {
            *out = rate * scale;
        }
        out.realised = Twist::from_vector(&(jacobian * rates * scale));
        out
    }

    /// Smallest singular value of the Jacobian at `q`, linear velocities divided by `length`
    /// \[m\]: 0 in a singularity, and for what is not finite.
    pub fn dexterity(&self, q: &Joints, length: f64) -> f64 {
        if !(q.is_finite() && length.is_finite() && length > 0.0) {
            return 0.0;
        }
        let weighted = weigh(&self.jacobian(q), &weights(length));
        modes(&weighted).eigenvalues.min().max(0.0).sqrt()
    }
}

/// Tool kinematics in the chain's base, for [`hal::Guard`]; the tool is the chain's tip.
impl Tool for Chain {
    fn pose(&self, positions: &Joints) -> Isometry3<f64> {
        self.forward(positions)
    }

    fn twist(&self, positions: &Joints, rates: &Joints) -> Twist {
        let jacobian = self.jacobian(positions);
        let screw = rates
            .iter()
            .enumerate()
            .fold(Vector6::zeros(), |sum, (i, rate)| {
                sum + jacobian.column(i) * *rate
            });
        Twist::from_vector(&screw)
    }
}

fn weights(length: f64) -> Vector6<f64> {
    let w = 1.0 / length;
    Vector6::new(w, w, w, 1.0, 1.0, 1.0)
}

fn weigh(jacobian: &Jacobian, weight: &Vector6<f64>) -> Jacobian {
    let mut weighted = *jacobian;
    for mut column in weighted.column_iter_mut() {
        column.component_mul_assign(weight);
    }
    weighted
}

/// Squared singular values and their directions of motion. Squaring halves the digits, which
/// leaves the singular values exact to 1e-7: far below any useful threshold.
fn modes(weighted: &Jacobian) -> SymmetricEigen<f64, nalgebra::Const<6>> {
    let gram: Matrix6<f64> = weighted * weighted.transpose();
    SymmetricEigen::new(gram)
}
