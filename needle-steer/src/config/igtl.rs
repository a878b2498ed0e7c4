//! Keys of the table `igtl`.

use serde::{Deserialize, Serialize};

/// Version of OpenIGTLink that is spoken; all versions are understood.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum IgtlVersion {
    /// Header version 1, which every program reads.
    #[default]
    Two,
    /// Header version 2, with an extended header.
    Three,
}

/// Another version.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("expected 2 or 3, found {0}")]
pub struct UnknownVersion(u8);

impl TryFrom<u8> for IgtlVersion {
    type Error = UnknownVersion;

    fn try_from(version: u8) -> Result<Self, UnknownVersion> {
        match version {
            2 => Ok(Self::Two),
            3 => Ok(Self::Three),
            other => Err(UnknownVersion(other)),
        }
    }
}

impl From<IgtlVersion> for u8 {
    fn from(version: IgtlVersion) -> Self {
        match version {
            IgtlVersion::Two => 2,
            IgtlVersion::Three => 3,
        }
    }
}

/// Axes of the other side's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum IgtlCoordinates {
    /// Right, anterior, superior: World's x, y and z.
    #[default]
    Ras,
    /// Left, posterior, superior.
    Lps,
}

/// OpenIGTLink.
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches of a configuration, each with a key of its own"
)]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Igtl {
    /// Serve the run, whatever the back end.
    pub serve: bool,
    /// Address and port.
    pub address: String,
    /// Let other machines connect: OpenIGTLink has no authentication.
    pub network: bool,
    /// Start at once, else when a client says `START`.
    pub autostart: bool,
    /// Keep the server up after the run, until it is interrupted.
    pub stay: bool,
    /// Protocol version of what is sent.
    pub version: IgtlVersion,
    /// Axes of the other side's frame.
    pub coordinates: IgtlCoordinates,
    /// Name of the device whose `TRANSFORM` or `POINT` is a new target.
    pub target_device: String,
    /// Rate of poses \[Hz\].
    pub poses_hz: f64,
    /// Rate of lines and of the state \[Hz\].
    pub lines_hz: f64,
    /// Highest rate of images \[Hz\].
    pub images_hz: f64,
}

impl Default for Igtl {
    fn default() -> Self {
        Self {
            serve: false,
            address: "127.0.0.1:18944".into(),
            network: false,
            autostart: true,
            stay: true,
            version: IgtlVersion::Two,
            coordinates: IgtlCoordinates::Ras,
            target_device: "NewTarget".into(),
            poses_hz: 30.0,
            lines_hz: 10.0,
            images_hz: 15.0,
        }
    }
}
