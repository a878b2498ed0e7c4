//! Many environments at once, on threads.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};

use super::episode::{Episode, Outcome, Step};
use super::observation::OBSERVATION;
use super::settings::{EnvError, Settings};

/// Environments that are stepped together. One whose episode ended begins the next one at the next
/// step, which then earns nothing, whatever its action is.
#[derive(Debug)]
pub struct Envs {
    episodes: Vec<Episode>,
    ended: Vec<bool>,
    threads: usize,
    width: usize,
}

/// Where the results of a step go, a place for each environment.
#[derive(Debug)]
pub struct Steps<'a> {
    /// Observations, one after the other.
    pub observations: &'a mut [f32],
    /// What each earned and whether it ended.
    pub steps: &'a mut [Step],
    /// The truth of each.
    pub outcomes: &'a mut [Outcome],
}

impl Envs {
    /// `count` environments of `settings` on `threads` threads, or all cores; their seeds count on
    /// from `seed`.
    ///
    /// # Errors
    /// See [`EnvError`].
    pub fn new(
        settings: Settings,
        count: usize,
        threads: Option<NonZeroUsize>,
        seed: u64,
    ) -> Result<Self, EnvError> {
        let worlds = Arc::new(settings.worlds()?);
        let settings = Arc::new(settings);
        let episodes: Result<Vec<Episode>, EnvError> = (0..count as u64)
            .map(|k| {
                Episode::new(
                    Arc::clone(&settings),
                    Arc::clone(&worlds),
                    seed.wrapping_add(k),
                )
            })
            .collect();
        Ok(Self {
            episodes: episodes?,
            ended: vec![false; count],
            threads: threads
                .or_else(|| std::thread::available_parallelism().ok())
                .map_or(1, NonZeroUsize::get),
            width: settings.actions.len(),
        })
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.episodes.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.episodes.is_empty()
    }

    /// Numbers of an action.
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Begins an episode in each environment that `chosen` names, in all by default: the first of
    /// its seed where there is one, else its next.
    ///
    /// # Errors
    /// A phantom that cannot be made.
    pub fn reset(
        &mut self,
        seeds: &[Option<u64>],
        chosen: Option<&[bool]>,
        into: Steps<'_>,
    ) -> Result<(), EnvError> {
        let is_chosen = |k: usize| chosen.is_none_or(|c| c.get(k).copied().unwrap_or(false));
        let seed = |k: usize| seeds.get(k).copied().flatten();
        self.each(into, |k, episode, ended, step| {
            if is_chosen(k) {
                *ended = false;
                *step = Step::default();
                episode.reset(seed(k))?;
            }
            Ok(())
        })
    }

    /// Steps every environment by its action, one after the other in `actions`.
    ///
    /// # Errors
    /// A phantom that cannot be made.
    pub fn step(&mut self, actions: &[f32], into: Steps<'_>) -> Result<(), EnvError> {
        let width = self.width;
        self.each(into, |k, episode, ended, step| {
            if core::mem::take(ended) {
                *step = Step::default();
                return episode.reset(None);
            }
            *step = episode.step(actions.get(k * width..(k + 1) * width).unwrap_or_default());
            *ended = step.terminated || step.truncated;
            Ok(())
        })
    }

    /// Does `work` on every environment, on the threads, and takes its results.
    fn each(
        &mut self,
        into: Steps<'_>,
        work: impl Fn(usize, &mut Episode, &mut bool, &mut Step) -> Result<(), EnvError> + Sync,
    ) -> Result<(), EnvError> {
        let places = into
            .observations
            .chunks_mut(OBSERVATION)
            .zip(into.steps)
            .zip(into.outcomes);
        let threads = self.threads.min(self.episodes.len()).max(1);
        let parts = self.episodes.iter_mut().zip(&mut self.ended).zip(places);
        let queue = Mutex::new(parts.enumerate());
        let failed = Mutex::new(None);
        let serve = || {
            loop {
                let next = queue.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some((k, ((episode, ended), ((seen, step), outcome)))) = next else {
                    return;
                };
                if let Err(error) = work(k, episode, ended, step) {
                    let mut failed = failed.lock().unwrap_or_else(PoisonError::into_inner);
                    failed.get_or_insert(error);
                }
                episode.observe(seen);
                *outcome = *episode.outcome();
            }
        };
        if threads == 1 {
            serve();
        } else {
            std::thread::scope(|scope| {
                for _ in 0..threads {
                    scope.spawn(serve);
                }
            });
        }
        let failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
        failed.map_or(Ok(()), Err)
    }
}
