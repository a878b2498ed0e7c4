//! A hand that pushes the needle through its guide: in steps that are asked for, with pauses and
//! errors.

use hal::Stamp;
use rand_chacha::ChaCha8Rng;

use crate::draw::{Purpose, normal, stream, uniform};
use crate::settings::HandSettings;

/// Errors of a step beyond so many standard deviations are not made.
const MOST: f64 = 2.0;
/// Least time of a step \[s\].
const LEAST_TIME: f64 = 0.5;

/// What the hand is about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Doing {
    /// It waits to be asked.
    Waits,
    /// It will push from a time on, to a way \[m\], at a speed \[m/s\].
    Pushes(Stamp, f64, f64),
}

/// The hand of one run.
#[derive(Clone, Debug)]
pub struct Hand {
    settings: HandSettings,
    rng: ChaCha8Rng,
    way: f64,
    now: Stamp,
    doing: Doing,
    /// Number of the newest request.
    heard: u64,
    /// Since when it is asked to hold.
    hold_since: Option<Stamp>,
}

impl Hand {
    /// The hand of run `seed`.
    pub fn new(settings: &HandSettings, seed: u64) -> Self {
        Self {
            settings: settings.clone(),
            rng: stream(seed, Purpose::Hand),
            way: 0.0,
            now: Stamp::ZERO,
            doing: Doing::Waits,
            heard: 0,
            hold_since: None,
        }
    }

    /// How far it has pushed at `now` \[m\]. `asked`: number of the newest request and the step that it
    /// asks for \[m\], or nothing to hold.
    pub fn advance_to(&mut self, now: Stamp, asked: (u64, Option<f64>)) -> f64 {
        let elapsed = now.secs_since(self.now).max(0.0);
        self.now = now;
        let Some(step) = asked.1 else {
            let since = *self.hold_since.get_or_insert(now);
            if now.secs_since(since) >= self.settings.reaction_s {
                self.doing = Doing::Waits;
            } else {
                self.push(elapsed);
            }
            return self.way;
        };
        self.hold_since = None;
        if asked.0 != self.heard {
            self.heard = asked.0;
            let pause = self.settings.pause_s * (0.5 + uniform(&mut self.rng));
            let error = self.settings.step_error * normal(&mut self.rng).clamp(-MOST, MOST);
            let step = (step * (1.0 + error)).max(0.0);
            let speed = (self.settings.speed_mm_s * 1e-3).min(step / LEAST_TIME);
            let from = now + core::time::Duration::from_secs_f64(pause);
            self.doing = Doing::Pushes(from, self.way + step, speed);
        }
        self.push(elapsed);
        self.way
    }

    fn push(&mut self, elapsed: f64) {
        if let Doing::Pushes(from, to, speed) = self.doing
            && self.now >= from
        {
            self.way = (self.way + speed * elapsed).min(to).max(self.way);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_made_after_a_pause_and_held_when_asked() {
        let settings = HandSettings {
            step_error: 0.0,
            pause_s: 1.0,
            ..HandSettings::default()
        };
        let mut hand = Hand::new(&settings, 1);
        let mut at = |k: u32, asked| hand.advance_to(Stamp::from_secs(f64::from(k) * 0.01), asked);
        let first: Vec<f64> = (0..400).map(|k| at(k, (1, Some(5e-3)))).collect();
        assert!(first[40].abs() < 1e-12, "a pause of half a second at least");
        assert!((first[399] - 5e-3).abs() < 1e-9, "{}", first[399]);
        let (mut begun, mut k) = (0.0, 400);
        while begun <= 7e-3 {
            begun = at(k, (2, Some(5e-3)));
            k += 1;
        }
        let held: Vec<f64> = (k..k + 100).map(|k| at(k, (2, None))).collect();
        let over = held[99] - begun;
        // Three tenths of a second at 4 mm/s.
        assert!(over > 0.5e-3 && over < 1.5e-3, "{over}");
        assert!((held[60] - held[99]).abs() < 1e-12);
    }

    #[test]
    fn steps_are_off_by_millimetres() {
        let mut hand = Hand::new(&HandSettings::default(), 3);
        let (mut before, mut square) = (0.0, 0.0);
        for step in 1..=200_u64 {
            let mut way = 0.0;
            for k in 0..40 {
                let now = Stamp::from_secs(step as f64 * 10.0 + f64::from(k) * 0.25);
                way = hand.advance_to(now, (step, Some(5e-3)));
            }
            square += (way - before - 5e-3_f64).powi(2);
            before = way;
        }
        let deviation = (square / 200.0_f64).sqrt() * 1e3;
        assert!((1.0..2.0).contains(&deviation), "{deviation}");
    }
}
