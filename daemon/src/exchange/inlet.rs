use std::fmt::Debug;

use cdcr_shared_types::ipc;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::sample::Sample;

/// The reading end of a service with several writers, who are served in turn.
///
/// iceoryx2 looks for a message at the oldest writer first, and would hear nobody else beside one that writes as fast as
/// is read. But it passes over a writer of which two messages are held (`subscriber_max_borrowed_samples`). So what was
/// read stays held until every writer that has something to say was heard.
#[derive(Debug)]
pub struct Inlet<T: ZeroCopySend + Debug + 'static> {
    subscriber: Subscriber<ipc::Service, T, ()>,
    held: Vec<Sample<ipc::Service, T, ()>>,
}

impl<T: ZeroCopySend + Debug + Copy + 'static> Inlet<T> {
    /// `most`: messages that may be held at one time.
    pub(super) fn new(subscriber: Subscriber<ipc::Service, T, ()>, most: usize) -> Self {
        let held = Vec::with_capacity(most);
        Self { subscriber, held }
    }

    /// The next message, if one waits. A copy: nobody changes it after it was checked.
    pub(super) fn receive(&mut self) -> Option<T> {
        let mut next = self.subscriber.receive().ok().flatten();
        if next.is_none() && !self.held.is_empty() {
            // Everybody was heard: a new round.
            self.held.clear();
            next = self.subscriber.receive().ok().flatten();
        }
        let sample = next?;
        let message = *sample;
        self.held.push(sample);
        Some(message)
    }
}
