//! Every message survives its bytes, in whatever pieces they come; damage is told.

mod samples;

use igtl::{
    Attribute, Body, Coordinates, Ends, Extension, HEADER, Header, Image, Message, MetaValue,
    Point, PolyData, Position, Reader, Reject, Scalar, Status, StatusCode, Text, Timestamp,
    Trajectory, Transform, Unsendable,
};
use proptest::collection::vec;
use proptest::prelude::*;

fn float() -> impl Strategy<Value = f32> {
    prop::num::f32::NORMAL | prop::num::f32::ZERO | prop::num::f32::SUBNORMAL
}

fn triple() -> impl Strategy<Value = [f32; 3]> {
    prop::array::uniform3(float())
}

fn word(most: usize) -> impl Strategy<Value = String> {
    vec(prop::char::range(' ', '~'), 0..=most).prop_map(String::from_iter)
}

fn point() -> impl Strategy<Value = Point> {
    let texts = (word(64), word(32), word(20));
    (texts, any::<[u8; 4]>(), triple(), float()).prop_map(
        |((name, group, owner), colour, place, diameter)| Point {
            name,
            group,
            colour,
            place,
            diameter,
            owner,
        },
    )
}

fn trajectory() -> impl Strategy<Value = Trajectory> {
    let ends = prop_oneof![Just(Ends::Entry), Just(Ends::Target), Just(Ends::Both)];
    (point(), triple(), ends).prop_map(|(point, target, ends)| Trajectory {
        name: point.name,
        group: point.group,
        ends,
        colour: point.colour,
        entry: point.place,
        target,
        diameter: point.diameter,
        owner: point.owner,
    })
}

fn cells(points: u32) -> impl Strategy<Value = Vec<Vec<u32>>> {
    vec(vec(0..points, 0..5), 0..4)
}

fn attribute() -> impl Strategy<Value = Attribute> {
    (0..5_u8, 1..10_u8, word(40), 0..6_usize, float()).prop_map(
        |(kind, components, name, n, value)| Attribute {
            kind,
            components,
            name,
            values: vec![value; n * usize::from(components)],
        },
    )
}

fn poly_data() -> impl Strategy<Value = PolyData> {
    vec(triple(), 1..9).prop_flat_map(|points| {
        let n = u32::try_from(points.len()).unwrap_or(0);
        let all = [cells(n), cells(n), cells(n), cells(n)];
        (Just(points), all, vec(attribute(), 0..3)).prop_map(|(points, cells, attributes)| {
            let [vertices, lines, polygons, strips] = cells;
            PolyData {
                points,
                vertices,
                lines,
                polygons,
                strips,
                attributes,
            }
        })
    })
}

fn image() -> impl Strategy<Value = Image> {
    let scalar = prop_oneof![
        Just(Scalar::Uint8),
        Just(Scalar::Int16),
        Just(Scalar::Float32),
        Just(Scalar::Float64),
    ];
    let coordinates = prop_oneof![Just(Coordinates::Ras), Just(Coordinates::Lps)];
    let size = prop::array::uniform3(0..5_u16);
    (
        (1..5_u8, scalar, any::<bool>(), coordinates),
        (size.clone(), size),
        prop::array::uniform3(triple()),
        triple(),
        any::<u8>(),
    )
        .prop_map(|(kind, (part_from, part_size), steps, centre, fill)| {
            let (components, scalar, big_endian, coordinates) = kind;
            let pixels: usize = part_size.iter().map(|&n| usize::from(n)).product();
            Image {
                components,
                scalar,
                big_endian,
                coordinates,
                size: [0, 1, 2].map(|i| part_from[i] + part_size[i]),
                steps,
                centre,
                part_from,
                part_size,
                pixels: vec![fill; pixels * usize::from(components) * scalar.size()],
            }
        })
}

fn body() -> impl Strategy<Value = Body> {
    let transform = (prop::array::uniform3(triple()), triple())
        .prop_map(|(axes, origin)| Body::Transform(Transform { axes, origin }));
    let position = (triple(), prop::array::uniform4(float())).prop_map(|(origin, orientation)| {
        Body::Position(Position {
            origin,
            orientation,
        })
    });
    let status = (any::<u16>(), any::<i64>(), word(20), word(60)).prop_map(
        |(code, sub_code, name, text)| {
            Body::Status(Status {
                code: StatusCode(code),
                sub_code,
                name,
                text,
            })
        },
    );
    let text = (any::<u16>(), vec(any::<u8>(), 0..80))
        .prop_map(|(encoding, bytes)| Body::Text(Text { encoding, bytes }));
    prop_oneof![
        transform,
        position,
        vec(point(), 0..4).prop_map(Body::Points),
        vec(trajectory(), 0..4).prop_map(Body::Trajectories),
        poly_data().prop_map(Body::PolyData),
        image().prop_map(Body::Image),
        status,
        text,
    ]
}

fn message() -> impl Strategy<Value = Message> {
    let value = (any::<u16>(), vec(any::<u8>(), 0..9))
        .prop_map(|(encoding, bytes)| MetaValue { encoding, bytes });
    let extension = (any::<u32>(), vec((word(12), value), 0..4))
        .prop_map(|(id, metadata)| Extension { id, metadata });
    let header = (word(20), any::<u64>(), prop::option::of(extension));
    (header, body()).prop_map(|((device, stamp, extension), body)| Message {
        device,
        stamp: Timestamp(stamp),
        extension,
        body,
    })
}

/// Everything that a reader makes of `bytes`, which come in pieces of `piece` bytes.
fn read(bytes: &[u8], piece: usize, limit: usize) -> (Vec<Result<Message, Reject>>, Reader) {
    let mut reader = Reader::new(limit);
    let mut read = Vec::new();
    for mut piece in bytes.chunks(piece) {
        while !piece.is_empty() {
            read.extend(reader.push(&mut piece));
        }
    }
    (read, reader)
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_message_survives_its_bytes(message in message()) {
        let bytes = message.encode().unwrap();
        prop_assert_eq!(Message::decode(&bytes).unwrap(), message);
    }

    #[test]
    fn messages_come_out_of_any_pieces(messages in vec(message(), 1..5), piece in 1..99_usize) {
        let bytes: Vec<u8> = messages.iter().flat_map(|m| m.encode().unwrap()).collect();
        let (read, reader) = read(&bytes, piece, 1 << 20);
        prop_assert_eq!(read.into_iter().collect::<Result<Vec<_>, _>>().unwrap(), messages);
        prop_assert_eq!(reader.end(), None);
    }

    #[test]
    fn a_flipped_bit_of_the_body_is_noticed(message in message(), at in any::<prop::sample::Index>(), bit in 0..8_u32) {
        let mut bytes = message.encode().unwrap();
        if bytes.len() > HEADER {
            let at = HEADER + at.index(bytes.len() - HEADER);
            bytes[at] ^= 1 << bit;
            let told = matches!(Message::decode(&bytes), Err(Reject::Checksum { .. }));
            prop_assert!(told);
        }
    }

    #[test]
    fn a_message_cut_short_is_none(message in message(), at in any::<prop::sample::Index>()) {
        let bytes = message.encode().unwrap();
        let cut = &bytes[..at.index(bytes.len())];
        let told = matches!(Message::decode(cut), Err(Reject::Truncated { .. }));
        prop_assert!(told);
        let (read, reader) = read(cut, 16, 1 << 20);
        prop_assert!(read.is_empty());
        prop_assert_eq!(reader.end().is_some(), !cut.is_empty());
    }
}

#[test]
fn the_samples_survive_their_bytes() {
    for message in samples::messages() {
        assert_eq!(Message::decode(&message.encode().unwrap()), Ok(message));
    }
}

#[test]
fn the_header_is_as_the_protocol_has_it() {
    let mut message = Message::new("Tip", Body::Transform(Transform::at([1.0, 2.0, 3.0])));
    message.stamp = Timestamp::from_nanos(1_500_000_000);
    let bytes = message.encode().unwrap();
    assert_eq!(bytes.len(), 58 + 48);
    assert_eq!(&bytes[..2], [0, 1]);
    assert_eq!(&bytes[2..14], b"TRANSFORM\0\0\0");
    assert_eq!(&bytes[14..34], b"Tip\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0");
    assert_eq!(&bytes[34..42], [0, 0, 0, 1, 0x80, 0, 0, 0]);
    assert_eq!(&bytes[42..50], [0, 0, 0, 0, 0, 0, 0, 48]);
    assert_eq!(&bytes[58..62], 1.0_f32.to_be_bytes());
    assert_eq!(
        &bytes[94..106],
        [0x3f, 0x80, 0, 0, 0x40, 0, 0, 0, 0x40, 0x40, 0, 0]
    );
}

/// `bytes` with the checksum of their body.
fn resealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let crc = igtl::crc64(&bytes[HEADER..]);
    bytes[50..58].copy_from_slice(&crc.to_be_bytes());
    let size = (bytes.len() - HEADER) as u64;
    bytes[42..50].copy_from_slice(&size.to_be_bytes());
    bytes
}

#[test]
fn a_reader_goes_on_after_content_it_does_not_read_and_gives_up_where_it_has_lost_its_place() {
    let good = Message::new("A", Body::Text(Text::new("STOP")));
    let bytes = good.encode().unwrap();
    let mut unknown = bytes.clone();
    unknown[2..14].copy_from_slice(b"TDATA\0\0\0\0\0\0\0");
    let mut longer = bytes.clone();
    longer.push(0);
    let mut short = bytes.clone();
    short.truncate(HEADER + 3);
    for (bad, reason) in [
        (resealed(unknown), "type"),
        (resealed(longer), "trailing"),
        (resealed(short), "truncated"),
    ] {
        let stream = [bad, bytes.clone()].concat();
        let (read, reader) = read(&stream, 7, 1000);
        assert_eq!(read.len(), 2, "{reason}");
        assert_eq!(read[0].as_ref().unwrap_err().reason(), reason);
        assert_eq!(read[1].as_ref().unwrap(), &good);
        assert!(!reader.is_lost());
    }
    let mut version = bytes.clone();
    version[1] = 9;
    let mut damaged = bytes.clone();
    damaged[60] ^= 1;
    let mut large = bytes.clone();
    large[42] = 0x7f;
    for (bad, reason) in [
        (version, "version"),
        (damaged, "checksum"),
        (large, "oversized"),
    ] {
        let stream = [bad, bytes.clone()].concat();
        let (read, reader) = read(&stream, 7, 1000);
        assert_eq!(read.len(), 1, "{reason}");
        assert_eq!(read[0].as_ref().unwrap_err().reason(), reason);
        assert!(reader.is_lost() && reader.memory() == 0);
    }
}

#[test]
fn a_reader_reserves_nothing_that_has_not_come() {
    let header = Header {
        version: 1,
        kind: "IMAGE".into(),
        device: String::new(),
        stamp: Timestamp::default(),
        body_size: 1 << 30,
        crc: 0,
    };
    let mut bytes = Message::new("", Body::Points(Vec::new())).encode().unwrap();
    bytes[42..50].copy_from_slice(&header.body_size.to_be_bytes());
    let (read, reader) = read(&bytes, 9, 1 << 31);
    assert!(read.is_empty() && reader.memory() < 200);
}

#[test]
fn what_has_no_room_is_refused() {
    let long = "x".repeat(21);
    let text = Body::Text(Text::new(&"x".repeat(70_000)));
    let image = Image {
        pixels: vec![0; 3],
        ..match samples::bodies().remove(5) {
            Body::Image(image) => image,
            other => panic!("{other:?}"),
        }
    };
    for (message, field) in [
        (Message::new(long, Body::Points(Vec::new())), "device name"),
        (
            Message::new("a\0b", Body::Points(Vec::new())),
            "device name",
        ),
        (Message::new("a", text), "bytes of a string"),
        (Message::new("a", Body::Image(image)), "bytes of pixels"),
    ] {
        let found = match message.encode().unwrap_err() {
            Unsendable::Long { field, .. }
            | Unsendable::Zero { field }
            | Unsendable::Many { field, .. }
            | Unsendable::Disagree { field, .. } => field,
        };
        assert_eq!(found, field);
    }
}

/// What pyigtl sent in one session, recorded (`tests/peers/pyigtl_session.py`).
#[test]
fn a_recorded_session_replays_whatever_the_pieces_and_is_written_again_bit_by_bit() {
    let session = include_bytes!("samples/pyigtl.igtl");
    let mut expected = vec!["STRING", "TRANSFORM", "POINT", "STRING"];
    expected.extend(["TRANSFORM"; 20]);
    expected.extend(["IMAGE", "POLYDATA", "STRING"]);
    for piece in [1, 7, 58, 1000, session.len()] {
        let (messages, reader) = read(session, piece, 64 << 10);
        assert_eq!(reader.end(), None);
        let messages: Vec<Message> = messages.into_iter().map(Result::unwrap).collect();
        let kinds: Vec<&str> = messages.iter().map(|message| message.body.kind()).collect();
        assert_eq!(kinds, expected, "{piece}");
        let again: Vec<u8> = messages
            .iter()
            .flat_map(|message| message.encode().unwrap())
            .collect();
        assert!(again == session, "{piece}");
        let stamps: Vec<u64> = messages.iter().map(|m| m.stamp.as_nanos()).collect();
        assert!(stamps.windows(2).all(|two| two[1] - two[0] > 24_000_000));
        let Body::Transform(last) = &messages[23].body else {
            panic!("{:?}", messages[23]);
        };
        assert!((last.origin[1] + 0.5).abs() < 1e-6, "{last:?}");
        assert_eq!(messages[23].device, "NeedleTipToTracker");
    }
}
