//! A run over OpenIGTLink: 3D Slicer, PLUS and whatever else speaks it.
//!
//! The run's thread hands snapshots to a bounded queue and polls another for requests. One thread
//! turns the newest snapshot into messages at held rates, one takes connections, and every
//! connection has a thread that reads and one that writes. What is slow, floods or makes no sense
//! is dropped and counted with its reason.

mod clients;
mod counters;
mod hear;
mod listen;
mod outbox;
mod scene;
mod space;
mod tracker;

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use hal::request::{Request, Verdict};
use hal::{ArmState, Overlay, Stamp, StereoFrame, Telemetry};
use igtl::Message;
use rosbridge::Severity;

use super::address::{AddressError, resolve};
use super::mailbox::mailbox;
use super::{Feed, FeedRates, Interface, Mailbox, Post, stand_back};
use crate::clock::began;
use crate::config::{Igtl, IgtlVersion};
use crate::controls::Controls;
use crate::cycle::Bearings;
use clients::{Client, Clients, Hear};
pub use counters::Counters;
use hear::{Ear, Heard};
use scene::{Optics, Sender, Writer};
use space::Space;
pub use tracker::{Tracker, TrackerError};

/// Answers that may wait to be put together.
const ANSWERS: usize = 64;

/// A server that cannot be.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The address.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// The address is in use, or not this machine's.
    #[error("igtl.address = \"{address}\": cannot be served")]
    Bind {
        /// What it is.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// The system has no thread left.
    #[error("a thread for connections")]
    Thread(#[source] std::io::Error),
}

/// A run's OpenIGTLink server. Dropping it sends what waits, and closes all connections.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    counters: Arc<Counters>,
    mailbox: Mailbox,
    // Before the connections, which it writes to.
    feed: Feed,
    _clients: Clients,
}

impl Server {
    /// Serves at the configuration's address; the run's time is `now`. What is sent for `tracker` is
    /// handed to it.
    ///
    /// # Errors
    /// See [`ServerError`].
    pub fn open(
        config: &Igtl,
        bearings: &Bearings,
        controls: &Arc<Controls>,
        tracker: Option<&Tracker>,
        now: Stamp,
    ) -> Result<Self, ServerError> {
        let open = ("igtl.network", config.network);
        let asked = resolve("igtl.address", &config.address, open)?;
        let listener = TcpListener::bind(asked).map_err(|source| ServerError::Bind {
            address: asked,
            source,
        })?;
        let address = listener.local_addr().map_err(ServerError::Thread)?;
        let counters = Arc::new(Counters::default());
        let (post, mailbox) = mailbox();
        let (answers, given) = sync_channel(ANSWERS);
        let space = Space(config.coordinates);
        let extended = config.version == IgtlVersion::Three;
        let hearing = Hearing {
            ear: Ear {
                space,
                world_from_left_camera: bearings.world_from_left_camera,
                target_device: config.target_device.clone(),
            },
            post,
            controls: Arc::clone(controls),
            tracker: tracker.filter(|tracker| tracker.takes_clients()).cloned(),
            counters: Arc::clone(&counters),
            answers,
        };
        let origin = began(now);
        std::thread::Builder::new()
            .name("igtl-answers".to_owned())
            .spawn(move || {
                stand_back();
                answer_all(&given, Writer::new(extended, began(Stamp::ZERO)));
            })
            .map_err(ServerError::Thread)?;
        let clients = Clients::serve(listener, Arc::clone(&counters), Arc::new(hearing))
            .map_err(ServerError::Thread)?;
        let sender = Sender {
            audience: clients.audience(),
            counters: Arc::clone(&counters),
            space,
            optics: Optics {
                world_from_left: bearings.world_from_left_camera,
                left_from_right: bearings
                    .cameras
                    .as_ref()
                    .map(|pair| pair.right_from_left.inverse()),
                left: bearings.cameras.as_ref().map(|pair| pair.left),
            },
            tracker: tracker.cloned(),
            writer: Writer::new(extended, origin),
        };
        let rates = FeedRates {
            poses: config.poses_hz,
            lines: config.lines_hz,
            images: config.images_hz,
        };
        let feed = Feed::start("igtl", rates, sender).map_err(ServerError::Thread)?;
        Ok(Self {
            address,
            counters,
            mailbox,
            feed,
            _clients: clients,
        })
    }

    /// Where it listens.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// What was dropped.
    pub fn counters(&self) -> Arc<Counters> {
        Arc::clone(&self.counters)
    }
}

impl Interface for Server {
    fn show(&mut self, telemetry: &Arc<Telemetry>) {
        self.feed.step(telemetry);
    }

    fn show_arm(&mut self, state: &ArmState) {
        self.feed.arm(state);
    }

    fn show_images(&mut self, pair: &StereoFrame, overlay: &Arc<Overlay>) {
        self.feed.images(pair, overlay);
    }

    fn poll(&mut self) -> Option<Request> {
        self.mailbox.poll()
    }

    /// Warnings: phase and verdict are in what is shown.
    fn say(&mut self, severity: Severity, text: &str) -> bool {
        if severity == Severity::Warning {
            self.feed.warning(text);
        }
        false
    }
}

/// What is done with messages from connections.
struct Hearing {
    ear: Ear,
    post: Post,
    controls: Arc<Controls>,
    tracker: Option<Tracker>,
    counters: Arc<Counters>,
    answers: SyncSender<Answer>,
}

/// What is said to who asked.
struct Answer {
    client: Arc<Client>,
    request: &'static str,
    verdict: Verdict,
}

/// Answers come from the run's thread, which waits for nothing: they are put together here.
fn answer_all(answers: &Receiver<Answer>, mut writer: Writer) {
    for answer in answers {
        let (accepted, text) = match &answer.verdict {
            Ok(text) => (true, text),
            Err(reason) => (false, reason),
        };
        writer.origin = began(Stamp::ZERO);
        let messages = writer.answer(answer.request, accepted, text);
        // Who takes no answers misses them.
        let _ = answer.client.send(&messages);
    }
}

impl Hear for Hearing {
    fn hear(&self, client: &Arc<Client>, message: &Message) {
        if let Some(tracker) = &self.tracker
            && tracker.hear(client.number, message)
        {
            return;
        }
        match self.ear.hear(message) {
            Heard::DeadMan => self.controls.refresh_dead_man(),
            Heard::Command(command) => {
                let (client, answers) = (Arc::clone(client), self.answers.clone());
                let request = hear::name(command);
                self.post.send(Request::new(command, move |verdict| {
                    // An answer for which there is no room is lost; the request is not.
                    let _ = answers.try_send(Answer {
                        client,
                        request,
                        verdict,
                    });
                }));
            }
            Heard::Dropped(reason, told) => {
                self.counters.add(reason);
                if let Some(reason) = told {
                    let _ = self.answers.try_send(Answer {
                        client: Arc::clone(client),
                        request: message.body.kind(),
                        verdict: Err(reason),
                    });
                }
            }
        }
    }
}
