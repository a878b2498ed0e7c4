//! One ROS 2 node as one participant of a DDS domain.

use std::net::Ipv4Addr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use rustdds::dds::CreateError;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, Publisher, RTPSEntity, Subscriber, Topic,
    TopicKind,
};

use crate::graph::{Gids, Graph, Guid, Own, prefix};
use crate::names::{self, BadName, Names};
use crate::peers;
use crate::quality::Quality;
use crate::topic::{Outlet, Raw, RawReader, RawWriter, Reader, Sample, Unchanged, Writer};

/// Topic of the nodes, which is none of ROS's.
const GRAPH: &str = "ros_discovery_info";
const GRAPH_TYPE: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";
/// The highest domain that RTPS's ports leave room for.
const LAST_DOMAIN: u16 = 232;
/// How often a writer's readers are counted.
const COUNTING: Duration = Duration::from_millis(250);
/// Messages of other nodes that wait to be looked at.
const MOST_NODES: u16 = 256;
/// Time in which participants on this computer have found each other.
const SETTLED: Duration = Duration::from_millis(1500);

/// How to join a domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// The domain's number (`ROS_DOMAIN_ID`).
    pub domain: u16,
    /// Whether to be found, and to look for others, on this computer's loopback interface alone.
    pub loopback: bool,
    /// How participants are numbered on the topic of the nodes.
    pub gids: Gids,
}

/// What cannot be had of DDS.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    /// A domain that does not exist.
    #[error("ROS_DOMAIN_ID is {domain}: expected 0 to {LAST_DOMAIN}")]
    Domain {
        /// Its number.
        domain: u16,
    },
    /// A name that ROS 2 does not allow.
    #[error(transparent)]
    Name(#[from] BadName),
    /// DDS refuses.
    #[error("{what}: {source}")]
    Dds {
        /// What was asked for.
        what: String,
        /// Why.
        source: CreateError,
    },
    /// No thread.
    #[error("no thread for a topic")]
    Thread(#[source] std::io::Error),
}

/// A node on the wire. Clones are the same; it leaves the domain with the last of them, and of its
/// readers, writers and servers.
#[derive(Clone)]
pub struct Participant {
    inner: Arc<Inner>,
}

/// A participant, without keeping it.
#[derive(Clone)]
pub(crate) struct WeakParticipant(Weak<Inner>);

struct Inner {
    publisher: Publisher,
    subscriber: Subscriber,
    names: Names,
    guid: Guid,
    own: Mutex<Own>,
    graph: Mutex<Graph>,
    /// Tells the others of this node.
    teller: RawWriter,
    /// Hears what the others tell.
    heard: Mutex<RawReader>,
    joined: Instant,
    /// This node's writers, and when their readers were last counted.
    outlets: Mutex<(Vec<Weak<Outlet>>, Instant)>,
    /// Dropped last: it joins DDS's threads.
    dds: DomainParticipant,
}

impl Participant {
    /// Joins a domain as the node of these names.
    ///
    /// # Errors
    /// No such domain, or DDS does not start.
    #[expect(clippy::disallowed_methods, reason = "discovery takes wall-clock time")]
    pub fn join(settings: &Settings, names: Names) -> Result<Self, WireError> {
        if settings.domain > LAST_DOMAIN {
            return Err(WireError::Domain {
                domain: settings.domain,
            });
        }
        let refused = |source| WireError::Dds {
            what: format!("joining the DDS domain {}", settings.domain),
            source,
        };
        let mut builder = DomainParticipantBuilder::new(settings.domain);
        if settings.loopback {
            builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
        }
        let dds = builder.build().map_err(refused)?;
        let policies = Quality::Latched(1).policies();
        let publisher = dds.create_publisher(&policies).map_err(refused)?;
        let subscriber = dds.create_subscriber(&policies).map_err(refused)?;
        let kind = TopicKind::NoKey;
        let nodes = dds
            .create_topic(GRAPH.to_owned(), GRAPH_TYPE.to_owned(), &policies, kind)
            .map_err(refused)?;
        let teller = publisher
            .create_datawriter_no_key::<Raw, Unchanged>(&nodes, Some(policies))
            .map_err(refused)?;
        // Of every node one message.
        let policies = Quality::Latched(MOST_NODES).policies();
        let heard = subscriber
            .create_simple_datareader_no_key::<Raw, Unchanged>(&nodes, Some(policies))
            .map_err(refused)?;
        let guid = dds.guid().to_bytes();
        let own = Own {
            gids: settings.gids,
            participant: guid,
            namespace: names.namespace(),
            node: names.node().to_owned(),
            readers: Vec::new(),
            writers: Vec::new(),
        };
        let participant = Self {
            inner: Arc::new(Inner {
                publisher,
                subscriber,
                names,
                guid,
                own: Mutex::new(own),
                graph: Mutex::default(),
                teller,
                heard: Mutex::new(heard),
                joined: Instant::now(),
                outlets: Mutex::new((Vec::new(), Instant::now())),
                dds,
            }),
        };
        participant.tell(|_| {});
        Ok(participant)
    }

    /// The node's names.
    pub fn names(&self) -> &Names {
        &self.inner.names
    }

    /// Writes to the topic of this full name, of a type `package/Name`.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow, or DDS refuses.
    pub fn writer(&self, topic: &str, kind: &str, quality: Quality) -> Result<Writer, WireError> {
        names::check(topic)?;
        self.raw_writer(&names::topic(topic), &names::message_type(kind), quality)
    }

    /// Calls `handler` with every message on the topic of this full name, on a thread of its own.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow, or DDS refuses.
    pub fn reader(
        &self,
        topic: &str,
        kind: &str,
        quality: Quality,
        handler: impl Fn(Sample<'_>) + Send + 'static,
    ) -> Result<Reader, WireError> {
        names::check(topic)?;
        let reader = self.raw_reader(&names::topic(topic), &names::message_type(kind), quality)?;
        Reader::named(self.clone(), reader, topic, handler)
    }

    /// Other nodes that write to the topic of this full name, as far as they live. Within the first
    /// second and a half of this node it waits until the others on this computer have been found.
    pub fn other_writers(&self, topic: &str) -> Vec<String> {
        while self.inner.joined.elapsed() < SETTLED {
            std::thread::park_timeout(SETTLED.saturating_sub(self.inner.joined.elapsed()));
        }
        let topic = names::topic(topic);
        let mut nodes: Vec<_> = peers::writers(&self.inner.dds, &self.inner.guid, &topic)
            .iter()
            .map(|writer| self.name_of(writer))
            .collect();
        nodes.sort();
        nodes.dedup();
        nodes
    }

    /// Changes what this node is said to have, and says it.
    pub(crate) fn tell(&self, change: impl FnOnce(&mut Own)) {
        let mut own = lock(&self.inner.own);
        change(&mut own);
        // Only the newest counts, and one is kept: there is always room.
        let _ = self.inner.teller.write(Raw(own.payload().into()), None);
    }

    /// What to call the node of an endpoint: its full name and, unless it is this one, the beginning of
    /// its participant's number.
    pub(crate) fn name_of(&self, endpoint: &Guid) -> String {
        let inner = &self.inner;
        if prefix(endpoint) == prefix(&inner.guid) {
            return inner.names.full();
        }
        inner.hear_nodes();
        let number = prefix(endpoint).map(|byte| format!("{byte:02x}")).concat();
        match lock(&inner.graph).node(endpoint) {
            Some(name) => format!("{name} ({number})"),
            None => format!("a participant that is no node ({number})"),
        }
    }

    /// Counts a writer's readers from now on.
    pub(crate) fn keep_count(&self, outlet: &Arc<Outlet>) {
        lock(&self.inner.outlets).0.push(Arc::downgrade(outlet));
    }

    pub(crate) fn downgrade(&self) -> WeakParticipant {
        WeakParticipant(Arc::downgrade(&self.inner))
    }

    pub(crate) fn raw_writer(
        &self,
        topic: &str,
        kind: &str,
        quality: Quality,
    ) -> Result<Writer, WireError> {
        let (topic, refused) = self.topic(topic, kind, quality)?;
        let writer = self
            .inner
            .publisher
            .create_datawriter_no_key(&topic, Some(quality.policies()))
            .map_err(refused)?;
        Ok(Writer::new(self.clone(), writer))
    }

    pub(crate) fn raw_reader(
        &self,
        topic: &str,
        kind: &str,
        quality: Quality,
    ) -> Result<RawReader, WireError> {
        let (topic, refused) = self.topic(topic, kind, quality)?;
        self.inner
            .subscriber
            .create_simple_datareader_no_key(&topic, Some(quality.policies()))
            .map_err(refused)
    }

    fn topic(
        &self,
        name: &str,
        kind: &str,
        quality: Quality,
    ) -> Result<(Topic, impl Fn(CreateError) -> WireError + use<>), WireError> {
        let what = name.to_owned();
        let refused = move |source| WireError::Dds {
            what: what.clone(),
            source,
        };
        let topic = self
            .inner
            .dds
            .create_topic(
                name.to_owned(),
                kind.to_owned(),
                &quality.policies(),
                TopicKind::NoKey,
            )
            .map_err(&refused)?;
        Ok((topic, refused))
    }
}

impl Inner {
    /// Takes in what others have told of their nodes.
    fn hear_nodes(&self) {
        let reader = lock(&self.heard);
        reader.drain_read_notifications();
        let mut graph = lock(&self.graph);
        loop {
            match reader.try_take_one() {
                Ok(Some(sample)) => graph.hear(&sample.into_value().0),
                Err(rustdds::dds::ReadError::Deserialization { .. }) => {}
                Ok(None) | Err(_) => return,
            }
        }
    }
}

impl WeakParticipant {
    /// Counts the readers of all writers, unless that was done a moment ago.
    #[expect(clippy::disallowed_methods, reason = "readers come in wall-clock time")]
    pub(crate) fn count_readers(&self) {
        let Some(inner) = self.0.upgrade() else {
            return;
        };
        let mut outlets = lock(&inner.outlets);
        if outlets.1.elapsed() >= COUNTING {
            outlets.1 = Instant::now();
            outlets.0.retain(|outlet| {
                outlet.upgrade().is_some_and(|outlet| {
                    outlet.count_readers();
                    true
                })
            });
        }
    }

    pub(crate) fn name_of(&self, endpoint: &Guid) -> Option<String> {
        let inner = self.0.upgrade()?;
        Some(Participant { inner }.name_of(endpoint))
    }
}

impl std::fmt::Debug for Participant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Participant")
            .field("node", &self.inner.names.full())
            .finish_non_exhaustive()
    }
}

/// Locks; the data behind these locks is whole at every moment.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
