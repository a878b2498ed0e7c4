//! Two ROS 2 nodes on the loopback interface: one says something, the other hears it and answers.
//!
//! `cargo run --release -p ros2wire --example two_nodes`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use ros2wire::names::{Arguments, Names};
use ros2wire::{Gids, Participant, Quality, Reader, Settings, WireError};

/// `ROS_DOMAIN_ID`.
const DOMAIN: u16 = 42;
/// Time in which nodes on one computer have found each other, with room to spare.
const PATIENCE: Duration = Duration::from_secs(20);

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// `std_msgs/String` in CDR, little endian: the length with its zero byte, the text, the zero byte.
fn cdr(text: &str) -> Outcome<Vec<u8>> {
    let mut bytes = u32::try_from(text.len() + 1)?.to_le_bytes().to_vec();
    bytes.extend_from_slice(text.as_bytes());
    bytes.push(0);
    Ok(bytes)
}

/// The text up to its zero byte: DDS may fill up what follows.
fn text(payload: &[u8]) -> String {
    let text = payload.get(4..).unwrap_or_default();
    let end = text.iter().position(|byte| *byte == 0);
    String::from_utf8_lossy(&text[..end.unwrap_or(text.len())]).into_owned()
}

fn join(node: &str) -> Outcome<Participant> {
    let settings = Settings {
        domain: DOMAIN,
        loopback: true,
        gids: Gids::Short,
    };
    Ok(Participant::join(
        &settings,
        Names::new(node, &Arguments::default())?,
    )?)
}

/// Hears a topic on a thread of its own, for as long as the reader is kept.
fn listen(
    node: &Participant,
    topic: &str,
) -> Result<(Reader, Receiver<(String, String)>), WireError> {
    let (heard, messages) = channel();
    let reader = node.reader(
        topic,
        "std_msgs/String",
        Quality::Latched(1),
        move |sample| {
            // Nobody may be listening any more.
            let _ = heard.send((text(sample.payload), sample.from.to_owned()));
        },
    )?;
    Ok((reader, messages))
}

fn main() -> Outcome<()> {
    // Names of their own, should the example run twice at a time.
    let mine = std::process::id();
    let [greeting, reply] = ["greeting", "reply"].map(|topic| format!("/{topic}_{mine}"));
    let (surgeon, robot) = (join("surgeon")?, join("robot")?);
    let (_asked, asked) = listen(&robot, &greeting)?;
    let (_answered, answered) = listen(&surgeon, &reply)?;

    // Latched: kept for readers that are found later, so nobody has to wait before speaking.
    let to_robot = surgeon.writer(&greeting, "std_msgs/String", Quality::Latched(1))?;
    let to_surgeon = robot.writer(&reply, "std_msgs/String", Quality::Latched(1))?;
    assert!(to_robot.send(cdr("how deep is the needle?")?));

    let (question, from) = asked.recv_timeout(PATIENCE)?;
    println!("{} heard from {from}: {question}", robot.names().full());
    assert!(to_surgeon.send(cdr("40 mm")?));
    let (answer, from) = answered.recv_timeout(PATIENCE)?;
    println!("{} heard from {from}: {answer}", surgeon.names().full());
    assert_eq!([question, answer], ["how deep is the needle?", "40 mm"]);
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}
