//! Reading and writing the fields of a body in one description.

/// Order of the bytes in a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// Most significant byte first; the Viper's controller.
    Big,
    /// Least significant byte first; some other ROS-Industrial controllers.
    Little,
}

impl ByteOrder {
    /// The other order.
    #[must_use]
    pub const fn swapped(self) -> Self {
        match self {
            Self::Big => Self::Little,
            Self::Little => Self::Big,
        }
    }

    /// Four bytes of an integer.
    pub const fn bytes(self, value: i32) -> [u8; 4] {
        match self {
            Self::Big => value.to_be_bytes(),
            Self::Little => value.to_le_bytes(),
        }
    }

    /// The integer of four bytes.
    pub const fn integer(self, bytes: [u8; 4]) -> i32 {
        match self {
            Self::Big => i32::from_be_bytes(bytes),
            Self::Little => i32::from_le_bytes(bytes),
        }
    }
}

/// One direction of a body: a writer or a reader.
pub trait Codec {
    /// The next integer.
    fn i32(&mut self, value: &mut i32);

    /// The next real: IEEE 754 single precision.
    #[expect(
        clippy::cast_sign_loss,
        clippy::cast_possible_wrap,
        reason = "a copy of the bits"
    )]
    fn f32(&mut self, value: &mut f32) {
        let mut bits = value.to_bits() as i32;
        self.i32(&mut bits);
        *value = f32::from_bits(bits as u32);
    }

    /// A row of integers.
    fn i32s(&mut self, values: &mut [i32]) {
        for value in values {
            self.i32(value);
        }
    }

    /// A row of reals.
    fn f32s(&mut self, values: &mut [f32]) {
        for value in values {
            self.f32(value);
        }
    }
}

/// The body of a message.
pub trait Body: Copy + Default {
    /// Bytes on the wire.
    const SIZE: usize;

    /// Visits all fields in the order of the wire.
    fn visit(&mut self, codec: &mut impl Codec);
}

/// Writes to a slice; what does not fit is dropped (sizes are checked by tests).
pub(super) struct Writer<'a> {
    pub(super) rest: &'a mut [u8],
    pub(super) order: ByteOrder,
}

impl Codec for Writer<'_> {
    fn i32(&mut self, value: &mut i32) {
        if let Some((head, tail)) = std::mem::take(&mut self.rest).split_first_chunk_mut() {
            *head = self.order.bytes(*value);
            self.rest = tail;
        }
    }
}

/// Reads from a slice; leaves fields alone that it does not hold.
pub(super) struct Reader<'a> {
    pub(super) rest: &'a [u8],
    pub(super) order: ByteOrder,
}

impl Codec for Reader<'_> {
    fn i32(&mut self, value: &mut i32) {
        if let Some((head, tail)) = self.rest.split_first_chunk() {
            *value = self.order.integer(*head);
            self.rest = tail;
        }
    }
}
