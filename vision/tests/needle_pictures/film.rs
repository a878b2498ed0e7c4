//! A needle that goes in and comes out again, without end.

use hal::telemetry::Tracking;
use hal::{Stamp, StereoFrame};
use nalgebra::{Point2, Vector2};
use vision::camera::View;
use vision::track::{
    Appearance, Change, Context, Flaw, ImageTracker, Look, StereoTracker, TrackSettings,
};

use super::{Needle, Scene, rig};

/// Pairs from one turn of the motion to the other: 20 MB at 1280, which a processor's cache holds as it
/// does images that just arrived.
const PAIRS: usize = 8;
/// Insertion between two pairs \[m\]: 3 mm/s at 30 Hz.
const STEP: f64 = 0.1e-3;
const BEVEL: f64 = 1.57e-3;
const DIAMETER: f64 = 0.7e-3;

pub struct Film {
    scene: Scene,
    needle: Needle,
    pairs: Vec<StereoFrame>,
    number: u64,
}

impl Film {
    pub fn new(width: usize) -> Self {
        let scene = Scene::new(rig(width), 1);
        let needle = Needle::bent(0.05, BEVEL, 0.8);
        let pairs = (0..PAIRS)
            .map(|k| {
                let needle = Needle {
                    depth: needle.depth + STEP * k as f64,
                    ..needle
                };
                scene.pair(&needle, k as u64)
            })
            .collect();
        Self {
            scene,
            needle,
            pairs,
            number: 0,
        }
    }

    /// The next pair's place in the film, and the insertion since the pair before.
    fn advance(&mut self) -> (usize, f64) {
        self.number += 1;
        let turn = PAIRS - 1;
        let k = usize::try_from(self.number).unwrap() % (2 * turn);
        if k == 0 || k > turn {
            ((2 * turn - k) % (2 * turn), -STEP)
        } else {
            (k, STEP)
        }
    }

    fn settings() -> TrackSettings {
        TrackSettings::default()
    }

    fn view(&self) -> View {
        self.scene.rig.views()[0]
    }

    /// How the needle looks in the left image.
    fn look(&self) -> Look {
        let (px, jacobian) = {
            let tip = self.needle.point(self.needle.depth);
            self.view().project_with_derivative(&tip).unwrap()
        };
        let sight = self.view().ray(px).unwrap().direction;
        let axis = (self.needle.point(self.needle.depth)
            - self.needle.point(self.needle.depth - 1e-5))
        .normalize();
        let across = axis.cross(&sight).normalize();
        Look {
            width: (jacobian * across).norm() * DIAMETER,
            bevel_px: (jacobian * axis).norm() * BEVEL,
            side: Some(self.needle.bevel_direction().dot(&across).abs()),
            rim_px: 0.0,
        }
    }

    /// A tracker of the left camera that has found the needle.
    pub fn image_tracker(&self) -> ImageTracker {
        let camera = self.view().camera;
        let mut tracker =
            ImageTracker::new(camera.width, camera.height, &Self::settings()).unwrap();
        let line: Vec<Vector2<f64>> = self
            .needle
            .guess()
            .iter()
            .filter_map(|p| self.view().project(&p.coords))
            .filter(|px| self.view().camera.contains(*px))
            .map(|px| px.0.coords)
            .collect();
        let reach = 14.0 * camera.width as f64 / 640.0;
        tracker
            .start(&self.pairs[0].left.image, &line, reach, &self.look())
            .unwrap();
        tracker
    }

    /// The next image.
    pub fn follow(&mut self, tracker: &mut ImageTracker) -> Result<(), Flaw> {
        let look = self.look();
        let scale = self.view().camera.width as f64 / 640.0;
        let (k, step) = self.advance();
        let advance = step * look.bevel_px / BEVEL;
        let change = Change {
            dt: 1.0 / 30.0,
            advance: Some((advance, 0.15 * scale + 0.2 * advance.abs())),
            walk: 0.1 * scale,
            ..Change::default()
        };
        tracker.follow(&self.pairs[k].left.image, &change, &look)
    }

    /// Where the tip is in the left image.
    pub fn tip_px(&self) -> Point2<f64> {
        let k = self.place();
        let tip = self.needle.point(self.needle.depth + STEP * k as f64);
        self.view().project(&tip).unwrap().0
    }

    fn place(&self) -> usize {
        let turn = PAIRS - 1;
        let k = usize::try_from(self.number).unwrap() % (2 * turn);
        if k > turn { 2 * turn - k } else { k }
    }

    /// A tracker that has found the needle in the first pair.
    pub fn stereo_tracker(&self) -> StereoTracker {
        let needle = Appearance {
            diameter: DIAMETER,
            bevel_length: BEVEL,
        };
        let mut tracker = StereoTracker::new(&self.scene.rig, needle, &Self::settings()).unwrap();
        let first = tracker.track(&self.pairs[0], &Context::default()).unwrap();
        assert_eq!(first.status, Tracking::Tracked, "{:?}", first.loss);
        tracker
    }

    fn pair(&self, k: usize) -> StereoFrame {
        let mut pair = self.pairs[k].clone();
        let stamp = Stamp::from_secs(self.number as f64 / 30.0);
        (pair.left.stamp, pair.right.stamp) = (stamp, stamp);
        pair
    }

    /// The next pair.
    pub fn track(&mut self, tracker: &mut StereoTracker) {
        let (k, step) = self.advance();
        let pair = self.pair(k);
        let context = Context {
            insertion: Some(step),
            bevel: Some(self.needle.bevel_direction().into_inner()),
            ..Context::default()
        };
        let tracked = tracker.track(&pair, &context).unwrap();
        assert_eq!(tracked.status, Tracking::Tracked, "{:?}", tracked.loss);
    }

    /// The first pair again after a loss: the needle is sought all over the images.
    pub fn find_again(&self, tracker: &mut StereoTracker) {
        tracker.forget_needle();
        self.find(tracker);
    }

    /// The same with everything forgotten, the background too.
    pub fn find_afresh(&self, tracker: &mut StereoTracker) {
        tracker.reset();
        self.find(tracker);
    }

    fn find(&self, tracker: &mut StereoTracker) {
        let tracked = tracker.track(&self.pairs[0], &Context::default()).unwrap();
        assert_eq!(tracked.status, Tracking::Tracked, "{:?}", tracked.loss);
    }

    /// Distance of the tip from the truth \[m\].
    pub fn error(&self, tracker: &StereoTracker) -> f64 {
        let tip = self
            .needle
            .point(self.needle.depth + STEP * self.place() as f64);
        (tracker.tracked().shape.tip.position.coords() - tip).norm()
    }
}
