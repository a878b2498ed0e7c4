//! The freedom of an arm with more joints than directions of motion.

use hal::{Joints, MAX_JOINTS};
use nalgebra::{Isometry3, SMatrix, SVector, SymmetricEigen};

use super::chain::{Chain, Jacobian};
use super::numeric::newton;

/// Rates of all joints, those beyond the arm's zero.
type Rates = SVector<f64, MAX_JOINTS>;

/// Steps along a family of solutions \[rad\], and how many to either side: a round trip of the
/// arms tried.
const STEP: f64 = 0.12;
/// See [`STEP`].
const STEPS: usize = 100;

/// Another posture with the tip at `target`, within the limits: the joints' own motion, which
/// leaves the tip where it is, is followed from `q` to either side.
pub(super) fn within_limits(chain: &Chain, target: &Isometry3<f64>, q: &Joints) -> Option<Joints> {
    for sense in [1.0, -1.0] {
        let (mut at, mut heading) = (*q, own_motion(&chain.jacobian(q)) * sense);
        for _ in 0..STEPS {
            let mut ahead = at;
            for (x, dx) in ahead.iter_mut().zip(heading.iter()) {
                *x += STEP * dx;
            }
            // Near a singularity the step leads too far from the family to come back.
            let Some(next) = newton(chain, target, ahead) else {
                break;
            };
            let onward = own_motion(&chain.jacobian(&next));
            heading = if onward.dot(&heading) < 0.0 {
                -onward
            } else {
                onward
            };
            at = next;
            if let Some(inside) = chain.near_zero(&at) {
                return Some(inside);
            }
        }
    }
    None
}

/// Unit joint rates that move the tip least: not at all, where a joint is to spare.
fn own_motion(jacobian: &Jacobian) -> Rates {
    let gram: SMatrix<f64, MAX_JOINTS, MAX_JOINTS> = jacobian.transpose() * jacobian;
    let modes = SymmetricEigen::new(gram);
    modes
        .eigenvectors
        .column(modes.eigenvalues.imin())
        .into_owned()
}

/// Time constant with which joints that are to spare come back to the middle of their ranges
/// \[s\].
const CENTRING: f64 = 10.0;
/// Fastest that any joint moves for that \[rad/s\].
const CENTRING_RATE: f64 = 0.02;

/// Rates that bring the joints but the last towards the middles of their ranges, before what
/// would move the tip is taken out.
pub(super) fn towards_middle(chain: &Chain, q: &Joints) -> Rates {
    let mut rates = Rates::zeros();
    let last = chain.len().saturating_sub(1);
    for (i, (x, limit)) in q.iter().zip(chain.limits()).enumerate().take(last) {
        let half = 0.5 * (limit.upper - limit.lower);
        // A continuous joint has no middle.
        if half < core::f64::consts::TAU {
            rates[i] = (0.5 * (limit.lower + limit.upper) - x) / CENTRING;
        }
    }
    rates
}

/// `rates`, the fastest at the rate of centring at most.
pub(super) fn slowed(rates: &Rates) -> Rates {
    rates * (CENTRING_RATE / rates.amax().max(CENTRING_RATE))
}
