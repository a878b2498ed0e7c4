//! What messages contain, a type of message a module.

pub(crate) mod image;
pub(crate) mod point;
pub(crate) mod polydata;
pub(crate) mod pose;
pub(crate) mod status;
pub(crate) mod text;
pub(crate) mod trajectory;

use crate::error::{Reject, Unsendable};
use crate::wire::Fields;
use image::Image;
use point::Point;
use polydata::PolyData;
use pose::{Position, Transform};
use status::Status;
use text::Text;
use trajectory::Trajectory;

/// Red, green, blue and opacity.
pub type Colour = [u8; 4];

/// The content of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// `TRANSFORM`: a rigid or affine transform.
    Transform(Transform),
    /// `POSITION`: a place and an orientation.
    Position(Position),
    /// `POINT`: named points.
    Points(Vec<Point>),
    /// `TRAJ`: named straight paths.
    Trajectories(Vec<Trajectory>),
    /// `POLYDATA`: points, lines and surfaces.
    PolyData(PolyData),
    /// `IMAGE`: a picture or a volume.
    Image(Image),
    /// `STATUS`: how the sender is.
    Status(Status),
    /// `STRING`: a text.
    Text(Text),
}

impl Body {
    /// Name of the type of message.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Transform(_) => "TRANSFORM",
            Self::Position(_) => "POSITION",
            Self::Points(_) => "POINT",
            Self::Trajectories(_) => "TRAJ",
            Self::PolyData(_) => "POLYDATA",
            Self::Image(_) => "IMAGE",
            Self::Status(_) => "STATUS",
            Self::Text(_) => "STRING",
        }
    }

    pub(crate) fn encode(&self, out: &mut Vec<u8>) -> Result<(), Unsendable> {
        match self {
            Self::Transform(transform) => transform.encode(out),
            Self::Position(position) => position.encode(out),
            Self::Points(points) => return points.iter().try_for_each(|point| point.encode(out)),
            Self::Trajectories(all) => return all.iter().try_for_each(|one| one.encode(out)),
            Self::PolyData(data) => return data.encode(out),
            Self::Image(image) => return image.encode(out),
            Self::Status(status) => return status.encode(out),
            Self::Text(text) => return text.encode(out),
        }
        Ok(())
    }

    pub(crate) fn decode(kind: &str, content: &[u8]) -> Result<Self, Reject> {
        let mut fields = Fields::new(content);
        let body = match kind {
            "TRANSFORM" => Self::Transform(Transform::decode(&mut fields)?),
            "POSITION" => Self::Position(Position::decode(&mut fields)?),
            "POINT" => Self::Points(all(&mut fields, Point::decode)?),
            "TRAJ" => Self::Trajectories(all(&mut fields, Trajectory::decode)?),
            "POLYDATA" => Self::PolyData(PolyData::decode(&mut fields)?),
            "IMAGE" => Self::Image(Image::decode(&mut fields)?),
            "STATUS" => Self::Status(Status::decode(&mut fields)?),
            "STRING" => Self::Text(Text::decode(&mut fields)?),
            name => {
                return Err(Reject::Type {
                    name: name.to_owned(),
                });
            }
        };
        fields.end()?;
        Ok(body)
    }
}

/// One after the other until the content ends.
fn all<'a, T>(
    fields: &mut Fields<'a>,
    read: impl Fn(&mut Fields<'a>) -> Result<T, Reject>,
) -> Result<Vec<T>, Reject> {
    let mut list = Vec::new();
    while fields.remaining() > 0 {
        list.push(read(fields)?);
    }
    Ok(list)
}
