//! A ring that never loses its newest element, with elements written in place.
//!
//! ```text
//!  sender ── ring (every element, while there is space) ──────► receiver ── (any channel) ──► last reader
//!    ▲    └─ spill (triple buffer: the newest without space) ─► receiver                            │
//!    └──────────────────────────── memory to be reused ───────────────┴───────────────────────────┘
//! ```
//!
//! If the ring is full, an element goes to the spill and replaces the one there. A receiver that stalled gets
//! the oldest elements, as many as the ring holds, and the newest one; those between are lost. The oldest
//! matter, too: they contain the answers to requests made before the stall.
//!
//! The ends exchange addresses of elements: an element is written once and read in place. The last reader
//! returns it, and the memory returned last is written first, while it is still in the caches.
//!
//! Invariant: all ends are wait-free, and nothing here allocates or frees after [`record_ring`].

use core::ops::Deref;

use rtrb::{Consumer, Producer, RingBuffer};
use triple_buffer::{Input, Output, TripleBuffer};

/// A sent element with its number in the order of sending, counted from 1.
#[derive(Debug)]
pub struct Sent<T> {
    number: u64,
    memory: Box<Option<T>>,
}

impl<T> Deref for Sent<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.memory.as_ref().as_ref().expect("it was written")
    }
}

#[derive(Debug)]
pub struct RecordSender<T: Send> {
    ring: Producer<Sent<T>>,
    spill: Input<Option<Sent<T>>>,
    /// From the receiver and from the last reader.
    returned: [Consumer<Sent<T>>; 2],
    /// Memory not in use.
    free: Vec<Box<Option<T>>>,
    /// Written when no memory is free, and not sent.
    spare: Box<Option<T>>,
    sent: u64,
}

#[derive(Debug)]
pub struct RecordReceiver<T: Send> {
    ring: Consumer<Sent<T>>,
    spill: Output<Option<Sent<T>>>,
    used: Used<T>,
    /// Number of the newest element received.
    taken: u64,
    lost: u64,
}

/// Returns elements that were read.
#[derive(Debug)]
pub struct Used<T: Send>(Producer<Sent<T>>);

/// A ring of `capacity` elements, with up to `beyond` more elements passed on by the receiver.
pub fn record_ring<T: Send>(
    capacity: usize,
    beyond: usize,
) -> (RecordSender<T>, RecordReceiver<T>, Used<T>) {
    // Three in the spill, and one held by the receiver.
    let elements = capacity + beyond + 4;
    let (ring_in, ring_out) = RingBuffer::new(capacity);
    let (spill_in, spill_out) = TripleBuffer::default().split();
    let (received, back_from_receiver) = RingBuffer::new(elements);
    let (read, back_from_reader) = RingBuffer::new(elements);
    let sender = RecordSender {
        ring: ring_in,
        spill: spill_in,
        returned: [back_from_receiver, back_from_reader],
        free: (0..elements).map(|_| Box::new(None)).collect(),
        spare: Box::new(None),
        sent: 0,
    };
    let receiver = RecordReceiver {
        ring: ring_out,
        spill: spill_out,
        used: Used(received),
        taken: 0,
        lost: 0,
    };
    (sender, receiver, Used(read))
}

impl<T: Send> RecordSender<T> {
    /// Sends the element that `write` leaves in memory, which may contain an earlier element. Never fails: if
    /// the ring is full, the element replaces the one in the spill.
    pub fn send(&mut self, write: impl FnOnce(&mut Option<T>)) {
        self.sent += 1;
        for returned in &mut self.returned {
            while let Ok(read) = returned.pop() {
                self.free.push(read.memory);
            }
        }
        // There is memory for all ends; it runs out only if a reader does not return elements.
        let Some(mut memory) = self.free.pop() else {
            return write(&mut self.spare);
        };
        write(&mut memory);
        let number = self.sent;
        if let Err(rtrb::PushError::Full(sent)) = self.ring.push(Sent { number, memory }) {
            let replaced = self.spill.input_buffer_mut().replace(sent);
            self.free.extend(replaced.map(|replaced| replaced.memory));
            self.spill.publish();
        }
    }
}

impl<T: Send> RecordReceiver<T> {
    /// The oldest waiting element. Elements arrive in the order of sending.
    pub fn receive(&mut self) -> Option<Sent<T>> {
        // Check the spill first, then the ring. An element spilled between the two checks found the ring
        // full; only this end removes elements, so the front of the ring is older. In the other order the
        // ring could fill up unseen between the checks.
        let spilled = self.spilled();
        let front = self.ring.peek().ok().map(|front| front.number);
        let next = match (spilled, front) {
            (Some(spilled), Some(front)) if front < spilled => self.ring.pop().ok()?,
            (Some(_), _) => self.spill.output_buffer_mut().take()?,
            (None, _) => self.ring.pop().ok()?,
        };
        self.lost += next.number - self.taken - 1;
        self.taken = next.number;
        Some(next)
    }

    /// Returns an element that is not passed on.
    pub fn recycle(&mut self, read: Sent<T>) {
        self.used.recycle(read);
    }

    pub fn is_empty(&mut self) -> bool {
        self.ring.is_empty() && self.spilled().is_none()
    }

    /// Number of elements lost so far because the ring was full.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Number of the newest spilled element, if it is newer than the newest one received.
    fn spilled(&mut self) -> Option<u64> {
        self.spill.update();
        let spilled = self.spill.output_buffer().as_ref();
        let number = spilled.map(|spilled| spilled.number);
        number.filter(|number| *number > self.taken)
    }
}

impl<T: Send> Used<T> {
    pub fn recycle(&mut self, read: Sent<T>) {
        // The ring has the capacity for all elements.
        let _ = self.0.push(read);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn send(sender: &mut RecordSender<u64>, element: u64) {
        sender.send(|memory| *memory = Some(element));
    }

    fn receive(receiver: &mut RecordReceiver<u64>) -> Option<u64> {
        let sent = receiver.receive()?;
        let element = *sent;
        receiver.recycle(sent);
        Some(element)
    }

    fn all(receiver: &mut RecordReceiver<u64>) -> Vec<u64> {
        core::iter::from_fn(|| receive(receiver)).collect()
    }

    #[test]
    fn a_full_ring_keeps_the_oldest_and_the_newest() {
        let (mut sender, mut receiver, _) = record_ring(3, 0);
        assert!(receiver.is_empty() && receiver.receive().is_none());
        (1..=10).for_each(|number| send(&mut sender, number));
        assert!(!receiver.is_empty());
        assert_eq!(all(&mut receiver), [1, 2, 3, 10]);
        assert!(receiver.is_empty());
        assert_eq!(receiver.lost(), 6);
        (11..=12).for_each(|number| send(&mut sender, number));
        assert_eq!(all(&mut receiver), [11, 12]);
        assert_eq!(receiver.lost(), 6);
    }

    #[test]
    fn what_found_no_room_comes_before_what_found_room_after_it() {
        let (mut sender, mut receiver, _) = record_ring(2, 0);
        (1..=3).for_each(|number| send(&mut sender, number));
        assert_eq!(receive(&mut receiver), Some(1));
        send(&mut sender, 4);
        send(&mut sender, 5);
        // 3 and 5 were spilled, and 5 replaced 3.
        assert_eq!(all(&mut receiver), [2, 4, 5]);
        assert_eq!(receiver.lost(), 1);
        (6..=8).for_each(|number| send(&mut sender, number));
        assert_eq!(receive(&mut receiver), Some(6));
        send(&mut sender, 9);
        assert_eq!(all(&mut receiver), [7, 8, 9]);
        assert_eq!(receiver.lost(), 1);
    }

    #[test]
    fn two_threads_lose_neither_the_order_nor_the_last() {
        const LAST: u64 = 200_000;
        let (mut sender, mut receiver, mut last) = record_ring(4, 1);
        let sending =
            std::thread::spawn(move || (1..=LAST).for_each(|number| send(&mut sender, number)));
        let (mut newest, mut received) = (0, 0);
        while newest < LAST {
            if let Some(sent) = receiver.receive() {
                assert!(*sent > newest, "{} after {newest}", *sent);
                newest = *sent;
                received += 1;
                last.recycle(sent);
            }
        }
        sending.join().unwrap();
        assert!(receiver.is_empty());
        assert_eq!(received + receiver.lost(), LAST);
    }

    #[test]
    fn no_memory_is_lost_and_the_warm_one_comes_first() {
        let (mut sender, mut receiver, mut last) = record_ring(3, 2);
        let mut addresses = std::collections::BTreeSet::new();
        let mut beyond = std::collections::VecDeque::new();
        for number in 1..=1000 {
            send(&mut sender, number);
            // A receiver that stalls now and then, and a reader that lags.
            while number % 7 < 3
                && let Some(sent) = receiver.receive()
            {
                addresses.insert(&raw const *sent as usize);
                beyond.push_back(sent);
                match beyond.len() {
                    1..=2 => {}
                    _ if number % 2 == 0 => beyond.drain(..).for_each(|sent| last.recycle(sent)),
                    _ => beyond
                        .pop_back()
                        .into_iter()
                        .for_each(|sent| receiver.recycle(sent)),
                }
            }
        }
        beyond.drain(..).for_each(|sent| last.recycle(sent));
        assert!(addresses.len() <= 9, "{addresses:?}");
        all(&mut receiver);
        send(&mut sender, 1001);
        assert_eq!(all(&mut receiver), [1001], "there is memory left");
        // With punctual readers the memory is always the same.
        let addresses = (0..9).map(|number| {
            send(&mut sender, number);
            let sent = receiver.receive().unwrap();
            let address = &raw const *sent as usize;
            last.recycle(sent);
            address
        });
        assert_eq!(
            addresses.collect::<std::collections::BTreeSet<_>>().len(),
            1
        );
    }
}
