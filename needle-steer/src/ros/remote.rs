//! The score of a run in a laboratory elsewhere, from the truth that it publishes.

use std::sync::{Mutex, MutexGuard, PoisonError};

use hal::Transform;
use hal::frame::{LeftCamera, World};
use hal::telemetry::{TruthEvent, TruthReport};
use nalgebra::Vector3;
use rosbridge::laboratory::{Hidden, Laboratory};

use crate::score::{GroundTruth, Score, Scoring, TrueFigures};

struct Inner {
    laboratory: Laboratory,
    newest: Option<Hidden>,
    /// Events since the last report.
    events: Vec<TruthEvent>,
    score: Option<Score>,
}

impl Inner {
    fn observe(&mut self) {
        while let Some(hidden) = self.laboratory.next_truth() {
            for event in &hidden.truth.events {
                if !self.events.contains(event) {
                    self.events.push(*event);
                }
            }
            self.newest = Some(hidden);
            self.score_newest();
        }
    }

    fn score_newest(&mut self) {
        if let (Some(score), Some(hidden)) = (&mut self.score, &self.newest) {
            let truth = &hidden.truth;
            score.observe(
                truth.stamp,
                [&truth.tip, &truth.direction],
                [truth.max_stretch, truth.mean_stretch],
            );
        }
    }

    fn truth(&self) -> TruthReport {
        self.newest
            .as_ref()
            .map_or_else(TruthReport::default, |hidden| hidden.truth.clone())
    }
}

/// An emulated laboratory behind topics.
pub(crate) struct RemoteLaboratory(Mutex<Inner>);

impl RemoteLaboratory {
    pub(crate) fn new(laboratory: Laboratory) -> Self {
        Self(Mutex::new(Inner {
            laboratory,
            newest: None,
            events: Vec::new(),
            score: None,
        }))
    }

    /// Locked, and up to date.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        inner.observe();
        inner
    }

    /// Whether there is a truth.
    pub(crate) fn is_known(&self) -> bool {
        self.lock().newest.is_some()
    }
}

impl GroundTruth for RemoteLaboratory {
    fn pre_insertion(&self) -> f64 {
        self.lock()
            .newest
            .as_ref()
            .map_or(0.0, |hidden| hidden.pre_insertion)
    }

    fn newest(&self) -> TruthReport {
        self.lock().truth()
    }

    fn stereo_from_world(&self) -> Transform<LeftCamera, World> {
        self.lock()
            .newest
            .as_ref()
            .map_or_else(Transform::identity, |hidden| hidden.stereo_from_world)
    }

    fn true_tip(&self) -> Vector3<f64> {
        self.lock().truth().tip
    }
}

impl Scoring for RemoteLaboratory {
    fn watch(&self, target: Vector3<f64>) {
        let mut inner = self.lock();
        inner.score = Some(Score::new(target));
        inner.score_newest();
    }

    fn report(&self) -> TruthReport {
        let mut inner = self.lock();
        let truth = TruthReport {
            events: core::mem::take(&mut inner.events),
            ..inner.truth()
        };
        Score::complete(inner.score.as_ref(), truth)
    }

    fn figures(&self) -> Option<TrueFigures> {
        let inner = self.lock();
        let truth = inner.truth();
        Some(inner.score?.figures(&truth.tip, &truth.direction))
    }
}
