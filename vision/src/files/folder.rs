//! Recorded pairs of images in a folder, as a stereo camera.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use hal::{CameraFrame, Error, ErrorKind, Stamp, StereoCamera, StereoFrame};

use super::{FileError, read_image, same_size};

/// Table of time stamps in a folder of images.
const STAMPS: &str = "stamps.csv";
/// Its first line.
const HEADER: &str = "left,right,left_ns,right_ns";
/// Endings of image files.
const ENDINGS: [&str; 9] = [
    "png", "jpg", "jpeg", "pgm", "pnm", "bmp", "tif", "tiff", "webp",
];

/// A folder that holds no sequence of pairs.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// Folder or file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// No images are there.
    #[error("{}: no images `left*` and `right*` (PNG, JPEG, PGM, BMP, TIFF, WebP)", folder.display())]
    Empty {
        /// The folder.
        folder: PathBuf,
    },
    /// Images of one camera are missing.
    #[error("{}: {left} left images, {right} right: every pair needs both", folder.display())]
    Unpaired {
        /// The folder.
        folder: PathBuf,
        /// Number of left images.
        left: usize,
        /// Number of right images.
        right: usize,
    },
    /// Without a table of stamps, names must hold them.
    #[error(
        "{}: the name holds no time stamp: expected nanoseconds after `{side}`, as in \
         `{side}_1700000000033333333.png`, or a file {STAMPS} in the folder",
        path.display()
    )]
    Name {
        /// The image.
        path: PathBuf,
        /// `left` or `right`.
        side: &'static str,
    },
    /// A line of the table is wrong.
    #[error("{}, line {line}: expected {expected}", path.display())]
    Stamps {
        /// The table.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What should be there.
        expected: &'static str,
    },
    /// Stamps that do not grow.
    #[error("{}: not later than the image before it", path.display())]
    Order {
        /// The image.
        path: PathBuf,
    },
    /// An image cannot be read or differs in size.
    #[error(transparent)]
    Image(#[from] FileError),
}

/// One pair on disk.
#[derive(Clone, Debug)]
struct Recorded {
    files: [PathBuf; 2],
    stamps: [Stamp; 2],
}

/// Pairs of images in a folder, played back by their time stamps.
///
/// The folder holds images of equal size whose names begin with `left` and `right` (PNG, JPEG,
/// PGM, BMP, TIFF, WebP). Time stamps, in nanoseconds on one clock, either follow in the names
/// (`left_1700000000033333333.png`; both cameras' images are then paired in the order of their
/// stamps), or stand in `stamps.csv`, which then also names the files:
///
/// ```text
/// left,right,left_ns,right_ns
/// left_000.png,right_000.png,0,12000
/// left_001.png,right_001.png,33333333,33345333
/// ```
///
/// Images stay on disk until they are asked for; [`StereoCamera::poll`] reads them.
#[derive(Clone, Debug)]
pub struct ImageFolder {
    folder: PathBuf,
    pairs: Vec<Recorded>,
    size: (usize, usize),
    next: usize,
    now: Option<Stamp>,
}

impl ImageFolder {
    /// Lists the pairs of `folder` and checks names, stamps and sizes.
    ///
    /// # Errors
    /// The folder or its table cannot be read, images are missing or of different sizes, stamps
    /// are missing or do not grow.
    pub fn open(folder: &Path) -> Result<Self, FolderError> {
        let table = folder.join(STAMPS);
        let pairs = if table.exists() {
            from_table(folder, &table)?
        } else {
            from_names(folder)?
        };
        for pair in pairs.windows(2) {
            if let [before, after] = pair
                && let Some(k) = (0..2).find(|k| after.stamps[*k] <= before.stamps[*k])
            {
                return Err(FolderError::Order {
                    path: after.files[k].clone(),
                });
            }
        }
        let size = same_size(pairs.iter().flat_map(|pair| &pair.files))?;
        Ok(Self {
            folder: folder.to_owned(),
            pairs,
            size,
            next: 0,
            now: None,
        })
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there are no pairs; [`ImageFolder::open`] refuses such folders.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Width and height of the images \[px\].
    pub const fn size(&self) -> (usize, usize) {
        self.size
    }

    /// When both images of the next pair have been taken; nothing at the end.
    pub fn next_stamp(&self) -> Option<Stamp> {
        self.pairs
            .get(self.next)
            .map(|pair| pair.stamps[0].max(pair.stamps[1]))
    }

    /// Sets the time: pairs taken until `now` can be polled.
    pub fn advance_to(&mut self, now: Stamp) {
        self.now = Some(now);
    }
}

impl StereoCamera for ImageFolder {
    /// The newest pair taken until the time set by [`ImageFolder::advance_to`]; its sequence
    /// number is its place in the folder.
    fn poll(&mut self) -> Result<Option<StereoFrame>, Error> {
        let waiting = self.pairs.get(self.next..).unwrap_or_default();
        let taken = waiting
            .iter()
            .take_while(|pair| {
                self.now
                    .is_some_and(|now| pair.stamps.iter().all(|s| *s <= now))
            })
            .count();
        let Some(index) = (self.next + taken).checked_sub(1).filter(|_| taken > 0) else {
            return Ok(None);
        };
        self.next = index + 1;
        let Some(pair) = self.pairs.get(index) else {
            return Ok(None);
        };
        let frame = |k: usize| -> Result<CameraFrame, Error> {
            let image = read_image(&pair.files[k]).map_err(|source| Error {
                device: format!("image folder {}", self.folder.display()),
                kind: ErrorKind::Protocol,
                source: Some(Box::new(source)),
            })?;
            Ok(CameraFrame {
                stamp: pair.stamps[k],
                sequence: index as u64,
                image: Arc::new(image),
            })
        };
        Ok(Some(StereoFrame {
            left: frame(0)?,
            right: frame(1)?,
        }))
    }
}

/// Pairs as `stamps.csv` names them.
fn from_table(folder: &Path, table: &Path) -> Result<Vec<Recorded>, FolderError> {
    let text = fs::read_to_string(table).map_err(|source| FolderError::Io {
        path: table.to_owned(),
        source,
    })?;
    let wrong = |line: usize, expected: &'static str| FolderError::Stamps {
        path: table.to_owned(),
        line,
        expected,
    };
    let mut lines = text.lines().enumerate();
    if lines.next().is_none_or(|(_, first)| first.trim() != HEADER) {
        return Err(wrong(1, HEADER));
    }
    let mut pairs = Vec::new();
    for (k, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let [left, right, left_ns, right_ns] = fields[..] else {
            return Err(wrong(k + 1, "four fields: left,right,left_ns,right_ns"));
        };
        let stamp = |text: &str| {
            let nanoseconds = text
                .parse()
                .map_err(|_| wrong(k + 1, "whole nanoseconds"))?;
            Ok::<_, FolderError>(Stamp::from_nanos(nanoseconds))
        };
        pairs.push(Recorded {
            files: [folder.join(left), folder.join(right)],
            stamps: [stamp(left_ns)?, stamp(right_ns)?],
        });
    }
    if pairs.is_empty() {
        return Err(wrong(2, "a pair of images"));
    }
    Ok(pairs)
}

/// Pairs by the stamps in the images' names.
fn from_names(folder: &Path) -> Result<Vec<Recorded>, FolderError> {
    let refused = |source| FolderError::Io {
        path: folder.to_owned(),
        source,
    };
    let mut sides: [Vec<(Stamp, PathBuf)>; 2] = [Vec::new(), Vec::new()];
    for entry in fs::read_dir(folder).map_err(refused)? {
        let path = entry.map_err(refused)?.path();
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        if !ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str())) {
            continue;
        }
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned());
        for (side, found) in ["left", "right"].into_iter().zip(&mut sides) {
            let Some(rest) = stem.as_deref().and_then(|stem| stem.strip_prefix(side)) else {
                continue;
            };
            let Ok(nanoseconds) = rest.trim_start_matches(['_', '-', '.']).parse() else {
                return Err(FolderError::Name { path, side });
            };
            found.push((Stamp::from_nanos(nanoseconds), path.clone()));
        }
    }
    let [mut left, mut right] = sides;
    if left.is_empty() && right.is_empty() {
        return Err(FolderError::Empty {
            folder: folder.to_owned(),
        });
    }
    if left.len() != right.len() {
        return Err(FolderError::Unpaired {
            folder: folder.to_owned(),
            left: left.len(),
            right: right.len(),
        });
    }
    left.sort();
    right.sort();
    let pairs = left.into_iter().zip(right);
    Ok(pairs
        .map(|((left_stamp, left), (right_stamp, right))| Recorded {
            files: [left, right],
            stamps: [left_stamp, right_stamp],
        })
        .collect())
}
