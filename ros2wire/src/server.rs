//! A service: requests on one topic, replies on another.
//!
//! ROS 2's middlewares differ in how a client knows its own reply. `rmw_fastrtps` and `rmw_connextdds`
//! name the request in the reply's metadata; `rmw_cyclonedds` puts sixteen bytes before request and reply,
//! which the reply repeats. A request says by its length which it is, and is answered alike, so that
//! clients of both are served.

use rustdds::rpc::SampleIdentity;
use rustdds::{GUID, SequenceNumber};

use crate::names;
use crate::participant::{Participant, WireError};
use crate::quality::Quality;
use crate::topic::{Arrived, Reader};

/// Requests and replies that are kept.
const DEPTH: u16 = 10;
/// What Cyclone's middleware puts before a message: half of a client's number, and a request's number.
const CYCLONE: usize = 16;

/// A service, offered until it is dropped.
#[derive(Debug)]
pub struct Server {
    _requests: Reader,
}

impl Server {
    /// Offers the service of this full name, of a type `package/Name`. `handler` makes a reply of a
    /// request, both in CDR, little endian; nothing where that is no such request. It runs on the
    /// service's own thread.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow, or DDS refuses.
    pub fn offer(
        participant: &Participant,
        service: &str,
        kind: &str,
        handler: impl Fn(&[u8]) -> Option<Vec<u8>> + Send + 'static,
    ) -> Result<Self, WireError> {
        names::check(service)?;
        let [request, response] = names::service_types(kind);
        let quality = Quality::Event(DEPTH);
        let replies = participant.raw_writer(&names::replies(service), &response, quality)?;
        let requests = participant.raw_reader(&names::requests(service), &request, quality)?;
        let requests = Reader::start(participant.clone(), requests, service, move |arrived| {
            if let Some(reply) = reply(&arrived.payload, &handler) {
                replies.answer(reply, client(&arrived), arrived.writer);
            }
        })?;
        Ok(Self {
            _requests: requests,
        })
    }
}

/// The reply to a request of either kind.
fn reply(request: &[u8], handler: impl Fn(&[u8]) -> Option<Vec<u8>>) -> Option<Vec<u8>> {
    if let Some(reply) = handler(request) {
        return Some(reply);
    }
    let (head, request) = request.split_at_checked(CYCLONE)?;
    Some([head, &handler(request)?].concat())
}

/// Whose reply it is: as a client of Fast DDS names itself, else by the request.
fn client(request: &Arrived) -> SampleIdentity {
    let named = request
        .related
        .filter(|related| related.writer_guid != GUID::GUID_UNKNOWN);
    SampleIdentity {
        writer_guid: named.map_or(request.writer, |related| related.writer_guid),
        sequence_number: named
            .map(|related| related.sequence_number)
            .filter(|&number| number != SequenceNumber::UNKNOWN && i64::from(number) > 0)
            .unwrap_or(request.number),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::time::Duration;

    use super::*;
    use crate::graph::Gids;
    use crate::names::{Arguments, Names};
    use crate::participant::Settings;

    #[test]
    fn a_client_whose_reader_is_found_after_its_request_is_answered() {
        let domain = 101;
        let settings = Settings {
            domain,
            loopback: true,
            gids: Gids::Short,
        };
        let join = |name| {
            let names = Names::new(name, &Arguments::default()).unwrap();
            Participant::join(&settings, names).unwrap()
        };
        let (server, client) = (join("server"), join("client"));
        let (asked, requests) = channel();
        let kind = "std_srvs/Trigger";
        let _offered = Server::offer(&server, "/s", kind, move |request: &[u8]| {
            asked.send(()).unwrap();
            Some(request.to_vec())
        });
        let [request, response] = names::service_types(kind);
        let quality = Quality::Event(DEPTH);
        let writer = client.raw_writer(&names::requests("/s"), &request, quality);
        let writer = writer.unwrap();
        while writer.readers() == 0 {
            std::thread::park_timeout(Duration::from_millis(5));
        }
        assert!(writer.send(vec![0; 20]));
        requests.recv_timeout(Duration::from_secs(10)).unwrap();
        let (heard, replies) = channel();
        let reader = client.raw_reader(&names::replies("/s"), &response, quality);
        let _reader = Reader::start(client.clone(), reader.unwrap(), "/s", move |arrived| {
            heard.send(arrived.payload).unwrap();
        });
        let reply = replies.recv_timeout(Duration::from_secs(10)).unwrap();
        assert_eq!(reply[..], [0; 20]);
    }

    #[test]
    fn requests_of_both_kinds_are_answered_alike() {
        let handler = |request: &[u8]| (request == [7]).then(|| vec![1, 2]);
        assert_eq!(reply(&[7], handler), Some(vec![1, 2]));
        let mut cyclone = [9; 17];
        cyclone[16] = 7;
        let expected = [&[9; 16][..], &[1, 2]].concat();
        assert_eq!(reply(&cyclone, handler), Some(expected));
        assert_eq!(reply(&[8], handler), None);
        assert_eq!(reply(&[9; 17], handler), None);
    }
}
