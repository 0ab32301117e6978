use std::collections::HashMap;
use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::{Command, Header, Telemetry, ipc};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::service::port_factory::PortFactory as _;

use crate::services::Channel;
use crate::{LinkError, Message};

/// Interval at which a waiting reader checks for a message: a fifth of the usual period.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Subscriber of one service: every message in order, and the number of lost ones.
///
/// A reader that pauses for longer than the service's queue lasts (telemetry: 256 records, 1.28 s at 5 ms)
/// loses the oldest messages; see [`lost`](Self::lost).
///
/// A stream outlives its daemon. When another daemon starts at the same place, its messages follow, with
/// another `sender_id` and numbers from 1. That does not count as loss.
#[derive(Debug)]
pub struct Stream<T: Message> {
    subscriber: Subscriber<ipc::Variant, T, ()>,
    gaps: GapCounter,
}

/// One record per cycle of the daemon.
pub type TelemetryStream = Stream<Telemetry>;

/// All commands of the daemon.
pub type CommandStream = Stream<Command>;

impl<T: Message> Stream<T> {
    /// For monitoring clients: leaves the places free that are reserved for the driver and the daemon.
    pub(crate) fn open(service: &Channel<T>) -> Result<Self, LinkError> {
        let readers = service.dynamic_config().number_of_subscribers();
        if readers >= T::SERVICE.queues().watchers() {
            return Err(LinkError::port(
                T::SERVICE,
                "all places are taken".to_owned(),
            ));
        }
        Self::open_reserved(service)
    }

    /// For the driver and other participants: may use the reserved places.
    pub(crate) fn open_reserved(service: &Channel<T>) -> Result<Self, LinkError> {
        let subscriber = service.make_port(
            T::SERVICE,
            0,
            |service| service.subscriber_builder().create(),
            |cause| LinkError::port(T::SERVICE, cause),
        )?;
        Ok(Self {
            subscriber,
            gaps: GapCounter::default(),
        })
    }

    /// The next message, or `None` when the queue is empty. Never blocks.
    ///
    /// # Errors
    /// [`LinkError::Receive`] when the memory of a writer cannot be mapped.
    pub fn try_next(&mut self) -> Result<Option<T>, LinkError> {
        let sample = self
            .subscriber
            .receive()
            .map_err(|cause| LinkError::receive(T::SERVICE, cause))?;
        Ok(sample.map(|sample| {
            let message = *sample.payload();
            self.gaps.count(message.header());
            message
        }))
    }

    /// The next message, or `None` when none arrived within `timeout`.
    ///
    /// # Errors
    /// As [`try_next`](Self::try_next).
    pub fn next_within(&mut self, timeout: Duration) -> Result<Option<T>, LinkError> {
        let deadline = Instant::now() + timeout;
        loop {
            let message = self.try_next()?;
            if message.is_some() || Instant::now() >= deadline {
                return Ok(message);
            }
            thread::sleep(POLL_INTERVAL);
        }
    }

    /// The newest queued message by its send time, or `None`; older ones are discarded.
    ///
    /// # Errors
    /// As [`try_next`](Self::try_next).
    pub fn newest(&mut self) -> Result<Option<T>, LinkError> {
        let mut newest: Option<T> = None;
        while let Some(message) = self.try_next()? {
            // Queued messages of a killed writer may follow those of its successor.
            if newest.is_none_or(|newest| newest.header().sent_ns <= message.header().sent_ns) {
                newest = Some(message);
            }
        }
        Ok(newest)
    }

    /// Number of lost messages, from the gaps in their sequence numbers. Counting begins at the first message
    /// of each sender, so the restart of a daemon does not count.
    pub fn lost(&self) -> u64 {
        self.gaps.lost
    }
}

/// Counts missing sequence numbers per sender.
#[derive(Debug, Default)]
struct GapCounter {
    last: HashMap<u64, u64>,
    lost: u64,
}

impl GapCounter {
    fn count(&mut self, header: &Header) {
        let last = self.last.insert(header.sender_id, header.sequence);
        if let Some(last) = last {
            self.lost += header.sequence.saturating_sub(last + 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_for_each_sender() {
        let mut gaps = GapCounter::default();
        let header = |sender_id, sequence| Header {
            sender_id,
            sequence,
            sent_ns: 0,
        };
        // The first message of a late joiner is not a gap; a restarted daemon is a new sender.
        for (sender_id, sequence, lost) in
            [(1, 40, 0), (1, 41, 0), (1, 45, 3), (2, 1, 3), (2, 3, 4)]
        {
            gaps.count(&header(sender_id, sequence));
            assert_eq!(gaps.lost, lost);
        }
    }
}
