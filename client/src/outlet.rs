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

/// Publisher of one service: stamps the header and sends.
///
/// A slow reader loses messages; it never blocks the publisher.
#[derive(Debug)]
pub(crate) struct Outlet<T: Message> {
    publisher: Publisher<ipc::Variant, T, ()>,
    sender: MessageSender,
    file: ServiceFile,
    checked: Cell<Instant>,
    /// Checks in a row that found the file replaced.
    replaced: Cell<u32>,
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
            file: service.file.clone(),
            checked: Cell::new(Instant::now()),
            replaced: Cell::default(),
        })
    }

    pub(crate) fn sender_id(&self) -> u64 {
        self.sender.id()
    }

    pub(crate) fn send(&self, mut message: T) -> Result<Header, LinkError> {
        self.check_place()?;
        let header = self.sender.next_header(T::SERVICE);
        message.set_header(header);
        self.publisher
            .send_copy(message)
            .map_err(|cause| LinkError::send(T::SERVICE, cause))?;
        Ok(header)
    }

    /// Fails where no daemon can receive any more. The second check in a row decides: a daemon whose root folder is emptied
    /// first brings its robot to rest, within a second and the ramp, and its driver takes part in that.
    fn check_place(&self) -> Result<(), LinkError> {
        if self.replaced.get() < 2 {
            if self.checked.get().elapsed() < CHECK_INTERVAL {
                return Ok(());
            }
            self.checked.set(Instant::now());
            let before = self.replaced.get();
            let is_replaced = self.file.is_replaced();
            self.replaced.set(if is_replaced { before + 1 } else { 0 });
        }
        if self.replaced.get() < 2 {
            return Ok(());
        }
        Err(LinkError::replaced(T::SERVICE))
    }
}
