//! A ring whose newest element is never lost.
//!
//! ```text
//!  sender ── ring (every element, as long as there is room) ──────────► receiver
//!         └─ spill (triple buffer: the newest that found no room) ──► receiver
//! ```
//!
//! When the ring is full, the element goes to the spill and replaces the one that was there. So what a receiver that was
//! held up gets is the oldest elements, as many as the ring holds, and the newest one; those between are lost. The
//! oldest matter, too: they hold the answers to the requests that were made before the hold-up.
//!
//! Invariant: both ends are wait-free, and nothing here allocates after [`record_ring`].

use rtrb::{Consumer, Producer, RingBuffer};
use triple_buffer::{Input, Output, triple_buffer};

/// An element with its place in the order of sending, counted from 1.
#[derive(Debug, Clone, Copy)]
struct Numbered<T> {
    number: u64,
    element: T,
}

#[derive(Debug)]
pub struct RecordSender<T: Send> {
    ring: Producer<Numbered<T>>,
    spill: Input<Option<Numbered<T>>>,
    sent: u64,
}

#[derive(Debug)]
pub struct RecordReceiver<T: Send> {
    ring: Consumer<Numbered<T>>,
    spill: Output<Option<Numbered<T>>>,
    /// Number of the newest element that was taken out.
    taken: u64,
    lost: u64,
}

pub fn record_ring<T: Copy + Send>(capacity: usize) -> (RecordSender<T>, RecordReceiver<T>) {
    let (ring_in, ring_out) = RingBuffer::new(capacity);
    let (spill_in, spill_out) = triple_buffer(&None);
    let sender = RecordSender {
        ring: ring_in,
        spill: spill_in,
        sent: 0,
    };
    let receiver = RecordReceiver {
        ring: ring_out,
        spill: spill_out,
        taken: 0,
        lost: 0,
    };
    (sender, receiver)
}

impl<T: Copy + Send> RecordSender<T> {
    /// Sends `element`. Never fails: in a full ring it takes the place of the newest one before it that found no room.
    pub fn send(&mut self, element: T) {
        self.sent += 1;
        let numbered = Numbered {
            number: self.sent,
            element,
        };
        if let Err(rtrb::PushError::Full(numbered)) = self.ring.push(numbered) {
            *self.spill.input_buffer_mut() = Some(numbered);
            self.spill.publish();
        }
    }
}

impl<T: Copy + Send> RecordReceiver<T> {
    /// The oldest element that waits. Elements come in the order in which they were sent.
    pub fn receive(&mut self) -> Option<T> {
        // The spill first, then the ring. What is spilled between the two found the ring full, and nobody but this end
        // makes room: then the front is older. The other way round the ring could fill up in between, unseen.
        let spilled = self.spilled();
        let front = self.ring.peek().ok().map(|front| front.number);
        let next = match (spilled, front) {
            (Some(spilled), Some(front)) if front < spilled => self.ring.pop().ok()?,
            (Some(_), _) => (*self.spill.output_buffer())?,
            (None, _) => self.ring.pop().ok()?,
        };
        self.lost += next.number - self.taken - 1;
        self.taken = next.number;
        Some(next.element)
    }

    pub fn is_empty(&mut self) -> bool {
        self.ring.is_empty() && self.spilled().is_none()
    }

    /// Elements so far that were lost because the ring was full.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Number of the newest spilled element, if it is newer than what was taken out.
    fn spilled(&mut self) -> Option<u64> {
        self.spill.update();
        let spilled = self.spill.output_buffer().as_ref();
        let number = spilled.map(|spilled| spilled.number);
        number.filter(|number| *number > self.taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(receiver: &mut RecordReceiver<u64>) -> Vec<u64> {
        core::iter::from_fn(|| receiver.receive()).collect()
    }

    #[test]
    fn a_full_ring_keeps_the_oldest_and_the_newest() {
        let (mut sender, mut receiver) = record_ring(3);
        assert!(receiver.is_empty() && receiver.receive().is_none());
        (1..=10).for_each(|number| sender.send(number));
        assert!(!receiver.is_empty());
        assert_eq!(all(&mut receiver), [1, 2, 3, 10]);
        assert!(receiver.is_empty());
        assert_eq!(receiver.lost(), 6);
        (11..=12).for_each(|number| sender.send(number));
        assert_eq!(all(&mut receiver), [11, 12]);
        assert_eq!(receiver.lost(), 6);
    }

    #[test]
    fn what_found_no_room_comes_before_what_found_room_after_it() {
        let (mut sender, mut receiver) = record_ring(2);
        (1..=3).for_each(|number| sender.send(number));
        assert_eq!(receiver.receive(), Some(1));
        sender.send(4);
        sender.send(5);
        // 3 and 5 found no room, and 5 took the place of 3.
        assert_eq!(all(&mut receiver), [2, 4, 5]);
        assert_eq!(receiver.lost(), 1);
        (6..=8).for_each(|number| sender.send(number));
        assert_eq!(receiver.receive(), Some(6));
        sender.send(9);
        assert_eq!(all(&mut receiver), [7, 8, 9]);
        assert_eq!(receiver.lost(), 1);
    }

    #[test]
    fn two_threads_lose_neither_the_order_nor_the_last() {
        const LAST: u64 = 200_000;
        let (mut sender, mut receiver) = record_ring(4);
        let sending = std::thread::spawn(move || (1..=LAST).for_each(|number| sender.send(number)));
        let (mut newest, mut received) = (0, 0);
        while newest < LAST {
            if let Some(number) = receiver.receive() {
                assert!(number > newest, "{number} after {newest}");
                newest = number;
                received += 1;
            }
        }
        sending.join().unwrap();
        assert!(receiver.is_empty());
        assert_eq!(received + receiver.lost(), LAST);
    }
}
