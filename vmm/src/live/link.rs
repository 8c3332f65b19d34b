//! Takt's ends of the two queues of one partition.

use takt_abi::live::{Answer, Buffer, MESSAGE_BYTES, Order, SampleHead, decode_answer};
use takt_channel::{QueuingDestination, QueuingSource, ReceiveError, Tsc};
use takt_scheduler::time;

use super::LiveError;
use crate::channels::Regions;
use crate::host_ports::pages::{Own, Peer};

/// Answers that are taken in one turn.
const ANSWERS_EACH_TURN: usize = 512;

/// Both ends.
pub struct Link {
    orders: QueuingSource<Own, Peer>,
    answers: QueuingDestination<Peer, Own>,
    buffer: Buffer,
    /// Number of the last order.
    number: u32,
    /// Number of the last answer, as the guest says.
    answered: u32,
    /// Which start of the guest's end the orders go to.
    epoch: u64,
    /// Messages that were no answers.
    hostile: u64,
}

/// What the guest has sent.
pub enum Received<'a> {
    /// An answer to the order of this number.
    Answer(u32, &'a Answer),
    /// A part of a sample.
    Sample(&'a SampleHead, &'a [u8]),
}

/// Why an order was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotSent {
    /// The guest has not opened its end: it is not there yet, or not any more.
    NoGuest,
    /// It has not taken the orders before.
    Full,
}

impl Link {
    /// Opens both. The headers of the guest's regions must have been written.
    ///
    /// # Errors
    /// See [`LiveError`].
    pub fn open(orders: &Regions<'_>, answers: &Regions<'_>) -> Result<Self, LiveError> {
        let mut own = Own::map(&orders.source)?;
        orders.geometry.format_source(&mut own)?;
        let peer = Peer::map(orders.destination.as_ref().ok_or(LiveError::Missing)?)?;
        let orders = QueuingSource::open(own, peer, &orders.geometry)?;
        let mut own = Own::map(answers.destination.as_ref().ok_or(LiveError::Missing)?)?;
        answers.geometry.format_destination(&mut own)?;
        let peer = Peer::map(&answers.source)?;
        let answers = QueuingDestination::open(peer, own, &answers.geometry)?;
        let buffer = [0; MESSAGE_BYTES];
        Ok(Self { orders, answers, buffer, number: 0, answered: 0, epoch: 0, hostile: 0 })
    }

    /// True once after each start of the guest's kernel: it knows nothing of what it was told before.
    pub fn has_restarted(&mut self) -> bool {
        let epoch = self.orders.status().peer_epoch;
        let has_restarted = std::mem::replace(&mut self.epoch, epoch) != epoch;
        if has_restarted {
            self.answered = self.number;
        }
        has_restarted
    }

    /// Whether the order of this number, or a later one, is answered, or the kernel has taken all there are. Before that
    /// the same is not asked again: a kernel with rare windows takes few orders, and those of operators need the room.
    pub fn may_ask_again(&mut self, number: u32) -> bool {
        self.answered.wrapping_sub(number) < 1 << 31 || self.orders.status().waiting == 0
    }

    /// Sends an order; returns its number, which its answer has too.
    ///
    /// # Errors
    /// See [`NotSent`].
    pub fn send(&mut self, order: &Order) -> Result<u32, NotSent> {
        // One that has started since the last turn has yet to be told what was kept for it, and orders that were meant for the one
        // before are void.
        let epoch = self.orders.status().peer_epoch;
        if epoch == 0 || epoch != self.epoch {
            return Err(NotSent::NoGuest);
        }
        // 0 is the number of an answer that was not asked for.
        let number = self.number.wrapping_add(1).max(1);
        let message = order.encode(number, &mut self.buffer).unwrap_or_default();
        let stamp = Tsc(time::Tsc::now().0);
        self.orders.send(message, stamp).map_err(|_| NotSent::Full)?;
        self.number = number;
        Ok(number)
    }

    /// Takes the answers that wait, up to a bound. What is no answer is counted.
    pub fn receive(&mut self, mut take: impl FnMut(Received<'_>)) {
        for _ in 0..ANSWERS_EACH_TURN {
            match self.answers.receive(&mut self.buffer) {
                Ok(message) => {
                    let answer = decode_answer(message.bytes);
                    match (answer, SampleHead::decode(message.bytes)) {
                        (Some((number, answer)), _) => {
                            self.answered = number;
                            take(Received::Answer(number, &answer));
                        }
                        (None, Some((head, bytes))) => take(Received::Sample(&head, bytes)),
                        (None, None) => self.hostile = self.hostile.saturating_add(1),
                    }
                }
                Err(ReceiveError::Empty | ReceiveError::Buffer(_)) => return,
                Err(ReceiveError::Unstable | ReceiveError::Hostile(_)) => {}
            }
        }
    }

    /// Number of the last order.
    #[cfg(test)]
    pub fn last(&self) -> u32 {
        self.number
    }

    /// What the guest has sent that no kernel would send.
    pub fn hostile(&mut self) -> u64 {
        self.hostile.saturating_add(self.answers.status().counters.hostile)
    }
}
