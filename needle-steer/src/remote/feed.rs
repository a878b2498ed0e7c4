//! Snapshots of a run, shown by a thread of their own at held rates.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use hal::{ArmState, Overlay, StereoFrame, Telemetry};
use rosbridge::aside::Aside;

use super::{now, stand_back};

/// Snapshots that may wait for the thread.
const QUEUE: usize = 64;
/// Shortest time between two looks at what is due.
const TICK: Duration = Duration::from_millis(4);
/// Warnings that wait for the next tick.
const WARNINGS: usize = 16;

enum Item {
    Step(Arc<Telemetry>),
    Arm(ArmState),
    Images(StereoFrame, Arc<Overlay>),
    Warning(String),
}

/// What is shown: the newest of everything.
#[derive(Debug, Default)]
pub(crate) struct Scene {
    pub(crate) telemetry: Option<Arc<Telemetry>>,
    pub(crate) arm: Option<ArmState>,
    pub(crate) images: Option<(StereoFrame, Arc<Overlay>)>,
    /// What was said since the last time.
    pub(crate) warnings: Vec<String>,
    /// Snapshots that found no room.
    pub(crate) dropped: u64,
}

/// What is to be shown now.
#[expect(clippy::struct_excessive_bools, reason = "a flag a kind")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Due {
    /// Poses and numbers.
    pub(crate) poses: bool,
    /// Lines: the needle and paths.
    pub(crate) lines: bool,
    /// Images that were not shown yet.
    pub(crate) images: bool,
    /// What changes once a second at most.
    pub(crate) slow: bool,
    /// Something was said.
    pub(crate) warnings: bool,
}

impl Due {
    const fn any(self) -> bool {
        self.poses || self.lines || self.images || self.slow || self.warnings
    }
}

/// Highest rates \[Hz\].
#[derive(Clone, Copy, Debug)]
pub(crate) struct FeedRates {
    pub(crate) poses: f64,
    pub(crate) lines: f64,
    pub(crate) images: f64,
}

/// Shows scenes, on the feed's thread.
pub(crate) trait Show: Send + 'static {
    /// Shows what is due.
    fn show(&mut self, scene: &Scene, due: Due);
}

/// The run's end. Dropping it shows the last snapshot and ends the thread.
#[derive(Debug)]
pub(crate) struct Feed(Aside<Item>);

impl Feed {
    /// Starts a thread of this name.
    pub(crate) fn start(
        name: &str,
        rates: FeedRates,
        mut show: impl Show,
    ) -> std::io::Result<Self> {
        let work = move |items: &Receiver<Item>, dropped: &AtomicU64| {
            stand_back();
            run(items, rates, dropped, &mut show);
        };
        Aside::start(name, QUEUE, work).map(Self)
    }

    pub(crate) fn step(&self, telemetry: &Arc<Telemetry>) {
        self.0.put(Item::Step(Arc::clone(telemetry)));
    }

    pub(crate) fn arm(&self, state: &ArmState) {
        self.0.put(Item::Arm(*state));
    }

    pub(crate) fn images(&self, pair: &StereoFrame, overlay: &Arc<Overlay>) {
        self.0.put(Item::Images(pair.clone(), Arc::clone(overlay)));
    }

    pub(crate) fn warning(&self, text: &str) {
        self.0.put(Item::Warning(text.to_owned()));
    }
}

/// A rate: when it is due next.
struct Beat {
    period: Duration,
    next: Option<Instant>,
}

impl Beat {
    fn new(hz: f64) -> Self {
        Self {
            period: Duration::from_secs_f64(1.0 / hz),
            next: None,
        }
    }

    /// Whether it is due; a beat that was missed is not made up for.
    fn strikes(&mut self, now: Instant) -> bool {
        match self.next {
            Some(next) if now < next => false,
            Some(next) if now < next + self.period => {
                self.next = Some(next + self.period);
                true
            }
            _ => {
                self.next = Some(now + self.period);
                true
            }
        }
    }
}

fn run(queue: &Receiver<Item>, rates: FeedRates, dropped: &AtomicU64, show: &mut impl Show) {
    let mut scene = Scene::default();
    let mut beats = [rates.poses, rates.lines, rates.images, 1.0].map(Beat::new);
    let mut fresh_images = false;
    let mut tick = now();
    loop {
        let ended = match queue.recv_timeout(tick.saturating_duration_since(now())) {
            Ok(item) => {
                fresh_images |= scene.take(item);
                if now() < tick {
                    continue;
                }
                false
            }
            Err(RecvTimeoutError::Timeout) => false,
            Err(RecvTimeoutError::Disconnected) => true,
        };
        for item in queue.try_iter().take(QUEUE) {
            fresh_images |= scene.take(item);
        }
        let time = now();
        tick = time + TICK;
        scene.dropped = dropped.load(Ordering::Relaxed);
        let [poses, lines, images, slow] = &mut beats;
        let due = Due {
            poses: ended || poses.strikes(time),
            lines: ended || lines.strikes(time),
            images: fresh_images && (ended || images.strikes(time)),
            slow: ended || slow.strikes(time),
            warnings: !scene.warnings.is_empty(),
        };
        if due.any() {
            show.show(&scene, due);
            fresh_images &= !due.images;
            scene.warnings.clear();
        }
        if ended {
            return;
        }
    }
}

impl Scene {
    /// Whether it is a pair of images.
    fn take(&mut self, item: Item) -> bool {
        match item {
            Item::Step(telemetry) => self.telemetry = Some(telemetry),
            Item::Arm(state) => self.arm = Some(state),
            Item::Images(pair, overlay) => {
                self.images = Some((pair, overlay));
                return true;
            }
            Item::Warning(text) if self.warnings.len() < WARNINGS => self.warnings.push(text),
            Item::Warning(_) => {}
        }
        false
    }
}
