//! What a file is, by its first bytes.

/// First bytes that suffice to recognise a file.
pub(super) const HEAD: usize = 16;

/// A kind of file that users hand over as a log or as a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// An MCAP file.
    Mcap,
    /// A ROS 1 bag.
    Bag,
    /// An SQLite database: the storage of most ROS 2 bags.
    Sqlite,
    /// A folder: a ROS 2 bag, or the folder of a run.
    Folder,
    /// A file compressed as a whole, by the program named.
    Compressed(&'static str),
    /// A ZIP archive: a spreadsheet's own format is one.
    Zip,
    /// HDF5, the format of newer MATLAB files.
    Hdf5,
    /// An older MATLAB file.
    Matlab,
    /// A file without content.
    Empty,
    /// Text: perhaps a table.
    Text,
    /// Something else.
    Binary,
}

impl FileKind {
    /// Recognises a file by its first bytes (16 suffice).
    pub fn of(head: &[u8]) -> Self {
        const SIGNATURES: [(&[u8], FileKind); 12] = [
            (b"\x89MCAP", FileKind::Mcap),
            (b"#ROSBAG", FileKind::Bag),
            (b"SQLite format 3", FileKind::Sqlite),
            (b"\x1f\x8b", FileKind::Compressed("gzip")),
            (b"\x28\xb5\x2f\xfd", FileKind::Compressed("zstd")),
            (b"\x04\x22\x4d\x18", FileKind::Compressed("lz4")),
            (b"\xfd7zXZ", FileKind::Compressed("xz")),
            (b"BZh", FileKind::Compressed("bzip2")),
            (b"PK\x03\x04", FileKind::Zip),
            (b"\x89HDF", FileKind::Hdf5),
            (b"MATLAB 7.3", FileKind::Hdf5),
            (b"MATLAB 5.0", FileKind::Matlab),
        ];
        let known = SIGNATURES
            .iter()
            .find(|(signature, _)| head.starts_with(signature));
        let marked = head.starts_with(b"\xff\xfe") || head.starts_with(b"\xfe\xff");
        let utf16 = marked || is_bare_utf16(head);
        match known {
            Some((_, kind)) => *kind,
            None if head.is_empty() => Self::Empty,
            None if mcap::MAGIC.starts_with(head) => Self::Mcap,
            None if utf16 || !head.iter().any(|byte| is_control(*byte)) => Self::Text,
            None => Self::Binary,
        }
    }

    /// What it is, in words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mcap => "an MCAP file",
            Self::Bag => "a ROS 1 bag",
            Self::Sqlite => "an SQLite database, as ROS 2 bags are (.db3)",
            Self::Folder => "a folder",
            Self::Compressed(_) => "a compressed file",
            Self::Zip => "a ZIP archive, as spreadsheets are (.xlsx)",
            Self::Hdf5 | Self::Matlab => "a MATLAB or HDF5 file",
            Self::Empty => "an empty file",
            Self::Text => "a text file",
            Self::Binary => "a file of an unknown kind",
        }
    }

    /// What makes a log or a table of it.
    pub fn remedy(self) -> String {
        let table = "a CSV table of its poses is read by `estimate` (docs/LOGS.md)";
        match self {
            Self::Bag => format!(
                "`mcap convert` makes an MCAP file of a bag, but logs (run.mcap) also hold the run's configuration; {table}"
            ),
            Self::Sqlite => format!(
                "`ros2 bag convert` makes an MCAP file of a bag, but logs (run.mcap) also hold the run's configuration; {table}"
            ),
            Self::Folder => "give the file in it: run.mcap, or a CSV table".to_owned(),
            Self::Compressed(program) => format!("decompress it with `{program} -d`"),
            Self::Zip => "save the sheet as CSV".to_owned(),
            Self::Hdf5 | Self::Matlab => "write its table as CSV (docs/LOGS.md)".to_owned(),
            Self::Empty => "nothing was written to it: record again".to_owned(),
            Self::Text => format!("logs are MCAP files (run.mcap); {table}"),
            Self::Mcap | Self::Binary => {
                "logs are MCAP files (run.mcap), tables are text (docs/LOGS.md)".to_owned()
            }
        }
    }
}

/// Latin letters in UTF-16 without a byte-order mark: every other byte is zero.
fn is_bare_utf16(head: &[u8]) -> bool {
    let pairs = head.as_chunks::<2>().0;
    let text = |letter: usize| {
        let other = 1 - letter;
        let is_letter = |pair: &[u8; 2]| pair[other] == 0 && !is_control(pair[letter]);
        pairs.len() > 1 && pairs.iter().all(is_letter)
    };
    text(0) || text(1)
}

/// Bytes that no text holds.
const fn is_control(byte: u8) -> bool {
    byte < b' ' && !matches!(byte, b'\t' | b'\n' | b'\r' | 0x0c)
}
