//! Finding the parts of a calibration under the names that programs give them.

use std::path::{Path, PathBuf};

use nalgebra::DMatrix;

use super::node::{Node, plain};
use crate::files::FileError;

/// Names of the 3 x 3 camera matrix (and of Kalibr's list fx fy cx cy), as letters and digits.
pub(super) const MATRIX: &[&str] = &[
    "m",
    "k",
    "cameramatrix",
    "intrinsics",
    "intrinsic",
    "intrinsicmatrix",
    "intrinsicsmatrix",
    "cameraintrinsics",
    "camera",
    "cammatrix",
    "mtx",
    "cammat",
    "cameramat",
    "matrix",
    "mat",
    "cm",
];
/// Names of the distortion coefficients.
pub(super) const COEFFICIENTS: &[&str] = &[
    "d",
    "distcoeffs",
    "distcoeff",
    "distcoefs",
    "dist",
    "distortion",
    "distortioncoefficients",
    "distortioncoeffs",
    "distortionparameters",
    "distortionvector",
    "distcoefficients",
    "cameradistortion",
    "coeffs",
    "kc",
    "dc",
];
/// Names of a rectifying rotation.
pub(super) const RECTIFICATION: &[&str] = &["rectificationmatrix", "rectification", "rect", "r"];
/// Names of a projection matrix of 3 x 4.
pub(super) const PROJECTION: &[&str] = &["projectionmatrix", "projection", "p"];
/// Names of the rotation between the cameras.
pub(super) const ROTATION: &[&str] = &[
    "r",
    "rotation",
    "rotationmatrix",
    "rot",
    "rmat",
    "stereor",
    "rvec",
    "rotationvector",
    "om",
];
/// Names of the translation between the cameras.
pub(super) const TRANSLATION: &[&str] = &[
    "t",
    "translation",
    "translationvector",
    "trans",
    "tvec",
    "tvecs",
    "stereot",
];
/// Names of a transform of 4 x 4 that takes the left camera's coordinates to the right's.
pub(super) const TRANSFORM: &[&str] = &[
    "tcncnm1",
    "rightfromleft",
    "transform",
    "extrinsics",
    "extrinsic",
    "rt",
    "t",
];
/// Names of a transform of 4 x 4 that takes a camera's coordinates to a common body's.
pub(super) const BODY: &[&str] = &["tbs", "tbc"];
/// Names of the labels that say which lens model it is.
pub(super) const LABELS: &[&str] = &[
    "distortionmodel",
    "cameramodel",
    "modeltype",
    "cameratype",
    "lensmodel",
    "projectionmodel",
    "distortiontype",
    "model",
    "type",
];
/// Names of a switch that says that the lens is a fisheye.
pub(super) const FISHEYE: &[&str] = &["fisheye", "isfisheye", "fisheyemodel", "usefisheye"];

/// What stands before and after a name to say which camera is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::files) struct Affix(pub &'static str, pub &'static str);

/// No camera is named: the value counts for both, or the file holds one camera.
pub(in crate::files) const NEITHER: Affix = Affix("", "");

/// How files tell the left camera from the right.
pub(super) const SIDES: &[[Affix; 2]] = &[
    [Affix("", "1"), Affix("", "2")],
    [Affix("left", ""), Affix("right", "")],
    [Affix("", "left"), Affix("", "right")],
    [Affix("", "l"), Affix("", "r")],
    [Affix("l", ""), Affix("r", "")],
    [Affix("cam0", ""), Affix("cam1", "")],
    [Affix("", "0"), Affix("", "1")],
    [Affix("cam1", ""), Affix("cam2", "")],
    [Affix("camera0", ""), Affix("camera1", "")],
    [Affix("camera1", ""), Affix("camera2", "")],
    [Affix("camleft", ""), Affix("camright", "")],
    [Affix("cameraleft", ""), Affix("cameraright", "")],
    [Affix("leftcamera", ""), Affix("rightcamera", "")],
    [Affix("leftcam", ""), Affix("rightcam", "")],
    [Affix("stereoleft", ""), Affix("stereoright", "")],
];

/// All values of one or two files by their full names, groups of keys joined.
pub(in crate::files) struct Keys {
    files: Vec<PathBuf>,
    entries: Vec<Entry>,
}

/// A value, its file's place in the list, and its name.
struct Entry {
    file: usize,
    plain: String,
    name: String,
    node: Node,
}

/// A value under one of the names looked for.
#[derive(Clone, Copy)]
pub(in crate::files) struct Found<'a> {
    pub path: &'a Path,
    pub name: &'a str,
    pub node: &'a Node,
}

impl Found<'_> {
    /// The error that says what the key should hold.
    pub(in crate::files) fn wrong(&self, expected: &str) -> FileError {
        FileError::Key {
            path: self.path.to_owned(),
            key: self.name.to_owned(),
            expected: expected.to_owned(),
        }
    }

    /// Its matrix.
    pub(in crate::files) fn matrix(&self) -> Result<DMatrix<f64>, FileError> {
        self.node
            .matrix()
            .ok_or_else(|| self.wrong("a matrix: rows, cols, data of finite numbers"))
    }

    /// Its numbers, row by row.
    pub(in crate::files) fn numbers(&self) -> Result<Vec<f64>, FileError> {
        let m = self.matrix()?;
        Ok(m.transpose().as_slice().to_vec())
    }
}

impl Keys {
    /// The values of files; with `sides`, those of the first are the left camera's and those of
    /// the second the right one's.
    pub(in crate::files) fn new(documents: &[(&Path, Node)], sides: bool) -> Self {
        let mut keys = Self {
            files: documents.iter().map(|(p, _)| (*p).to_owned()).collect(),
            entries: Vec::new(),
        };
        for (file, (_, node)) in documents.iter().enumerate() {
            let side = ["left", "right"].get(file).filter(|_| sides);
            keys.add(file, side.copied().unwrap_or(""), "", node);
        }
        keys
    }

    fn add(&mut self, file: usize, side: &str, group: &str, node: &Node) {
        let Node::Map(entries) = node else { return };
        for (key, node) in entries {
            let name = if group.is_empty() {
                key.clone()
            } else {
                format!("{group}.{key}")
            };
            if node.is_leaf() {
                self.entries.push(Entry {
                    file,
                    plain: format!("{side}{}", plain(&name)),
                    name,
                    node: node.clone(),
                });
            } else {
                self.add(file, side, &name, node);
            }
        }
    }

    /// The first of `names` that is there, with `affix` around it, and that `fits`.
    pub(in crate::files) fn find_where(
        &self,
        Affix(before, after): Affix,
        names: &[&str],
        fits: impl Fn(&Node) -> bool,
    ) -> Option<Found<'_>> {
        names.iter().find_map(|name| {
            let full = format!("{before}{name}{after}");
            let entry = self
                .entries
                .iter()
                .find(|e| e.plain == full && fits(&e.node))?;
            Some(Found {
                path: self.files.get(entry.file)?,
                name: &entry.name,
                node: &entry.node,
            })
        })
    }

    /// The first of `names` that is there, with `affix` around it.
    pub(in crate::files) fn find(&self, affix: Affix, names: &[&str]) -> Option<Found<'_>> {
        self.find_where(affix, names, |_| true)
    }

    /// All values under any of `names`, with `affix` around it.
    pub(in crate::files) fn all<'a>(
        &'a self,
        Affix(before, after): Affix,
        names: &'a [&str],
    ) -> impl Iterator<Item = Found<'a>> + 'a {
        self.entries.iter().filter_map(move |e| {
            let inner = e.plain.strip_prefix(before)?.strip_suffix(after)?;
            names.contains(&inner).then_some(Found {
                path: self.files.get(e.file)?,
                name: &e.name,
                node: &e.node,
            })
        })
    }

    /// The first file, for messages about no key in particular.
    pub(in crate::files) fn path(&self) -> &Path {
        self.files.first().map_or(Path::new(""), PathBuf::as_path)
    }

    /// The error that a key is missing, with those that are there.
    pub(in crate::files) fn missing(&self, key: &str, meaning: &str) -> FileError {
        const MOST: usize = 24;
        let names: Vec<&str> = self.entries.iter().map(|e| e.name.as_str()).collect();
        let mut found = names.get(..MOST).unwrap_or(&names).join(", ");
        if names.len() > MOST {
            found += ", ...";
        }
        let files: Vec<String> = self.files.iter().map(|p| p.display().to_string()).collect();
        FileError::MissingKey {
            files: files.join(", "),
            key: key.to_owned(),
            meaning: meaning.to_owned(),
            found,
        }
    }
}
