//! Camera views with the tracked needle drawn over them.

use std::fmt::Write;
use std::io::Cursor;

use super::course::Course;

/// The views as figures.
pub(super) fn views(course: &Course) -> String {
    let mut html = String::new();
    for view in &course.pairs {
        for (name, image) in [
            ("left", &view.pair.left.image),
            ("right", &view.pair.right.image),
        ] {
            let Some(png) = encoded(image) else { continue };
            let _ = writeln!(
                html,
                "<figure><img alt=\"{name} image\" style=\"width:100%\" \
                 src=\"data:image/png;base64,{}\"><figcaption>{name}, {:.2} s</figcaption></figure>",
                base64(&png),
                view.time
            );
        }
    }
    html
}

fn encoded(image: &hal::GrayImage) -> Option<Vec<u8>> {
    let (width, height) = (
        u32::try_from(image.width()).ok()?,
        u32::try_from(image.height()).ok()?,
    );
    let buffer = image::GrayImage::from_raw(width, height, image.pixels().to_vec())?;
    let mut png = Cursor::new(Vec::new());
    buffer.write_to(&mut png, image::ImageFormat::Png).ok()?;
    Some(png.into_inner())
}

fn base64(bytes: &[u8]) -> String {
    use base64::Engine as _;
    base64::engine::general_purpose::STANDARD.encode(bytes)
}
