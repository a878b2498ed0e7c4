//! What a message asks for.

use hal::frame::{LeftCamera, World};
use hal::request::Command;
use hal::{Position, Transform};
use igtl::{Body, Message};

use super::space::{Misplaced, Space};

/// What a message is to the run.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Heard {
    /// It asks for something.
    Command(Command),
    /// It refreshes the dead-man's token.
    DeadMan,
    /// It is dropped: a word for counters, and the reason for who sent it, if that is to be told.
    Dropped(&'static str, Option<String>),
}

/// How messages are understood.
#[derive(Clone, Debug)]
pub(super) struct Ear {
    pub(super) space: Space,
    pub(super) world_from_left_camera: Transform<World, LeftCamera>,
    /// Name of the device whose place is a new target; capital letters do not matter.
    pub(super) target_device: String,
}

/// Words that may be said in a `STRING`, beside `TARGET x y z`.
const WORDS: [(&str, Command); 9] = [
    ("START", Command::Start),
    ("RESUME", Command::Start),
    ("PAUSE", Command::Pause),
    ("RETRACT", Command::Retract),
    ("STOP", Command::Stop),
    ("HOME", Command::Home),
    ("CLEAR_FAULT", Command::ClearFault),
    ("ENABLE", Command::Enable(true)),
    ("DISABLE", Command::Enable(false)),
];
/// The word that refreshes the dead-man's token.
const DEAD_MAN: &str = "DEAD_MAN";
/// The word before the coordinates of a target \[mm\].
const TARGET: &str = "TARGET";
/// Longest word that is repeated to who said it \[characters\].
const REPEATED: usize = 40;

impl Ear {
    pub(super) fn hear(&self, message: &Message) -> Heard {
        match &message.body {
            Body::Text(text) => match text.text() {
                Ok(text) => self.word(text),
                Err(reject) => Heard::Dropped("text", Some(reject.to_string())),
            },
            Body::Transform(transform) if self.is_target(&message.device) => {
                self.target(self.space.read_origin(transform))
            }
            Body::Points(points) if self.is_target(&message.device) => {
                let mut named = points.iter().filter(|point| self.is_target(&point.name));
                let (([point], ..) | (_, Some(point), None)) =
                    (points.as_slice(), named.next(), named.next())
                else {
                    let reason = format!(
                        "{} points: send one, or name one of them {}",
                        points.len(),
                        self.target_device
                    );
                    return Heard::Dropped("ambiguous", Some(reason));
                };
                self.target(self.space.read_point(point.place))
            }
            // Programs share all they have: that is no mistake of theirs.
            Body::Transform(_) | Body::Points(_) => Heard::Dropped("other device", None),
            _ => Heard::Dropped("other type", None),
        }
    }

    fn is_target(&self, name: &str) -> bool {
        name.eq_ignore_ascii_case(&self.target_device)
    }

    fn word(&self, text: &str) -> Heard {
        let mut words = text.split_whitespace();
        let first = words.next().unwrap_or_default();
        let rest: Vec<&str> = words.collect();
        if first.eq_ignore_ascii_case(TARGET) {
            let numbers: Vec<f32> = rest.iter().filter_map(|word| word.parse().ok()).collect();
            return match numbers[..] {
                [x, y, z] if rest.len() == 3 => self.target(self.space.read_point([x, y, z])),
                _ => Heard::Dropped("text", Some("expected TARGET x y z [mm]".into())),
            };
        }
        if rest.is_empty() {
            if first.eq_ignore_ascii_case(DEAD_MAN) {
                return Heard::DeadMan;
            }
            let known = WORDS
                .iter()
                .find(|(word, _)| first.eq_ignore_ascii_case(word));
            if let Some((_, command)) = known {
                return Heard::Command(*command);
            }
        }
        let shown: String = text.chars().take(REPEATED).collect();
        let known: Vec<&str> = WORDS.iter().map(|(word, _)| *word).collect();
        let reason = format!(
            "`{shown}` is no command: {}, {DEAD_MAN}, {TARGET} x y z",
            known.join(", ")
        );
        Heard::Dropped("unknown command", Some(reason))
    }

    fn target(&self, place: Result<Position<World>, Misplaced>) -> Heard {
        match place {
            Ok(place) => {
                let target = self.world_from_left_camera.inverse() * place;
                Heard::Command(Command::Target(target))
            }
            Err(why) => Heard::Dropped(why.reason(), Some(format!("target refused: {why}"))),
        }
    }
}

/// Name of a command in answers.
pub(super) const fn name(command: Command) -> &'static str {
    match command {
        Command::Start => "START",
        Command::Stop => "STOP",
        Command::Pause => "PAUSE",
        Command::Retract => "RETRACT",
        Command::Home => "HOME",
        Command::ClearFault => "CLEAR_FAULT",
        Command::Enable(true) => "ENABLE",
        Command::Enable(false) => "DISABLE",
        Command::Target(_) => TARGET,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::IgtlCoordinates;
    use igtl::{Point, Status, StatusCode, Text};
    use nalgebra::{Isometry3, Vector3};

    fn ear() -> Ear {
        Ear {
            space: Space(IgtlCoordinates::Ras),
            world_from_left_camera: Transform::assume(Isometry3::translation(0.0, 0.0, 1.0)),
            target_device: "NewTarget".into(),
        }
    }

    fn said(text: &str) -> Heard {
        ear().hear(&Message::new("Any", Body::Text(Text::new(text))))
    }

    fn place(heard: &Heard) -> Vector3<f64> {
        match heard {
            Heard::Command(Command::Target(target)) => target.coords(),
            other => panic!("{other:?}"),
        }
    }

    fn reason(heard: &Heard) -> &'static str {
        match heard {
            Heard::Dropped(reason, _) => reason,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn every_word_is_understood_and_named_alike() {
        for (word, command) in WORDS {
            assert_eq!(
                said(&format!(" {}\n", word.to_lowercase())),
                Heard::Command(command)
            );
            if word != "RESUME" {
                assert_eq!(name(command), word);
            }
        }
        assert_eq!(said("dead_man"), Heard::DeadMan);
        for text in ["", "GO", "START NOW", "STOPP"] {
            assert_eq!(reason(&said(text)), "unknown command");
        }
    }

    #[test]
    fn a_target_comes_as_transform_point_or_text() {
        let expected = Vector3::new(0.1, -0.2, -0.7);
        let transform = igtl::Transform::at([100.0, -200.0, 300.0]);
        let point = |name: &str| Point {
            name: name.into(),
            place: [100.0, -200.0, 300.0],
            ..Point::default()
        };
        let other = Point::default();
        for body in [
            Body::Transform(transform),
            Body::Points(vec![point("F-1")]),
            Body::Points(vec![other.clone(), point("newtarget"), other.clone()]),
        ] {
            let heard = ear().hear(&Message::new("NEWTARGET", body));
            assert!((place(&heard) - expected).norm() < 1e-9);
        }
        assert!((place(&said("target 100 -200 300")) - expected).norm() < 1e-9);
        for body in [
            Body::Points(Vec::new()),
            Body::Points(vec![other.clone(), other.clone()]),
            Body::Points(vec![point("newtarget"), point("newtarget")]),
        ] {
            let heard = ear().hear(&Message::new("NewTarget", body));
            assert_eq!(reason(&heard), "ambiguous");
        }
    }

    #[test]
    fn what_is_no_target_is_dropped_with_its_reason() {
        let heard = |device: &str, body| ear().hear(&Message::new(device, body));
        let transform = Body::Transform(igtl::Transform::at([0.0; 3]));
        assert_eq!(reason(&heard("Probe", transform)), "other device");
        let status = Body::Status(Status {
            code: StatusCode::OK,
            sub_code: 0,
            name: String::new(),
            text: String::new(),
        });
        assert_eq!(reason(&heard("Probe", status)), "other type");
        for (text, told) in [
            ("TARGET nan 0 0", "not finite"),
            ("TARGET 1e30 0 0", "far"),
            ("TARGET 0 0", "text"),
            ("TARGET 0 0 0 0", "text"),
            ("TARGET 0 0 x", "text"),
        ] {
            assert_eq!(reason(&said(text)), told, "{text}");
        }
        let body = Body::Text(Text {
            encoding: 4,
            bytes: b"STOP".to_vec(),
        });
        assert_eq!(reason(&heard("", body)), "text");
    }
}
