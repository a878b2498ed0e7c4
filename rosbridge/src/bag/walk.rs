//! A message's bytes field by field.

use super::definition::{Count, Definition, Field, Kind};

/// Bytes that are no such message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the message is shorter or longer than its definition says")]
pub struct Malformed;

/// What a message's fields become.
pub(crate) trait Sink {
    /// Whether the fields of `name`, a type with its package, are to be left out from here on to
    /// [`Sink::leave`].
    fn enter(&mut self, name: &str);
    fn leave(&mut self, name: &str);
    /// A field begins; whether it is wanted.
    fn field(&mut self, of: &str, field: &Field) -> bool;
    /// Numbers of `size` bytes each.
    fn plain(&mut self, size: usize, bytes: &[u8]);
    fn text(&mut self, bytes: &[u8]);
    /// Seconds and nanoseconds.
    fn time(&mut self, seconds: u32, nanos: u32);
    fn duration(&mut self, seconds: i32, nanos: i32) {
        self.count(seconds.cast_unsigned());
        self.count(nanos.cast_unsigned());
    }
    /// How many values follow.
    fn count(&mut self, count: u32);
}

/// Shows all of `bytes`, a message of ROS 1, to `sink`.
pub(crate) fn walk(
    definition: &Definition,
    mut bytes: &[u8],
    sink: &mut dyn Sink,
) -> Result<(), Malformed> {
    message(definition, 0, &mut bytes, sink)?;
    if bytes.is_empty() {
        Ok(())
    } else {
        Err(Malformed)
    }
}

fn message(
    definition: &Definition,
    place: usize,
    bytes: &mut &[u8],
    sink: &mut dyn Sink,
) -> Result<(), Malformed> {
    let kind = &definition.types[place];
    sink.enter(&kind.name);
    for field in &kind.fields {
        if sink.field(&kind.name, field) {
            values(definition, field, bytes, sink)?;
        } else {
            values(definition, field, bytes, &mut Nothing)?;
        }
    }
    sink.leave(&kind.name);
    Ok(())
}

fn values(
    definition: &Definition,
    field: &Field,
    bytes: &mut &[u8],
    sink: &mut dyn Sink,
) -> Result<(), Malformed> {
    let count = match field.count {
        Count::One => 1,
        Count::Fixed(count) => count,
        Count::Any => {
            let count = word(bytes)?;
            sink.count(count);
            usize::try_from(count).map_err(|_| Malformed)?
        }
    };
    if let Kind::Plain(size) = field.kind {
        let length = size.checked_mul(count).ok_or(Malformed)?;
        sink.plain(size, take(bytes, length)?);
        return Ok(());
    }
    for _ in 0..count {
        // Every value has bytes but for those of empty types, of which there are no arrays.
        match field.kind {
            Kind::Plain(_) => {}
            Kind::Text => {
                let length = usize::try_from(word(bytes)?).map_err(|_| Malformed)?;
                sink.text(take(bytes, length)?);
            }
            Kind::Time => sink.time(word(bytes)?, word(bytes)?),
            Kind::Duration => {
                let [seconds, nanos] = [word(bytes)?, word(bytes)?].map(u32::cast_signed);
                sink.duration(seconds, nanos);
            }
            Kind::Message(inner) => {
                if bytes.is_empty() {
                    return Err(Malformed);
                }
                message(definition, inner, bytes, sink)?;
            }
        }
    }
    Ok(())
}

fn take<'a>(bytes: &mut &'a [u8], length: usize) -> Result<&'a [u8], Malformed> {
    let (taken, rest) = bytes.split_at_checked(length).ok_or(Malformed)?;
    *bytes = rest;
    Ok(taken)
}

fn word(bytes: &mut &[u8]) -> Result<u32, Malformed> {
    let (word, rest) = bytes.split_first_chunk().ok_or(Malformed)?;
    *bytes = rest;
    Ok(u32::from_le_bytes(*word))
}

/// Takes nothing.
struct Nothing;

impl Sink for Nothing {
    fn enter(&mut self, _: &str) {}
    fn leave(&mut self, _: &str) {}
    fn field(&mut self, _: &str, _: &Field) -> bool {
        false
    }
    fn plain(&mut self, _: usize, _: &[u8]) {}
    fn text(&mut self, _: &[u8]) {}
    fn time(&mut self, _: u32, _: u32) {}
    fn count(&mut self, _: u32) {}
}
