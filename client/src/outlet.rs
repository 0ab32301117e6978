use std::cell::Cell;
use std::time::{Duration, Instant};

use cdcr_shared_types::{Header, ipc};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::BackpressureStrategy;

use crate::sender::MessageSender;
use crate::services::{Channel, ServiceFile};
use crate::{LinkError, Message};

/// Interval of the checks that the daemon's root folder is still the one of the port.
const CHECK_INTERVAL: Duration = Duration::from_secs(2);
/// How long the folder is another one before a port fails. A daemon whose folder is emptied notices that within 1 s and waits
/// up to 10 s for its robot to be at rest; its driver takes part in that.
const RAMP: Duration = Duration::from_secs(12);

/// Publisher of one service: stamps the header and sends.
///
/// A slow reader loses messages; it never blocks the publisher.
#[derive(Debug)]
pub(crate) struct Outlet<T: Message> {
    publisher: Publisher<ipc::Variant, T, ()>,
    sender: MessageSender,
    place: PlaceWatch,
}

impl<T: Message> Outlet<T> {
    pub(crate) fn open(service: &Channel<T>, sender: MessageSender) -> Result<Self, LinkError> {
        let queues = T::SERVICE.queues();
        let bytes = queues.writer_bytes(size_of::<T>());
        let publisher = service.make_port(
            T::SERVICE,
            bytes,
            |service| {
                service
                    .publisher_builder()
                    .backpressure_strategy(BackpressureStrategy::DiscardData)
                    .override_sample_preallocation(move |_| queues.writer_messages())
                    .create()
            },
            |cause| LinkError::port(T::SERVICE, cause),
        )?;
        Ok(Self {
            publisher,
            sender,
            place: PlaceWatch::new(service.file.clone()),
        })
    }

    pub(crate) fn sender_id(&self) -> u64 {
        self.sender.id()
    }

    pub(crate) fn send(&self, mut message: T) -> Result<Header, LinkError> {
        if self.place.is_lost(Instant::now()) {
            return Err(LinkError::replaced(T::SERVICE));
        }
        let header = self.sender.next_header(T::SERVICE);
        message.set_header(header);
        self.publisher
            .send_copy(message)
            .map_err(|cause| LinkError::send(T::SERVICE, cause))?;
        Ok(header)
    }
}

/// Watches whether a daemon can still receive what a port sends.
#[derive(Debug)]
struct PlaceWatch {
    file: ServiceFile,
    checked: Cell<Instant>,
    /// The first of the checks in a row that found the file replaced.
    replaced: Cell<Option<Instant>>,
}

impl PlaceWatch {
    fn new(file: ServiceFile) -> Self {
        Self {
            file,
            checked: Cell::new(Instant::now()),
            replaced: Cell::default(),
        }
    }

    /// Whether no daemon can receive any more, for ever.
    fn is_lost(&self, now: Instant) -> bool {
        if !self.is_sure() && now - self.checked.get() >= CHECK_INTERVAL {
            self.checked.set(now);
            let before = self.replaced.get();
            let is_replaced = self.file.is_replaced();
            self.replaced
                .set(is_replaced.then(|| before.unwrap_or(now)));
        }
        self.is_sure()
    }

    fn is_sure(&self) -> bool {
        let since = self.replaced.get();
        since.is_some_and(|since| self.checked.get() - since >= RAMP)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_lost_only_after_a_daemon_can_have_brought_its_robot_to_rest() {
        for (every_ms, told_ms) in [(5, 14_000), (2_000, 14_000), (60_000, 120_000)] {
            let watch = PlaceWatch::new(ServiceFile::new("/nonexistent/service".into()));
            let begin = watch.checked.get();
            let after = |ms: u64| begin + Duration::from_millis(ms);
            let sent_ms = (1..).map(|k| k * every_ms);
            let first_ms = sent_ms.clone().find(|ms| watch.is_lost(after(*ms)));
            assert_eq!(first_ms, Some(told_ms));
            assert!(watch.is_lost(after(told_ms + 1)), "for ever");
        }
    }
}
