//! The checksum of a message's body.

/// Generator of ECMA-182, without its highest term.
const POLYNOMIAL: u64 = 0x42f0_e1eb_a9ea_3693;

static TABLE: [u64; 256] = table();

const fn table() -> [u64; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut rest = (byte as u64) << 56;
        let mut bit = 0;
        while bit < 8 {
            let carry = rest >> 63 == 1;
            rest <<= 1;
            if carry {
                rest ^= POLYNOMIAL;
            }
            bit += 1;
        }
        table[byte] = rest;
        byte += 1;
    }
    table
}

/// CRC-64 of ECMA-182: highest bit first, from zero, nothing inverted.
pub fn crc64(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |rest, &byte| {
        let [top, ..] = rest.to_be_bytes();
        (rest << 8) ^ TABLE[usize::from(top ^ byte)]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_value_of_the_catalogue_comes_out() {
        // CRC-64/ECMA-182 in the catalogue of parametrised CRC algorithms.
        assert_eq!(crc64(b"123456789"), 0x6c40_df5f_0b49_7347);
        assert_eq!(crc64(b""), 0);
    }
}
