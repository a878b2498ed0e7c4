//! The last states and commands of an arm, for the report of a fault.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::{Arm, ArmDescription, ArmState, Error, ErrorKind, RateCommand};

/// Something that happened at the seam of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// Feedback.
    State(ArmState),
    /// Feedback failed.
    StateFailed(ErrorKind),
    /// A command and what became of it.
    Command(RateCommand, Result<(), ErrorKind>),
    /// `enable` and what became of it.
    Enable(Result<(), ErrorKind>),
    /// `stop` and what became of it.
    Stop(Result<(), ErrorKind>),
    /// `reset` and what became of it.
    Reset(Result<(), ErrorKind>),
}

/// An arm whose last events are kept.
#[derive(Debug)]
pub struct Recorded<A> {
    arm: A,
    events: VecDeque<Event>,
    capacity: usize,
}

impl<A: Arm> Recorded<A> {
    /// Keeps the last `capacity` events of `arm`, at least one.
    pub fn new(arm: A, capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self {
            arm,
            events: VecDeque::with_capacity(capacity),
            capacity,
        }
    }

    /// The events kept, oldest first.
    pub fn events(&self) -> impl ExactSizeIterator<Item = &Event> {
        self.events.iter()
    }

    /// The arm behind.
    pub fn inner(&self) -> &A {
        &self.arm
    }

    /// The arm behind, to reach what is not in the trait.
    pub fn inner_mut(&mut self) -> &mut A {
        &mut self.arm
    }

    fn keep(&mut self, event: Event) {
        if self.events.len() == self.capacity {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }
}

fn outcome(result: &Result<(), Error>) -> Result<(), ErrorKind> {
    result.as_ref().map(|&()| ()).map_err(Error::kind)
}

impl<A: Arm> Arm for Recorded<A> {
    fn description(&self) -> &ArmDescription {
        self.arm.description()
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        let result = self.arm.state();
        self.keep(match &result {
            Ok(state) => Event::State(*state),
            Err(error) => Event::StateFailed(error.kind()),
        });
        result
    }

    fn enable(&mut self) -> Result<(), Error> {
        let result = self.arm.enable();
        self.keep(Event::Enable(outcome(&result)));
        result
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        let result = self.arm.command(command);
        self.keep(Event::Command(*command, outcome(&result)));
        result
    }

    fn stop(&mut self) -> Result<(), Error> {
        let result = self.arm.stop();
        self.keep(Event::Stop(outcome(&result)));
        result
    }

    fn reset(&mut self) -> Result<(), Error> {
        let result = self.arm.reset();
        self.keep(Event::Reset(outcome(&result)));
        result
    }

    fn explanation(&self) -> Option<String> {
        self.arm.explanation()
    }
}

#[cfg(test)]
mod tests {
    use core::time::Duration;

    use super::*;
    use crate::{ArmMode, JointLimit, Joints, Stamp};

    /// An arm that counts its calls and refuses when told to.
    struct Fake {
        description: ArmDescription,
        refusal: Option<ErrorKind>,
        calls: u32,
    }

    impl Fake {
        fn new() -> Self {
            let limit = JointLimit {
                lower: -1.0,
                upper: 1.0,
                velocity: 1.0,
                acceleration: 4.0,
                jerk: 40.0,
            };
            let description = ArmDescription {
                name: "fake".into(),
                joint_names: vec!["joint".into()],
                limits: vec![limit],
                period: Duration::from_millis(16),
            };
            Self {
                description,
                refusal: None,
                calls: 0,
            }
        }

        fn call(&mut self) -> Result<(), Error> {
            self.calls += 1;
            self.refusal
                .map_or(Ok(()), |kind| Err(Error::new("fake", kind)))
        }
    }

    impl Arm for Fake {
        fn description(&self) -> &ArmDescription {
            &self.description
        }

        fn state(&mut self) -> Result<ArmState, Error> {
            self.call()?;
            let zero = Joints::zeros(1).unwrap();
            Ok(ArmState {
                stamp: Stamp::from_secs(f64::from(self.calls)),
                positions: zero,
                rates: zero,
                mode: ArmMode::Enabled,
            })
        }

        fn enable(&mut self) -> Result<(), Error> {
            self.call()
        }

        fn command(&mut self, _: &RateCommand) -> Result<(), Error> {
            self.call()
        }

        fn stop(&mut self) -> Result<(), Error> {
            self.call()
        }

        fn reset(&mut self) -> Result<(), Error> {
            self.call()
        }
    }

    fn command(sequence: u64) -> RateCommand {
        RateCommand {
            sequence,
            stamp: Stamp::ZERO,
            rates: Joints::zeros(1).unwrap(),
        }
    }

    #[test]
    fn every_call_is_passed_on_once_and_kept_with_what_became_of_it() {
        let mut arm = Recorded::new(Fake::new(), 100);
        assert_eq!(arm.description().name, "fake");
        let state = arm.state().unwrap();
        arm.enable().unwrap();
        arm.command(&command(1)).unwrap();
        arm.inner_mut().refusal = Some(ErrorKind::Faulted);
        assert_eq!(
            arm.command(&command(2)).unwrap_err().kind(),
            ErrorKind::Faulted
        );
        assert_eq!(arm.state().unwrap_err().kind(), ErrorKind::Faulted);
        assert_eq!(arm.enable().unwrap_err().kind(), ErrorKind::Faulted);
        assert_eq!(arm.stop().unwrap_err().kind(), ErrorKind::Faulted);
        arm.inner_mut().refusal = None;
        arm.stop().unwrap();
        arm.reset().unwrap();
        let refused = Err(ErrorKind::Faulted);
        let expected = [
            Event::State(state),
            Event::Enable(Ok(())),
            Event::Command(command(1), Ok(())),
            Event::Command(command(2), refused),
            Event::StateFailed(ErrorKind::Faulted),
            Event::Enable(refused),
            Event::Stop(refused),
            Event::Stop(Ok(())),
            Event::Reset(Ok(())),
        ];
        assert!(arm.events().eq(&expected), "{:?}", arm.events);
        assert_eq!(arm.inner().calls, 9);
    }

    #[test]
    fn only_the_newest_events_are_kept_in_order() {
        for capacity in [0, 1, 4] {
            let mut arm = Recorded::new(Fake::new(), capacity);
            let kept = u64::try_from(capacity.max(1)).unwrap();
            for sequence in 1..=10 {
                arm.command(&command(sequence)).unwrap();
                assert_eq!(arm.events().len() as u64, sequence.min(kept));
            }
            let sequences: Vec<u64> = arm
                .events()
                .map(|event| match event {
                    Event::Command(command, _) => command.sequence,
                    other => panic!("{other:?}"),
                })
                .collect();
            assert_eq!(sequences, (11 - kept..=10).collect::<Vec<_>>());
        }
    }
}
