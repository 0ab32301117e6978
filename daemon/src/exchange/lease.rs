use cdcr_controller::safety::LeaseState;

/// The right to feed the reference: one client at a time, as long as it renews.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Lease {
    duration_ns: u64,
    holder: Option<Holder>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Holder {
    client: u64,
    expires_ns: u64,
}

impl Lease {
    /// A free lease that lasts `duration_ns` from each renewal.
    pub(super) fn new(duration_ns: u64) -> Self {
        Self {
            duration_ns,
            holder: None,
        }
    }

    /// The client that holds the lease at `now_ns`.
    pub(super) fn holder(&self, now_ns: u64) -> Option<u64> {
        self.holder
            .filter(|holder| holder.expires_ns > now_ns)
            .map(|holder| holder.client)
    }

    /// State of the lease for the cycle.
    pub(super) fn state(&self, now_ns: u64) -> LeaseState {
        match self.holder {
            None => LeaseState::Free,
            Some(_) if self.holder(now_ns).is_some() => LeaseState::Held,
            Some(_) => LeaseState::Expired,
        }
    }

    /// Remaining time of the lease \[ns\].
    pub(super) fn left_ns(&self, now_ns: u64) -> u64 {
        self.holder
            .map_or(0, |holder| holder.expires_ns.saturating_sub(now_ns))
    }

    /// Acquires or renews the lease. False if another client holds it, or `client` is 0 (no client).
    pub(super) fn acquire(&mut self, client: u64, now_ns: u64) -> bool {
        let free = self.holder(now_ns).is_none_or(|holder| holder == client) && client != 0;
        if free {
            let expires_ns = now_ns + self.duration_ns;
            self.holder = Some(Holder { client, expires_ns });
        }
        free
    }

    /// Renews the lease for its holder. False if `client` does not hold it.
    pub(super) fn renew(&mut self, client: u64, now_ns: u64) -> bool {
        self.holder(now_ns) == Some(client) && self.acquire(client, now_ns)
    }

    /// Extends a lease still valid at `paused_since_ns` by `paused_ns`, a time without gathers: the holder could
    /// not renew it.
    pub(super) fn extend(&mut self, paused_since_ns: u64, paused_ns: u64) {
        if let Some(holder) = &mut self.holder
            && holder.expires_ns > paused_since_ns
        {
            holder.expires_ns += paused_ns;
        }
    }

    /// Releases the lease. False if `client` does not hold it.
    pub(super) fn release(&mut self, client: u64, now_ns: u64) -> bool {
        let held = self.holder(now_ns) == Some(client);
        if held {
            self.holder = None;
        }
        held
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_holder_at_a_time_until_it_falls_silent() {
        let mut lease = Lease::new(100);
        assert!(lease.acquire(1, 0));
        assert!(!lease.acquire(2, 50) && !lease.renew(2, 50) && !lease.release(2, 50));
        assert!(lease.renew(1, 50));
        assert_eq!((lease.holder(149), lease.left_ns(149)), (Some(1), 1));
        assert_eq!(lease.holder(150), None);
        assert_eq!(lease.state(149), LeaseState::Held);
        assert_eq!(lease.state(150), LeaseState::Expired);
        assert!(
            !lease.renew(1, 150),
            "an expired lease is not renewed but acquired anew"
        );
        assert!(lease.acquire(2, 150));
        assert!(lease.release(2, 160) && lease.holder(160).is_none());
        assert_eq!(lease.state(160), LeaseState::Free);
        assert!(!lease.acquire(0, 200));
    }

    #[test]
    fn time_in_which_nobody_listened_does_not_count() {
        let mut lease = Lease::new(100);
        assert!(lease.acquire(1, 0));
        lease.extend(90, 400);
        assert_eq!((lease.holder(499), lease.holder(500)), (Some(1), None));
        // A lease that had expired before remains expired.
        lease.extend(600, 400);
        assert_eq!(lease.holder(500), None);
    }
}
