//! Typed access to a YAML document, with errors that name file and key.

use std::path::Path;

use nalgebra::DMatrix;
use yaml_rust2::{Yaml, YamlLoader};

use super::{FileError, read_text};

/// A YAML file whose top level is a mapping.
pub(super) struct Document<'a> {
    path: &'a Path,
    root: Yaml,
}

impl<'a> Document<'a> {
    /// Reads a file. OpenCV's first line (`%YAML:1.0`) is no valid directive and is skipped.
    pub(super) fn read(path: &'a Path) -> Result<Self, FileError> {
        let text = read_text(path)?;
        let body = match text.split_once('\n') {
            Some((first, rest)) if first.starts_with("%YAML") => rest,
            _ => &text,
        };
        let mut documents = YamlLoader::load_from_str(body).map_err(|source| FileError::Yaml {
            path: path.to_owned(),
            source,
        })?;
        let root = documents.pop().unwrap_or(Yaml::Null);
        let document = Self { path, root };
        if document.root.as_hash().is_some() {
            Ok(document)
        } else {
            Err(document.wrong("", "a mapping of keys"))
        }
    }

    /// The error that says what a key should hold.
    pub(super) fn wrong(&self, key: &str, expected: &str) -> FileError {
        FileError::Key {
            path: self.path.to_owned(),
            key: key.to_owned(),
            expected: expected.to_owned(),
        }
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        self.path
    }

    /// Whether a key (path of keys, by dots) is there.
    pub(super) fn has(&self, key: &str) -> bool {
        !self.get(key).is_badvalue()
    }

    fn get(&self, key: &str) -> &Yaml {
        key.split('.').fold(&self.root, |node, part| &node[part])
    }

    /// A finite number.
    pub(super) fn number(&self, key: &str) -> Result<f64, FileError> {
        number(self.get(key)).ok_or_else(|| self.wrong(key, "a finite number"))
    }

    /// A count above zero.
    pub(super) fn count(&self, key: &str) -> Result<usize, FileError> {
        self.get(key)
            .as_i64()
            .and_then(|n| usize::try_from(n).ok())
            .filter(|&n| n > 0)
            .ok_or_else(|| self.wrong(key, "an integer above 0"))
    }

    /// A text.
    pub(super) fn text(&self, key: &str) -> Result<&str, FileError> {
        self.get(key)
            .as_str()
            .ok_or_else(|| self.wrong(key, "a text"))
    }

    /// A matrix as `rows`, `cols`, `data` (row-major), of finite numbers.
    pub(super) fn matrix(&self, key: &str) -> Result<DMatrix<f64>, FileError> {
        let rows = self.count(&format!("{key}.rows"))?;
        let cols = self.count(&format!("{key}.cols"))?;
        let wrong = || self.wrong(key, "a matrix: rows, cols, data of finite numbers");
        let node = self.get(key);
        let data: Option<Vec<f64>> = node["data"]
            .as_vec()
            .and_then(|v| v.iter().map(number).collect());
        let data = data.ok_or_else(wrong)?;
        if rows.checked_mul(cols) != Some(data.len()) {
            return Err(wrong());
        }
        Ok(DMatrix::from_row_slice(rows, cols, &data))
    }

    /// A matrix of known size.
    pub(super) fn sized(
        &self,
        key: &str,
        rows: usize,
        cols: usize,
    ) -> Result<DMatrix<f64>, FileError> {
        let m = self.matrix(key)?;
        if m.shape() == (rows, cols) {
            Ok(m)
        } else {
            Err(self.wrong(key, &format!("a matrix of {rows} x {cols}")))
        }
    }
}

fn number(node: &Yaml) -> Option<f64> {
    let value = match node {
        #[expect(clippy::cast_precision_loss, reason = "files hold small integers")]
        Yaml::Integer(n) => *n as f64,
        Yaml::Real(text) => text.parse().ok()?,
        _ => return None,
    };
    value.is_finite().then_some(value)
}

/// A number with all its digits, with a point as OpenCV's reader needs it.
pub(super) fn digits(value: f64) -> String {
    format!("{value:.16e}")
}

/// Numbers on lines of at most four.
pub(super) fn list(values: impl IntoIterator<Item = f64>) -> String {
    let words: Vec<String> = values.into_iter().map(digits).collect();
    let lines: Vec<String> = words.chunks(4).map(|c| c.join(", ")).collect();
    lines.join(",\n      ")
}
