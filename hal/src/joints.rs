//! Joint vectors of fixed capacity and the limits of joints.

use core::ops::{Deref, DerefMut};

use serde::{Deserialize, Serialize};

/// The largest number of joints of an arm.
pub const MAX_JOINTS: usize = 7;

/// Values of an arm's joints, base to flange: positions \[rad\] or rates \[rad/s\], as the
/// name says. Six or seven of them on the arms in use; at most [`MAX_JOINTS`].
#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<f64>", into = "Vec<f64>")]
pub struct Joints {
    values: [f64; MAX_JOINTS],
    len: u8,
}

impl Joints {
    /// `len` zeros.
    ///
    /// # Errors
    /// More than [`MAX_JOINTS`] joints.
    pub fn zeros(len: usize) -> Result<Self, TooManyJoints> {
        match u8::try_from(len) {
            Ok(short) if len <= MAX_JOINTS => Ok(Self {
                values: [0.0; MAX_JOINTS],
                len: short,
            }),
            _ => Err(TooManyJoints { len }),
        }
    }

    /// Copies a slice.
    ///
    /// # Errors
    /// More than [`MAX_JOINTS`] joints.
    pub fn from_slice(values: &[f64]) -> Result<Self, TooManyJoints> {
        let mut joints = Self::zeros(values.len())?;
        joints.copy_from_slice(values);
        Ok(joints)
    }

    /// As many zeros as `self` has joints: standstill.
    #[must_use]
    pub fn zeroed(&self) -> Self {
        Self {
            values: [0.0; MAX_JOINTS],
            len: self.len,
        }
    }

    /// Applies `f` to every value.
    #[must_use]
    pub fn map(&self, mut f: impl FnMut(f64) -> f64) -> Self {
        let mut out = *self;
        out.iter_mut().for_each(|x| *x = f(*x));
        out
    }

    /// Combines two vectors value by value; the shorter length wins.
    #[must_use]
    pub fn zip(&self, other: &Self, mut f: impl FnMut(f64, f64) -> f64) -> Self {
        let mut out = if self.len <= other.len { *self } else { *other };
        for (x, (a, b)) in out.iter_mut().zip(self.iter().zip(other.iter())) {
            *x = f(*a, *b);
        }
        out
    }

    /// Whether every value is finite.
    pub fn is_finite(&self) -> bool {
        self.iter().all(|x| x.is_finite())
    }

    /// Largest absolute value; zero for no joints.
    pub fn max_abs(&self) -> f64 {
        self.iter().fold(0.0, |m: f64, x| m.max(x.abs()))
    }
}

impl From<[f64; 6]> for Joints {
    fn from(q: [f64; 6]) -> Self {
        Self {
            values: [q[0], q[1], q[2], q[3], q[4], q[5], 0.0],
            len: 6,
        }
    }
}

impl From<[f64; 7]> for Joints {
    fn from(values: [f64; 7]) -> Self {
        Self { values, len: 7 }
    }
}

impl TryFrom<Vec<f64>> for Joints {
    type Error = TooManyJoints;

    fn try_from(values: Vec<f64>) -> Result<Self, TooManyJoints> {
        Self::from_slice(&values)
    }
}

impl From<Joints> for Vec<f64> {
    fn from(joints: Joints) -> Self {
        joints.to_vec()
    }
}

impl Deref for Joints {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.values[..usize::from(self.len)]
    }
}

impl DerefMut for Joints {
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.values[..usize::from(self.len)]
    }
}

impl core::fmt::Debug for Joints {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

/// An arm with more joints than [`MAX_JOINTS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{len} joints; at most {MAX_JOINTS} are supported")]
pub struct TooManyJoints {
    /// The number of joints asked for.
    pub len: usize,
}

/// Limits of one revolute joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointLimit {
    /// Lowest position \[rad\].
    pub lower: f64,
    /// Highest position \[rad\].
    pub upper: f64,
    /// Highest speed \[rad/s\].
    pub velocity: f64,
    /// Highest acceleration \[rad/s2\].
    pub acceleration: f64,
    /// Highest jerk \[rad/s3\].
    pub jerk: f64,
}

/// Limits of all joints, base to flange.
pub type JointLimits = [JointLimit];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capacity_is_checked_and_json_round_trips() {
        assert_eq!(Joints::from_slice(&[0.0; 8]), Err(TooManyJoints { len: 8 }));
        let q = Joints::from([1.0, -2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(q.len(), 6);
        assert_eq!(q.max_abs(), 6.0);
        assert_eq!(q.zip(&q.zeroed(), |a, b| a - b), q);
        assert!(!q.map(|_| f64::NAN).is_finite());
    }
}
