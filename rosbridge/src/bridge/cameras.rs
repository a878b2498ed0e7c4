//! Images and camera parameters as messages.

use hal::CameraFrame;
use hal::frame::{Frame, LeftCamera, RightCamera};

use crate::convert;
use crate::msg::sensor_msgs;
use crate::seam::{Node, NodeClock, NodeError, Outlet, Quality};

/// A camera's parameters as OpenCV and ROS have them \[px\].
#[derive(Clone, Debug, PartialEq)]
pub struct CameraModel {
    /// Width \[px\].
    pub width: u32,
    /// Height \[px\].
    pub height: u32,
    /// fx, fy, cx, cy \[px\]; pixel centres are integers.
    pub intrinsics: [f64; 4],
    /// ROS's name of the lens model: `plumb_bob`, `rational_polynomial`, `equidistant`.
    pub distortion_model: &'static str,
    /// The model's coefficients, as ROS orders them: five, eight, four.
    pub distortion: Vec<f64>,
    /// First row's last entry of the projection matrix: -fx times the distance to the left
    /// camera \[px m\]; 0 for the left camera.
    pub shift: f64,
}

impl CameraModel {
    pub(crate) fn message(&self, header: crate::msg::std_msgs::Header) -> sensor_msgs::CameraInfo {
        let [fx, fy, cx, cy] = self.intrinsics;
        sensor_msgs::CameraInfo {
            header,
            height: self.height,
            width: self.width,
            distortion_model: self.distortion_model.to_owned(),
            D: self.distortion.clone(),
            K: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            P: [
                fx, 0.0, cx, self.shift, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0,
            ],
            ..sensor_msgs::CameraInfo::default()
        }
    }
}

/// The topics of one camera.
pub(crate) struct CameraOutlet {
    image: Outlet<sensor_msgs::Image>,
    info: Outlet<sensor_msgs::CameraInfo>,
    model: Option<CameraModel>,
    frame: &'static str,
}

impl CameraOutlet {
    pub(crate) fn left(node: &Node, model: Option<CameraModel>) -> Result<Self, NodeError> {
        Self::new(node, "left", LeftCamera::NAME, model)
    }

    pub(crate) fn right(node: &Node, model: Option<CameraModel>) -> Result<Self, NodeError> {
        Self::new(node, "right", RightCamera::NAME, model)
    }

    fn new(
        node: &Node,
        side: &str,
        frame: &'static str,
        model: Option<CameraModel>,
    ) -> Result<Self, NodeError> {
        Ok(Self {
            image: Outlet::new(node, &format!("{side}/image_raw"), Quality::Stream(2))?,
            info: Outlet::new(node, &format!("{side}/camera_info"), Quality::Stream(2))?,
            model,
            frame,
        })
    }

    /// Publishes an image where somebody listens.
    pub(crate) fn send(&self, clock: &NodeClock, frame: &CameraFrame) {
        let stamp = clock.ros_stamp(frame.stamp);
        if self.image.subscribers() > 0 {
            let mut image = convert::image(frame, self.frame);
            image.header.stamp = convert::time(stamp);
            self.image.send(image);
        }
        if let Some(model) = &self.model
            && self.info.subscribers() > 0
        {
            self.info
                .send(model.message(convert::header(stamp, self.frame, frame.sequence)));
        }
    }
}
