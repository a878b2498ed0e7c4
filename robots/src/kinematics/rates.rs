//! From the twist of the tip to joint rates, also at singularities.

use hal::guarded::Tool;
use hal::telemetry::Limit;
use hal::{Joints, MAX_JOINTS, Twist};
use nalgebra::{Isometry3, Matrix6, SVector, SymmetricEigen, Vector3, Vector6};

use super::chain::{Chain, Jacobian};
use super::redundant::{slowed, towards_middle};

/// How twists become joint rates near singularities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateSettings {
    /// Length by which linear velocities are divided to compare with angular ones \[m\].
    pub length: f64,
    /// Directions of motion with a smaller singular value than this are damped \[1\].
    pub threshold: f64,
}

/// Angle \[rad\] and distance \[m\] between the last joint's axis and the tip's z within which
/// that joint spins the tip: what calibration makes of an axis built along it.
const ALONE: (f64, f64) = (0.02, 3e-3);
/// Speed of the tip from which centring has its full rate \[m/s\]: where it stands still, so do
/// the joints.
const CENTRED_FROM: f64 = 1e-3;
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
    /// [`RateSettings::length`] \[1\]; of fewer than six joints, among as many as there are joints:
    /// what such a device cannot do in any posture is no singularity.
    pub dexterity: f64,
    /// Limits that made `realised` differ from what was wanted.
    pub limits: Vec<Limit>,
}

impl Chain {
    /// Joint rates for the twist of the tip's origin, along the axes of the base. Twists and
    /// positions that are not finite give standstill, and so do settings that are no positive
    /// length and no threshold.
    ///
    /// Of an arm of seven joints, the last one alone turns the tip about its own z, if that is
    /// the joint's axis: whatever the spin, the others stand still. They take the smallest
    /// rates that do the rest of the twist, and while the tip moves they drift slowly towards
    /// the middles of their ranges.
    ///
    /// Directions of motion whose singular value s is below the threshold t are damped:
    /// 1/s becomes s / (s^2 + t^2 - s t), which has no step at t and vanishes in the
    /// singularity. So rates stay below about the twist over t, whatever the pose; then all of
    /// them are scaled into the speed limits of the joints.
    pub fn rates(&self, q: &Joints, twist: &Twist, settings: &RateSettings) -> TwistRates {
        let (pose, jacobian) = self.forward_jacobian(q);
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
        let spinner = self.spinner(&pose, &jacobian);
        let weighted = match &spinner {
            Some(spinner) => weigh(&spinner.jacobian, &weight),
            None => weigh(&jacobian, &weight),
        };
        let modes = modes(&weighted);
        let task = spinner.as_ref().map_or_else(
            || twist.to_vector(),
            |spinner| spinner.task(&twist, &jacobian),
        );
        let wanted = modes.eigenvectors.transpose() * task.component_mul(&weight);
        let mut amounts = Vector6::zeros();
        out.dexterity = self.least_mode(&modes.eigenvalues);
        for k in 0..6 {
            let squared = modes.eigenvalues[k].max(0.0);
            let s = squared.sqrt();
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
        let mut rates = weighted.transpose() * (modes.eigenvectors * amounts);
        if let Some(spinner) = &spinner {
            if out.dexterity >= settings.threshold {
                let share = (twist.linear.norm() / CENTRED_FROM).min(1.0);
                rates += self.centring(q, &weighted, &modes) * share;
            }
            spinner.make_up(&mut rates);
        }

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

    /// The last joint, if it is one of seven and turns the tip about its own z.
    fn spinner(&self, pose: &Isometry3<f64>, jacobian: &Jacobian) -> Option<Spinner> {
        let spin = self
            .spin()
            .filter(|spin| spin.tilt < ALONE.0 && spin.aside < ALONE.1)?;
        (self.len() == MAX_JOINTS).then(|| {
            let axis = pose.rotation * Vector3::z();
            let mut spinner = Spinner {
                jacobian: *jacobian,
                axial: SVector::zeros(),
                axis,
                sense: spin.sense,
            };
            for i in 0..MAX_JOINTS - 1 {
                let mut angular = spinner.jacobian.fixed_view_mut::<3, 1>(3, i);
                spinner.axial[i] = angular.dot(&axis);
                angular -= axis * spinner.axial[i];
            }
            let mut last = spinner.jacobian.column_mut(MAX_JOINTS - 1);
            last.fill(0.0);
            last.fixed_rows_mut::<3>(3).copy_from(&(axis * spin.sense));
            spinner
        })
    }

    /// Rates towards the middles of the joints' ranges that leave the tip's axis where it is.
    fn centring(
        &self,
        q: &Joints,
        weighted: &Jacobian,
        modes: &SymmetricEigen<f64, nalgebra::Const<6>>,
    ) -> SVector<f64, MAX_JOINTS> {
        let wanted = towards_middle(self, q);
        let moved = modes.eigenvectors.transpose() * (weighted * wanted);
        let undone =
            weighted.transpose() * (modes.eigenvectors * moved.component_div(&modes.eigenvalues));
        slowed(&(wanted - undone))
    }

    /// Smallest singular value of the Jacobian at `q`, linear velocities divided by `length`
    /// \[m\]: 0 in a singularity, and for what is not finite. See [`TwistRates::dexterity`].
    pub fn dexterity(&self, q: &Joints, length: f64) -> f64 {
        if !(q.is_finite() && length.is_finite() && length > 0.0) {
            return 0.0;
        }
        let weighted = weigh(&self.jacobian(q), &weights(length));
        self.least_mode(&modes(&weighted).eigenvalues)
    }

    /// Smallest singular value among as many as there are joints.
    fn least_mode(&self, squared: &Vector6<f64>) -> f64 {
        let mut squared = *squared;
        if self.len() < squared.len() {
            squared.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
        }
        let counted = squared.iter().take(self.len());
        counted.fold(f64::INFINITY, |least, x| least.min(x.max(0.0).sqrt()))
    }
}

/// A last joint that spins the tip alone.
struct Spinner {
    /// The Jacobian with the spin left to the last joint.
    jacobian: Jacobian,
    /// Spin that each other joint gives the tip.
    axial: SVector<f64, MAX_JOINTS>,
    axis: Vector3<f64>,
    sense: f64,
}

impl Spinner {
    /// The twist as this Jacobian gives it. An axis that is slightly off the tip's z moves the
    /// tip when it turns: the other joints take that back.
    fn task(&self, twist: &Twist, jacobian: &Jacobian) -> Vector6<f64> {
        let last = MAX_JOINTS - 1;
        let rate = self.sense * self.axis.dot(&twist.angular);
        twist.to_vector() - (jacobian.column(last) - self.jacobian.column(last)) * rate
    }

    /// The last joint makes up for the spin that the others give.
    fn make_up(&self, rates: &mut SVector<f64, MAX_JOINTS>) {
        let spin = self.axial.dot(rates);
        rates[MAX_JOINTS - 1] -= self.sense * spin;
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
