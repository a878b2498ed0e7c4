//! Whether an insertion makes progress: a law that only moves back and forth ends with a verdict.

use std::time::Duration;

use hal::Stamp;

/// Longest time without progress: three times what `hybrid` may spend on slowing down at a
/// tenth of the nominal speed, and many turns of the bevel.
const PATIENCE: Duration = Duration::from_mins(1);
/// Part of the nominal speed below which an approach is none: a fifth of the slowest that is meant.
const CREEPING: f64 = 0.02;

/// Watches the distance to the target's plane.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Approach that counts \[m\].
    step: f64,
    /// Least distance so far \[m\], and when it was last undercut.
    nearest: Option<(f64, Stamp)>,
}

impl Progress {
    /// Of an insertion at `nominal` \[m/s\].
    pub fn new(nominal: f64) -> Self {
        Self {
            step: CREEPING * nominal * PATIENCE.as_secs_f64(),
            nearest: None,
        }
    }

    /// Whether the newest distance counted as progress.
    pub fn has_advanced(&self, now: Stamp) -> bool {
        self.nearest.is_some_and(|(_, since)| since == now)
    }

    /// Takes note of the distance ahead \[m\]; answers the time without progress \[s\] once it is
    /// too long.
    pub fn update(&mut self, now: Stamp, ahead: f64) -> Option<f64> {
        match self.nearest {
            // NaN is no progress.
            Some((nearest, since)) if ahead.is_nan() || ahead > nearest - self.step => {
                let waited = now.since(since);
                (waited > PATIENCE).then_some(waited.as_secs_f64())
            }
            _ => {
                self.nearest = Some((ahead, now));
                None
            }
        }
    }

    /// Begins anew: after a pause.
    pub fn reset(&mut self) {
        self.nearest = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn to_and_fro_is_no_progress() {
        let mut progress = Progress::new(1e-3);
        for i in 0..100_u32 {
            let ahead = 0.05 - 1e-3 * f64::from(i % 7);
            let verdict = progress.update(Stamp::from_secs(f64::from(i)), ahead);
            // The nearest point is met first at 6 s.
            assert_eq!(verdict.is_some(), i > 66, "{i}: {verdict:?}");
        }
        progress.reset();
        for i in 0..1000_u32 {
            let ahead = 0.08 - 3e-5 * f64::from(i);
            assert_eq!(progress.update(Stamp::from_secs(f64::from(i)), ahead), None);
        }
        progress.reset();
        let creeping = (0..100_u32)
            .find(|i| {
                let (now, ahead) = (Stamp::from_secs(f64::from(*i)), 0.05 - 1e-5 * f64::from(*i));
                progress.update(now, ahead).is_some()
            })
            .unwrap();
        assert_eq!(creeping, 61);
    }
}
