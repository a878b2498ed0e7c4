//! What kept an insertion waiting, and for how long.

use crate::outcome::Cause;

/// Share of a time that a cause must have taken to be named for it.
const SHARE: f64 = 1.0 / 3.0;

/// Time in which the arm was held, by cause.
#[derive(Clone, Debug, Default)]
pub struct Holds {
    all: Vec<(Cause, f64)>,
    recent: Vec<(Cause, f64)>,
}

impl Holds {
    /// The arm was held for `seconds` more.
    pub fn note(&mut self, cause: Cause, seconds: f64) {
        for tally in [&mut self.all, &mut self.recent] {
            match tally.iter_mut().find(|(known, _)| *known == cause) {
                Some((_, sum)) => *sum += seconds,
                None => tally.push((cause, seconds)),
            }
        }
    }

    /// The insertion got on.
    pub fn progress(&mut self) {
        self.recent.clear();
    }

    /// What took most of the last `seconds` without progress, if anything did.
    pub fn cause_of(&self, seconds: f64) -> Option<Cause> {
        most(&self.recent, seconds)
    }

    /// What took most of a whole run of `seconds`, if anything did.
    pub fn cause_of_all(&self, seconds: f64) -> Option<Cause> {
        most(&self.all, seconds)
    }
}

fn most(tally: &[(Cause, f64)], seconds: f64) -> Option<Cause> {
    tally
        .iter()
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, sum)| *sum > SHARE * seconds)
        .map(|(cause, _)| *cause)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_hold_names_the_cause() {
        let mut holds = Holds::default();
        holds.note(Cause::Stall, 30.0);
        holds.progress();
        holds.note(Cause::MeasurementsLate, 5.0);
        holds.note(Cause::MeasurementsLate, 5.0);
        assert_eq!(holds.cause_of(20.0), Some(Cause::MeasurementsLate));
        assert_eq!(holds.cause_of(60.0), None);
        assert_eq!(holds.cause_of_all(80.0), Some(Cause::Stall));
    }
}
