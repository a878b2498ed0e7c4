//! A node of ROS 2: messages are turned into CDR and back here, and `ros2wire` carries them.

use std::sync::{Arc, Mutex};

use ros2wire::names::{Arguments, Names};
use ros2wire::{Gids, Participant, Reader, Server, Settings, WireError, Writer};

use super::{
    Domain, NodeError, NodeOptions, Quality, SHUTDOWN_DEADLINE, arguments, lock, sockets, within,
};
use crate::cdr::Converter;

/// What keeps a topic or a service open.
enum Part {
    Reader(#[expect(dead_code, reason = "kept while the node is")] Reader),
    Server(#[expect(dead_code, reason = "kept while the node is")] Server),
    Writer(Arc<Mutex<Option<Writer>>>),
}

/// A node on the wire.
pub(super) struct Ros2 {
    names: Names,
    full: String,
    open: Mutex<Option<Open>>,
}

/// What there is until the node ends.
struct Open {
    participant: Participant,
    parts: Vec<Part>,
}

impl Ros2 {
    /// Joins the domain.
    pub(super) fn connect(options: &NodeOptions, domain: Domain) -> Result<Self, NodeError> {
        let arguments = Arguments::read(arguments::of_ros());
        let refused = |error: WireError| NodeError::Wire {
            reason: reason(&error),
        };
        let names = Names::new(&options.name, &arguments).map_err(|bad| refused(bad.into()))?;
        let settings = Settings {
            domain: domain.number,
            loopback: !options.network,
            gids: if domain.long_gids {
                Gids::Long
            } else {
                Gids::Short
            },
        };
        let join = || Participant::join(&settings, names.clone()).map_err(refused);
        let participant = if options.network {
            join()?
        } else {
            sockets::confined(join).map_err(|error| NodeError::NotConfined {
                reason: error.to_string(),
            })??
        };
        Ok(Self {
            full: names.full(),
            names,
            open: Mutex::new(Some(Open {
                participant,
                parts: Vec::new(),
            })),
        })
    }

    pub(super) fn name(&self) -> &str {
        &self.full
    }

    pub(super) fn resolved(&self, name: &str) -> String {
        self.names.resolve(name)
    }

    pub(super) fn other_publishers(&self, topic: &str) -> Option<Vec<String>> {
        let participant = self.participant()?;
        Some(participant.other_writers(&self.resolved(topic)))
    }

    /// Leaves the domain; a network that hangs does not keep the process from ending.
    pub(super) fn close(&self) {
        let open = lock(&self.open).take();
        let _ = within(SHUTDOWN_DEADLINE, move || {
            for part in open.into_iter().flat_map(|open| open.parts) {
                if let Part::Writer(writer) = &part {
                    *lock(writer) = None;
                }
            }
        });
    }

    fn participant(&self) -> Option<Participant> {
        lock(&self.open)
            .as_ref()
            .map(|open| open.participant.clone())
    }

    /// Opens something unless the node has ended.
    fn add(
        &self,
        name: &str,
        open: impl FnOnce(&Participant, &str) -> Result<Part, WireError>,
    ) -> Result<(), NodeError> {
        let Some(participant) = self.participant() else {
            return Ok(());
        };
        let full = self.resolved(name);
        let part = open(&participant, &full).map_err(|error| NodeError::Register {
            name: full,
            reason: reason(&error),
        })?;
        if let Some(open) = &mut *lock(&self.open) {
            open.parts.push(part);
        }
        Ok(())
    }

    pub(super) fn writer(
        &self,
        topic: &str,
        kind: &str,
        definition: &str,
        quality: Quality,
    ) -> Result<Outgoing, NodeError> {
        let converter = converter(topic, kind, definition)?;
        let writer = Arc::new(Mutex::new(None));
        let kept = Arc::clone(&writer);
        self.add(topic, |participant, full| {
            *lock(&kept) = Some(participant.writer(full, converter.name(), promise(quality))?);
            Ok(Part::Writer(kept))
        })?;
        Ok(Outgoing { converter, writer })
    }

    /// `handler` gets messages as ROS 1 has them, and the sender's name.
    pub(super) fn reader(
        &self,
        topic: &str,
        kind: &str,
        definition: &str,
        quality: Quality,
        handler: impl Fn(&[u8], &str) + Send + 'static,
    ) -> Result<(), NodeError> {
        let converter = converter(topic, kind, definition)?;
        self.add(topic, |participant, full| {
            let name = converter.name().to_owned();
            let reader = participant.reader(full, &name, promise(quality), move |sample| {
                // Nonsense is silence.
                if let Ok(message) = converter.decode(sample.payload) {
                    handler(&message, sample.from);
                }
            })?;
            Ok(Part::Reader(reader))
        })
    }

    /// `handler` makes a reply of a request, both as ROS 1 has them; nothing where it cannot.
    pub(super) fn server(
        &self,
        service: &str,
        kind: &str,
        [request, response]: &[String; 2],
        handler: impl Fn(&[u8]) -> Option<Vec<u8>> + Send + 'static,
    ) -> Result<(), NodeError> {
        let request = converter(service, kind, request)?;
        let response = converter(service, kind, response)?;
        self.add(service, |participant, full| {
            let server = Server::offer(participant, full, kind, move |bytes| {
                let asked = request.decode(bytes).ok()?;
                response.encode(&handler(&asked)?).ok()
            })?;
            Ok(Part::Server(server))
        })
    }
}

/// A topic that the node writes to.
pub(super) struct Outgoing {
    converter: Converter,
    writer: Arc<Mutex<Option<Writer>>>,
}

impl Outgoing {
    /// Hands over a message as ROS 1 has it.
    pub(super) fn send(&self, message: &[u8]) {
        if let (Some(writer), Ok(cdr)) = (&*lock(&self.writer), self.converter.encode(message)) {
            // No room: a reader does not take what it is sent, and the message is dropped.
            writer.send(cdr);
        }
    }

    pub(super) fn readers(&self) -> usize {
        lock(&self.writer).as_ref().map_or(0, Writer::readers)
    }
}

fn converter(name: &str, kind: &str, definition: &str) -> Result<Converter, NodeError> {
    Converter::new(kind, definition).map_err(|error| NodeError::Register {
        name: name.to_owned(),
        reason: error.to_string(),
    })
}

const fn promise(quality: Quality) -> ros2wire::Quality {
    match quality {
        Quality::Stream(kept) => ros2wire::Quality::Stream(kept),
        Quality::Event(kept) => ros2wire::Quality::Event(kept),
        Quality::Latched(kept) => ros2wire::Quality::Latched(kept),
    }
}

/// The chain of causes in one line.
fn reason(error: &WireError) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(next) = cause {
        text = format!("{text}: {next}");
        cause = next.source();
    }
    text
}
