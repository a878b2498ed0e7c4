//! So much a second, and no more.

use std::time::Instant;

/// What may be spent, refilled with time.
#[derive(Debug)]
pub(crate) struct Budget {
    per_second: f64,
    left: f64,
    at: Option<Instant>,
}

impl Budget {
    /// So much a second; a second's worth at once.
    pub(crate) const fn new(per_second: f64) -> Self {
        Self {
            per_second,
            left: per_second,
            at: None,
        }
    }

    /// Spends `amount` if it is there.
    pub(crate) fn spend(&mut self, now: Instant, amount: f64) -> bool {
        if let Some(at) = self.at {
            let gained = now.saturating_duration_since(at).as_secs_f64() * self.per_second;
            self.left = (self.left + gained).min(self.per_second);
        }
        self.at = Some(now);
        let enough = amount <= self.left;
        if enough {
            self.left -= amount;
        }
        enough
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_second_gives_what_a_second_takes() {
        let start = super::super::now();
        let mut budget = Budget::new(10.0);
        let spent = |budget: &mut Budget, ms: u64| {
            (0..100)
                .filter(|_| budget.spend(start + Duration::from_millis(ms), 1.0))
                .count()
        };
        assert_eq!(spent(&mut budget, 0), 10);
        assert_eq!(spent(&mut budget, 550), 5);
        assert_eq!(spent(&mut budget, 60_000), 10);
    }
}
