//! The public V+ program of 2018, as its source reads.

use hal::Joints;

use super::controller::{Controller, Wait};
use super::journal::Record;
use crate::viper::Port;
use crate::viper::wire::{ByteOrder, Codec, JointPosition, Message, TrajAck, sequence};

/// It always reads this many bytes, whatever the frame says.
const READ: usize = 68;
/// Feedback comes every this many cycles: ten times a second at most.
const CYCLES_PER_REPORT: i32 = 7;

/// Walks over the fields that the program looks at.
struct Fields<'a>(&'a [u8]);

impl Codec for Fields<'_> {
    fn i32(&mut self, value: &mut i32) {
        if let Some((head, tail)) = self.0.split_first_chunk() {
            *value = ByteOrder::Big.integer(*head);
            self.0 = tail;
        }
    }
}

impl Controller {
    /// Reads as many blocks as there are, unless a motion blocks the program.
    pub(super) fn read_2018(&mut self) {
        while self.blocked.is_none() && self.unread.len() >= READ {
            let block: Vec<u8> = self.unread.drain(..READ).collect();
            self.take_block(&block);
        }
    }

    fn take_block(&mut self, block: &[u8]) {
        let mut fields = Fields(block);
        let (mut header, mut number, mut target) = ([0; 4], 0, [0.0; 6]);
        fields.i32s(&mut header);
        fields.i32(&mut number);
        fields.f32s(&mut target);
        let stop = number == sequence::STOP;
        // Comm type 2 asks for an answer; it comes before the motion.
        if header[2] == 2 {
            let sequence = if stop { sequence::STOP } else { 0 };
            self.answer(Message::TrajAck(TrajAck { sequence }), true);
        }
        // A stop is not a brake: it only skips its own move.
        if !stop {
            self.move_2018(&target);
        }
    }

    fn move_2018(&mut self, target: &[f32; 6]) {
        let target = Joints::from(target.map(f64::from));
        let reachable = self
            .config
            .limits
            .iter()
            .zip(target.iter())
            .all(|(limit, q)| (limit.lower..=limit.upper).contains(q));
        let powered = self.is_powered();
        if !reachable || !powered && self.knobs.abort_without_power {
            return self.abort();
        }
        if !powered {
            return;
        }
        if self.has_room() {
            self.queue(Wait::Fast(target));
        } else {
            self.blocked = Some(target);
        }
    }

    /// A motion error ends the task; it is restarted about a cycle later.
    fn abort(&mut self) {
        self.record(Record::Aborted);
        self.brake();
        self.unread.clear();
        self.close(Port::Motion);
        self.connections[Port::Motion as usize].opened_after = self.now + self.config.cycle;
    }

    pub(super) fn report_2018(&mut self) {
        if self.tick % CYCLES_PER_REPORT == 0 {
            let positions = self.encoders();
            self.feed_back(Message::JointPosition(JointPosition {
                sequence: 0,
                positions,
            }));
            let mut status = self.status();
            // This program never tells of errors, and calls motion possible when there is none.
            (status.error_code, status.in_error) = (0, 0);
            status.motion_possible = i32::from(!self.is_moving());
            self.feed_back(Message::Status(status));
        }
    }
}
