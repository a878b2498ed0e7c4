//! A tracker over OpenIGTLink as the sensor of the tip: an electromagnetic coil behind PLUS, or
//! whatever sends a `TRANSFORM` of the sensor's pose.
//!
//! The other side's axes become those of the tracker's frame as all coordinates do at this edge
//! ([`Space`]); `tracker.position_mm` and `tracker.rpy_deg` place that frame in World. Place and axis
//! of the tip count; what the sensor turns by about the axis does not.

mod clock;
mod link;

use std::net::ToSocketAddrs;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use hal::frame::{LeftCamera, World};
use hal::{Position, SensedShape, SensedTip, ShapeSensor, Stamp, Transform};
use igtl::{Body, Message, Timestamp};
use nalgebra::{Isometry3, Matrix3, Point3, Unit, Vector3};

use super::super::address::AddressError;
use super::counters::Counters;
use super::space::Space;
use crate::clock::WallTime;
use crate::config::{Config, TrackerSource};
use clock::{Dated, SenderClock};
use link::Link;

/// Silence after which another sender of the device is listened to, and after which a tracker counts as
/// one that is in the way of a start.
const SILENT: Duration = Duration::from_millis(500);

/// A tracker that cannot be.
#[derive(Debug, thiserror::Error)]
pub enum TrackerError {
    /// The address of its server.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// The system has no thread left.
    #[error("a thread for the tracker")]
    Thread(#[source] std::io::Error),
}

/// Where measurements arrive; connections and the sensor share it.
#[derive(Clone, Debug)]
pub struct Tracker(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    device: String,
    /// Address of the server; nothing where clients send.
    server: Option<String>,
    geometry: Geometry,
    delay: Duration,
    time: WallTime,
    counters: Counters,
    state: Mutex<State>,
}

/// From a pose on the wire to a tip in the stereo frame.
#[derive(Clone, Debug)]
struct Geometry {
    space: Space,
    world_from_tracker: Isometry3<f64>,
    left_from_world: Transform<LeftCamera, World>,
    /// The tip in the sensor's frame \[m\].
    tip: Point3<f64>,
    /// The needle's axis there.
    axis: Unit<Vector3<f64>>,
    covariance: Matrix3<f64>,
    axis_sigma: f64,
}

#[derive(Debug, Default)]
struct State {
    clock: SenderClock,
    newest: Option<SensedShape>,
    /// Who sent last, and when that arrived.
    sender: Option<(u64, Stamp)>,
    sequence: u64,
    /// Why there is no connection to the server.
    cut: Option<String>,
}

impl Tracker {
    /// The tracker that `config` asks for, on the time of the rig, and the sensor of the tip.
    ///
    /// # Errors
    /// See [`TrackerError`].
    pub(crate) fn open(
        config: &Config,
        time: WallTime,
        left_from_world: &Transform<LeftCamera, World>,
    ) -> Result<(Self, impl ShapeSensor + use<>), TrackerError> {
        let settings = &config.tracker;
        let server = settings.source == TrackerSource::Server;
        let sigma = settings.sigma_mm * 1e-3;
        let tracker = Self(Arc::new(Shared {
            device: settings.device.clone(),
            server: server.then(|| settings.address.clone()),
            geometry: Geometry {
                space: Space(config.igtl.coordinates),
                world_from_tracker: settings.world_from_tracker(),
                left_from_world: *left_from_world,
                tip: Point3::from(Vector3::from(settings.tip_mm) * 1e-3),
                axis: Unit::new_normalize(settings.axis.into()),
                covariance: Matrix3::from_diagonal_element(sigma * sigma),
                axis_sigma: settings.axis_sigma_mrad * 1e-3,
            },
            delay: Duration::from_secs_f64(settings.delay_ms * 1e-3),
            time,
            counters: Counters::default(),
            state: Mutex::default(),
        }));
        let link = server
            .then(|| {
                let unknown = |source| AddressError::Unknown {
                    key: "tracker.address",
                    address: settings.address.clone(),
                    source,
                };
                let addresses = settings.address.to_socket_addrs().map_err(unknown)?;
                tracker.link_is(Some("not yet".to_owned()));
                Link::start(tracker.clone(), addresses.collect()).map_err(TrackerError::Thread)
            })
            .transpose()?;
        let sensor = Sensor {
            tracker: tracker.clone(),
            _link: link,
        };
        Ok((tracker, sensor))
    }

    /// Whether programs that connect to the run send the tip.
    pub(super) fn takes_clients(&self) -> bool {
        self.0.server.is_none()
    }

    /// What was dropped.
    pub(super) fn counters(&self) -> &Counters {
        &self.0.counters
    }

    /// Measurements that were taken.
    pub(super) fn taken(&self) -> u64 {
        self.state().sequence
    }

    /// Takes a message from `source` if it is the device's; whether it is.
    pub(super) fn hear(&self, source: u64, message: &Message) -> bool {
        let Body::Transform(transform) = &message.body else {
            return false;
        };
        if !message.device.eq_ignore_ascii_case(&self.0.device) {
            return false;
        }
        let arrived = self.0.time.now();
        if let Err(reason) = self.take(source, transform, message.stamp, arrived) {
            self.0.counters.add(reason);
        }
        true
    }

    fn take(
        &self,
        source: u64,
        transform: &igtl::Transform,
        sent: Timestamp,
        arrived: Stamp,
    ) -> Result<(), &'static str> {
        // A tool that is not seen is sent so by programs that send it all the same.
        if *transform == igtl::Transform::at([0.0; 3]) {
            return Err("tracker: the identity, as tools that are not seen");
        }
        let mut tip = self.0.geometry.tip(transform)?;
        let mut state = self.state();
        match state.sender {
            Some((other, at)) if other != source => {
                if arrived.since(at) < SILENT {
                    return Err("tracker: another sender");
                }
                state.clock = SenderClock::default();
            }
            _ => {}
        }
        state.sender = Some((source, arrived));
        let stamp = match state.clock.date(sent, arrived) {
            Dated::At(stamp) => stamp,
            Dated::Repeated => return Err("tracker: the same stamp again"),
            Dated::SetBack => return Err("tracker: a stamp before the last one"),
        };
        let nanos = stamp.as_nanos();
        let delay = u64::try_from(self.0.delay.as_nanos()).unwrap_or(nanos);
        tip.stamp = Stamp::from_nanos(nanos.saturating_sub(delay));
        tip.sequence = state.sequence;
        state.sequence += 1;
        state.newest = Some(tip);
        Ok(())
    }

    /// Says why there is no connection to the server, or that there is one.
    fn link_is(&self, cut: Option<String>) {
        self.state().cut = cut;
    }

    /// Why no measurements come; nothing where they do.
    fn hindrance(&self, now: Stamp) -> Option<String> {
        let device = &self.0.device;
        let state = self.state();
        let silent = match state.sender {
            Some((_, at)) if now.since(at) <= SILENT => return None,
            Some((_, at)) => format!(
                "the last TRANSFORM of `{device}` came {:.1} s ago",
                now.secs_since(at)
            ),
            None => format!("no TRANSFORM of `{device}` has come"),
        };
        let link = match (&self.0.server, &state.cut) {
            (Some(server), Some(cut)) => format!("; no connection to {server}: {cut}"),
            (Some(server), None) => format!("; connected to {server}"),
            (None, _) => String::new(),
        };
        drop(state);
        let dropped: Vec<String> = self.0.counters.counts().into_iter().map(words).collect();
        let dropped = if dropped.is_empty() {
            String::new()
        } else {
            format!("; dropped: {}", dropped.join(", "))
        };
        Some(format!("{silent}{link}{dropped}"))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn words((reason, count): (&'static str, u64)) -> String {
    format!("{reason} ({count})")
}

impl Geometry {
    /// The tip, without a time.
    fn tip(&self, transform: &igtl::Transform) -> Result<SensedShape, &'static str> {
        let pose = self
            .space
            .read_pose(transform)
            .map_err(super::space::Misplaced::reason)?;
        let pose = self.world_from_tracker * pose;
        let place: Position<World> = Position::new(pose * self.tip);
        let axis = self.left_from_world.rotate(&(pose.rotation * *self.axis));
        Ok(SensedShape {
            stamp: Stamp::ZERO,
            sequence: 0,
            points: Vec::new(),
            tip: SensedTip {
                position: self.left_from_world * place,
                covariance: self.covariance,
                direction: Unit::new_normalize(axis),
                direction_sigma: self.axis_sigma,
            },
        })
    }
}

/// The run's end.
struct Sensor {
    tracker: Tracker,
    _link: Option<Link>,
}

impl ShapeSensor for Sensor {
    fn poll(&mut self) -> Result<Option<SensedShape>, hal::Error> {
        Ok(self.tracker.state().newest.take())
    }

    fn hindrance(&self) -> Option<String> {
        self.tracker.hindrance(self.tracker.0.time.now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config;
    use igtl::Text;
    use nalgebra::UnitQuaternion;

    fn opened(sets: &[&str]) -> (Tracker, Box<dyn ShapeSensor>) {
        let sets: Vec<String> = ["run.sensor=em", "tracker.source=clients", "igtl.serve=true"]
            .iter()
            .chain(sets)
            .map(ToString::to_string)
            .collect();
        let config = config::load(None, &sets).unwrap();
        let left_from_world = Transform::assume(Isometry3::translation(0.0, 0.0, -1.0));
        let (tracker, sensor) =
            Tracker::open(&config, WallTime::start(), &left_from_world).unwrap();
        (tracker, Box::new(sensor))
    }

    fn message(device: &str, pose: &Isometry3<f64>, stamp: u64) -> Message {
        let space = Space(config::IgtlCoordinates::Ras);
        let body = Body::Transform(space.pose(pose).unwrap());
        Message {
            stamp: Timestamp::from_nanos(stamp),
            ..Message::new(device, body)
        }
    }

    const DEVICE: &str = "NeedleTipToTracker";
    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn a_pose_becomes_the_tip_through_sensor_tracker_and_world() {
        let (tracker, mut sensor) = opened(&[
            "tracker.position_mm=[100.0,200.0,300.0]",
            "tracker.rpy_deg=[0.0,0.0,90.0]",
            "tracker.tip_mm=[0.0,0.0,10.0]",
            "tracker.axis=[0.0,0.0,1.0]",
            "tracker.sigma_mm=0.5",
        ]);
        assert!(sensor.hindrance().unwrap().contains("has come"));
        // The sensor's z along the tracker's x, which is World's y.
        let turn = UnitQuaternion::from_euler_angles(0.0, core::f64::consts::FRAC_PI_2, 0.0);
        let pose = Isometry3::from_parts(Vector3::new(0.05, 0.0, 0.0).into(), turn);
        assert!(tracker.hear(1, &message("needletiptotracker", &pose, SECOND)));
        assert_eq!(sensor.hindrance(), None);
        let seen = sensor.poll().unwrap().unwrap();
        assert!(sensor.poll().unwrap().is_none());
        let expected = Vector3::new(0.1, 0.26, -0.7);
        assert!(
            (seen.tip.position.coords() - expected).norm() < 1e-6,
            "{seen:?}"
        );
        assert!((*seen.tip.direction - Vector3::y()).norm() < 1e-6);
        assert!((seen.tip.covariance[(0, 0)] - 0.25e-6).abs() < 1e-12);
        assert!(seen.points.is_empty());
    }

    #[test]
    fn what_is_no_measurement_is_dropped_with_its_reason() {
        let (tracker, mut sensor) = opened(&[]);
        let pose = Isometry3::translation(0.4, 0.0, 0.2);
        let at = |stamp| message(DEVICE, &pose, stamp);
        assert!(!tracker.hear(1, &message("NewTarget", &pose, SECOND)));
        assert!(!tracker.hear(1, &Message::new(DEVICE, Body::Text(Text::new("START")))));
        let mut scaled = igtl::Transform::at([1.0, 2.0, 3.0]);
        scaled.axes[0] = [2.0, 0.0, 0.0];
        let mut nan = igtl::Transform::at([f32::NAN, 0.0, 0.0]);
        nan.axes[1] = [0.0, f32::NAN, 0.0];
        for bad in [
            scaled,
            nan,
            igtl::Transform::at([0.0; 3]),
            igtl::Transform::at([9000.0, 0.0, 0.0]),
        ] {
            assert!(tracker.hear(1, &Message::new(DEVICE, Body::Transform(bad))));
        }
        assert!(sensor.poll().unwrap().is_none());
        for stamp in [10, 11, 11, 9] {
            assert!(tracker.hear(1, &at(stamp * SECOND)));
        }
        // Another one at the same time.
        assert!(tracker.hear(2, &at(12 * SECOND)));
        assert_eq!(tracker.taken(), 2);
        assert_eq!(sensor.poll().unwrap().unwrap().sequence, 1);
        let counts: Vec<(&str, u64)> = tracker.counters().counts().into_iter().collect();
        assert_eq!(
            counts,
            [
                ("far", 1),
                ("no rotation", 1),
                ("not finite", 1),
                ("tracker: a stamp before the last one", 1),
                ("tracker: another sender", 1),
                ("tracker: the identity, as tools that are not seen", 1),
                ("tracker: the same stamp again", 1),
            ]
        );
    }

    #[test]
    fn a_tracker_that_cannot_be_is_refused_with_its_key() {
        let refused = |sets: &[&str]| {
            let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
            config::load(None, &sets).unwrap_err().to_string()
        };
        for (sets, told) in [
            (&["tracker.source=server"][..], "run.sensor"),
            (&["tracker.source=clients", "run.sensor=em"], "igtl.serve"),
            (&["tracker.axis=[0.0,0.0,0.0]"], "tracker.axis"),
            (&["tracker.device=\"\""], "tracker.device"),
            (&["tracker.sigma_mm=0.0"], "tracker.sigma_mm"),
        ] {
            assert!(refused(sets).contains(told), "{sets:?}: {}", refused(sets));
        }
    }
}
