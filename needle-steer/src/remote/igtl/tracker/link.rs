//! A connection to a tracker's server, PLUS's for one: made again whenever it ends.

use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use super::super::listen::{Allowance, NOTICE, listen};
use super::Tracker;

/// Longest wait for the server to answer.
const CONNECT: Duration = Duration::from_secs(1);
/// Time between two attempts.
const AGAIN: Duration = Duration::from_millis(500);
/// What a server may send: images too, which are not looked at. One that is silent may be dead.
const ALLOWANCE: Allowance = Allowance {
    body: 16 << 20,
    bytes_hz: (256 << 20) as f64,
    messages_hz: 5000.0,
    silence: Some(Duration::from_secs(2)),
};
/// The source of what comes over the one connection.
const SOURCE: u64 = 0;

/// A thread that keeps the connection up. Dropping it ends both.
#[derive(Debug)]
pub(super) struct Link {
    ending: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Link {
    /// Connects to one of `addresses` from now on.
    ///
    /// # Errors
    /// The system has no thread left.
    pub(super) fn start(tracker: Tracker, addresses: Vec<SocketAddr>) -> std::io::Result<Self> {
        let ending = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&ending);
        let thread = std::thread::Builder::new()
            .name("igtl-tracker".to_owned())
            .spawn(move || keep(&tracker, &addresses, &ended))?;
        Ok(Self {
            ending,
            thread: Some(thread),
        })
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic has been reported where it happened.
            let _ = thread.join();
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "waits between two attempts")]
fn keep(tracker: &Tracker, addresses: &[SocketAddr], ending: &AtomicBool) {
    let is_ending = || ending.load(Ordering::Acquire);
    while !is_ending() {
        let ended = match connect(addresses) {
            Ok(stream) => {
                tracker.link_is(None);
                let counters = tracker.counters();
                let reason = listen(stream, &ALLOWANCE, counters, is_ending, |message| {
                    if !tracker.hear(SOURCE, message) {
                        counters.add("other device or type");
                    }
                });
                if let Some(reason) = reason {
                    counters.add(reason);
                }
                reason
                    .unwrap_or("the server closed the connection")
                    .to_owned()
            }
            Err(error) => error.to_string(),
        };
        tracker.link_is(Some(ended));
        let mut left = AGAIN;
        while !left.is_zero() && !is_ending() {
            let nap = left.min(NOTICE);
            std::thread::sleep(nap);
            left -= nap;
        }
    }
}

fn connect(addresses: &[SocketAddr]) -> std::io::Result<TcpStream> {
    let mut last = std::io::ErrorKind::AddrNotAvailable.into();
    for address in addresses {
        let stream = TcpStream::connect_timeout(address, CONNECT).and_then(|stream| {
            stream.set_nodelay(true)?;
            stream.set_read_timeout(Some(NOTICE))?;
            Ok(stream)
        });
        match stream {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}
