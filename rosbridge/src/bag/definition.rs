//! Definitions of ROS 1 messages, read from their text.

use std::collections::HashMap;

/// How deep types may stand in each other: a definition that contains itself has no end.
const DEEPEST: usize = 16;

/// What a field holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A number of so many bytes.
    Plain(usize),
    Text,
    Time,
    Duration,
    /// A message: its place in [`Definition::types`].
    Message(usize),
}

/// How often a field's value stands in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Count {
    One,
    Fixed(usize),
    Any,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Field {
    pub(crate) name: String,
    /// The type's name, without package where the text leaves that out.
    pub(crate) type_name: String,
    pub(crate) kind: Kind,
    pub(crate) count: Count,
}

/// A type: its name with the package, its fields, and its constants as they are written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Type {
    pub(crate) name: String,
    pub(crate) fields: Vec<Field>,
    pub(crate) constants: Vec<String>,
}

/// A message's type and all that it is made of; the message's own comes first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Definition {
    pub(crate) types: Vec<Type>,
}

/// A definition that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DefinitionError {
    /// A type that is not defined.
    #[error("type {name} is not defined")]
    Unknown {
        /// Its name.
        name: String,
    },
    /// A line that is no field.
    #[error("`{line}` is no field")]
    Line {
        /// The line.
        line: String,
    },
    /// A type that contains itself.
    #[error("type {name} contains itself")]
    Endless {
        /// Its name.
        name: String,
    },
}

impl Definition {
    /// Reads the definition of `message_type` with those of what it is made of, as logs hold them.
    pub(crate) fn read(message_type: &str, text: &str) -> Result<Self, DefinitionError> {
        let mut sections: Vec<(String, Vec<&str>)> = vec![(message_type.to_owned(), Vec::new())];
        for line in text.lines() {
            if let Some(name) = line.strip_prefix("MSG: ") {
                sections.push((name.trim().to_owned(), Vec::new()));
            } else if !line.starts_with("====")
                && let Some((_, lines)) = sections.last_mut()
            {
                lines.push(line);
            }
        }
        let places: HashMap<String, usize> = sections
            .iter()
            .enumerate()
            .map(|(place, (name, _))| (name.clone(), place))
            .collect();
        let types = sections
            .into_iter()
            .map(|(name, lines)| read_type(name, &lines, &places))
            .collect::<Result<_, _>>()?;
        let definition = Self { types };
        definition.check_depth(0, 0)?;
        Ok(definition)
    }

    fn check_depth(&self, place: usize, depth: usize) -> Result<(), DefinitionError> {
        let kind = &self.types[place];
        if depth > DEEPEST {
            return Err(DefinitionError::Endless {
                name: kind.name.clone(),
            });
        }
        kind.fields.iter().try_for_each(|field| match field.kind {
            Kind::Message(inner) => self.check_depth(inner, depth + 1),
            _ => Ok(()),
        })
    }
}

fn read_type(
    name: String,
    lines: &[&str],
    places: &HashMap<String, usize>,
) -> Result<Type, DefinitionError> {
    let package = name.split('/').next().unwrap_or_default().to_owned();
    let mut read = Type {
        name,
        ..Type::default()
    };
    for line in lines {
        let bad = || DefinitionError::Line {
            line: (*line).to_owned(),
        };
        let plain = line.split('#').next().unwrap_or_default().trim();
        if plain.is_empty() {
            continue;
        }
        if plain.contains('=') {
            // What follows # belongs to a text.
            let whole = plain.starts_with("string");
            let constant = if whole { line.trim() } else { plain };
            read.constants.push(constant.to_owned());
            continue;
        }
        let (kind, field) = plain.split_once(char::is_whitespace).ok_or_else(bad)?;
        let (kind, count) = match kind.split_once('[') {
            None => (kind, Count::One),
            Some((kind, "]")) => (kind, Count::Any),
            Some((kind, rest)) => {
                let number = rest.strip_suffix(']').ok_or_else(bad)?;
                (kind, Count::Fixed(number.parse().map_err(|_| bad())?))
            }
        };
        let full = match kind {
            "Header" => "std_msgs/Header".to_owned(),
            kind if kind.contains('/') => kind.to_owned(),
            kind => format!("{package}/{kind}"),
        };
        let found = match kind {
            "bool" | "int8" | "uint8" | "byte" | "char" => Kind::Plain(1),
            "int16" | "uint16" => Kind::Plain(2),
            "int32" | "uint32" | "float32" => Kind::Plain(4),
            "int64" | "uint64" | "float64" => Kind::Plain(8),
            "string" => Kind::Text,
            "time" => Kind::Time,
            "duration" => Kind::Duration,
            _ => Kind::Message(
                *places
                    .get(&full)
                    .ok_or(DefinitionError::Unknown { name: full.clone() })?,
            ),
        };
        let type_name = match found {
            Kind::Message(_) => full,
            _ => kind.to_owned(),
        };
        read.fields.push(Field {
            name: field.trim().to_owned(),
            type_name,
            kind: found,
            count,
        });
    }
    Ok(read)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::msg::{needle_steer_msgs, visualization_msgs};
    use crate::seam::Message;

    #[test]
    fn every_type_is_found_and_constants_are_no_fields() {
        let name = visualization_msgs::MarkerArray::msg_type();
        let text = visualization_msgs::MarkerArray::msg_definition();
        let definition = Definition::read(&name, &text).unwrap();
        let marker = definition
            .types
            .iter()
            .find(|found| found.name == "visualization_msgs/Marker")
            .unwrap();
        assert_eq!(marker.fields[0].type_name, "std_msgs/Header");
        assert_eq!(marker.fields.len(), 15);
        assert!(marker.constants.contains(&"uint8 ARROW=0".to_owned()));
        let name = needle_steer_msgs::Step::msg_type();
        let text = needle_steer_msgs::Step::msg_definition();
        assert!(Definition::read(&name, &text).is_ok());
    }

    #[test]
    fn what_is_no_definition_is_told() {
        let read = |text: &str| Definition::read("a/B", text).unwrap_err();
        assert!(matches!(read("float64"), DefinitionError::Line { .. }));
        assert!(matches!(read("Other x"), DefinitionError::Unknown { .. }));
        assert!(matches!(read("B x"), DefinitionError::Endless { .. }));
        assert!(matches!(read("int8[x] y"), DefinitionError::Line { .. }));
    }
}
