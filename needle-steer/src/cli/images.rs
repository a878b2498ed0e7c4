//! What the pixels of image files given on the command line are.

use clap::Args;
use vision::files::Pixels;

#[derive(Debug, Args)]
pub(super) struct ImageArgs {
    /// The images are raw ones of a colour camera: one colour a pixel, in squares of two by two. The
    /// order of the colours does not change their grey values.
    #[arg(long, value_name = "ORDER", num_args = 0..=1, default_missing_value = "any",
        value_parser = ["any", "rggb", "bggr", "grbg", "gbrg"])]
    bayer: Option<String>,
}

impl ImageArgs {
    pub(super) const fn pixels(&self) -> Pixels {
        match self.bayer {
            Some(_) => Pixels::Mosaic,
            None => Pixels::Plain,
        }
    }
}
