//! Camera views with the tracked needle drawn over them.

use std::fmt::Write;
use std::io::Cursor;

use nalgebra::Vector3;
use vision::StereoRig;
use vision::camera::View as Projection;

use super::course::{Course, View};

/// The views as figures.
pub(super) fn views(course: &Course) -> String {
    let mut html = String::new();
    let rig = course.cameras.as_ref().map(StereoRig::views);
    for view in &course.pairs {
        for (k, (name, image)) in [
            ("left", &view.pair.left.image),
            ("right", &view.pair.right.image),
        ]
        .into_iter()
        .enumerate()
        {
            let Some(png) = encoded(image) else { continue };
            let drawn = rig.map_or_else(String::new, |rig| drawing(view, &rig[k]));
            let (width, height) = (image.width(), image.height());
            let _ = writeln!(
                html,
                "<figure><svg viewBox=\"-0.5 -0.5 {width} {height}\" style=\"width:100%\" role=\"img\" \
                 aria-label=\"{name} image\"><image x=\"-0.5\" y=\"-0.5\" width=\"{width}\" \
                 height=\"{height}\" href=\"data:image/png;base64,{}\"/>{drawn}</svg>\
                 <figcaption>{name}, {:.2} s</figcaption></figure>",
                base64(&png),
                view.time
            );
        }
    }
    html
}

/// The measured needle as a line and the target as a cross, in pixels.
fn drawing(view: &View, camera: &Projection) -> String {
    let px = |point: &Vector3<f64>| camera.project(point).map(|px| (px.0.x, px.0.y));
    let mut svg = String::new();
    if !view.points.is_empty() {
        svg.push_str("<polyline fill=\"none\" stroke=\"#00c853\" stroke-width=\"1\" points=\"");
        for (x, y) in view.points.iter().filter_map(px) {
            let _ = write!(svg, "{x:.2},{y:.2} ");
        }
        svg.push_str("\"/>");
    }
    if let Some((x, y)) = view.target.as_ref().and_then(px) {
        let _ = write!(
            svg,
            "<path stroke=\"#d50000\" stroke-width=\"1\" d=\"M{:.2} {y:.2}h12M{x:.2} {:.2}v12\"/>",
            x - 6.0,
            y - 6.0
        );
    }
    svg
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
