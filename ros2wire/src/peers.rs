//! Which other participants write to a topic, and which of those have died without a word.
//!
//! A participant that is killed stays known until its lease ends (ten seconds to a minute). On the own
//! computer the port at which it was reached tells sooner: nobody holds it, or another one.

use std::collections::HashMap;
use std::net::{SocketAddrV4, UdpSocket};
use std::time::Instant;

use rustdds::DomainParticipant;
use rustdds::discovery::DiscoveredWriterData;

use crate::graph::{Guid, prefix};

/// RTPS's numbering of ports.
const FIRST_PORT: u32 = 7400;
const PORTS_OF_A_DOMAIN: u32 = 250;
const USER_UNICAST: u32 = 11;
const PORTS_OF_A_PARTICIPANT: u32 = 2;

/// Writers of other participants to a topic (in DDS's words), as far as they live.
pub(crate) fn writers(dds: &DomainParticipant, own: &Guid, topic: &str) -> Vec<Guid> {
    let known = dds.discovered_writers();
    let holders = holders(&known);
    let own_port = FIRST_PORT
        + PORTS_OF_A_DOMAIN * u32::from(dds.domain_id())
        + USER_UNICAST
        + PORTS_OF_A_PARTICIPANT * u32::from(dds.participant_id());
    known
        .iter()
        .filter(|writer| writer.publication_topic_data.topic_name == topic)
        .filter(|writer| {
            let guid = writer.writer_proxy.remote_writer_guid.to_bytes();
            let addresses = addresses(writer);
            let replaced = addresses.iter().any(|address| {
                u32::from(address.port()) == own_port
                    || holders
                        .get(address)
                        .is_some_and(|(_, last)| *last != prefix(&guid))
            });
            let gone = !addresses.is_empty() && addresses.iter().copied().all(is_free);
            prefix(&guid) != prefix(own) && !replaced && !gone
        })
        .map(|writer| writer.writer_proxy.remote_writer_guid.to_bytes())
        .collect()
}

/// Who was last said to be reached at each address of this computer.
fn holders(known: &[DiscoveredWriterData]) -> HashMap<SocketAddrV4, (Instant, [u8; 12])> {
    let mut holders = HashMap::new();
    for writer in known {
        let last = prefix(&writer.writer_proxy.remote_writer_guid.to_bytes());
        for address in addresses(writer) {
            let holder = holders
                .entry(address)
                .or_insert((writer.last_updated, last));
            if writer.last_updated > holder.0 {
                *holder = (writer.last_updated, last);
            }
        }
    }
    holders
}

/// Where a writer's participant is reached on this computer; nothing if it is reached elsewhere, too.
fn addresses(writer: &DiscoveredWriterData) -> Vec<SocketAddrV4> {
    let locators = &writer.writer_proxy.unicast_locator_list;
    let here: Vec<_> = locators
        .iter()
        .filter_map(|locator| match std::net::SocketAddr::from(*locator) {
            std::net::SocketAddr::V4(address) if locator.is_loopback() => Some(address),
            _ => None,
        })
        .collect();
    if here.len() == locators.len() {
        here
    } else {
        Vec::new()
    }
}

/// Whether nobody on this computer holds a port: then it can be had, for a moment.
fn is_free(address: SocketAddrV4) -> bool {
    UdpSocket::bind(address).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_free_when_nobody_holds_it() {
        let held = UdpSocket::bind("0.0.0.0:0").unwrap();
        let port = held.local_addr().unwrap().port();
        let address = SocketAddrV4::new(std::net::Ipv4Addr::LOCALHOST, port);
        assert!(!is_free(address));
        drop(held);
        assert!(is_free(address));
    }
}
