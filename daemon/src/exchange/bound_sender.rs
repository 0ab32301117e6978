/// The process whose measurements are accepted: the first one received, until it is lost. Two drivers of one
/// robot would alternate measurements of two robots. The cycle detects a lost driver and faults; this type
/// only decides who may replace it. A lost tip sensor is not a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BoundSender {
    /// A process without an accepted measurement for longer than this is lost \[ns\].
    lost_after_ns: u64,
    last: Option<LastMessage>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct LastMessage {
    sender: u64,
    received_ns: u64,
}

impl BoundSender {
    /// No process yet; a process is lost after `lost_after_ns` of silence.
    pub(super) fn new(lost_after_ns: u64) -> Self {
        Self {
            lost_after_ns,
            last: None,
        }
    }

    /// True if measurements of `sender` are accepted at `now_ns`; `may_change` lets another process replace a
    /// silent one.
    pub(super) fn is(&self, sender: u64, now_ns: u64, may_change: bool) -> bool {
        self.last.is_none_or(|last| {
            let is_silent = now_ns.saturating_sub(last.received_ns) > self.lost_after_ns;
            let is_lost = may_change && is_silent;
            last.sender == sender || is_lost
        })
    }

    /// The process bound last.
    pub(super) fn id(&self) -> Option<u64> {
        self.last.map(|last| last.sender)
    }

    /// `sender` is the process bound last.
    pub(super) fn is_bound_to(&self, sender: u64) -> bool {
        self.id() == Some(sender)
    }

    /// Binds `sender`, whose measurement was accepted at `now_ns`.
    pub(super) fn bind(&mut self, sender: u64, now_ns: u64) {
        let received_ns = now_ns;
        self.last = Some(LastMessage {
            sender,
            received_ns,
        });
    }

    /// Excludes the `paused_ns` without a gather from the silence of the process.
    pub(super) fn extend(&mut self, paused_ns: u64) {
        if let Some(last) = &mut self.last {
            last.received_ns += paused_ns;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_driver_stays_until_it_is_lost() {
        let mut driver = BoundSender::new(100);
        assert!(driver.is(1, 0, false) && driver.is(2, 0, false));
        driver.bind(1, 50);
        assert!(driver.is(1, 60, false) && !driver.is(2, 60, true));
        assert!(!driver.is(2, 150, true));
        // A cycle that has not yet detected the loss would mix up the two robots.
        assert!(!driver.is(2, 151, false));
        assert!(driver.is(2, 151, true) && driver.is(1, 151, true));
        driver.extend(30);
        assert!(!driver.is(2, 180, true) && driver.is(2, 181, true));
        driver.bind(2, 200);
        assert!(!driver.is(1, 300, true));
    }
}
