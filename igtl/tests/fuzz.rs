//! Damaged messages: no panic, and no more memory than one message takes.

mod samples;

use igtl::{HEADER, Message, Reader, crc64};

/// Damaged messages that are tried.
const TRIED: u32 = if cfg!(debug_assertions) {
    20_000
} else {
    1_000_000
};
/// Largest body that the reader takes \[bytes\].
const LIMIT: usize = 64 << 10;

/// xorshift64*: the same damage in every run.
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn below(&mut self, n: usize) -> usize {
        let n = n.max(1) as u64;
        usize::try_from(self.next() % n).unwrap_or(0)
    }
}

/// Changes a message in one of the ways in which one can be wrong.
fn damage(bytes: &mut Vec<u8>, chance: &mut Chance) {
    for _ in 0..=chance.below(4) {
        let at = chance.below(bytes.len());
        match chance.below(6) {
            0 => bytes[at] ^= 1 << chance.below(8),
            1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][chance.below(5)],
            2 => bytes.truncate(at.max(1)),
            3 => {
                let piece = bytes[at..].to_vec();
                let to = chance.below(bytes.len());
                bytes.splice(to..to, piece);
            }
            4 => {
                // A number of four bytes, where counts and sizes stand.
                let at = HEADER + 4 * chance.below(12);
                let value = [0, 1, 0xffff, u32::MAX, 0x4000_0000][chance.below(5)];
                if let Some(place) = bytes.get_mut(at..at + 4) {
                    place.copy_from_slice(&value.to_be_bytes());
                }
            }
            _ => {
                let n = chance.below(64);
                bytes.extend((0..n).map(|_| chance.next().to_be_bytes()[0]));
            }
        }
        bytes.truncate(2 * LIMIT);
    }
}

/// Makes header and body agree, so that the damage reaches what reads the content.
fn reseal(bytes: &mut [u8]) {
    if bytes.len() < HEADER {
        return;
    }
    let size = (bytes.len() - HEADER) as u64;
    let crc = crc64(&bytes[HEADER..]);
    bytes[42..50].copy_from_slice(&size.to_be_bytes());
    bytes[50..58].copy_from_slice(&crc.to_be_bytes());
}

/// Memory of this process \[kB\], where the system tells.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[test]
fn damaged_messages_neither_panic_nor_pile_up() {
    let originals: Vec<Vec<u8>> = samples::messages()
        .iter()
        .map(|message| message.encode().unwrap())
        .collect();
    let mut chance = Chance(0x9e37_79b9_7f4a_7c15);
    let (mut whole, mut refused, mut lost) = (0_u32, 0_u32, 0_u32);
    let mut reader = Reader::new(LIMIT);
    let mut before = None;
    for i in 0..TRIED {
        let mut bytes = originals[chance.below(originals.len())].clone();
        damage(&mut bytes, &mut chance);
        if chance.below(4) > 0 {
            reseal(&mut bytes);
        }
        let piece = 1 + chance.below(512);
        for mut piece in bytes.chunks(piece) {
            while !piece.is_empty() {
                match reader.push(&mut piece) {
                    Some(Ok(message)) => {
                        whole += 1;
                        // What was read can be written, but for names that are too long now that
                        // what was no text in them is replaced.
                        if let Ok(again) = message.encode() {
                            assert!(Message::decode(&again).is_ok());
                        }
                    }
                    Some(Err(_)) => refused += 1,
                    None => {}
                }
            }
        }
        assert!(reader.memory() <= 2 * (HEADER + LIMIT));
        if reader.is_lost() || chance.below(8) == 0 {
            lost += u32::from(reader.is_lost());
            reader = Reader::new(LIMIT);
        }
        if i == TRIED / 10 {
            before = resident();
        }
    }
    let each = TRIED / 50;
    assert!(
        whole > each && refused > each && lost > each,
        "{whole} {refused} {lost}"
    );
    if let (Some(before), Some(after)) = (before, resident()) {
        assert!(after < before + 4096, "from {before} to {after} kB");
    }
}
