//! Connections: who may come, what each may send, and when one is given up.

use std::io::{ErrorKind, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use igtl::Message;

use super::super::{now, stand_back};
use super::counters::Counters;
use super::listen::{Allowance, NOTICE, is_passing, listen};
use super::outbox::Outbox;

/// Connections at a time.
const CLIENTS: usize = 16;
/// Time between two looks for a new connection; also bounds how fast they may come.
const ACCEPT: Duration = Duration::from_millis(20);
/// What a connection may send: what is understood is small, and some sensors of a tracker at 250 Hz
/// are no flood.
const ALLOWANCE: Allowance = Allowance {
    body: 64 << 10,
    bytes_hz: (4 << 20) as f64,
    messages_hz: 2000.0,
    silence: None,
};
/// Longest wait for a peer to take anything, and for one piece of news to be written.
const STUCK: Duration = Duration::from_secs(2);

/// One connection.
#[derive(Debug)]
pub(super) struct Client {
    /// Its number among all that there were.
    pub(super) number: u64,
    stream: TcpStream,
    outbox: Outbox,
    gone: AtomicBool,
}

impl Client {
    /// Sends messages to this one alone.
    pub(super) fn send(&self, messages: &Arc<[u8]>) -> bool {
        self.outbox.push(messages)
    }

    fn is_gone(&self) -> bool {
        self.gone.load(Ordering::Acquire)
    }

    /// Gives the connection up.
    fn give_up(&self) {
        self.gone.store(true, Ordering::Release);
        self.outbox.close();
        // It may have gone by itself.
        let _ = self.stream.shutdown(Shutdown::Both);
    }
}

/// What becomes of a message from a connection, on that connection's thread.
pub(super) trait Hear: Send + Sync + 'static {
    fn hear(&self, client: &Arc<Client>, message: &Message);
}

/// All connections to one address, and the threads that serve them.
#[derive(Debug)]
pub(super) struct Clients {
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    list: Mutex<Vec<Arc<Client>>>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    counters: Arc<Counters>,
    /// Connections that there were.
    count: AtomicU64,
    ending: AtomicBool,
}

impl Shared {
    fn list(&self) -> MutexGuard<'_, Vec<Arc<Client>>> {
        self.list.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The end of [`Clients`] that shows things to all.
#[derive(Clone, Debug)]
pub(super) struct Audience(Arc<Shared>);

impl Audience {
    /// Number of connections.
    pub(super) fn len(&self) -> usize {
        self.0.list().len()
    }

    /// Sends messages to all. Who has no room for them misses them.
    pub(super) fn send(&self, messages: &Arc<[u8]>) {
        for client in self.0.list().iter() {
            if !client.send(messages) {
                self.0.counters.add("not sent: slow");
            }
        }
    }
}

impl Clients {
    /// Takes connections from now on.
    ///
    /// # Errors
    /// The system has no thread left, or the socket fails.
    pub(super) fn serve(
        listener: TcpListener,
        counters: Arc<Counters>,
        hear: Arc<dyn Hear>,
    ) -> std::io::Result<Self> {
        listener.set_nonblocking(true)?;
        let shared = Arc::new(Shared {
            list: Mutex::default(),
            threads: Mutex::default(),
            counters,
            count: AtomicU64::new(0),
            ending: AtomicBool::new(false),
        });
        let serving = Arc::clone(&shared);
        let acceptor = std::thread::Builder::new()
            .name("igtl-accept".to_owned())
            .spawn(move || {
                stand_back();
                accept(&listener, &serving, &hear);
            })?;
        Ok(Self {
            shared,
            acceptor: Some(acceptor),
        })
    }

    pub(super) fn audience(&self) -> Audience {
        Audience(Arc::clone(&self.shared))
    }
}

impl Drop for Clients {
    /// What waits is written before the connections close, as far as peers take it.
    fn drop(&mut self) {
        self.shared.ending.store(true, Ordering::Release);
        if let Some(acceptor) = self.acceptor.take() {
            // A panic has been reported where it happened.
            let _ = acceptor.join();
        }
        for client in self.shared.list().iter() {
            client.outbox.close();
        }
        let threads = std::mem::take(
            &mut *self
                .shared
                .threads
                .lock()
                .unwrap_or_else(PoisonError::into_inner),
        );
        for thread in threads {
            let _ = thread.join();
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "waits for connections")]
fn accept(listener: &TcpListener, shared: &Arc<Shared>, hear: &Arc<dyn Hear>) {
    while !shared.ending.load(Ordering::Acquire) {
        if let Ok((stream, _)) = listener.accept() {
            if shared.list().len() >= CLIENTS {
                shared.counters.add("connection refused: too many");
            } else if begin(stream, shared, hear).is_err() {
                shared.counters.add("connection refused: system");
            }
        }
        std::thread::sleep(ACCEPT);
        let mut threads = shared
            .threads
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        threads.retain(|thread| !thread.is_finished());
    }
}

/// A connection's two threads.
fn begin(stream: TcpStream, shared: &Arc<Shared>, hear: &Arc<dyn Hear>) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(NOTICE))?;
    stream.set_write_timeout(Some(STUCK))?;
    let (incoming, outgoing) = (stream.try_clone()?, stream.try_clone()?);
    let client = Arc::new(Client {
        number: shared.count.fetch_add(1, Ordering::Relaxed),
        stream,
        outbox: Outbox::default(),
        gone: AtomicBool::new(false),
    });
    let mut threads = shared
        .threads
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    let named = |name: &str| std::thread::Builder::new().name(name.to_owned());
    let (reading, counters, hear) = (
        Arc::clone(&client),
        Arc::clone(&shared.counters),
        Arc::clone(hear),
    );
    threads.push(named("igtl-read").spawn(move || {
        stand_back();
        let is_gone = || reading.is_gone();
        let ended = listen(incoming, &ALLOWANCE, &counters, is_gone, |message| {
            hear.hear(&reading, message);
        });
        if let Some(reason) = ended {
            counters.add(reason);
        }
        reading.give_up();
    })?);
    let (writing, serving) = (Arc::clone(&client), Arc::clone(shared));
    shared.list().push(client);
    let writer = named("igtl-write").spawn(move || {
        stand_back();
        if let Some(reason) = write(&writing, outgoing) {
            serving.counters.add(reason);
        }
        writing.give_up();
        serving.list().retain(|other| !Arc::ptr_eq(other, &writing));
    });
    threads.push(writer.inspect_err(|_| {
        if let Some(client) = shared.list().pop() {
            client.give_up();
        }
    })?);
    Ok(())
}

/// Writes until there is nothing more to come or the connection is given up; says why in the latter
/// case.
fn write(client: &Client, mut stream: TcpStream) -> Option<&'static str> {
    while let Some(messages) = client.outbox.next() {
        let deadline = now() + STUCK;
        if client.is_gone() {
            return None;
        }
        match write_until(&mut stream, &messages, deadline) {
            Ok(()) => {}
            Err(error) if is_passing(&error) => return Some("connection closed: slow"),
            Err(_) => return None,
        }
    }
    None
}

/// A peer that takes a byte now and then keeps its connection no longer than one that takes none.
fn write_until(stream: &mut TcpStream, mut bytes: &[u8], deadline: Instant) -> std::io::Result<()> {
    while !bytes.is_empty() {
        if now() > deadline {
            return Err(ErrorKind::TimedOut.into());
        }
        match stream.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(n) => bytes = &bytes[n..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
