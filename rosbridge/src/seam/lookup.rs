//! Questions to the master that rosrust does not ask: under which address it knows a node. With a
//! deadline of their own.

use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// Longest wait for a connection, and for each answer.
const DEADLINE: Duration = Duration::from_millis(500);
/// Longest answer that is read.
const LONGEST: u64 = 64 * 1024;

/// The address of a node's own server, as the master knows it; nothing if it knows no such node.
///
/// # Errors
/// The master does not answer.
pub(super) fn node_uri(master: &str, caller: &str, node: &str) -> io::Result<Option<String>> {
    let body = format!(
        "<?xml version=\"1.0\"?><methodCall><methodName>lookupNode</methodName><params>\
         <param><value><string>{caller}</string></value></param>\
         <param><value><string>{node}</string></value></param></params></methodCall>"
    );
    let host = host(master).ok_or(io::ErrorKind::InvalidInput)?;
    let mut stream = connect(host)?;
    let request = format!(
        "POST /RPC2 HTTP/1.0\r\nHost: {host}\r\nContent-Type: text/xml\r\n\
         Content-Length: {}\r\n\r\n{body}",
        body.len()
    );
    stream.write_all(request.as_bytes())?;
    let mut answer = String::new();
    stream.take(LONGEST).read_to_string(&mut answer)?;
    Ok(address(&answer))
}

/// Whether something listens at the address of a node.
pub(super) fn is_alive(uri: &str) -> bool {
    host(uri).is_some_and(|host| connect(host).is_ok())
}

fn connect(host: &str) -> io::Result<TcpStream> {
    let stream = host
        .to_socket_addrs()?
        .find_map(|address| TcpStream::connect_timeout(&address, DEADLINE).ok())
        .ok_or(io::ErrorKind::ConnectionRefused)?;
    stream.set_read_timeout(Some(DEADLINE))?;
    stream.set_write_timeout(Some(DEADLINE))?;
    Ok(stream)
}

/// Host and port of `http://host:port/`.
fn host(uri: &str) -> Option<&str> {
    uri.strip_prefix("http://")?.split('/').next()
}

/// The address in an answer; an answer that the node is unknown has none.
fn address(answer: &str) -> Option<String> {
    let body = answer.split_once("<methodResponse>")?.1;
    let from = body.find("http://")?;
    let uri = body[from..].split('<').next()?;
    Some(uri.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_address_is_found_in_an_answer_and_nowhere_else() {
        let answer = |value: &str| {
            format!(
                "HTTP/1.0 200 OK\r\nServer: http://x/\r\n\r\n<?xml version='1.0'?>\n<methodResponse>\n\
                 <params>\n<param>\n<value><array><data>\n{value}</data></array></value>\n</param>\n\
                 </params>\n</methodResponse>\n"
            )
        };
        let known = "<value><int>1</int></value>\n<value><string>node api</string></value>\n\
                     <value><string>http://127.0.0.1:4711/</string></value>\n";
        assert_eq!(
            address(&answer(known)).as_deref(),
            Some("http://127.0.0.1:4711/")
        );
        let unknown = "<value><int>-1</int></value>\n<value><string>unknown node [/a]</string>\
                       </value>\n<value><int>0</int></value>\n";
        assert_eq!(address(&answer(unknown)), None);
        assert_eq!(host("http://127.0.0.1:11311/"), Some("127.0.0.1:11311"));
        assert_eq!(host("rosrpc://127.0.0.1:1"), None);
    }
}
