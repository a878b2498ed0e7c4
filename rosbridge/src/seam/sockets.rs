//! What libraries do not set on their sockets, and do not hand out to be set.
//!
//! Timeouts on rosrust's: without them a subscriber that stops reading blocks its topic for all others
//! (rosrust issue 211), and a client that connects and stays silent keeps others from connecting. The
//! loopback interface on RustDDS's: it announces itself there alone when told so, but listens at all
//! addresses.

use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::time::Duration;

/// Longest time to reach the own socket.
const WAKE_TIMEOUT: Duration = Duration::from_millis(200);

/// Ends the threads that wait for connections at ports whose topic or service is gone: they
/// look only when somebody connects.
pub(super) fn wake(ports: &[u16]) {
    for &port in ports {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        // Refused: the thread has ended already.
        let _ = TcpStream::connect_timeout(&address, WAKE_TIMEOUT);
    }
}

#[cfg(not(target_os = "linux"))]
pub(super) fn limited<T>(bind: impl FnOnce() -> T) -> (T, Vec<u16>) {
    (bind(), Vec::new())
}

#[cfg(target_os = "linux")]
pub(super) use linux::limited;

/// Runs `open` and ties the UDP sockets that it opened to the loopback interface: what comes from, or
/// would go to, another machine then passes none of them.
///
/// # Errors
/// The system does not tie them.
#[cfg(all(feature = "ros2", not(target_os = "linux")))]
pub(super) fn confined<T>(_: impl FnOnce() -> T) -> std::io::Result<T> {
    Err(std::io::ErrorKind::Unsupported.into())
}

#[cfg(all(feature = "ros2", target_os = "linux"))]
pub(super) use linux::confined;

#[cfg(target_os = "linux")]
mod linux {
    use std::collections::HashMap;
    use std::fs;
    use std::os::fd::{BorrowedFd, OwnedFd, RawFd};
    use std::path::PathBuf;
    use std::sync::Mutex;
    use std::time::Duration;

    use rustix::net::sockopt;

    use crate::seam::lock;

    /// Longest time that sending to a subscriber may block the topic.
    const SEND_TIMEOUT: Duration = Duration::from_millis(200);
    /// Longest time that a client may stay silent while it connects.
    const RECEIVE_TIMEOUT: Duration = Duration::from_secs(1);
    /// Longest time that sent data may stay unacknowledged \[ms\].
    const USER_TIMEOUT_MS: u32 = 2_000;

    static BINDING: Mutex<()> = Mutex::new(());

    /// Runs `bind` and puts timeouts on the listening sockets that it opened; accepted sockets
    /// inherit them. Also returns their ports.
    pub(in crate::seam) fn limited<T>(bind: impl FnOnce() -> T) -> (T, Vec<u16>) {
        let _one_at_a_time = lock(&BINDING);
        let before = listeners();
        let bound = bind();
        let mut ports = Vec::new();
        for (inode, socket) in listeners() {
            if before.contains_key(&inode) {
                continue;
            }
            // A socket without its timeouts works as ROS nodes usually do.
            let _ =
                sockopt::set_socket_timeout(&socket, sockopt::Timeout::Send, Some(SEND_TIMEOUT));
            let _ =
                sockopt::set_socket_timeout(&socket, sockopt::Timeout::Recv, Some(RECEIVE_TIMEOUT));
            let _ = sockopt::set_tcp_nodelay(&socket, true);
            let _ = sockopt::set_tcp_user_timeout(&socket, USER_TIMEOUT_MS);
            ports.extend(port(&socket));
        }
        (bound, ports)
    }

    fn port(socket: &OwnedFd) -> Option<u16> {
        let address = rustix::net::getsockname(socket).ok()?;
        std::net::SocketAddr::try_from(address)
            .ok()
            .map(|address| address.port())
    }

    /// The loopback interface.
    #[cfg(feature = "ros2")]
    const LOOPBACK: &[u8] = b"lo";

    /// Runs `open` and ties the UDP sockets that it opened to the loopback interface.
    #[cfg(feature = "ros2")]
    pub(in crate::seam) fn confined<T>(open: impl FnOnce() -> T) -> std::io::Result<T> {
        use rustix::net::SocketType;
        let _one_at_a_time = lock(&BINDING);
        let is_udp =
            |socket: &OwnedFd| sockopt::socket_type(socket).is_ok_and(|t| t == SocketType::DGRAM);
        let before = sockets(is_udp);
        let opened = open();
        for (inode, socket) in sockets(is_udp) {
            if !before.contains_key(&inode) && port(&socket).is_some() {
                socket2::SockRef::from(&socket).bind_device(Some(LOOPBACK))?;
            }
        }
        Ok(opened)
    }

    /// The process's listening sockets, by what `/proc` calls them.
    fn listeners() -> HashMap<PathBuf, OwnedFd> {
        sockets(|socket| sockopt::socket_acceptconn(socket).unwrap_or(false))
    }

    /// The process's sockets of a kind.
    fn sockets(is_wanted: impl Fn(&OwnedFd) -> bool) -> HashMap<PathBuf, OwnedFd> {
        let Ok(entries) = fs::read_dir("/proc/self/fd") else {
            return HashMap::new();
        };
        entries
            .filter_map(|entry| {
                let entry = entry.ok()?;
                let target = fs::read_link(entry.path()).ok()?;
                if !target.to_str()?.starts_with("socket:") {
                    return None;
                }
                let socket = duplicate(entry.file_name().to_str()?.parse().ok()?)?;
                is_wanted(&socket).then_some((target, socket))
            })
            .collect()
    }

    /// A second descriptor of the same open file.
    fn duplicate(descriptor: RawFd) -> Option<OwnedFd> {
        #[expect(unsafe_code, reason = "libraries do not hand out their sockets")]
        // SAFETY: the descriptor was open a moment ago and is only duplicated. Had another
        // thread closed it since, duplicating fails or yields another open file, which the
        // caller keeps apart by asking what it is.
        let borrowed = unsafe { BorrowedFd::borrow_raw(descriptor) };
        borrowed.try_clone_to_owned().ok()
    }
}

#[cfg(all(test, feature = "ros2", target_os = "linux"))]
mod tests {
    use std::net::{TcpListener, UdpSocket};

    use socket2::SockRef;

    #[test]
    fn sockets_that_are_opened_are_tied_to_loopback_and_others_are_not() {
        let before = UdpSocket::bind("0.0.0.0:0").unwrap();
        let open = || {
            (
                UdpSocket::bind("0.0.0.0:0"),
                TcpListener::bind("127.0.0.1:0"),
            )
        };
        let (tied, listener) = super::confined(open).unwrap();
        let device = |socket: SockRef<'_>| socket.device().unwrap();
        assert_eq!(device(SockRef::from(&tied.unwrap())).unwrap(), b"lo");
        assert_eq!(device(SockRef::from(&listener.unwrap())), None);
        assert_eq!(device(SockRef::from(&before)), None);
    }
}
