use std::fmt::Debug;

use cdcr_shared_types::{Header, ipc};
use iceoryx2::identifiers::UniquePublisherId;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::sample::Sample;

/// The reading end of a service with several writers, which are served in turn.
///
/// iceoryx2 checks the oldest writer for a message first. A writer that sends as fast as it is read would
/// exclude all others. But iceoryx2 skips a writer of which two messages are held
/// (`subscriber_max_borrowed_samples`). So messages remain held after reading until every waiting writer has
/// been served.
#[derive(Debug)]
pub struct Inlet<T: ZeroCopySend + Debug + 'static> {
    subscriber: Subscriber<ipc::Variant, T, ()>,
    held: Vec<Sample<ipc::Variant, T, ()>>,
    /// The newest sequence number of each writer, the newest writer last.
    newest: Vec<(UniquePublisherId, u64)>,
    header_of: fn(&T) -> &Header,
}

#[derive(Debug, Clone, Copy)]
pub struct Received<T> {
    pub message: T,
    /// The message is newer than earlier ones of its writer.
    pub is_newer: bool,
}

impl<T: ZeroCopySend + Debug + Copy + 'static> Inlet<T> {
    /// `most` is the number of messages that may be held at one time.
    pub(super) fn new(
        subscriber: Subscriber<ipc::Variant, T, ()>,
        most: usize,
        header_of: fn(&T) -> &Header,
    ) -> Self {
        Self {
            subscriber,
            held: Vec::with_capacity(most),
            newest: Vec::with_capacity(most),
            header_of,
        }
    }

    /// The next message, if one waits. A copy, so that no writer can change it after its check.
    pub(crate) fn receive(&mut self) -> Option<Received<T>> {
        let mut next = self.subscriber.receive().ok().flatten();
        if next.is_none() && !self.held.is_empty() {
            // All writers have been served: a new round.
            self.held.clear();
            next = self.subscriber.receive().ok().flatten();
        }
        let sample = next?;
        let message = *sample;
        let writer = sample.header().publisher_id();
        self.held.push(sample);
        let is_newer = self.is_newer(writer, (self.header_of)(&message).sequence);
        Some(Received { message, is_newer })
    }

    fn is_newer(&mut self, writer: UniquePublisherId, sequence: u64) -> bool {
        if let Some((_, newest)) = self.newest.iter_mut().find(|(known, _)| *known == writer) {
            let is_newer = sequence > *newest;
            *newest = sequence.max(*newest);
            return is_newer;
        }
        if self.newest.len() == self.newest.capacity() {
            // Twice the number of simultaneous writers: most of them have gone.
            self.newest.remove(0);
        }
        self.newest.push((writer, sequence));
        true
    }
}
