//! A tracker sends three poses of a needle's tip over OpenIGTLink; a client on the same computer reads
//! them out of the stream, in whatever pieces they come.
//!
//! `cargo run --release -p igtl --example tip_over_a_socket`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::time::Duration;

use igtl::{Body, Message, Reader, Transform};

/// Largest message that the client takes \[bytes\].
const LARGEST: usize = 64 << 10;
/// Silence after which the client gives up.
const SILENCE: Duration = Duration::from_secs(10);

type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// The tip as it sinks by 1 mm from message to message.
fn sent() -> Vec<Message> {
    [0.0, 1.0, 2.0]
        .map(|depth| Message::new("Tip", Body::Transform(Transform::at([12.0, -3.5, depth]))))
        .to_vec()
}

fn track(mut client: TcpStream) -> Outcome<()> {
    for message in sent() {
        client.write_all(&message.encode()?)?;
    }
    Ok(())
}

fn receive(mut tracker: TcpStream) -> Outcome<Vec<Message>> {
    tracker.set_read_timeout(Some(SILENCE))?;
    let (mut reader, mut messages) = (Reader::new(LARGEST), Vec::new());
    let mut piece = [0; 50];
    loop {
        let length = tracker.read(&mut piece)?;
        if length == 0 {
            break;
        }
        let mut bytes = &piece[..length];
        while let Some(message) = reader.push(&mut bytes) {
            messages.push(message?);
        }
    }
    match reader.end() {
        Some(broken_off) => Err(broken_off.into()),
        None => Ok(messages),
    }
}

fn main() -> Outcome<()> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let place = listener.local_addr()?;
    let tracker = std::thread::spawn(move || track(listener.accept()?.0));
    let received = receive(TcpStream::connect(place)?)?;
    tracker
        .join()
        .map_err(|_| "the tracker's thread panicked")??;
    for message in &received {
        if let Body::Transform(tip) = &message.body {
            let [x, y, z] = tip.origin;
            println!("{} at {x:.1} {y:.1} {z:.1} mm", message.device);
        }
    }
    assert_eq!(received, sent());
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}
