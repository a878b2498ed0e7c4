//! Addresses at which a run is served.

use std::net::{SocketAddr, ToSocketAddrs};

/// An address that cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum AddressError {
    /// An address that means nothing.
    #[error("{key} = \"{address}\": no address with a port")]
    Unknown {
        /// Its key.
        key: &'static str,
        /// What it is.
        address: String,
        /// Why.
        source: std::io::Error,
    },
    /// An address that other machines reach.
    #[error(
        "{key} = \"{address}\": other machines reach it, and the protocol knows no authentication: \
         whoever connects commands the needle; {network} = true opens it all the same"
    )]
    Open {
        /// Its key.
        key: &'static str,
        /// What it is.
        address: SocketAddr,
        /// The key that opens it.
        network: &'static str,
    },
}

/// The address that stands in the configuration at `key`; one that other machines reach only where
/// `network`, a key and its value, allows it.
///
/// # Errors
/// See [`AddressError`].
pub(crate) fn resolve(
    key: &'static str,
    address: &str,
    (network, is_open): (&'static str, bool),
) -> Result<SocketAddr, AddressError> {
    let unknown = |source| AddressError::Unknown {
        key,
        address: address.to_owned(),
        source,
    };
    let address = address
        .to_socket_addrs()
        .map_err(unknown)?
        .next()
        .ok_or_else(|| unknown(std::io::ErrorKind::AddrNotAvailable.into()))?;
    if !address.ip().is_loopback() && !is_open {
        return Err(AddressError::Open {
            key,
            address,
            network,
        });
    }
    Ok(address)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_other_machines_reach_is_refused_unless_it_is_opened() {
        let resolve =
            |address, is_open| resolve("igtl.address", address, ("igtl.network", is_open));
        assert!(resolve("127.0.0.1:0", false).is_ok());
        let refused = resolve("0.0.0.0:0", false).unwrap_err().to_string();
        for told in [
            "igtl.address = \"0.0.0.0:0\"",
            "no authentication",
            "igtl.network = true",
        ] {
            assert!(refused.contains(told), "{refused}");
        }
        assert!(resolve("0.0.0.0:0", true).unwrap().ip().is_unspecified());
        let refused = resolve("nonsense", true).unwrap_err().to_string();
        assert!(refused.contains("igtl.address = \"nonsense\""), "{refused}");
    }
}
