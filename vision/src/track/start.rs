//! Finding the needle in a pair, to begin with and after a loss.

use hal::GrayImage;
use nalgebra::{Matrix2, Point3, Vector2, Vector3};

use super::StereoTracker;
use super::answer::{Context, Loss};
use super::curve::MOST;
use super::geometry::resembles;
use super::single::{Flaw, Look};
use super::space::Curve3;
use crate::camera::{DistortedPx, triangulate};

/// How far from a guess the needle is sought \[px\], in images 640 wide.
const AROUND_GUESS: f64 = 14.0;

impl StereoTracker {
    /// Finds the needle: at clicked points, near a guess, or anywhere.
    pub(super) fn start(
        &mut self,
        images: [&GrayImage; 2],
        context: &Context<'_>,
    ) -> Result<(), Loss> {
        let clicked = self.clicked.take();
        if let (None, Some(guess)) = (&clicked, context.guess)
            && !self.shows_enough(guess)
        {
            if guess.is_empty() {
                for (tracker, image) in self.images.iter_mut().zip(images) {
                    tracker.learn(image);
                }
            }
            return Err(Loss::NotFound);
        }
        if clicked.is_none() && context.guess.is_none() {
            return self.search(images, context, None);
        }
        for k in 0..2 {
            let (line, reach, look) = match (&clicked, context.guess) {
                (Some(points), _) => {
                    let line = points[k].iter().map(|px| px.0.coords).collect();
                    let (look, _) = self.look(k, &self.scene, None, context);
                    (line, AROUND_GUESS, look)
                }
                (None, Some(guess)) => self.near_guess(k, guess, context),
                (None, None) => return Err(Loss::NotFound),
            };
            let tracker = &mut self.images[k];
            let reach = reach * tracker.scale();
            let begun = if line.len() < 2 {
                Err(Flaw::Short)
            } else {
                tracker.start_dark_or_bright(images[k], &line, reach, &look)
            };
            if begun.is_err() {
                self.forget_needle();
                return Err(Loss::NotFound);
            }
        }
        let outcome = self.first_curve().and_then(|mut curve| {
            self.fuse(&mut curve, 12)?;
            let plausible =
                clicked.is_some() || context.guess.is_none_or(|guess| resembles(&curve, guess));
            if plausible {
                Ok(curve)
            } else {
                Err(Loss::NotFound)
            }
        });
        match outcome {
            Ok(curve) => {
                self.curve = Some(curve);
                self.losses = 0;
                Ok(())
            }
            Err(loss) => {
                self.forget_needle();
                Err(loss)
            }
        }
    }

    /// Whether a guess is long enough in both images to begin with: where a needle has only just
    /// come into sight, any tip fits.
    fn shows_enough(&self, guess: &[Point3<f64>]) -> bool {
        let (Some(first), Some(last)) = (guess.first(), guess.last()) else {
            return false;
        };
        self.views.iter().zip(&self.images).all(|(view, image)| {
            let ends = view.project(&first.coords).zip(view.project(&last.coords));
            let length = ends.map_or(0.0, |(a, b)| (b.0 - a.0).norm());
            length >= self.settings.visible_px * image.scale()
        })
    }

    /// A guess in one image.
    fn near_guess(
        &self,
        k: usize,
        guess: &[Point3<f64>],
        context: &Context<'_>,
    ) -> (Vec<Vector2<f64>>, f64, Look) {
        let view = &self.views[k];
        let line = guess
            .iter()
            .filter_map(|p| view.project(&p.coords))
            .filter(|px| view.camera.contains(*px))
            .map(|px| px.0.coords)
            .collect();
        let tip = guess.last().map_or(self.scene, |p| p.coords);
        let axis = match guess {
            [.., before, last] => (last - before).try_normalize(1e-9),
            _ => None,
        };
        let (look, _) = self.look(k, &tip, axis.as_ref(), context);
        (line, AROUND_GUESS, look)
    }

    /// Points on both curves at equal parameters, triangulated: a start for the fit.
    fn first_curve(&self) -> Result<Curve3, Loss> {
        let [Some(left), Some(right)] = [self.images[0].filter(), self.images[1].filter()] else {
            return Err(Loss::NotFound);
        };
        let curves = [left.curve(), right.curve()];
        let count = curves[0].control_points().len();
        let mut points = [Vector3::zeros(); MOST];
        for (i, point) in points.iter_mut().enumerate().take(count) {
            let t = i as f64 / (count - 1) as f64;
            let pixels = curves.map(|curve| DistortedPx(curve.at(t).into()));
            *point = triangulate(&self.views, &pixels, &[Matrix2::identity(); 2])
                .map_err(|_| Loss::NoCurve)?
                .position
                .coords();
        }
        Ok(Curve3::through(count, points))
    }
}
