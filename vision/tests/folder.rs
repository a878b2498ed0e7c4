//! Folders of images as a stereo camera.
#![expect(clippy::unwrap_used, reason = "a failed step is a failed test")]

use std::path::{Path, PathBuf};

use hal::{Stamp, StereoCamera};
use vision::files::{FolderError, ImageFolder};

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).unwrap();
    }
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// A PGM of one grey value.
fn pgm(path: &Path, width: usize, grey: u8) {
    let mut bytes = format!("P5\n{width} 4\n255\n").into_bytes();
    bytes.resize(bytes.len() + 4 * width, grey);
    std::fs::write(path, bytes).unwrap();
}

fn at(nanoseconds: u64) -> Stamp {
    Stamp::from_nanos(nanoseconds)
}

#[test]
fn names_with_stamps_are_played_by_time_and_late_pairs_skipped() {
    let folder = folder("folder-names");
    for (k, ns) in (0_u8..).zip([900_u64, 1000, 1100, 1200]) {
        pgm(&folder.join(format!("left_{ns}.pgm")), 6, 10 * k);
        pgm(&folder.join(format!("right-{}.pgm", ns + 7)), 6, 10 * k + 1);
    }
    std::fs::write(folder.join("notes.txt"), "ignored").unwrap();
    let mut source = ImageFolder::open(&folder).unwrap();
    assert_eq!((source.len(), source.size()), (4, (6, 4)));
    assert_eq!(source.poll().unwrap(), None, "no time was set");
    assert_eq!(source.next_stamp(), Some(at(907)));
    source.advance_to(at(906));
    assert_eq!(
        source.poll().unwrap(),
        None,
        "the right image is not taken yet"
    );
    source.advance_to(at(907));
    let first = source.poll().unwrap().unwrap();
    assert_eq!((first.left.stamp, first.right.stamp), (at(900), at(907)));
    assert_eq!(
        (first.left.image.pixels()[0], first.right.image.pixels()[0]),
        (0, 1)
    );
    assert_eq!(source.poll().unwrap(), None, "a pair is returned once");
    // 1000 is skipped: 1100 is newer.
    source.advance_to(at(1150));
    let third = source.poll().unwrap().unwrap();
    assert_eq!((third.left.sequence, third.left.stamp), (2, at(1100)));
    source.advance_to(at(9999));
    assert_eq!(source.poll().unwrap().unwrap().right.sequence, 3);
    assert_eq!((source.poll().unwrap(), source.next_stamp()), (None, None));
}

#[test]
fn a_table_names_files_and_stamps() {
    let folder = folder("folder-table");
    for k in 0..2 {
        pgm(&folder.join(format!("left{k}.pgm")), 5, k);
        pgm(&folder.join(format!("right{k}.pgm")), 5, k + 100);
    }
    let table = folder.join("stamps.csv");
    let write = |text: &str| std::fs::write(&table, text).unwrap();
    write("left,right,left_ns,right_ns\nleft0.pgm,right0.pgm,5,6\nleft1.pgm,right1.pgm,50,60\n");
    let mut source = ImageFolder::open(&folder).unwrap();
    source.advance_to(at(60));
    let pair = source.poll().unwrap().unwrap();
    assert_eq!(
        (pair.right.image.pixels()[0], pair.right.stamp),
        (101, at(60))
    );

    let said = |text: &str| {
        write(text);
        ImageFolder::open(&folder).unwrap_err().to_string()
    };
    assert!(said("left,right,ns\n").contains("stamps.csv, line 1"));
    assert!(said("left,right,left_ns,right_ns\n").contains("a pair of images"));
    assert!(said("left,right,left_ns,right_ns\nleft0.pgm,right0.pgm,5\n").contains("line 2"));
    assert!(
        said("left,right,left_ns,right_ns\nleft0.pgm,right0.pgm,5,6.5\n").contains("nanoseconds")
    );
    let gone = said("left,right,left_ns,right_ns\nleft0.pgm,gone.pgm,5,6\n");
    assert!(gone.contains("gone.pgm"), "{gone}");
    let order =
        said("left,right,left_ns,right_ns\nleft0.pgm,right0.pgm,5,6\nleft1.pgm,right1.pgm,50,6\n");
    assert!(order.contains("right1.pgm: not later"), "{order}");
}

#[test]
fn folders_that_hold_no_sequence_are_refused_by_name() {
    let folder = folder("folder-bad");
    let open = || ImageFolder::open(&folder).unwrap_err();
    assert!(matches!(open(), FolderError::Empty { .. }));
    pgm(&folder.join("left_10.pgm"), 5, 0);
    assert!(matches!(
        open(),
        FolderError::Unpaired {
            left: 1,
            right: 0,
            ..
        }
    ));
    pgm(&folder.join("right_10.pgm"), 6, 0);
    let error = open().to_string();
    assert!(error.contains("right_10.pgm: 6 x 4 pixels"), "{error}");
    pgm(&folder.join("left_b.pgm"), 5, 0);
    assert!(
        open()
            .to_string()
            .contains("left_b.pgm: the name holds no time stamp")
    );
    let nowhere = ImageFolder::open(&folder.join("nowhere"))
        .unwrap_err()
        .to_string();
    assert!(nowhere.contains("nowhere"), "{nowhere}");
}

#[test]
fn an_image_that_became_unreadable_is_a_device_error_with_its_cause() {
    let folder = folder("folder-torn");
    pgm(&folder.join("left_10.pgm"), 5, 0);
    pgm(&folder.join("right_10.pgm"), 5, 0);
    let mut source = ImageFolder::open(&folder).unwrap();
    std::fs::remove_file(folder.join("right_10.pgm")).unwrap();
    source.advance_to(at(10));
    let error = source.poll().unwrap_err();
    let cause = error.source.unwrap().to_string();
    assert!(error.device.contains("folder-torn") && cause.contains("right_10.pgm"));
}
