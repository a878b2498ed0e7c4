//! A run over Foxglove's WebSocket protocol: for Foxglove, Lichtblick and their kind.
//!
//! Topics, types and frames are those of logs, so that one layout shows both. The maintained SDK
//! serves the connections on threads of its own; a queue a connection is bounded, and drops its
//! oldest messages where a client is slow.

mod meshes;
mod services;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema};
use foxglove::{WebSocketServer, WebSocketServerHandle};
use hal::request::Request;
use hal::{ArmState, Overlay, Stamp, StereoFrame, Telemetry};
use rosbridge::Severity;
use rosbridge::stream::{MESSAGE_ENCODING, SCHEMA_ENCODING, Stream, Topic};

use super::address::{AddressError, resolve};
use super::mailbox::mailbox;
use super::{Due, Feed, FeedRates, Interface, Mailbox, Scene, Show};
use crate::config::Config;
use crate::controls::Controls;
use crate::cycle::Bearings;
use crate::rig;
use crate::ros::{camera_models, frames};
use meshes::Meshes;

/// Messages that may wait for a client: a fifth of a second, and no more than 60 MB of images.
const BACKLOG: usize = 64;

/// Time in which the SDK, which knows no flush, sends the last snapshot and the last answers.
const PARTING: Duration = Duration::from_millis(300);

/// A live view that cannot be.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The address.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// The server.
    #[error("live.address = \"{address}\": cannot be served")]
    Serve {
        /// Where.
        address: SocketAddr,
        /// Why.
        source: foxglove::FoxgloveError,
    },
    /// The system has no thread left.
    #[error("a thread for the live view")]
    Thread(#[source] std::io::Error),
}

/// A run's live view. Dropping it shows the last snapshot and closes all connections.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    mailbox: Mailbox,
    // Before the server, which it writes to.
    feed: Option<Feed>,
    handle: Option<WebSocketServerHandle>,
}

impl Server {
    /// Serves at the configuration's address.
    ///
    /// # Errors
    /// See [`LiveError`].
    pub fn open(
        config: &Config,
        bearings: &Bearings,
        controls: &Arc<Controls>,
    ) -> Result<Self, LiveError> {
        let robot = rig::description(config);
        let meshes = Meshes::of(config, robot.as_deref().unwrap_or_default());
        let config = &config.live;
        let open = ("live.network", config.network);
        let asked = resolve("live.address", &config.address, open)?;
        let serve = |source| LiveError::Serve {
            address: asked,
            source,
        };
        let (post, mailbox) = mailbox();
        let context = Context::new();
        let mut channels = Vec::new();
        for topic in Topic::ALL {
            let channel = topic.channel();
            let schema = Schema::new(
                channel.message_type,
                SCHEMA_ENCODING,
                channel.definition.into_bytes(),
            );
            let built = ChannelBuilder::new(channel.name)
                .message_encoding(MESSAGE_ENCODING)
                .schema(schema)
                .context(&context)
                .build_raw()
                .map_err(serve)?;
            channels.push(built);
        }
        let handle = WebSocketServer::new()
            .name("needle-steer")
            .bind(asked.ip().to_string(), asked.port())
            .context(&context)
            .message_backlog_size(BACKLOG)
            .supported_encodings(["json"])
            .services(services::all(
                &post,
                controls,
                bearings.world_from_left_camera,
            ))
            .fetch_asset_handler_blocking_fn(move |_, name| meshes.read(&name))
            .start_blocking()
            .map_err(serve)?;
        let address = SocketAddr::new(asked.ip(), handle.port());
        let sender = Sender {
            _context: context,
            channels,
            stream: Stream {
                joint_names: bearings.chain.names().to_vec(),
                frames: frames(bearings),
                cameras: bearings.cameras.as_ref().map(camera_models),
                robot,
            },
        };
        let rates = FeedRates {
            poses: config.poses_hz,
            lines: config.lines_hz,
            images: config.images_hz,
        };
        let feed = Feed::start("live", rates, sender).map_err(LiveError::Thread)?;
        Ok(Self {
            address,
            mailbox,
            feed: Some(feed),
            handle: Some(handle),
        })
    }

    /// Where it listens.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    #[expect(
        clippy::disallowed_methods,
        reason = "waits for what is on its way; the run is over"
    )]
    fn drop(&mut self) {
        self.feed = None;
        if let Some(handle) = self.handle.take() {
            std::thread::sleep(PARTING);
            handle.stop().wait_blocking();
        }
    }
}

impl Interface for Server {
    fn show(&mut self, telemetry: &Arc<Telemetry>) {
        if let Some(feed) = &self.feed {
            feed.step(telemetry);
        }
    }

    fn show_arm(&mut self, state: &ArmState) {
        if let Some(feed) = &self.feed {
            feed.arm(state);
        }
    }

    fn show_images(&mut self, pair: &StereoFrame, overlay: &Arc<Overlay>) {
        if let Some(feed) = &self.feed {
            feed.images(pair, overlay);
        }
    }

    fn poll(&mut self) -> Option<Request> {
        self.mailbox.poll()
    }

    /// Warnings: phase and verdict are in what is shown.
    fn say(&mut self, severity: Severity, text: &str) -> bool {
        if let (Severity::Warning, Some(feed)) = (severity, &self.feed) {
            feed.warning(text);
        }
        false
    }
}

/// Sends scenes to whoever subscribes; nothing is put together for nobody.
struct Sender {
    _context: Arc<Context>,
    channels: Vec<Arc<RawChannel>>,
    stream: Stream,
}

impl Sender {
    fn send(&self, topic: Topic, stamp: Stamp, message: impl FnOnce(&Stream) -> Option<Vec<u8>>) {
        let Some(channel) = self.channels.get(topic as usize) else {
            return;
        };
        if channel.has_sinks()
            && let Some(bytes) = message(&self.stream)
        {
            // The run's time, as in logs.
            let meta = PartialMetadata::with_log_time(stamp.as_nanos());
            channel.log_with_meta(&bytes, meta);
        }
    }
}

impl Show for Sender {
    fn show(&mut self, scene: &Scene, due: Due) {
        if let (true, Some(arm)) = (due.poses, &scene.arm) {
            self.send(Topic::JointStates, arm.stamp, |s| s.joint_states(arm));
        }
        if let Some(t) = &scene.telemetry {
            if due.poses {
                self.send(Topic::Tf, t.stamp, |s| s.tf(t));
                self.send(Topic::Tip, t.stamp, |s| s.tip(t));
                self.send(Topic::State, t.stamp, |s| s.state(t));
            }
            if due.lines {
                self.send(Topic::Markers, t.stamp, |s| s.markers(t));
            }
            if due.slow {
                self.send(Topic::TfStatic, t.stamp, |s| s.tf_static(t.stamp));
                self.send(Topic::Robot, t.stamp, Stream::robot);
            }
            for text in &scene.warnings {
                self.send(Topic::Note, t.stamp, |s| s.warning(t.stamp, text));
            }
        }
        if let (true, Some((pair, overlay))) = (due.images, &scene.images) {
            let stamp = pair.left.stamp;
            self.send(Topic::LeftImage, stamp, |s| s.image(pair, false));
            self.send(Topic::RightImage, stamp, |s| s.image(pair, true));
            self.send(Topic::LeftInfo, stamp, |s| s.camera_info(pair, false));
            self.send(Topic::RightInfo, stamp, |s| s.camera_info(pair, true));
            self.send(Topic::Overlay, stamp, |s| s.overlay(overlay));
        }
    }
}
