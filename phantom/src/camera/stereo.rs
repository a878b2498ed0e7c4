//! The pair of cameras as a device: exposures, latency, drops, pooled images.

use std::collections::VecDeque;
use std::sync::Arc;

use core::time::Duration;

use hal::frame::{LeftCamera, World};
use hal::{CameraFrame, GrayImage, Stamp, StereoCamera, StereoFrame, Transform};
use nalgebra::Isometry3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::background;
use super::board::{BoardError, BoardView};
use super::calibration::{self, Given};
use super::covariance::Undetermined;
use super::geometry;
use super::noise::{Noise, Stream, generator};
use super::parameters::{RigParameters, Side};
use super::renderer::Renderer;
use super::settings::CameraSettings;
use super::view::View;
use crate::NeedleView;
use crate::settings::{SettingsError, placed};

/// A rig that cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RigError {
    /// A setting is outside its range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A distortion that maps two directions to one pixel.
    #[error("the {camera} camera's distortion folds within its image")]
    Folded {
        /// Which camera.
        camera: &'static str,
    },
    /// The calibration whose covariance is asked for has no solution.
    #[error(transparent)]
    Calibration(#[from] Undetermined),
}

/// Images kept for reuse; more are given away.
const POOL: usize = 64;
/// Number of an exposure of a board, apart from those of the needle.
const BOARDS: u64 = 1 << 40;

/// Two synchronised cameras before the gel, with seeded flaws.
///
/// The plant is brought to [`Self::next_exposure`] and shown with [`Self::expose`]; the pair
/// arrives, for [`StereoCamera::poll`], once [`Self::advance_to`] has passed its latency.
/// What is drawn for an exposure depends on the seed and the exposure's number alone.
#[derive(Debug)]
pub struct StereoRig {
    settings: CameraSettings,
    seed: u64,
    truth: RigParameters,
    given: Given,
    views: [View; 2],
    world_from_phantom: Isometry3<f64>,
    /// Made for the first image: a laboratory whose needle is sensed otherwise takes none.
    renderers: Option<[Renderer; 2]>,
    pool: Vec<Arc<GrayImage>>,
    in_flight: VecDeque<(Stamp, StereoFrame)>,
    sequence: u64,
    last_delivery: Stamp,
    now: Stamp,
}

impl StereoRig {
    /// Builds the rig before a phantom at `world_from_phantom` (z into the gel).
    ///
    /// # Errors
    /// A setting is outside its range, the phantom stands nowhere, or the calibration's views do
    /// not determine it.
    pub fn new(
        settings: &CameraSettings,
        world_from_phantom: &Isometry3<f64>,
        seed: u64,
    ) -> Result<Self, RigError> {
        settings.validate()?;
        placed("world_from_phantom", world_from_phantom)?;
        let truth = geometry::true_parameters(settings, world_from_phantom);
        for (camera, lens) in [("left", &truth.left), ("right", &truth.right)] {
            if !lens.unfolded(settings.width_px, settings.height_px) {
                return Err(RigError::Folded { camera });
            }
        }
        let gel_centre = world_from_phantom * geometry::gel_centre(settings);
        let given = calibration::given(&truth, &settings.calibration, &gel_centre, seed)?;
        let views = Side::BOTH.map(|side| truth.view(side));
        Ok(Self {
            settings: settings.clone(),
            seed,
            truth,
            given,
            views,
            world_from_phantom: *world_from_phantom,
            renderers: None,
            pool: Vec::with_capacity(POOL),
            in_flight: VecDeque::new(),
            sequence: 0,
            last_delivery: Stamp::ZERO,
            now: Stamp::ZERO,
        })
    }

    /// The rig as it is: for scores and tests.
    pub const fn truth(&self) -> &RigParameters {
        &self.truth
    }

    /// The rig as its calibration and registration have it: for the controller.
    pub const fn given(&self) -> &RigParameters {
        &self.given.parameters
    }

    /// Where the frame of the calibrated cameras' reconstructions truly lies: the rigid frame
    /// in which they agree best with the truth about the gel. Targets given in the stereo frame
    /// are placed in the laboratory by it; with a perfect calibration it is the left camera's.
    pub const fn stereo_from_world(&self) -> &Transform<LeftCamera, World> {
        &self.given.stereo_from_world
    }

    /// Pose of the left camera's true optical frame in the laboratory.
    pub fn world_from_left_camera(&self) -> Transform<World, LeftCamera> {
        self.truth.left_from_world.inverse()
    }

    /// The settings it was built from.
    pub const fn settings(&self) -> &CameraSettings {
        &self.settings
    }

    /// When the next exposure is due: 0, 1, 2 ... over the rate.
    pub fn next_exposure(&self) -> Stamp {
        Stamp::from_secs(self.sequence as f64 / self.settings.rate_hz)
    }

    /// Takes the pair that is due at [`Self::next_exposure`] and sends it on its way, unless it
    /// is dropped.
    pub fn expose(&mut self, needle: &NeedleView) {
        let stamp = self.next_exposure();
        let sequence = self.sequence;
        self.sequence += 1;
        let delivery = &self.settings.delivery;
        let mut generator = generator(self.seed, Stream::Delivery, sequence);
        let dropped = generator.random::<f64>() < delivery.drop_probability;
        let spread = delivery.latency_max_ms - delivery.latency_min_ms;
        let latency_ms = delivery.latency_min_ms + spread * generator.random::<f64>();
        if dropped {
            return;
        }
        let [left, right] = self.render(needle, sequence).map(|image| CameraFrame {
            stamp,
            sequence,
            image,
        });
        let delivered = stamp + Duration::from_secs_f64(1e-3 * latency_ms);
        self.last_delivery = self.last_delivery.max(delivered);
        self.in_flight
            .push_back((self.last_delivery, StereoFrame { left, right }));
    }

    /// Moves the rig's clock on; pairs that have arrived by `now` can be polled.
    pub fn advance_to(&mut self, now: Stamp) {
        self.now = self.now.max(now);
    }

    /// Left and right image of a needle as exposure number `sequence` shows it; no timing.
    pub fn render(&mut self, needle: &NeedleView, sequence: u64) -> [Arc<GrayImage>; 2] {
        self.draw(Some(needle), sequence)
    }

    /// Left and right image without a needle.
    pub fn empty(&mut self, sequence: u64) -> [Arc<GrayImage>; 2] {
        self.draw(None, sequence)
    }

    fn draw(&mut self, needle: Option<&NeedleView>, sequence: u64) -> [Arc<GrayImage>; 2] {
        self.with_renderers(
            |renderer, view, generator, image| {
                renderer.draw(view, needle, generator, image);
            },
            2 * sequence,
        )
    }

    /// Left and right image by `draw`; the random numbers of the pair are those of the exposures
    /// `number` and `number + 1`.
    fn with_renderers(
        &mut self,
        draw: impl Fn(&mut Renderer, &View, &mut ChaCha8Rng, &mut GrayImage),
        number: u64,
    ) -> [Arc<GrayImage>; 2] {
        let mut renderers = self.renderers.take().unwrap_or_else(|| self.prepared());
        let images = Side::BOTH.map(|side| {
            let index = side.index();
            let mut image = self.blank();
            let mut generator = generator(self.seed, Stream::Exposure, number + index as u64);
            draw(
                &mut renderers[index],
                &self.views[index],
                &mut generator,
                Arc::make_mut(&mut image),
            );
            self.keep(&image);
            image
        });
        self.renderers = Some(renderers);
        images
    }

    /// Noise and empty scenes: what is drawn once for all images.
    fn prepared(&self) -> [Renderer; 2] {
        let (settings, seed) = (&self.settings, self.seed);
        let noise = Noise::new(&settings.noise, settings.width_px, seed).map(Arc::new);
        [0, 1].map(|index| {
            let mut levels = background::screen(settings, index, seed);
            background::gel(
                &mut levels,
                settings,
                index,
                &self.views[index],
                &self.world_from_phantom,
                seed,
            );
            Renderer::new(settings, levels, noise.clone())
        })
    }

    /// Left and right image of a board, the container removed.
    ///
    /// # Errors
    /// A camera does not see the board's face.
    pub fn board_pair(
        &mut self,
        board: &BoardView,
        sequence: u64,
    ) -> Result<[Arc<GrayImage>; 2], BoardError> {
        for (view, camera) in self.views.iter().zip(["left", "right"]) {
            board.check(view, camera)?;
        }
        Ok(self.with_renderers(
            |renderer, view, generator, image| {
                renderer.draw_board(view, board, generator, image);
            },
            BOARDS + 2 * sequence,
        ))
    }

    /// An image nobody else holds: from the pool if there is one.
    fn blank(&mut self) -> Arc<GrayImage> {
        let free = self
            .pool
            .iter_mut()
            .position(|image| Arc::get_mut(image).is_some());
        match free {
            Some(i) => self.pool.swap_remove(i),
            None => Arc::new(GrayImage::filled(
                self.settings.width_px,
                self.settings.height_px,
                0,
            )),
        }
    }

    fn keep(&mut self, image: &Arc<GrayImage>) {
        if self.pool.len() < POOL {
            self.pool.push(image.clone());
        }
    }
}

impl StereoCamera for StereoRig {
    fn poll(&mut self) -> Result<Option<StereoFrame>, hal::Error> {
        let mut newest = None;
        while let Some((arrival, _)) = self.in_flight.front() {
            if *arrival > self.now {
                break;
            }
            newest = self.in_flight.pop_front().map(|(_, frame)| frame);
        }
        Ok(newest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A laboratory whose needle is not seen by cameras must not pay for their scenes.
    #[test]
    fn nothing_is_drawn_before_the_first_image() {
        let settings = CameraSettings::ideal();
        let mut rig = StereoRig::new(&settings, &Isometry3::identity(), 1).unwrap();
        assert!(rig.renderers.is_none());
        let first = rig.empty(0);
        assert!(rig.renderers.is_some());
        assert_eq!(rig.empty(0), first, "the scene stays");
    }
}
