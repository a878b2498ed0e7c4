//! Two participants in one process, on the loopback interface, in a domain of their own.
#![expect(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "tests of live threads: they wait, and fail by panicking"
)]

use std::net::UdpSocket;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use ros2wire::names::{Arguments, Names};
use ros2wire::{Gids, Participant, Quality, Reader, Server, Settings};

/// Participants of one test do not meet those of another.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn domain() -> (MutexGuard<'static, ()>, u16) {
    let alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let first = std::process::id() % 100;
    let number = (0..100)
        .map(|i| u16::try_from((first + i) % 100 + 1).unwrap())
        .find(|number| UdpSocket::bind(("0.0.0.0", 7410 + 250 * number)).is_ok());
    (alone, number.unwrap())
}

fn join(domain: u16, name: &str) -> Participant {
    let settings = Settings {
        domain,
        loopback: true,
        gids: Gids::Short,
    };
    Participant::join(&settings, Names::new(name, &Arguments::default()).unwrap()).unwrap()
}

fn wait_until(mut done: impl FnMut() -> bool) -> bool {
    let end = Instant::now() + Duration::from_secs(10);
    while Instant::now() < end {
        if done() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    done()
}

fn listen(
    to: &Participant,
    topic: &str,
    quality: Quality,
) -> (Reader, Receiver<(Vec<u8>, String)>) {
    let (heard, messages) = channel();
    let reader = to
        .reader(topic, "std_msgs/String", quality, move |sample| {
            // The test may have ended.
            let _ = heard.send((sample.payload.to_vec(), sample.from.to_owned()));
        })
        .unwrap();
    (reader, messages)
}

#[test]
fn messages_arrive_with_their_senders_name_and_latched_ones_late() {
    let (_alone, domain) = domain();
    let (here, there) = (join(domain, "here"), join(domain, "there"));
    let latched = here
        .writer("/still", "std_msgs/String", Quality::Latched(1))
        .unwrap();
    for payload in [b"old.", b"new."] {
        assert!(latched.send(payload.to_vec()));
    }
    let (_still, still) = listen(&there, "/still", Quality::Latched(1));
    // Lately sent ones may come before the last, as RustDDS clears them out now and then.
    let (mut payload, from) = still.recv_timeout(Duration::from_secs(10)).unwrap();
    if payload == b"old." {
        payload = still.recv_timeout(Duration::from_secs(10)).unwrap().0;
    }
    assert_eq!(payload, b"new.");
    assert!(from.starts_with("/here ("), "{from}");
    let writer = here
        .writer("/words", "std_msgs/String", Quality::Event(10))
        .unwrap();
    let (_words, words) = listen(&there, "/words", Quality::Stream(10));
    assert!(wait_until(|| writer.readers() == 1));
    for n in 0..10_u8 {
        assert!(writer.send(vec![n; 4]));
    }
    for n in 0..10_u8 {
        let (payload, _) = words.recv_timeout(Duration::from_secs(10)).unwrap();
        assert_eq!(payload, [n; 4]);
    }
    // As large as an image.
    let large: Vec<u8> = (0..1_000_000_u32).map(|n| n.to_le_bytes()[0]).collect();
    assert!(writer.send(large.clone()));
    let (payload, _) = words.recv_timeout(Duration::from_secs(10)).unwrap();
    assert!(payload == large, "{} bytes", payload.len());
    // A reader that asks for reliability does not hear who offers none.
    let offers = here
        .writer("/lossy", "std_msgs/String", Quality::Stream(1))
        .unwrap();
    let (_asks, _nothing) = listen(&there, "/lossy", Quality::Event(1));
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(offers.readers(), 0);
}

#[test]
fn other_writers_are_known_until_they_leave() {
    let (_alone, domain) = domain();
    let here = join(domain, "here");
    assert!(here.other_writers("/words").is_empty());
    let there = join(domain, "there");
    let _own = here
        .writer("/words", "std_msgs/String", Quality::Event(1))
        .unwrap();
    let writer = there
        .writer("/words", "std_msgs/String", Quality::Event(1))
        .unwrap();
    // Which node a writer is of is told by another message.
    let named = |others: &[String]| others.iter().any(|other| other.starts_with("/there ("));
    let known = wait_until(|| named(&here.other_writers("/words")));
    let others = here.other_writers("/words");
    assert!(known, "{others:?}");
    assert_eq!(others.len(), 1);
    drop((writer, there));
    assert!(wait_until(|| here.other_writers("/words").is_empty()));
}

/// A client as Fast DDS makes one: the request is known by its writer and number, or by a reader that it
/// names, and the reply says which it answers.
#[test]
fn clients_of_fast_dds_are_answered_by_name() {
    use rustdds::no_key::{DataWriter, SimpleDataReader};
    use rustdds::policy::{History, Reliability};
    use rustdds::rpc::SampleIdentity;
    use rustdds::{
        DomainParticipantBuilder, GUID, QosPolicyBuilder, SequenceNumber, TopicKind,
        WriteOptionsBuilder,
    };

    let (_alone, domain) = domain();
    let here = join(domain, "here");
    let _server = Server::offer(&here, "/here/start", "std_srvs/Trigger", |request| {
        // One byte that means nothing; the reply says yes, with a text.
        (request.len() <= 4).then(|| vec![1, 0, 0, 0, 3, 0, 0, 0, b'o', b'k', 0])
    })
    .unwrap();
    let qos = QosPolicyBuilder::new()
        .reliability(Reliability::Reliable {
            max_blocking_time: rustdds::Duration::ZERO,
        })
        .history(History::KeepLast { depth: 10 })
        .build();
    let client = DomainParticipantBuilder::new(domain)
        .with_only_networks([std::net::Ipv4Addr::LOCALHOST])
        .build()
        .unwrap();
    let topic = |name: &str, part: &str| {
        let kind = format!("std_srvs::srv::dds_::Trigger_{part}_");
        client
            .create_topic(name.to_owned(), kind, &qos, TopicKind::NoKey)
            .unwrap()
    };
    let writer: DataWriter<u8> = client
        .create_publisher(&qos)
        .unwrap()
        .create_datawriter_no_key_cdr(&topic("rq/here/startRequest", "Request"), None)
        .unwrap();
    let reader: SimpleDataReader<(bool, String)> = client
        .create_subscriber(&qos)
        .unwrap()
        .create_simple_datareader_no_key(&topic("rr/here/startReply", "Response"), None)
        .unwrap();
    std::thread::sleep(Duration::from_secs(1));
    for named in [GUID::GUID_UNKNOWN, reader.guid()] {
        let options = WriteOptionsBuilder::new().related_sample_identity(SampleIdentity {
            writer_guid: named,
            sequence_number: SequenceNumber::UNKNOWN,
        });
        let asked = writer.write_with_options(0, options.build()).unwrap();
        let mut reply = None;
        let answered = wait_until(|| {
            reader.drain_read_notifications();
            reply = reader.try_take_one().unwrap();
            reply.is_some()
        });
        assert!(answered, "no reply");
        let reply = reply.unwrap();
        let expected = SampleIdentity {
            writer_guid: if named == GUID::GUID_UNKNOWN {
                asked.writer_guid
            } else {
                named
            },
            ..asked
        };
        assert_eq!(reply.related_sample_identity(), Some(expected));
        assert_eq!(reply.into_value(), (true, "ok".to_owned()));
    }
}
