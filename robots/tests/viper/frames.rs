//! T1, T2, T3, T16: frames.

use std::collections::HashMap;

use hal::{Arm, ErrorKind, FaultReason};
use proptest::prelude::*;
use robots::viper::wire::steer;
use robots::viper::wire::{
    ByteOrder, Comm, Decoder, Frame, IoOperation, JointFeedback, JointPosition, MAX_FRAME, Message,
    Ping, ReplyCode, Status, TrajAck, TrajPt, TrajPtFull, WIRE_JOINTS, WireError, encode_io,
    sequence,
};
use robots::viper::{Dialect, Fault, Port, ProtocolError};

use crate::bench::Bench;

const SIMPLE: &str = include_str!("../../../tests/data/viper/simple_message_golden.csv");
const ADEPT: &str = include_str!("../../../tests/data/viper/adept2018_golden.csv");

fn bytes_of(hex: &str) -> Vec<u8> {
    (0..hex.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap())
        .collect()
}

/// `name,order,bytes,hex` rows: (name, order) to bytes.
fn golden(csv: &str) -> HashMap<(&str, &str), Vec<u8>> {
    let rows = csv.lines().skip(1).filter(|line| !line.is_empty());
    rows.map(|line| {
        let mut fields = line.split(',');
        let mut next = || fields.next().unwrap();
        let (name, order, length, hex) = (next(), next(), next(), next());
        let bytes = bytes_of(hex);
        assert_eq!(bytes.len(), length.parse::<usize>().unwrap(), "{name}");
        ((name, order), bytes)
    })
    .collect()
}

fn wide(values: [f32; 6]) -> [f32; WIRE_JOINTS] {
    let mut wide = [0.0; WIRE_JOINTS];
    wide[..6].copy_from_slice(&values);
    wide
}

/// The values from which the golden frames were made.
fn sample_joints() -> [f32; WIRE_JOINTS] {
    wide([0.3, -1.2, 2.1, 0.4, -0.7, 1.1])
}

fn sample_point(sequence: i32, velocity: f32, duration: f32) -> TrajPt {
    TrajPt {
        sequence,
        positions: sample_joints(),
        velocity,
        duration,
    }
}

fn simple_frames() -> Vec<(&'static str, Frame)> {
    let velocities = wide([0.01, 0.02, 0.03, 0.04, 0.05, 0.06]);
    let accelerations = wide([-0.1, -0.2, -0.3, -0.4, -0.5, -0.6]);
    let positions = sample_joints();
    let point = sample_point(5, 0.1, 0.1);
    vec![
        ("PING_request", Frame::request(Message::EmptyPing)),
        ("PING_reply_success", Frame::reply(Message::EmptyPing, true)),
        (
            "JOINT_POSITION_topic_seq7",
            Frame::topic(Message::JointPosition(JointPosition {
                sequence: 7,
                positions,
            })),
        ),
        (
            "JOINT_TRAJ_PT_request_seq5_vel0.1_dur0.1",
            Frame::request(Message::TrajPt(point)),
        ),
        (
            "JOINT_TRAJ_PT_reply_success_full",
            Frame::reply(Message::TrajPt(point), true),
        ),
        (
            "JOINT_TRAJ_PT_request_STOP(-4)",
            Frame::request(Message::TrajPt(sample_point(sequence::STOP, 0.0, 0.0))),
        ),
        (
            "JOINT_TRAJ_PT_FULL_request_seq3_t0.25",
            Frame::request(Message::TrajPtFull(TrajPtFull {
                robot_id: 0,
                sequence: 3,
                valid: 15,
                time: 0.25,
                positions,
                velocities,
                accelerations,
            })),
        ),
        (
            "JOINT_FEEDBACK_topic_t1.5",
            Frame::topic(Message::JointFeedback(JointFeedback {
                robot_id: 0,
                valid: 7,
                time: 1.5,
                positions,
                velocities,
                accelerations,
            })),
        ),
        (
            "STATUS_topic_on_noestop_noerr_moving_auto",
            Frame::topic(Message::Status(Status {
                in_motion: 1,
                motion_possible: 0,
                ..Status::READY
            })),
        ),
    ]
}

#[test]
fn t01_golden_frames_of_both_byte_orders_are_equal_byte_for_byte() {
    let golden = golden(SIMPLE);
    let frames = simple_frames();
    assert_eq!(golden.len(), 2 * frames.len());
    for (name, frame) in frames {
        for (label, order) in [("BE", ByteOrder::Big), ("LE", ByteOrder::Little)] {
            let expected = &golden[&(name, label)];
            assert_eq!(frame.encode(order).as_slice(), expected, "{name} {label}");
            assert_eq!(
                Frame::decode(&expected[4..], order),
                Ok(frame),
                "{name} {label}"
            );
        }
    }
}

#[test]
fn t01_golden_frames_of_the_2018_program_are_equal_byte_for_byte() {
    let golden = golden(ADEPT);
    let stop = TrajPt {
        sequence: sequence::STOP,
        ..TrajPt::default()
    };
    let reply = |sequence| Frame::reply(Message::TrajAck(TrajAck { sequence }), true);
    let joints = JointPosition {
        sequence: 0,
        positions: sample_joints(),
    };
    let pressed = Status {
        drives_powered: 0,
        e_stopped: 1,
        motion_possible: 1,
        ..Status::READY
    };
    let frames = [
        (
            "cmd_point_seq5",
            "client->11000",
            Frame::request(Message::TrajPt(sample_point(5, 0.1, 0.1))),
        ),
        ("cmd_reply", "11000->client", reply(0)),
        (
            "cmd_stop",
            "client->11000",
            Frame::request(Message::TrajPt(stop)),
        ),
        ("cmd_stop_reply", "11000->client", reply(sequence::STOP)),
        (
            "fdb_joints",
            "11002->client",
            Frame::topic(Message::JointPosition(joints)),
        ),
        (
            "fdb_status_auto_powered_idle",
            "11002->client",
            Frame::topic(Message::Status(Status::READY)),
        ),
        (
            "fdb_status_estop",
            "11002->client",
            Frame::topic(Message::Status(pressed)),
        ),
    ];
    for (name, direction, frame) in &frames {
        let expected = &golden[&(*name, *direction)];
        assert_eq!(frame.encode(ByteOrder::Big).as_slice(), expected, "{name}");
        assert_eq!(
            Frame::decode(&expected[4..], ByteOrder::Big),
            Ok(*frame),
            "{name}"
        );
    }
    let io = [
        ("io_read_1106", IoOperation::Read, 1106),
        ("io_write_104", IoOperation::Write, 104),
    ];
    for (name, operation, signal) in io {
        assert_eq!(
            encode_io(operation, signal).to_vec(),
            golden[&(name, "client->11001")],
            "{name}"
        );
    }
    assert_eq!(golden.len(), frames.len() + io.len());
}

/// One frame of each `steer` message.
fn steer_frames() -> Vec<(usize, Frame)> {
    let positions = [0.3, -1.2, 2.1, 0.4, -0.7, 1.1];
    let reply = steer::HelloReply {
        session: 3,
        joints: 6,
        ..steer::HelloReply::default()
    };
    let point = steer::Point {
        session: 3,
        sequence: 9,
        flags: 1,
        duration_us: 16_000,
        positions,
    };
    let accepted = steer::PointReply {
        session: 3,
        sequence: 9,
        refusal: 0,
        tick: 77,
    };
    let stop = steer::Stop {
        session: 3,
        sequence: 10,
    };
    let stopped = steer::StopReply {
        session: 3,
        sequence: 10,
        tick: 78,
    };
    let feedback = steer::Feedback {
        session: 3,
        tick: 78,
        sequence: 9,
        armed: 1,
        disarmed_by: 10,
        status: Status::READY,
        positions,
    };
    vec![
        (68, Frame::request(Message::Hello(steer::Hello::default()))),
        (112, Frame::reply(Message::HelloReply(reply), true)),
        (56, Frame::request(Message::Point(point))),
        (32, Frame::reply(Message::PointReply(accepted), false)),
        (24, Frame::request(Message::Stop(stop))),
        (28, Frame::reply(Message::StopReply(stopped), true)),
        (88, Frame::topic(Message::Feedback(feedback))),
    ]
}

#[test]
fn t01_steer_frames_have_their_documented_sizes_and_come_back() {
    for (size, frame) in steer_frames() {
        let bytes = frame.encode(ByteOrder::Big);
        assert_eq!(bytes.as_slice().len(), size, "{frame:?}");
        assert_eq!(
            Frame::decode(&bytes.as_slice()[4..], ByteOrder::Big),
            Ok(frame)
        );
    }
}

#[test]
fn a_steer_greeting_is_a_stop_order_to_the_2018_program() {
    let hello = Frame::request(Message::Hello(steer::Hello::default())).encode(ByteOrder::Big);
    let stop = &golden(ADEPT)[&("cmd_stop", "client->11000")];
    assert_eq!(hello.as_slice().len(), stop.len());
    // Communication type and sequence are all that this program looks at before it moves.
    assert_eq!(hello.as_slice()[8..12], stop[8..12]);
    assert_eq!(hello.as_slice()[16..20], stop[16..20]);
}

fn all_frames() -> Vec<Frame> {
    let simple = simple_frames().into_iter().map(|(_, frame)| frame);
    let long_ping = Frame::request(Message::Ping(Ping { data: [7; 10] }));
    simple
        .chain(steer_frames().into_iter().map(|(_, frame)| frame))
        .chain([long_ping])
        .collect()
}

fn decode_all(pieces: &[&[u8]]) -> (Vec<Frame>, Result<(), WireError>) {
    let mut decoder = Decoder::new(ByteOrder::Big, 0);
    let mut frames = Vec::new();
    for piece in pieces {
        if let Err(error) = decoder.push(piece, |frame| frames.push(frame)) {
            return (frames, Err(error));
        }
    }
    (frames, Ok(()))
}

fn stream(frames: &[Frame]) -> Vec<u8> {
    frames
        .iter()
        .flat_map(|frame| frame.encode(ByteOrder::Big).as_slice().to_vec())
        .collect()
}

#[test]
fn t02_byte_by_byte_and_merged_delivery_give_the_same_frames() {
    let frames = all_frames();
    let bytes = stream(&frames);
    let single: Vec<&[u8]> = bytes.chunks(1).collect();
    assert_eq!(decode_all(&single), (frames.clone(), Ok(())));
    assert_eq!(decode_all(&[&bytes]), (frames.clone(), Ok(())));
    let mut decoder = Decoder::new(ByteOrder::Big, 4);
    let mut seen = 0;
    decoder.push(&[0xff; 3], |_| seen += 1).unwrap();
    decoder.push(&[0xff], |_| seen += 1).unwrap();
    decoder.push(&bytes, |_| seen += 1).unwrap();
    assert_eq!(seen, frames.len(), "after a preamble of four bytes");
    assert!(!decoder.is_mid_frame());
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn t02_any_cutting_of_the_stream_gives_the_same_frames(
        cuts in proptest::collection::vec(1_usize..200, 1..40)
    ) {
        let frames = all_frames();
        let bytes = stream(&frames);
        let mut pieces = Vec::new();
        let mut rest = bytes.as_slice();
        for cut in cuts.iter().cycle() {
            if rest.is_empty() { break; }
            let (piece, after) = rest.split_at((*cut).min(rest.len()));
            pieces.push(piece);
            rest = after;
        }
        prop_assert_eq!(decode_all(&pieces), (frames, Ok(())));
    }
}

#[test]
fn t03_bad_frames_are_named_and_final() {
    let good = Frame::topic(Message::Status(Status::READY)).encode(ByteOrder::Big);
    let with = |at: usize, value: i32| {
        let mut bytes = good.as_slice().to_vec();
        bytes[at..at + 4].copy_from_slice(&value.to_be_bytes());
        bytes
    };
    let nan = {
        let point = TrajPt {
            velocity: f32::NAN,
            ..TrajPt::default()
        };
        Frame::request(Message::TrajPt(point))
            .encode(ByteOrder::Big)
            .as_slice()
            .to_vec()
    };
    let length = |length| WireError::Length {
        length,
        least: 12,
        most: MAX_FRAME - 4,
    };
    for (bytes, expected) in [
        (with(0, -1), length(-1)),
        (with(0, 0), length(0)),
        (with(0, 11), length(11)),
        (with(0, i32::MAX), length(i32::MAX)),
        (with(4, 999), WireError::Type { kind: 999 }),
        (with(8, 0), WireError::Comm { comm: 0 }),
        (with(12, 3), WireError::ReplyCode { code: 3 }),
        (
            with(4, 10),
            WireError::BodySize {
                kind: 10,
                found: 28,
            },
        ),
        (nan, WireError::NotFinite { kind: 11 }),
    ] {
        let mut decoder = Decoder::new(ByteOrder::Big, 0);
        assert_eq!(
            decoder.push(&bytes, |frame| panic!("{frame:?}")),
            Err(expected)
        );
        assert_eq!(
            decoder.push(good.as_slice(), |frame| panic!("{frame:?}")),
            Err(expected)
        );
    }
    let (frames, outcome) = decode_all(&[&good.as_slice()[..43]]);
    assert!(
        frames.is_empty() && outcome.is_ok(),
        "a truncated frame waits for its end"
    );
}

#[test]
fn t03_garbage_faults_the_driver_and_is_survived() {
    for dialect in [Dialect::Steer, Dialect::Adept2018] {
        for port in Port::ALL {
            let mut bench = Bench::moving(dialect);
            bench
                .emulator()
                .inject(port, b"GET / HTTP/1.1\r\n\r\n and more of it");
            bench.try_to_go(crate::bench::slow(), 4);
            assert_eq!(
                bench.reason(),
                Some(FaultReason::Protocol),
                "{dialect:?} {port:?}"
            );
            bench.rest(10);
            bench.assert_dead();
            bench.assert_revives();
        }
    }
}

#[test]
fn t03_a_frame_that_does_not_belong_faults_the_driver() {
    let ping = Frame::request(Message::EmptyPing).encode(ByteOrder::Big);
    let wrong = Frame::topic(Message::TrajPt(TrajPt::default())).encode(ByteOrder::Big);
    let mut bench = Bench::enabled(Dialect::Steer);
    bench.emulator().inject(Port::State, ping.as_slice());
    bench.rest(2);
    assert_eq!(bench.reason(), None, "a ping is harmless");
    bench.emulator().inject(Port::State, wrong.as_slice());
    bench.rest(2);
    let fault = bench.arm().monitor().fault();
    assert_eq!(
        fault,
        Some(Fault::Protocol(ProtocolError::Unexpected { port: "state" }))
    );
}

#[test]
fn t16_the_wrong_byte_order_is_named_at_the_first_frame() {
    let frame = Frame::topic(Message::JointPosition(JointPosition::default()));
    let (_, outcome) = decode_all(&[&frame.encode(ByteOrder::Little).as_slice()[..4]]);
    let error = outcome.unwrap_err();
    assert_eq!(
        error,
        WireError::ByteOrder {
            found: 0x3800_0000,
            swapped: 0x38
        }
    );
    assert!(
        error.to_string().contains("0x38000000 where 0x38 fits"),
        "{error}"
    );

    let mut bench = Bench::new(Dialect::Adept2018);
    bench
        .emulator()
        .turn(|knobs| knobs.order = ByteOrder::Little);
    bench.rest(20);
    assert_eq!(bench.reason(), Some(FaultReason::Protocol));
    let fault = bench.arm().monitor().fault().unwrap().to_string();
    assert!(fault.contains("other byte order"), "{fault}");
    assert_eq!(bench.arm().enable().unwrap_err().kind(), ErrorKind::Faulted);
}

/// Bytes that look like frames more often than not.
fn hostile() -> impl Strategy<Value = Vec<u8>> {
    let field = prop_oneof![
        4 => prop_oneof![Just(0), Just(1), Just(2), Just(3), Just(11), Just(13)],
        2 => prop_oneof![Just(10), Just(14), Just(15), Just(16), Just(40), Just(56), Just(64)],
        2 => 1199..1205_i32,
        1 => any::<i32>(),
    ];
    let words = proptest::collection::vec(field, 0..24).prop_map(|words| {
        words
            .into_iter()
            .flat_map(i32::to_be_bytes)
            .collect::<Vec<u8>>()
    });
    let frames = proptest::collection::vec((0_usize..18, 0_usize..200, any::<u8>()), 1..4)
        .prop_map(|picks| {
            let all = all_frames();
            let mut bytes = Vec::new();
            for (pick, at, value) in picks {
                let frame = all[pick % all.len()].encode(ByteOrder::Big);
                let start = bytes.len();
                bytes.extend_from_slice(frame.as_slice());
                // A third keep their bytes; the others get one wrong.
                if let Some(byte) = bytes.get_mut(start + at) {
                    *byte = value;
                }
            }
            bytes
        });
    prop_oneof![
        words,
        frames,
        proptest::collection::vec(any::<u8>(), 0..300)
    ]
}

/// Decodes, checks what came out; the number of frames.
fn survive(bytes: &[u8]) -> usize {
    let mut count = 0;
    for order in [ByteOrder::Big, ByteOrder::Little] {
        let mut decoder = Decoder::new(order, 0);
        let first = decoder.push(bytes, |frame| {
            count += 1;
            // What was understood can be said again, byte for byte.
            let again = frame.encode(order);
            assert_eq!(Frame::decode(&again.as_slice()[4..], order), Ok(frame));
        });
        if let Err(error) = first {
            assert_eq!(decoder.push(&[0], |_| ()), Err(error));
        }
    }
    count
}

fn fuzz(cases: u32) -> (u64, u64) {
    let mut runner = proptest::test_runner::TestRunner::new_with_rng(
        ProptestConfig {
            cases,
            failure_persistence: None,
            ..ProptestConfig::default()
        },
        proptest::test_runner::TestRng::deterministic_rng(
            proptest::test_runner::RngAlgorithm::ChaCha,
        ),
    );
    let counts = std::cell::Cell::new((0, 0));
    let outcome = runner.run(&hostile(), |bytes| {
        let frames = survive(&bytes) as u64;
        counts.set((counts.get().0 + 1, counts.get().1 + frames));
        Ok(())
    });
    outcome.unwrap();
    counts.get()
}

#[test]
fn t03_decoder_survives_hostile_input() {
    let (inputs, frames) = fuzz(20_000);
    assert_eq!(inputs, 20_000);
    assert!(
        frames > 2_000,
        "too few inputs get past the header: {frames}"
    );
}

/// `cargo test --release -p robots --test viper ten_million -- --ignored --nocapture`
#[test]
#[ignore = "a minute and more; run by hand"]
fn t03_decoder_survives_ten_million_hostile_inputs() {
    let (inputs, frames) = fuzz(10_000_000);
    println!("{inputs} inputs survived, {frames} frames understood");
    assert_eq!(inputs, 10_000_000);
}

#[test]
fn headers_of_all_frames_say_what_they_are() {
    for frame in all_frames() {
        let is_reply = frame.comm == Comm::Reply;
        assert_eq!(is_reply, frame.reply != ReplyCode::None, "{frame:?}");
    }
}
