//! Logs that went through other tools, and files that are no logs.

use std::io::Write as _;

use mcap::records::op;

use super::*;

const PREFIX: usize = 9;

/// The records of an MCAP file: opcode and content.
fn raw_records(file: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let mut rest = &file[8..];
    let mut found = Vec::new();
    while rest.len() > PREFIX {
        let length = u64::from_le_bytes(rest[1..PREFIX].try_into().unwrap());
        let end = PREFIX + usize::try_from(length).unwrap();
        found.push((rest[0], rest[PREFIX..end].to_vec()));
        rest = &rest[end..];
    }
    found
}

fn file(records: &[(u8, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = mcap::MAGIC.to_vec();
    for (opcode, content) in records {
        bytes.push(*opcode);
        bytes.extend((content.len() as u64).to_le_bytes());
        bytes.extend(content);
    }
    bytes.extend(mcap::MAGIC);
    bytes
}

/// The same log with compressed chunks, as `mcap compress` writes it.
fn recompressed(log: &[u8], compression: &str) -> Vec<u8> {
    let mut records = raw_records(log);
    for (opcode, content) in &mut records {
        if *opcode != op::CHUNK {
            continue;
        }
        // Times, size and checksum; an empty name; the length of the records; the records.
        let (head, data) = (&content[..28], &content[40..]);
        let packed = pack(data, compression);
        let name = u32::try_from(compression.len()).unwrap().to_le_bytes();
        let length = (packed.len() as u64).to_le_bytes();
        *content = [head, &name, compression.as_bytes(), &length, &packed].concat();
    }
    file(&records)
}

fn pack(data: &[u8], compression: &str) -> Vec<u8> {
    match compression {
        "zstd" => {
            // Two frames, a skippable one between them.
            let level = ruzstd::encoding::CompressionLevel::Fastest;
            let (first, second) = data.split_at(data.len() / 2);
            let mut packed = ruzstd::encoding::compress_to_vec(first, level);
            packed.extend(0x184d_2a50_u32.to_le_bytes());
            packed.extend(3_u32.to_le_bytes());
            packed.extend([1, 2, 3]);
            packed.extend(ruzstd::encoding::compress_to_vec(second, level));
            packed
        }
        "lz4" => {
            let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
            encoder.write_all(data).unwrap();
            encoder.finish().unwrap()
        }
        _ => data.to_vec(),
    }
}

#[test]
fn compressed_logs_read_as_they_were_written() {
    let records = records(40);
    let bytes = written(&records, 7, true);
    for compression in ["zstd", "lz4"] {
        let packed = recompressed(&bytes, compression);
        assert!(packed.len() < bytes.len(), "{compression} saves nothing");
        let mut reader = LogReader::new(packed.as_slice()).unwrap();
        let back: Vec<Record> = reader.by_ref().map(Result::unwrap).collect();
        assert!(reader.is_complete());
        assert_eq!(back.len(), records.len());
        assert!(records.iter().zip(&back).all(|(a, b)| same(a, b)));
    }
}

/// Chunks that unfold to far more than they say, or say far more than anyone has: as little is
/// unfolded as shows it.
#[test]
fn a_bomb_is_refused_where_it_stands() {
    const UNFOLDED: usize = 16 << 20;
    let log = written(&records(3), 7, true);
    for compression in ["zstd", "lz4"] {
        let packed = pack(&vec![0; UNFOLDED], compression);
        assert!(100 * packed.len() < UNFOLDED, "{compression}");
        for (declared, expected) in [
            (1000, "holds 1001 bytes, not 1000"),
            (UNFOLDED as u64 + 1, "not 16777217"),
            (u64::MAX, "claims 18446744073709551615 bytes"),
        ] {
            let mut records = raw_records(&recompressed(&log, compression));
            for (_, content) in records.iter_mut().filter(|(o, _)| *o == op::CHUNK) {
                content.truncate(32 + compression.len());
                content[16..24].copy_from_slice(&u64::to_le_bytes(declared));
                content.extend((packed.len() as u64).to_le_bytes());
                content.extend(&packed);
            }
            let bytes = file(&records);
            let error = LogReader::new(bytes.as_slice())
                .and_then(|mut reader| reader.find_map(Result::err).map_or(Ok(()), Err))
                .unwrap_err()
                .to_string();
            for part in ["at byte", expected, "mcap recover"] {
                assert!(error.contains(part), "{compression}: {error}");
            }
        }
    }
}

#[test]
fn an_unknown_compression_is_named_with_the_remedy() {
    let bytes = recompressed(&written(&records(2), 7, true), "snappy");
    let error = LogReader::new(bytes.as_slice())
        .map(|mut reader| reader.find_map(Result::err).unwrap())
        .unwrap();
    let text = error.to_string();
    assert!(
        text.contains("`snappy`") && text.contains("mcap compress"),
        "{text}"
    );
}

/// Tools that rewrite a log may put the metadata behind the messages.
#[test]
fn the_description_of_the_run_may_stand_at_the_end() {
    let records = records(5);
    let mut raw = raw_records(&written(&records, 7, true));
    let metadata: Vec<_> = raw.extract_if(.., |(o, _)| *o == op::METADATA).collect();
    let end = raw.iter().position(|(o, _)| *o == op::DATA_END).unwrap();
    raw.splice(end..end, metadata);
    let bytes = file(&raw);
    let mut reader = LogReader::new(bytes.as_slice()).unwrap();
    assert_eq!(*reader.run(), run_info());
    let back: Vec<Record> = reader.by_ref().map(Result::unwrap).collect();
    let steps = |all: &[Record]| all.iter().filter(|r| matches!(r, Record::Step(_))).count();
    assert_eq!((back.len(), steps(&back)), (records.len(), 5));
}

#[test]
fn a_damaged_chunk_is_placed_by_its_offset() {
    let bytes = written(&records(20), 7, true);
    for compression in ["", "zstd", "lz4"] {
        let mut bytes = recompressed(&bytes, compression);
        let at = bytes.len() / 2;
        bytes[at] ^= 0x40;
        let error = LogReader::new(bytes.as_slice())
            .map(|mut reader| reader.find_map(Result::err).unwrap())
            .unwrap();
        let text = error.to_string();
        let Some(offset) = text.split("at byte ").nth(1) else {
            panic!("{text}");
        };
        let offset: usize = offset.split(':').next().unwrap().parse().unwrap();
        assert_eq!(bytes[offset], op::CHUNK, "{text}");
        assert!(offset < at && text.contains("mcap recover"), "{text}");
    }
}

#[test]
fn files_that_are_no_logs_are_called_by_their_name() {
    let cases: [(&[u8], &str, &str); 9] = [
        (b"#ROSBAG V2.0\n\x10\0\0\0", "a ROS 1 bag", "mcap convert"),
        (
            b"SQLite format 3\0\0\0\0\0",
            "ROS 2 bags",
            "ros2 bag convert",
        ),
        (b"\x1f\x8b\x08\0\0\0\0\0", "compressed", "gzip -d"),
        (b"\x28\xb5\x2f\xfd\0\0\0\0", "compressed", "zstd -d"),
        (b"PK\x03\x04\x14\0\0\0", ".xlsx", "CSV"),
        (b"[run]\nseed = 1\n", "a text file", "run.mcap"),
        (b"", "an empty file", "record again"),
        (b"\x89MCA", "an MCAP file", "docs/LOGS.md"),
        (b"\0\x01\x02\x03", "unknown kind", "MCAP"),
    ];
    for (bytes, name, remedy) in cases {
        let text = LogReader::new(bytes).unwrap_err().to_string();
        assert!(text.contains(name) && text.contains(remedy), "{text}");
    }
    let folder = LogReader::open(&std::env::temp_dir()).unwrap_err();
    assert!(folder.to_string().contains("a folder"), "{folder}");
    let missing = LogReader::open(std::path::Path::new("/nonexistent/run.mcap")).unwrap_err();
    assert!(missing.to_string().contains("/nonexistent/run.mcap"));
}

#[test]
fn an_mcap_file_of_something_else_is_no_run() {
    let mut other = std::io::Cursor::new(Vec::new());
    mcap::Writer::new(&mut other).unwrap().finish().unwrap();
    let error = LogReader::new(other.get_ref().as_slice()).unwrap_err();
    assert!(matches!(error, ReadError::NotARun { .. }), "{error}");
    assert!(error.to_string().contains("docs/LOGS.md"), "{error}");
}

/// Draws from a fixed seed (SplitMix64).
struct Draws(u64);

impl Draws {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        usize::try_from((z ^ (z >> 31)) >> 1).unwrap() % bound
    }
}

/// One to four changes: bits turned, bytes overwritten, cut out, doubled or added.
fn mutated(bytes: &[u8], draws: &mut Draws) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=draws.below(4) {
        let at = draws.below(bytes.len());
        let end = (at + 1 + draws.below(40)).min(bytes.len());
        match draws.below(6) {
            0 => bytes[at] ^= 1 << draws.below(8),
            1 => bytes[at..end].fill(u8::try_from(draws.below(256)).unwrap()),
            2 => drop(bytes.drain(at..end)),
            3 => bytes.extend_from_within(at..end),
            4 => {
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            _ => bytes.truncate(at.max(1)),
        }
        bytes.push(0);
    }
    bytes
}

/// Damage of any kind ends in fewer records or in one message that says where and what helps;
/// reading is bounded, since each step takes bytes from a finite file.
#[test]
fn a_thousand_mutated_logs_read_or_say_what_helps() {
    let records = records(6);
    let plain = written(&records, 9, true);
    let files = [
        plain.clone(),
        recompressed(&plain, "zstd"),
        recompressed(&plain, "lz4"),
    ];
    let mut draws = Draws(21);
    let (mut sound, mut refused) = (0, 0);
    for round in 0..1000 {
        let bytes = mutated(&files[round % 3], &mut draws);
        let end = LogReader::new(bytes.as_slice()).and_then(|reader| {
            for record in reader {
                if let Record::Step(step) = record? {
                    assert!(same_step(&step, &telemetry(step.step)), "an invented step");
                }
            }
            Ok(())
        });
        match end {
            Ok(()) => sound += 1,
            Err(error) => {
                refused += 1;
                let text = error.to_string();
                let place = ["at byte", "/", "first", "file"];
                let remedy = ["mcap ", "docs/LOGS.md", "record again", "the version that"];
                assert!(place.iter().any(|p| text.contains(p)), "{round}: {text}");
                assert!(remedy.iter().any(|r| text.contains(r)), "{round}: {text}");
            }
        }
    }
    assert!(
        sound > 100 && refused > 300,
        "{sound} read, {refused} refused"
    );
}
