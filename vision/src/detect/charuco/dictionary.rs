//! The markers of a `ChArUco` board: OpenCV's predefined dictionaries.

use core::fmt;
use core::str::FromStr;

/// Bits of all dictionaries, with their source.
const BITS: &str = include_str!("dictionaries.txt");
/// Sizes of the dictionaries that OpenCV names.
const COUNTS: [usize; 3] = [50, 100, 250];

/// A predefined dictionary: the first `count` markers of `side` x `side` bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dictionary {
    side: usize,
    count: usize,
}

impl Dictionary {
    /// Bits along a marker's side, without its black border.
    pub const fn side(self) -> usize {
        self.side
    }

    /// Number of markers.
    pub const fn count(self) -> usize {
        self.count
    }

    /// The markers' bits, row by row, the first the most significant; white is 1.
    pub fn codes(self) -> Vec<u64> {
        let name = format!("[{}]", self.side);
        let words = BITS
            .lines()
            .skip_while(|line| *line != name)
            .skip(1)
            .take_while(|line| !line.starts_with('['))
            .flat_map(str::split_whitespace);
        words
            .filter_map(|word| u64::from_str_radix(word, 16).ok())
            .take(self.count)
            .collect()
    }

    /// Wrong bits with which a marker still counts: half of what OpenCV corrects, because a board
    /// needs two markers that agree and no marker has to be saved.
    pub(super) const fn wrong_bits(self) -> u32 {
        match self.side {
            4 => 0,
            5 => 1,
            _ => 3,
        }
    }
}

/// A name that is no supported dictionary.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "dictionary {0}: expected DICT_4X4_50, DICT_5X5_100, DICT_6X6_250 or another of these with \
     50, 100 or 250 markers"
)]
pub struct UnknownDictionary(String);

impl FromStr for Dictionary {
    type Err = UnknownDictionary;

    /// OpenCV's name, `DICT_` not needed.
    fn from_str(text: &str) -> Result<Self, UnknownDictionary> {
        let upper = text.trim().to_uppercase();
        let name = upper.strip_prefix("DICT_").unwrap_or(&upper);
        let parsed = name.split_once('_').and_then(|(bits, count)| {
            let (a, b) = bits.split_once('X')?;
            let side = a.parse().ok().filter(|side| (4..=6).contains(side))?;
            let count = count.parse().ok().filter(|count| COUNTS.contains(count))?;
            (a == b).then_some(Self { side, count })
        });
        parsed.ok_or_else(|| UnknownDictionary(text.to_owned()))
    }
}

impl fmt::Display for Dictionary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "DICT_{0}X{0}_{1}", self.side, self.count)
    }
}

/// A marker of `side` x `side` bits after a quarter turn clockwise.
pub(super) fn turned(code: u64, side: usize) -> u64 {
    let bit = |row: usize, col: usize| code >> (side * side - 1 - row * side - col) & 1;
    let mut out = 0;
    for row in 0..side {
        for col in 0..side {
            out = out << 1 | bit(side - 1 - col, row);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_dictionary_is_whole_and_no_marker_is_another_turned() {
        for (name, side) in [("DICT_4X4_250", 4), ("5x5_250", 5), ("DICT_6X6_250", 6)] {
            let dictionary: Dictionary = name.parse().unwrap();
            let codes = dictionary.codes();
            assert_eq!((codes.len(), dictionary.side()), (250, side));
            for (k, &code) in codes.iter().enumerate() {
                assert!(code < 1 << (side * side));
                let mut other = code;
                for _ in 0..3 {
                    other = turned(other, side);
                    assert!(!codes.contains(&other), "{k}");
                }
                assert_eq!(turned(other, side), code);
            }
        }
        // Marker 0 of the first, as printed: .#.## ... its second row from the top begins dark.
        assert_eq!("4X4_50".parse::<Dictionary>().unwrap().codes()[0], 0xb532);
        for wrong in ["DICT_7X7_50", "4X5_50", "4X4_60", "APRILTAG_36H11"] {
            assert!(wrong.parse::<Dictionary>().is_err());
        }
    }
}
