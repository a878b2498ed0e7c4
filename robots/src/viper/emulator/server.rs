//! The emulator behind two listening sockets.

use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use hal::Stamp;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::Notify;
use tokio::time::timeout;

use super::Emulator;
use crate::viper::Port;

/// A client that does not read is thrown out after this time.
const WRITE_PATIENCE: Duration = Duration::from_secs(1);
/// Resolution of the emulator on a wall clock.
const STEP: Duration = Duration::from_millis(1);

/// What tells the time: a wall clock, or nothing when the emulator is advanced from outside.
type Clock = Option<Arc<dyn Fn() -> Stamp + Send + Sync>>;

/// Listens until it is dropped.
#[derive(Debug)]
pub struct Server {
    /// Where points and stops are taken.
    pub motion: SocketAddr,
    /// Where feedback is given.
    pub state: SocketAddr,
    end: Arc<Notify>,
    thread: Option<JoinHandle<()>>,
}

/// Why the emulator does not listen.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// A port cannot be had.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// Address and port.
        address: SocketAddr,
        /// The system's words.
        source: io::Error,
    },
    /// No thread can be had.
    #[error("no thread: {0}")]
    Thread(#[from] io::Error),
}

impl Server {
    /// Listens on two ports of `address` (0 for any free one). With a clock the emulator lives
    /// on it; without one it is advanced by [`Emulator::advance_to`].
    ///
    /// # Errors
    /// A port is taken, or no thread can be had.
    pub fn start(
        emulator: Emulator,
        address: IpAddr,
        [motion, state]: [u16; 2],
        now: Clock,
    ) -> Result<Self, ServerError> {
        let (listeners, addresses) = {
            let (motion, at_motion) = listen(address, motion)?;
            let (state, at_state) = listen(address, state)?;
            ([motion, state], [at_motion, at_state])
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let end = Arc::new(Notify::new());
        let ended = Arc::clone(&end);
        let thread = std::thread::Builder::new()
            .name("viper-emulator".into())
            .spawn(move || {
                runtime.block_on(async {
                    tokio::select! {
                        () = serve(&emulator, listeners, &now) => {}
                        () = ended.notified() => {}
                    }
                });
                // Dropping the runtime closes all connections.
                drop(runtime);
                for port in Port::ALL {
                    emulator.disconnect(port);
                }
            })?;
        let [motion, state] = addresses;
        Ok(Self {
            motion,
            state,
            end,
            thread: Some(thread),
        })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.end.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been reported on its way.
            let _ = thread.join();
        }
    }
}

fn listen(address: IpAddr, port: u16) -> Result<(TcpListener, SocketAddr), ServerError> {
    let address = SocketAddr::new(address, port);
    let open = || {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let bound = listener.local_addr()?;
        Ok((listener, bound))
    };
    open().map_err(|source| ServerError::Listen { address, source })
}

async fn serve(emulator: &Emulator, [motion, state]: [TcpListener; 2], now: &Clock) {
    tokio::join!(
        accept(emulator, Port::Motion, motion, now),
        accept(emulator, Port::State, state, now),
        live(emulator, now),
    );
}

async fn live(emulator: &Emulator, now: &Clock) {
    let Some(now) = now else { return };
    loop {
        emulator.advance_to(now());
        tokio::time::sleep(STEP).await;
    }
}

async fn accept(emulator: &Emulator, port: Port, listener: TcpListener, now: &Clock) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
        return;
    };
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Out of descriptors, for instance: others may be given back.
            tokio::time::sleep(WRITE_PATIENCE).await;
            continue;
        };
        if emulator.connect(port) {
            let (emulator, now) = (emulator.clone(), now.clone());
            tokio::spawn(async move {
                // Whatever ends the conversation, the client is gone.
                let _ = converse(&emulator, port, stream, &now).await;
                emulator.disconnect(port);
            });
        }
    }
}

async fn converse(
    emulator: &Emulator,
    port: Port,
    mut stream: TcpStream,
    now: &Clock,
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let mut buffer = [0; 2048];
    loop {
        while let Some(bytes) = emulator.transmit(port) {
            timeout(WRITE_PATIENCE, stream.write_all(&bytes)).await??;
        }
        if emulator.is_closing(port) {
            return Ok(());
        }
        tokio::select! {
            read = stream.read(&mut buffer) => match read? {
                0 => return Ok(()),
                n => {
                    let at = now.as_ref().map_or_else(|| emulator.now(), |now| now());
                    emulator.receive(at, port, &buffer[..n]);
                }
            },
            () = emulator.shared.wake[port as usize].notified() => {}
        }
    }
}
