use cdcr_shared_types::{Header, ipc};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::BackpressureStrategy;

use crate::sender::MessageSender;
use crate::services::Channel;
use crate::{LinkError, Message};

/// Publisher of one service: stamps the header and sends.
///
/// A slow reader loses messages; it never blocks the publisher.
#[derive(Debug)]
pub(crate) struct Outlet<T: Message> {
    publisher: Publisher<ipc::Variant, T, ()>,
    sender: MessageSender,
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
        Ok(Self { publisher, sender })
    }

    pub(crate) fn sender_id(&self) -> u64 {
        self.sender.id()
    }

    pub(crate) fn send(&self, mut message: T) -> Result<Header, LinkError> {
        let header = self.sender.next_header(T::SERVICE);
        message.set_header(header);
        self.publisher
            .send_copy(message)
            .map_err(|cause| LinkError::send(T::SERVICE, cause))?;
        Ok(header)
    }
}
