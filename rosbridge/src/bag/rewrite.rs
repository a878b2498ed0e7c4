//! A message with its stamps on the wall clock: as ROS 1 has it, and in CDR, as ROS 2.

use super::definition::Field;
use super::walk::Sink;
use super::{HEADER, nanos, seconds};

/// What brings stamps to the wall clock.
#[derive(Clone, Copy, Debug)]
struct Shift {
    /// Wall-clock time at the run's time zero \[ns\].
    began: u64,
    /// Whether the field is a header's: its zero is the run's beginning. Others that are zero say that
    /// there is no time.
    in_header: bool,
}

impl Shift {
    const fn new(began: u64) -> Self {
        Self {
            began,
            in_header: false,
        }
    }

    fn of(self, whole: u32, fraction: u32) -> (u32, u32) {
        if (whole, fraction) == (0, 0) && !self.in_header {
            return (0, 0);
        }
        seconds(nanos(whole, fraction).saturating_add(self.began))
    }
}

/// The same message of ROS 1.
#[derive(Debug)]
pub(crate) struct Ros1 {
    shift: Shift,
    pub(crate) bytes: Vec<u8>,
}

impl Ros1 {
    pub(crate) const fn new(began: u64) -> Self {
        Self {
            shift: Shift::new(began),
            bytes: Vec::new(),
        }
    }
}

impl Sink for Ros1 {
    fn enter(&mut self, _: &str) {}
    fn leave(&mut self, _: &str) {}
    fn field(&mut self, of: &str, _: &Field) -> bool {
        self.shift.in_header = of == HEADER;
        true
    }
    fn plain(&mut self, _: usize, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }
    fn text(&mut self, bytes: &[u8]) {
        self.count(u32::try_from(bytes.len()).unwrap_or(u32::MAX));
        self.bytes.extend_from_slice(bytes);
    }
    fn time(&mut self, whole: u32, fraction: u32) {
        let (whole, fraction) = self.shift.of(whole, fraction);
        self.count(whole);
        self.count(fraction);
    }
    fn count(&mut self, count: u32) {
        self.bytes.extend_from_slice(&count.to_le_bytes());
    }
}

/// The message in CDR: little endian, numbers at multiples of their size, texts ending in zero.
#[derive(Debug)]
pub(crate) struct Cdr {
    shift: Shift,
    bytes: Vec<u8>,
}

/// What precedes a message: plain CDR, little endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

impl Cdr {
    pub(crate) fn new(began: u64) -> Self {
        Self {
            shift: Shift::new(began),
            bytes: ENCAPSULATION.to_vec(),
        }
    }

    /// A header's stamp.
    pub(crate) fn stamp(&mut self, whole: u32, fraction: u32) {
        self.shift.in_header = true;
        self.time(whole, fraction);
    }

    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Fills up to a multiple of `size`, counted from the encapsulation's end.
    fn align(&mut self, size: usize) {
        while !(self.bytes.len() - ENCAPSULATION.len()).is_multiple_of(size) {
            self.bytes.push(0);
        }
    }
}

/// ROS 2's names of a field.
pub(crate) fn ros2_name(name: &str) -> String {
    // CameraInfo's D, K, R and P.
    name.to_ascii_lowercase()
}

/// Whether ROS 2 has the field: its headers are not numbered.
pub(crate) fn in_ros2(of: &str, field: &str) -> bool {
    !(of == HEADER && field == "seq")
}

impl Sink for Cdr {
    fn enter(&mut self, _: &str) {}

    fn leave(&mut self, _: &str) {}

    fn field(&mut self, of: &str, field: &Field) -> bool {
        self.shift.in_header = false;
        for added in super::ros2::added_before(of, &field.name) {
            (added.empty)(self);
        }
        self.shift.in_header = of == HEADER;
        in_ros2(of, &field.name)
    }

    fn plain(&mut self, size: usize, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.align(size);
            self.bytes.extend_from_slice(bytes);
        }
    }

    fn text(&mut self, bytes: &[u8]) {
        self.count(u32::try_from(bytes.len() + 1).unwrap_or(u32::MAX));
        self.bytes.extend_from_slice(bytes);
        self.bytes.push(0);
    }

    fn time(&mut self, whole: u32, fraction: u32) {
        let (whole, fraction) = self.shift.of(whole, fraction);
        self.count(whole);
        self.count(fraction);
    }

    fn count(&mut self, count: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&count.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::super::definition::Definition;
    use super::super::walk::walk;
    use super::*;

    const TEXT: &str = "Header header\nuint8 small\nfloat64 large\ntime other\nstring[] words\n\
        ================================================================================\n\
        MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n";

    fn message() -> Vec<u8> {
        let mut bytes = Vec::new();
        // Number, stamp zero, "ab"; 7; 1.5; no other time; one word.
        for word in [9_u32, 0, 0, 2] {
            bytes.extend_from_slice(&word.to_le_bytes());
        }
        bytes.extend_from_slice(b"ab\x07");
        bytes.extend_from_slice(&1.5_f64.to_le_bytes());
        for word in [0_u32, 0, 1, 1] {
            bytes.extend_from_slice(&word.to_le_bytes());
        }
        bytes.push(b'x');
        bytes
    }

    #[test]
    fn a_headers_zero_is_the_beginning_and_another_zero_is_none() {
        let definition = Definition::read("a/B", TEXT).unwrap();
        let mut same = Ros1::new(3_000_000_004);
        walk(&definition, &message(), &mut same).unwrap();
        let mut expected = message();
        expected[4..12].copy_from_slice(&[3, 0, 0, 0, 4, 0, 0, 0]);
        assert_eq!(same.bytes, expected);
    }

    /// By the rules of CDR, counted by hand.
    #[test]
    fn cdr_aligns_numbers_and_ends_texts() {
        let definition = Definition::read("a/B", TEXT).unwrap();
        let mut cdr = Cdr::new(3_000_000_004);
        walk(&definition, &message(), &mut cdr).unwrap();
        let mut expected = vec![0, 1, 0, 0];
        expected.extend_from_slice(&[3, 0, 0, 0, 4, 0, 0, 0, 3, 0, 0, 0]);
        expected.extend_from_slice(b"ab\0\x07");
        expected.extend_from_slice(&1.5_f64.to_le_bytes());
        expected.extend_from_slice(&[0; 8]);
        expected.extend_from_slice(&[1, 0, 0, 0, 2, 0, 0, 0]);
        expected.extend_from_slice(b"x\0");
        assert_eq!(cdr.into_bytes(), expected);
    }

    #[test]
    fn what_is_too_short_or_too_long_is_refused() {
        let definition = Definition::read("a/B", TEXT).unwrap();
        let whole = message();
        for length in 0..whole.len() {
            let walked = walk(&definition, &whole[..length], &mut Cdr::new(0));
            assert!(walked.is_err(), "{length}");
        }
        let long = [&whole[..], &[0]].concat();
        assert!(walk(&definition, &long, &mut Cdr::new(0)).is_err());
    }
}
