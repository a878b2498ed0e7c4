use std::time::Duration;

use hal::frame::{LeftCamera, World};
use hal::telemetry::{
    LawReport, Limit, ModelReport, Phase, SteeringMode, Telemetry, Tracking, TruthReport,
};
use hal::{
    ArmMode, ArmState, CameraFrame, FaultReason, GrayImage, Joints, Position, RateCommand,
    SensedPoint, SensedShape, SensedTip, Stamp, StereoFrame, Transform, Twist,
};
use nalgebra::{Isometry3, Matrix3, Point3, Unit, UnitQuaternion, Vector2, Vector3};
use proptest::prelude::*;

use super::*;

mod foreign;

/// Values that differ in every place, and numbers that only survive bit by bit.
fn telemetry(step: u64) -> Telemetry {
    let s = step as f64;
    let line = |n: usize, z: f64| {
        (0..n)
            .map(|i| Vector3::new(0.1 * i as f64, s / 3.0, z))
            .collect::<Vec<_>>()
    };
    let pose = Isometry3::from_parts(
        Vector3::new(0.4, s / 7.0, 0.25).into(),
        UnitQuaternion::from_euler_angles(3.0, 0.1 / (s + 1.0), -0.2),
    );
    Telemetry {
        step,
        stamp: Stamp::from_nanos(step * 33_333_333 + 1),
        image_stamp: (step % 2 == 1).then(|| Stamp::from_nanos(step * 33_000_007)),
        phase: Phase::Steering,
        tracking: Tracking::Predicted,
        arm_mode: ArmMode::Faulted(FaultReason::TrackingError),
        joints: Joints::from([s, -0.0, f64::MIN_POSITIVE, 1e300, 0.1, -6.0]),
        joint_rates: Joints::from([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]),
        world_from_base: Transform::assume(pose),
        world_from_tip: Transform::assume(pose.inverse()),
        base_twist: Twist {
            linear: Vector3::new(0.1, 0.2, s),
            angular: Vector3::z(),
        },
        measured_tip: step.is_multiple_of(3).then(|| shape(step).tip),
        target: Position::new(Point3::new(0.01, 0.02, 0.5)),
        lateral_error: if step == 0 { f64::NAN } else { 1e-3 / s },
        axial_distance: 0.08,
        depth: 1e-3 * s,
        law: LawReport {
            mode: SteeringMode::DutyCycleInsert,
            heading_error: 0.1,
            bevel_error: 0.2,
            duty_cycle: f64::NAN,
            predicted_miss: Vector2::new(1e-4, -2e-4),
            shortfall: 0.3,
            base_authority: 0.4,
            bevel_authority: 0.5,
            limits: vec![Limit::JointJerk(5), Limit::RemainingTurns],
        },
        model: ModelReport {
            shape: line(30, 0.1),
            spring_points: line(4, 0.2),
            rest_points: line(4, 0.3),
            predicted_path: line(2, 0.4),
            stiffness: 22_200.0,
            stiffness_sigma: 0.11,
            mean_stretch: 1e-3,
            max_stretch: 2e-3,
            entry_stretch: 3e-3,
            entry_force: 0.7,
            iterations: 9,
            residual: 1e-12,
            shaft_off: 0.0,
            path_off: 0.0,
        },
        truth: step.is_multiple_of(2).then(|| TruthReport {
            stamp: Stamp::from_nanos(step * 11),
            shape: line(5, 0.6),
            tip: Vector3::x(),
            direction: Vector3::y(),
            target: Vector3::z(),
            lateral_error: 0.1,
            axial_distance: 0.2,
            max_stretch: 0.3,
            mean_stretch: 0.4,
            ..TruthReport::default()
        }),
    }
}

fn shape(sequence: u64) -> SensedShape {
    let x = sequence as f64 / 3.0;
    SensedShape {
        stamp: Stamp::from_nanos(sequence * 7),
        sequence,
        points: vec![
            SensedPoint {
                position: Position::new(Point3::new(x, 0.2, 0.3)),
                sigma: 1e-5
            };
            12
        ],
        tip: SensedTip {
            position: Position::new(Point3::new(0.1, x, 0.3)),
            covariance: Matrix3::from_fn(|i, j| 1e-9 * (3.0 * i as f64 + j as f64)),
            direction: Unit::new_normalize(Vector3::new(0.1, 0.2, x + 1.0)),
            direction_sigma: 1e-3,
        },
    }
}

fn stereo(sequence: u64, width: usize) -> StereoFrame {
    let frame = |shade: u8| {
        let pixels = (0..width * 3)
            .map(|i| u8::try_from(i % 251).unwrap() ^ shade)
            .collect();
        CameraFrame {
            stamp: Stamp::from_nanos(sequence * 33_333_333),
            sequence,
            image: GrayImage::from_pixels(width, 3, pixels).unwrap().into(),
        }
    };
    StereoFrame {
        left: frame(0),
        right: frame(0x55),
    }
}

fn arm(i: u64) -> ArmState {
    ArmState {
        stamp: Stamp::from_nanos(u64::from(u32::MAX) * 1_000_000_000 + i),
        positions: Joints::from([0.1, 0.2, 0.3, 0.4, 0.5, i as f64 / 3.0]),
        rates: Joints::from([1.1, 1.2, 1.3, 1.4, 1.5, 1.6]),
        mode: ArmMode::Moving,
    }
}

fn run_info() -> RunInfo {
    RunInfo {
        config: "law = \"hybrid\" # with µ and \"quotes\"\n".to_owned(),
        seed: u64::MAX,
        versions: [("needle-steer".to_owned(), "0.1.0".to_owned())].into(),
        labels: [("law".to_owned(), "hybrid".to_owned())].into(),
        began: Some(Duration::from_nanos(1_700_000_000_123_456_789)),
        joint_names: vec!["joint_1".to_owned(), "joint_2".to_owned()],
        world_from_left_camera: Transform::<World, LeftCamera>::assume(Isometry3::new(
            Vector3::new(0.1, -1.0 / 3.0, 1e-9),
            Vector3::new(0.3, 2.0, 0.1),
        )),
    }
}

fn records(steps: u64) -> Vec<Record> {
    let mut records = Vec::new();
    for i in 0..steps {
        records.push(arm(i).into());
        records.push(shape(i).into());
        records.push(stereo(i, 8).into());
        records.push(telemetry(i).into());
        let command = RateCommand {
            sequence: u64::MAX - i,
            stamp: Stamp::from_nanos(i),
            rates: Joints::from([0.1; 7]),
        };
        records.push(command.into());
    }
    records.push(Record::Note {
        stamp: Stamp::from_secs(1.5),
        level: Level::Error,
        text: "the tip is lost".to_owned(),
    });
    records.push(Record::Document {
        name: "result.json".to_owned(),
        text: "{}".to_owned(),
    });
    records
}

/// Equality bit by bit where floats may be NaN.
fn same(a: &Record, b: &Record) -> bool {
    match (a, b) {
        (Record::Step(a), Record::Step(b)) => same_step(a, b),
        _ => a == b,
    }
}

/// A log with a flush after every `per_chunk` records.
fn written(records: &[Record], per_chunk: usize, finish: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = LogWriter::new(&mut bytes, &run_info(), Scenery::default()).unwrap();
    for chunk in records.chunks(per_chunk) {
        for record in chunk {
            writer.write(record).unwrap();
        }
        writer.flush().unwrap();
    }
    if finish {
        writer.finish().unwrap();
    } else {
        std::mem::forget(writer);
    }
    bytes
}

#[test]
fn everything_reads_back_bit_by_bit() {
    let records = records(7);
    let bytes = written(&records, 10, true);
    let mut reader = LogReader::new(bytes.as_slice()).unwrap();
    assert_eq!(*reader.run(), run_info());
    let back: Vec<Record> = reader.by_ref().map(Result::unwrap).collect();
    assert!(reader.is_complete());
    assert_eq!(back.len(), records.len());
    for (a, b) in records.iter().zip(&back) {
        assert!(same(a, b), "{a:?}\n{b:?}");
    }
}

#[test]
fn same_step_sees_the_last_bit_and_accepts_nan() {
    let (a, mut b) = (telemetry(0), telemetry(0));
    assert!(a.lateral_error.is_nan() && same_step(&a, &b));
    b.depth = -0.0;
    assert!(!same_step(&a, &b));
}

/// A file cut anywhere reads as a prefix of its records, without an error.
#[test]
fn cut_anywhere_the_rest_is_readable() {
    let records = records(3);
    let bytes = written(&records, 4, true);
    let mut most = 0;
    for length in 0..bytes.len() {
        let Ok(mut reader) = LogReader::new(&bytes[..length]) else {
            assert_eq!(most, 0, "unreadable at {length}");
            continue;
        };
        let back: Vec<Record> = reader.by_ref().map(Result::unwrap).collect();
        assert!(back.iter().zip(&records).all(|(a, b)| same(a, b)));
        assert!(back.len() >= most, "a longer file holds no less");
        most = back.len();
    }
    assert_eq!(most, records.len());
}

/// What was flushed is in the sink, even if the writer never gets further.
#[test]
fn flushed_records_survive_a_kill() {
    let records = records(5);
    let bytes = written(&records, records.len(), false);
    let mut reader = LogReader::new(bytes.as_slice()).unwrap();
    assert_eq!(reader.by_ref().map(Result::unwrap).count(), records.len());
    assert!(!reader.is_complete());
}

/// The schemas are what viewers expect: complete ROS 1 definitions on ROS 1 channels.
#[test]
fn viewers_find_ros1_channels_with_definitions() {
    let bytes = written(&records(2), 100, true);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.channels.len(), topic::TOPICS.len());
    for channel in summary.channels.values() {
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!(
            (schema.encoding.as_str(), channel.message_encoding.as_str()),
            ("ros1msg", "ros1")
        );
        assert!(schema.name.contains('/') && !schema.data.is_empty());
    }
    // Two steps of 6 measurements and decisions and 3 drawings; besides one set of markers (10 Hz),
    // one static tree, one note.
    assert_eq!(
        summary.stats.unwrap().message_count,
        2 * (6 + 3) + 1 + 1 + 1
    );
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Damage gives an error or fewer records, never a panic, a hang or an invented step.
    #[test]
    fn damage_is_noticed(at in any::<prop::sample::Index>(), bit in 0..8_u32) {
        let records = records(2);
        let mut bytes = written(&records, 3, true);
        let index = at.index(bytes.len());
        bytes[index] ^= 1 << bit;
        if let Ok(reader) = LogReader::new(bytes.as_slice()) {
            for record in reader.map_while(Result::ok) {
                if let Record::Step(step) = record {
                    prop_assert!(same_step(&step, &telemetry(step.step)));
                }
            }
        }
    }
}

#[test]
fn thread_writes_while_the_run_goes_on_and_completes_on_drop() {
    let folder = std::env::temp_dir().join(format!("rosbridge-log-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("run.mcap");
    let records = records(40);
    let mut log = Log::create(&path, &run_info(), Overflow::Wait).unwrap();
    assert_eq!(LogReader::open(&path).unwrap().count(), 0);
    for record in &records {
        log.write(record.clone()).unwrap();
    }
    // A reader finds them while the log is still open: what a kill would leave.
    let mut found = 0;
    for _ in 0..400 {
        found = LogReader::open(&path).unwrap().map(Result::unwrap).count();
        if found == records.len() {
            break;
        }
        std::thread::park_timeout(std::time::Duration::from_millis(25));
    }
    assert_eq!(found, records.len());
    let written = log.finish().unwrap();
    assert_eq!(
        written,
        Written {
            records: records.len() as u64,
            dropped: 0
        }
    );
    let mut reader = LogReader::open(&path).unwrap();
    assert_eq!(reader.by_ref().count(), records.len());
    assert!(reader.is_complete());

    drop(Log::create(&path, &run_info(), Overflow::Drop).unwrap());
    let mut reader = LogReader::open(&path).unwrap();
    assert_eq!(reader.by_ref().count(), 0);
    assert!(reader.is_complete());
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A full disk is reported once with its reason; then the log has stopped.
#[test]
fn full_disk_is_reported() {
    let full = std::path::Path::new("/dev/full");
    if !full.exists() {
        return;
    }
    let error = Log::create(full, &run_info(), Overflow::Wait).unwrap_err();
    assert!(matches!(error, WriteError::Mcap(_)), "{error}");
}
