use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use cdcr_shared_types::{Header, Service};

use crate::monotonic_ns;

/// Identity of a sender, drawn at random, and one sequence number per service.
///
/// Clones share the sequence numbers, so that two ports of one connection never send the same one.
#[derive(Debug, Clone)]
pub(crate) struct MessageSender {
    id: u64,
    sequences: Arc<[AtomicU64; Service::ALL.len()]>,
}

impl MessageSender {
    /// A new sender. Its identity collides with another one with a probability of 2⁻⁶⁴.
    pub(crate) fn new() -> Self {
        Self {
            id: RandomState::new().build_hasher().finish().max(1),
            sequences: Arc::default(),
        }
    }

    pub(crate) fn id(&self) -> u64 {
        self.id
    }

    /// Header of the next message on `service`: sequence 1, 2, 3, …, and the present time.
    pub(crate) fn next_header(&self, service: Service) -> Header {
        let previous = self.sequences[service as usize].fetch_add(1, Ordering::Relaxed);
        Header {
            sender_id: self.id,
            sequence: previous + 1,
            sent_ns: monotonic_ns(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_service_counts_for_itself_and_clones_count_together() {
        let sender = MessageSender::new();
        assert_ne!(sender.id(), 0);
        assert_ne!(sender.id(), MessageSender::new().id());
        assert_eq!(sender.next_header(Service::Control).sequence, 1);
        assert_eq!(sender.clone().next_header(Service::Control).sequence, 2);
        assert_eq!(sender.next_header(Service::Reference).sequence, 1);
    }
}
