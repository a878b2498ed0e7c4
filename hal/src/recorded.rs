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
}
