//! OpenIGTLink: messages of image-guided therapy as bytes and back, without any I/O.
//!
//! Trackers, imaging and robots of an operating room speak it, mostly by 3D Slicer and PLUS.
//! Written from the protocol's published description (<https://github.com/openigtlink/OpenIGTLink>,
//! Documents/Protocol); checked against `pyigtl` and against Debian's reference library.
//!
//! * [`Message`]: one message with its header, its [`Body`] and, in header version 2, its number
//!   and metadata; [`Message::encode`] and [`Message::decode`].
//! * [`Reader`]: messages out of a stream of bytes, with memory bounded by one message.
//! * [`Reject`]: why bytes are no message.
//!
//! Protocol versions 1 and 2 have header version 1, protocol version 3 has header version 2: an
//! extended header before the content, and metadata after it. Lengths are in millimetres, as on the
//! wire; which way the axes point is not said there, and no business of this crate.
//!
//! ```
//! use igtl::{Body, Message, Reader, Transform};
//!
//! let sent = Message::new("Tip", Body::Transform(Transform::at([1.0, 2.0, 3.0])));
//! let bytes = sent.encode()?;
//! let mut reader = Reader::new(64 << 10);
//! let received = reader.push(&mut bytes.as_slice()).unwrap()?;
//! assert_eq!(received, sent);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! **Architecture invariant:** no I/O, no clock, no thread.

mod body;
mod crc;
mod error;
mod header;
mod message;
mod reader;
mod stamp;
mod wire;

pub use body::image::{Coordinates, Image, Scalar};
pub use body::point::Point;
pub use body::polydata::{Attribute, PolyData};
pub use body::pose::{Position, Transform};
pub use body::status::{Status, StatusCode};
pub use body::text::{ASCII, Text, UTF_8};
pub use body::trajectory::{Ends, Trajectory};
pub use body::{Body, Colour};
pub use crc::crc64;
pub use error::{Reject, Unsendable};
pub use header::{HEADER, Header};
pub use message::{Extension, Message, MetaValue};
pub use reader::Reader;
pub use stamp::Timestamp;

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
