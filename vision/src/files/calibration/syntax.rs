//! From a file's bytes to its content: YAML as OpenCV, ROS and people write it, JSON, XML; and
//! the names of the files that are none of these.

use std::path::Path;

use quick_xml::Reader;
use quick_xml::events::Event;
use yaml_rust2::{Yaml, YamlLoader};

use super::node::Node;
use crate::files::FileError;

/// Reads a file.
pub(super) fn read(path: &Path) -> Result<Node, FileError> {
    let bytes = std::fs::read(path).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })?;
    if let Some((what, remedy)) = binary(&bytes) {
        return Err(foreign(path, what, remedy));
    }
    let text = String::from_utf8(bytes).map_err(|_| {
        foreign(
            path,
            "no text file",
            "save the calibration as YAML, XML or JSON",
        )
    })?;
    let text = text.trim_start_matches('\u{feff}');
    let node = match text.trim_start().chars().next() {
        Some('<') => xml(path, text)?,
        Some('{') => match serde_json::from_str(text) {
            Ok(value) => json(&value),
            // YAML's own braces.
            Err(_) => yaml(path, text)?,
        },
        _ if sections(text) => {
            return Err(foreign(
                path,
                "a file of [sections], as `ost.txt` of ROS or a ZED's `.conf`",
                "give the YAML that the same program writes (ROS: left.yaml and right.yaml), or \
                 run `calibrate stereo`",
            ));
        }
        _ => yaml(path, text)?,
    };
    match node {
        Node::Map(ref entries) if !entries.is_empty() => Ok(node),
        _ => Err(FileError::Key {
            path: path.to_owned(),
            key: String::new(),
            expected: "a mapping of keys (`M1: ...`), but the file has none".to_owned(),
        }),
    }
}

fn foreign(path: &Path, what: &str, remedy: &str) -> FileError {
    FileError::Foreign {
        path: path.to_owned(),
        what: what.to_owned(),
        remedy: remedy.to_owned(),
    }
}

/// Names a binary file by its first bytes, with the way round.
fn binary(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    const MATLAB: &str = "in MATLAB, write the matrices as text: \
        [K1, D1, K2, D2, R, T] = stereoParametersToOpenCV(stereoParams), then put them into a YAML \
        file as M1, D1, M2, D2, R, T and imageSize (T is in millimetres there: --unit-mm 1)";
    const NUMPY: &str = "in Python, write the arrays with cv2.FileStorage('stereo.yml', \
        cv2.FILE_STORAGE_WRITE) as M1, D1, M2, D2, R, T";
    let kinds: [(&[u8], &str, &str); 6] = [
        (b"MATLAB 5.0 MAT-file", "a MATLAB .mat file", MATLAB),
        (
            b"\x89HDF\r\n\x1a\n",
            "an HDF5 file (a MATLAB 7.3 .mat)",
            MATLAB,
        ),
        (b"\x93NUMPY", "a NumPy .npy file", NUMPY),
        (b"PK\x03\x04", "a ZIP archive (NumPy's .npz is one)", NUMPY),
        (b"\x80\x03", "a Python pickle", NUMPY),
        (b"\x80\x04", "a Python pickle", NUMPY),
    ];
    kinds
        .into_iter()
        .find(|(magic, _, _)| bytes.starts_with(magic))
        .map(|(_, what, remedy)| (what, remedy))
}

/// Whether a text is divided by lines like `[image]`.
fn sections(text: &str) -> bool {
    let mut lines = text.lines().map(str::trim);
    lines.any(|line| {
        let name = line.strip_prefix('[').and_then(|l| l.strip_suffix(']'));
        name.is_some_and(|name| {
            name.starts_with(char::is_alphabetic)
                && name
                    .chars()
                    .all(|c| c.is_alphanumeric() || "_/- ".contains(c))
        })
    })
}

fn yaml(path: &Path, text: &str) -> Result<Node, FileError> {
    let documents = YamlLoader::load_from_str(&tidied(text)).map_err(|source| FileError::Yaml {
        path: path.to_owned(),
        source,
    })?;
    let of_keys = documents.iter().find(|d| d.as_hash().is_some());
    Ok(of_keys.map_or(Node::Null, from_yaml))
}

/// What OpenCV's reader allows and YAML does not: its first line (`%YAML:1.0`, also below
/// comments), no blank after a key (`data:[`), tabs.
fn tidied(text: &str) -> String {
    let mut tidy = String::with_capacity(text.len());
    for line in text.lines().filter(|line| !line.starts_with('%')) {
        let body = line.trim_start();
        let indent = &line[..line.len() - body.len()];
        tidy += &indent.replace('\t', "    ");
        let key = body
            .find(':')
            .filter(|&at| {
                body[..at]
                    .chars()
                    .all(|c| c.is_alphanumeric() || "_.- ".contains(c))
            })
            .map(|at| body.split_at(at + 1));
        match key {
            Some((key, value)) if value.starts_with(['[', '{', '!', '-', '"']) => {
                tidy += key;
                tidy.push(' ');
                tidy += value;
            }
            _ => tidy += body,
        }
        tidy.push('\n');
    }
    tidy
}

fn from_yaml(yaml: &Yaml) -> Node {
    match yaml {
        #[expect(clippy::cast_precision_loss, reason = "files hold small integers")]
        Yaml::Integer(n) => Node::Number(*n as f64),
        Yaml::Real(text) => text
            .parse()
            .map_or_else(|_| Node::Text(text.clone()), Node::Number),
        Yaml::Boolean(b) => Node::Number(f64::from(u8::from(*b))),
        Yaml::String(text) => Node::Text(text.clone()),
        Yaml::Array(list) => Node::List(list.iter().map(from_yaml).collect()),
        Yaml::Hash(map) => Node::Map(
            map.iter()
                .filter_map(|(key, value)| {
                    let key = match key {
                        Yaml::String(key) => key.clone(),
                        Yaml::Integer(n) => n.to_string(),
                        _ => return None,
                    };
                    Some((key, from_yaml(value)))
                })
                .collect(),
        ),
        _ => Node::Null,
    }
}

fn json(value: &serde_json::Value) -> Node {
    match value {
        serde_json::Value::Number(n) => n.as_f64().map_or(Node::Null, Node::Number),
        serde_json::Value::Bool(b) => Node::Number(f64::from(u8::from(*b))),
        serde_json::Value::String(text) => Node::Text(text.clone()),
        serde_json::Value::Array(list) => Node::List(list.iter().map(json).collect()),
        serde_json::Value::Object(map) => {
            Node::Map(map.iter().map(|(k, v)| (k.clone(), json(v))).collect())
        }
        serde_json::Value::Null => Node::Null,
    }
}

/// An element of an XML file while it is open.
#[derive(Default)]
struct Open {
    name: String,
    text: String,
    children: Vec<(String, Node)>,
}

impl Open {
    /// Its value: a group of elements, a list (`<_>`), numbers, or a text.
    fn closed(self) -> Node {
        if self.children.is_empty() {
            let words: Vec<&str> = self.text.split_whitespace().collect();
            let numbers: Option<Vec<Node>> = words
                .iter()
                .map(|w| w.parse().ok().map(Node::Number))
                .collect();
            return match numbers {
                Some(list) if list.len() == 1 => list.into_iter().next().unwrap_or(Node::Null),
                Some(list) if !list.is_empty() => Node::List(list),
                _ => Node::Text(self.text.trim().trim_matches('"').to_owned()),
            };
        }
        if self.children.iter().all(|(name, _)| name == "_") {
            return Node::List(self.children.into_iter().map(|(_, node)| node).collect());
        }
        Node::Map(self.children)
    }
}

/// OpenCV's `FileStorage` as XML.
fn xml(path: &Path, text: &str) -> Result<Node, FileError> {
    let wrong = |reason: String| FileError::Xml {
        path: path.to_owned(),
        reason,
    };
    let mut reader = Reader::from_str(text);
    let mut open = vec![Open::default()];
    loop {
        let event = reader.read_event().map_err(|e| wrong(e.to_string()))?;
        match event {
            Event::Start(tag) => open.push(Open {
                name: String::from_utf8_lossy(tag.name().as_ref()).into_owned(),
                ..Open::default()
            }),
            Event::Text(part) => {
                if let Some(element) = open.last_mut() {
                    element.text += &String::from_utf8_lossy(&part);
                }
            }
            Event::End(_) => {
                if let Some(element) = open.pop()
                    && let Some(parent) = open.last_mut()
                {
                    let name = element.name.clone();
                    parent.children.push((name, element.closed()));
                }
            }
            Event::Eof => break,
            _ => {}
        }
    }
    let storage = open
        .into_iter()
        .next()
        .and_then(|root| root.children.into_iter().next());
    match storage {
        Some((name, node)) if name == "opencv_storage" => Ok(node),
        Some((name, _)) => Err(foreign(
            path,
            &format!("an XML file of another kind (`{name}`)"),
            "expected OpenCV's `opencv_storage`",
        )),
        None => Err(wrong("no element".to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opencvs_liberties_with_yaml_are_tidied() {
        let text = "# bench\n%YAML:1.0\n---\nM:\n\trows: 1\n\tcols: 2\n\tdata:[1., 2.]\nurl: a:b\n";
        let node = yaml(Path::new("x"), text).unwrap();
        assert_eq!(node.get("M").unwrap().matrix().unwrap()[(0, 1)], 2.0);
        assert_eq!(node.get("url").unwrap().text(), Some("a:b"));
    }

    #[test]
    fn xml_groups_lists_numbers_and_texts() {
        let text = "<?xml version=\"1.0\"?>\n<!-- c -->\n<opencv_storage><a>1 2\n3</a><b><_>4</_>\
                    <_>5</_></b><c>\"word\"</c></opencv_storage>";
        let node = xml(Path::new("x"), text).unwrap();
        assert_eq!(node.get("a").unwrap().matrix().unwrap().len(), 3);
        assert_eq!(node.get("b").unwrap().matrix().unwrap().len(), 2);
        assert_eq!(node.get("c").unwrap().text(), Some("word"));
        assert!(xml(Path::new("x"), "<a><b></a>").is_err());
    }
}
