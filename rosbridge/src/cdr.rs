//! Messages between ROS 1's bytes, which this crate's types have, and ROS 2's CDR: field by field, by
//! the messages' own definitions, so that a new message needs no code.

use crate::bag::definition::{Count, Definition, DefinitionError, Field, Kind};
use crate::bag::rewrite::{Cdr, in_ros2};
use crate::bag::walk::{Malformed, walk};
use crate::bag::{NOTE, note, ros2};

/// What precedes a message in CDR, which DDS handles by itself.
const ENCAPSULATION: usize = 4;
/// Bytes that may fill up a message at its end.
const PADDING: usize = 3;

/// Turns messages of one type into CDR and back.
#[derive(Debug)]
pub(crate) struct Converter {
    definition: Definition,
}

impl Converter {
    /// Of a type `package/Name` and its definition, as ROS 1 has it.
    ///
    /// # Errors
    /// See [`DefinitionError`].
    pub(crate) fn new(name: &str, definition: &str) -> Result<Self, DefinitionError> {
        let definition = Definition::read(name, definition)?;
        Ok(Self { definition })
    }

    /// What ROS 2 calls the type, `package/Name`.
    pub(crate) fn name(&self) -> &str {
        match self.root() {
            NOTE => "rcl_interfaces/Log",
            name => name,
        }
    }

    /// A message of ROS 1 in CDR.
    ///
    /// # Errors
    /// It is no such message.
    pub(crate) fn encode(&self, message: &[u8]) -> Result<Vec<u8>, Malformed> {
        if self.is_empty() {
            // ROS 2's empty messages have a byte that means nothing.
            return Ok(vec![0]);
        }
        let mut cdr = Cdr::new(0);
        if self.root() == NOTE {
            note(message, &mut cdr)?;
        } else {
            walk(&self.definition, message, &mut cdr)?;
        }
        Ok(cdr.into_bytes().split_off(ENCAPSULATION))
    }

    /// A message in CDR as ROS 1 has it.
    ///
    /// # Errors
    /// It is no such message, or has fields that ROS 1 has not.
    pub(crate) fn decode(&self, message: &[u8]) -> Result<Vec<u8>, Malformed> {
        if self.is_empty() {
            return match message.len() {
                0..=4 => Ok(Vec::new()),
                _ => Err(Malformed),
            };
        }
        let mut reading = Reading {
            definition: &self.definition,
            message,
            place: 0,
            out: Vec::with_capacity(message.len() + 16),
        };
        reading.message(0)?;
        if message.len() - reading.place > PADDING {
            return Err(Malformed);
        }
        Ok(reading.out)
    }

    fn root(&self) -> &str {
        self.definition.types.first().map_or("", |root| &root.name)
    }

    fn is_empty(&self) -> bool {
        let root = self.definition.types.first();
        root.is_some_and(|root| root.fields.is_empty())
    }
}

/// A message in CDR on its way to ROS 1's bytes.
struct Reading<'a> {
    definition: &'a Definition,
    message: &'a [u8],
    place: usize,
    out: Vec<u8>,
}

impl<'a> Reading<'a> {
    fn message(&mut self, place: usize) -> Result<(), Malformed> {
        let definition = self.definition;
        let kind = &definition.types[place];
        for field in &kind.fields {
            if ros2::added_before(&kind.name, &field.name).next().is_some() {
                return Err(Malformed);
            }
            if in_ros2(&kind.name, &field.name) {
                self.values(field)?;
            } else {
                // A header's number.
                self.out.extend_from_slice(&0_u32.to_le_bytes());
            }
        }
        Ok(())
    }

    fn values(&mut self, field: &Field) -> Result<(), Malformed> {
        let count = match field.count {
            Count::One => 1,
            Count::Fixed(count) => count,
            Count::Any => usize::try_from(self.word()?).map_err(|_| Malformed)?,
        };
        if let Kind::Plain(size) = field.kind {
            if count > 0 {
                self.align(size);
                let bytes = self.take(size.checked_mul(count).ok_or(Malformed)?)?;
                self.out.extend_from_slice(bytes);
            }
            return Ok(());
        }
        for _ in 0..count {
            if self.place >= self.message.len() {
                return Err(Malformed);
            }
            match field.kind {
                Kind::Plain(_) => {}
                Kind::Text => self.text()?,
                Kind::Time | Kind::Duration => {
                    self.word()?;
                    self.word()?;
                }
                Kind::Message(inner) => self.message(inner)?,
            }
        }
        Ok(())
    }

    /// A text, whose length in CDR counts the zero at its end.
    fn text(&mut self) -> Result<(), Malformed> {
        self.align(4);
        let length = u32::from_le_bytes(*self.take(4)?.first_chunk().ok_or(Malformed)?);
        let bytes = self.take(usize::try_from(length).map_err(|_| Malformed)?)?;
        let text = match bytes.split_last() {
            None => bytes,
            Some((0, text)) => text,
            Some(_) => return Err(Malformed),
        };
        let length = u32::try_from(text.len()).map_err(|_| Malformed)?;
        self.out.extend_from_slice(&length.to_le_bytes());
        self.out.extend_from_slice(text);
        Ok(())
    }

    /// Four bytes, which are the same in both.
    fn word(&mut self) -> Result<u32, Malformed> {
        self.align(4);
        let word = *self.take(4)?.first_chunk().ok_or(Malformed)?;
        self.out.extend_from_slice(&word);
        Ok(u32::from_le_bytes(word))
    }

    fn align(&mut self, size: usize) {
        self.place = self.place.next_multiple_of(size.max(1));
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], Malformed> {
        let end = self.place.checked_add(length).ok_or(Malformed)?;
        let taken = self.message.get(self.place..end).ok_or(Malformed)?;
        self.place = end;
        Ok(taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::msg::{
        geometry_msgs, needle_steer_lockstep, needle_steer_msgs, rosgraph_msgs, sensor_msgs,
        std_msgs, trajectory_msgs, visualization_msgs,
    };
    use crate::seam::{Message, RosMsg, Span, Time};

    fn converter<M: Message>() -> Converter {
        Converter::new(&M::msg_type(), &M::msg_definition()).unwrap()
    }

    fn bytes<M: RosMsg>(message: &M) -> Vec<u8> {
        let mut bytes = Vec::new();
        message.encode(&mut bytes).unwrap();
        bytes
    }

    /// There and back, and every shorter message is refused.
    fn returns<M: Message>(message: &M) {
        let converter = converter::<M>();
        let cdr = converter.encode(&bytes(message)).unwrap();
        let back = converter.decode(&cdr).unwrap();
        assert_eq!(&M::decode(&mut back.as_slice()).unwrap(), message);
        for padded in 1..=3 {
            let padded = [&cdr[..], &vec![0; padded]].concat();
            assert_eq!(converter.decode(&padded).unwrap(), back);
        }
        assert!(converter.decode(&[&cdr[..], &[0; 4]].concat()).is_err());
        for length in 0..cdr.len().saturating_sub(PADDING) {
            let short = converter.decode(&cdr[..length]);
            assert!(short.is_err(), "{} of {}", length, cdr.len());
        }
    }

    #[test]
    fn messages_go_there_and_back() {
        let stamp = Time { sec: 5, nsec: 9 };
        let header = std_msgs::Header {
            seq: 0,
            stamp,
            frame_id: "world".into(),
        };
        returns(&sensor_msgs::JointState {
            header: header.clone(),
            name: vec!["a".into(), "bcd".into()],
            position: vec![1.5, -2.0],
            velocity: Vec::new(),
            effort: vec![3.0],
        });
        returns(&geometry_msgs::PointStamped {
            header: header.clone(),
            point: geometry_msgs::Point {
                x: 1.0,
                y: 2.0,
                z: -3.0,
            },
        });
        returns(&trajectory_msgs::JointTrajectory {
            header: header.clone(),
            joint_names: vec!["a".into()],
            points: vec![trajectory_msgs::JointTrajectoryPoint {
                positions: vec![1.0],
                time_from_start: Span { sec: 2, nsec: 7 },
                ..Default::default()
            }],
        });
        returns(&needle_steer_lockstep::World {
            header: header.clone(),
            images: vec![
                sensor_msgs::Image {
                    header: header.clone(),
                    data: vec![7; 5],
                    ..Default::default()
                };
                2
            ],
            shapes: vec![needle_steer_msgs::Shape {
                header,
                sequence: 3,
                ..Default::default()
            }],
            events: vec![1, 2, 3],
            pre_insertion: 0.25,
            ..Default::default()
        });
    }

    #[test]
    fn empty_messages_have_a_byte_in_ros_2() {
        let empty = converter::<std_msgs::Empty>();
        assert_eq!(empty.encode(&[]).unwrap(), [0]);
        assert!(empty.decode(&[0]).unwrap().is_empty());
        assert!(empty.decode(&[0; 5]).is_err());
    }

    #[test]
    fn notes_are_ros_2s_own_and_what_ros_1_lacks_is_not_read() {
        let note = converter::<rosgraph_msgs::Log>();
        assert_eq!(note.name(), "rcl_interfaces/Log");
        let message = rosgraph_msgs::Log {
            level: rosgraph_msgs::Log::WARN,
            msg: "late".into(),
            ..Default::default()
        };
        let cdr = note.encode(&bytes(&message)).unwrap();
        assert_eq!(cdr[8], 30);
        let markers = converter::<visualization_msgs::MarkerArray>();
        let message = visualization_msgs::MarkerArray {
            markers: vec![visualization_msgs::Marker::default()],
        };
        let cdr = markers.encode(&bytes(&message)).unwrap();
        assert!(markers.decode(&cdr).is_err());
    }
}
