//! One message of every type, with values that differ in every place.

use igtl::{
    ASCII, Attribute, Body, Coordinates, Ends, Extension, Image, Message, MetaValue, Point,
    PolyData, Position, Scalar, Status, StatusCode, Text, Timestamp, Trajectory, Transform,
};

/// The contents.
pub(crate) fn bodies() -> Vec<Body> {
    vec![
        Body::Transform(Transform {
            axes: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            origin: [10.5, -20.25, 30.125],
        }),
        Body::Position(Position {
            origin: [1.5, 2.5, -3.5],
            orientation: [0.5, -0.5, 0.5, 0.5],
        }),
        Body::Points(vec![
            Point {
                name: "target".into(),
                group: "Fiducial".into(),
                colour: [255, 128, 0, 64],
                place: [4.0, 5.0, 6.0],
                diameter: 2.5,
                owner: "left".into(),
            },
            Point {
                name: "entry".into(),
                place: [-4.0, -5.0, -6.0],
                ..Point::default()
            },
        ]),
        Body::Trajectories(vec![Trajectory {
            name: "path".into(),
            group: "Trajectory".into(),
            ends: Ends::Both,
            colour: [1, 2, 3, 4],
            entry: [7.0, 8.0, 9.0],
            target: [10.0, 11.0, 12.0],
            diameter: 0.75,
            owner: "plan".into(),
        }]),
        Body::PolyData(PolyData {
            attributes: vec![Attribute {
                kind: 0,
                components: 1,
                name: "depth".into(),
                values: vec![0.0, 1.0, 2.0, 3.0, 4.0],
            }],
            ..PolyData::polylines([
                &[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.0, 2.0]][..],
                &[[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]][..],
            ])
        }),
        Body::Image(Image {
            components: 3,
            scalar: Scalar::Uint8,
            big_endian: false,
            coordinates: Coordinates::Ras,
            size: [4, 2, 1],
            steps: [[0.5, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 1.0]],
            centre: [10.0, 20.0, 30.0],
            part_from: [0, 0, 0],
            part_size: [4, 2, 1],
            pixels: (0..24).collect(),
        }),
        Body::Status(Status {
            code: StatusCode::OK,
            sub_code: -7,
            name: "Steering".into(),
            text: "depth 12.5 mm".into(),
        }),
        Body::Text(Text::new("START")),
    ]
}

/// Messages of all header versions.
pub(crate) fn messages() -> Vec<Message> {
    let extension = Extension {
        id: 42,
        metadata: vec![(
            "frame".into(),
            MetaValue {
                encoding: ASCII,
                bytes: "world".into(),
            },
        )],
    };
    let extensions = [None, Some(Extension::default()), Some(extension)];
    extensions
        .into_iter()
        .flat_map(|extension| {
            bodies().into_iter().map(move |body| Message {
                stamp: Timestamp::from_nanos(1_700_000_000_250_000_000),
                extension: extension.clone(),
                ..Message::new("NeedleTip", body)
            })
        })
        .collect()
}
