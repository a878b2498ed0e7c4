//! Big-endian numbers and padded texts, read with bounds and written.

use crate::error::{Reject, Unsendable};

/// Reads fields from the front of a slice.
pub(crate) struct Fields<'a> {
    rest: &'a [u8],
}

macro_rules! numbers {
    ($($name:ident: $type:ty),*) => {$(
        pub(crate) fn $name(&mut self, field: &'static str) -> Result<$type, Reject> {
            self.array(field).map(<$type>::from_be_bytes)
        }
    )*};
}

impl<'a> Fields<'a> {
    pub(crate) const fn new(rest: &'a [u8]) -> Self {
        Self { rest }
    }

    numbers! { u8: u8, u16: u16, u32: u32, u64: u64, i64: i64, f32: f32 }

    pub(crate) fn bytes(&mut self, n: usize, field: &'static str) -> Result<&'a [u8], Reject> {
        let (head, rest) = self
            .rest
            .split_at_checked(n)
            .ok_or(Reject::Truncated { field })?;
        self.rest = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], Reject> {
        let (head, rest) = self
            .rest
            .split_first_chunk()
            .ok_or(Reject::Truncated { field })?;
        self.rest = rest;
        Ok(*head)
    }

    pub(crate) fn floats<const N: usize>(
        &mut self,
        field: &'static str,
    ) -> Result<[f32; N], Reject> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f32(field)?;
        }
        Ok(values)
    }

    /// A text in a field of `n` bytes, padded with zeros.
    pub(crate) fn padded(&mut self, n: usize, field: &'static str) -> Result<String, Reject> {
        text(self.bytes(n, field)?, field)
    }

    /// A text that a zero byte ends.
    pub(crate) fn terminated(&mut self, field: &'static str) -> Result<String, Reject> {
        let end = self.rest.iter().position(|&byte| byte == 0);
        let end = end.ok_or(Reject::Truncated { field })?;
        let found = self.bytes(end, field)?;
        self.u8(field)?;
        text(found, field)
    }

    pub(crate) const fn remaining(&self) -> usize {
        self.rest.len()
    }

    pub(crate) fn end(&self) -> Result<(), Reject> {
        match self.rest.len() {
            0 => Ok(()),
            bytes => Err(Reject::Trailing { bytes }),
        }
    }
}

/// The text before the first zero byte.
pub(crate) fn text(bytes: &[u8], field: &'static str) -> Result<String, Reject> {
    let end = bytes.iter().position(|&byte| byte == 0);
    let found = &bytes[..end.unwrap_or(bytes.len())];
    std::str::from_utf8(found)
        .map(str::to_owned)
        .map_err(|_| Reject::Text { field })
}

pub(crate) fn put_floats(out: &mut Vec<u8>, values: &[f32]) {
    for value in values {
        out.extend_from_slice(&value.to_be_bytes());
    }
}

/// A text in a field of `n` bytes, padded with zeros.
pub(crate) fn put_padded(
    out: &mut Vec<u8>,
    value: &str,
    n: usize,
    field: &'static str,
) -> Result<(), Unsendable> {
    without_zero(value, field)?;
    if value.len() > n {
        return Err(Unsendable::Long {
            field,
            bytes: value.len(),
            limit: n,
        });
    }
    out.extend_from_slice(value.as_bytes());
    out.resize(out.len() + n - value.len(), 0);
    Ok(())
}

pub(crate) fn without_zero(value: &str, field: &'static str) -> Result<(), Unsendable> {
    if value.contains('\0') {
        return Err(Unsendable::Zero { field });
    }
    Ok(())
}

/// A length as a number on the wire.
pub(crate) fn count<T: TryFrom<usize>>(
    found: usize,
    limit: usize,
    field: &'static str,
) -> Result<T, Unsendable> {
    T::try_from(found).map_err(|_| Unsendable::Many {
        field,
        found,
        limit,
    })
}
