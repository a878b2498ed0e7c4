//! Reading a connection: what its peer may send, and when it is given up.

use std::io::{ErrorKind, Read};
use std::net::TcpStream;
use std::time::Duration;

use igtl::{Message, Reader};

use super::super::{Budget, now};
use super::counters::Counters;

/// Longest time that a thread takes to notice that its connection was given up.
pub(super) const NOTICE: Duration = Duration::from_millis(200);

/// What a peer may send.
#[derive(Clone, Copy, Debug)]
pub(super) struct Allowance {
    /// Largest body \[bytes\].
    pub(super) body: usize,
    /// Bytes in a second.
    pub(super) bytes_hz: f64,
    /// Messages in a second.
    pub(super) messages_hz: f64,
    /// Longest silence; endless where there is none.
    pub(super) silence: Option<Duration>,
}

/// Hands messages to `hear` until the connection ends or `is_gone`; says why where it is to be given
/// up.
pub(super) fn listen(
    mut stream: TcpStream,
    allowance: &Allowance,
    counters: &Counters,
    is_gone: impl Fn() -> bool,
    mut hear: impl FnMut(&Message),
) -> Option<&'static str> {
    let mut reader = Reader::new(allowance.body);
    let mut buffer = vec![0; 8 << 10];
    let (mut bytes, mut messages) = (
        Budget::new(allowance.bytes_hz),
        Budget::new(allowance.messages_hz),
    );
    let mut heard = now();
    while !is_gone() {
        let n = match stream.read(&mut buffer) {
            Ok(0) => {
                if let Some(cut) = reader.end() {
                    counters.add(cut.reason());
                }
                return None;
            }
            Ok(n) => n,
            Err(error) if is_passing(&error) => {
                if allowance.silence.is_some_and(|most| heard.elapsed() > most) {
                    return Some("connection closed: silent");
                }
                continue;
            }
            Err(_) => return None,
        };
        heard = now();
        if !bytes.spend(heard, n as f64) {
            return Some("connection closed: flood");
        }
        let mut rest = &buffer[..n];
        while !rest.is_empty() {
            let Some(read) = reader.push(&mut rest) else {
                continue;
            };
            if !messages.spend(heard, 1.0) {
                return Some("connection closed: flood");
            }
            match read {
                Ok(message) => hear(&message),
                Err(reject) => {
                    counters.add(reject.reason());
                    if reader.is_lost() {
                        return Some("connection closed: lost its place");
                    }
                }
            }
        }
    }
    None
}

/// Whether a socket is to be tried again.
pub(super) fn is_passing(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}
