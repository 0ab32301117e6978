use cdcr_shared_types::Service;
use cdcr_shared_types::codes::Outcome;

use super::DURATION_MAX_S;
use crate::remedy::remedy;
use crate::{LinkError, Liveness, RequestError};

/// Why a feed ended early.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FeedError {
    /// An option is out of range.
    #[error("{name} is {value_s} s; it must be {least_s} to {most_s} s")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// Its value \[s\].
        value_s: f64,
        /// Least allowed value \[s\].
        least_s: f64,
        /// Largest allowed value \[s\].
        most_s: f64,
    },
    /// The duration of the trajectory is negative, not finite, or longer than a day.
    #[error("the trajectory lasts {duration_s} s; it must be 0 to {most_s} s", most_s = DURATION_MAX_S)]
    Duration {
        /// Duration of the trajectory \[s\].
        duration_s: f64,
    },
    /// A request (lease, track) was refused, or timed out while the daemon runs.
    #[error(transparent)]
    Request(RequestError),
    /// A port failed, or the daemon has stopped sending or has ended.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The daemon refused a chunk of the reference.
    #[error(
        "the daemon rejected the reference: {outcome}, at point {point} ({time_s:.3} s). {}",
        remedy(*outcome)
    )]
    Refused {
        /// Reason of the refusal.
        outcome: Outcome,
        /// Index of the point in the whole trajectory.
        point: u64,
        /// Time of the point since the start of the trajectory \[s\].
        time_s: f64,
    },
    /// The lease was lost before the daemon tracked the reference.
    #[error(
        "the lease was lost after {played_s:.2} s of the reference: this program was delayed for longer than reference.lease_ms, or another \
         client released it. cdcrctl status shows whether another client holds it now: end that one or wait for it, then feed again"
    )]
    LeaseLost {
        /// Played time of the trajectory \[s\].
        played_s: f64,
    },
    /// The reference was over before the daemon tracked it.
    #[error(
        "the reference was over before the daemon tracked it, after {played_s:.2} s: this program was delayed. Feed the reference again, \
         earlier (a longer lead) if that happens again"
    )]
    TooLate {
        /// Played time of the trajectory \[s\].
        played_s: f64,
    },
    /// The daemon did not report an outcome of the first chunk.
    #[error("the daemon did not react to the reference within 1 s; see cdcrctl status")]
    Ignored,
    /// The daemon was restarted during the feed.
    #[error(
        "the daemon was restarted after {played_s:.2} s of the reference: lease and reference are lost. Feed the \
         reference again"
    )]
    Restarted {
        /// Played time of the trajectory \[s\].
        played_s: f64,
    },
    /// The daemon left tracking.
    #[error(
        "the daemon left tracking after {played_s:.2} s of the reference: it is {mode} because {reason}. \
         {remedy}"
    )]
    LeftTracking {
        /// Played time of the trajectory \[s\].
        played_s: f64,
        /// Text of the daemon's mode.
        mode: &'static str,
        /// Text of its reason.
        reason: &'static str,
        /// What to do before the next feed.
        remedy: &'static str,
    },
}

impl FeedError {
    /// For a request to track a reference that this feed had the daemon accept, and that `is_over` by now.
    pub(super) fn not_tracked(error: RequestError, played_s: f64, is_over: bool) -> Self {
        match error {
            RequestError::Refused {
                outcome: Outcome::NoReference,
                ..
            } if is_over => Self::TooLate { played_s },
            // A reference that is not over went with a lease that was renewed after it had expired.
            RequestError::Refused {
                outcome: Outcome::NoLease | Outcome::NoReference,
                ..
            } => Self::LeaseLost { played_s },
            error => error.into(),
        }
    }
}

impl From<RequestError> for FeedError {
    // When the daemon has ended, the error says so, independent of the request that failed.
    fn from(error: RequestError) -> Self {
        match error {
            RequestError::Timeout {
                waited,
                liveness: liveness @ (Liveness::Ended | Liveness::Replaced),
                ..
            } => LinkError::silent(Service::Control, waited, liveness).into(),
            error => Self::Request(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PoseDifference, RequestName};
    use cdcr_shared_types::codes::{Mode, RequestKind};
    use std::time::Duration;

    #[test]
    fn a_feed_that_was_not_tracked_names_the_holder_or_the_delay_and_not_how_to_feed() {
        let refused = |outcome| RequestError::Refused {
            asked: RequestName::Request(RequestKind::Track),
            outcome,
            mode: Mode::Holding,
            pose: PoseDifference::default(),
        };
        let lost = ["lost after 1.50 s", "cdcrctl status shows"];
        for (outcome, is_over, words) in [
            (Outcome::NoLease, false, lost),
            (Outcome::NoLease, true, lost),
            (Outcome::NoReference, false, lost),
            (Outcome::NoReference, true, ["over before", "after 1.50 s"]),
        ] {
            let text = FeedError::not_tracked(refused(outcome), 1.5, is_over).to_string();
            assert!(words.iter().all(|word| text.contains(word)), "{text}");
            assert!(!text.contains("--track"), "{text}");
            assert_eq!(text.contains("lease"), words == lost, "{text}");
        }
        let too_far = refused(Outcome::TooFar);
        assert_eq!(
            FeedError::not_tracked(too_far.clone(), 0.0, true),
            FeedError::Request(too_far)
        );
    }

    #[test]
    fn a_request_that_an_ended_daemon_did_not_answer_reports_its_end_and_no_lease() {
        let timeout = |liveness| RequestError::Timeout {
            asked: RequestName::Renewal,
            waited: Duration::from_secs(1),
            liveness,
        };
        let text = FeedError::from(timeout(Liveness::Ended)).to_string();
        assert!(
            text.contains("it has ended") && !text.contains("lease"),
            "{text}"
        );
        let running = timeout(Liveness::Runs { process_id: None });
        assert_eq!(
            FeedError::from(running.clone()),
            FeedError::Request(running)
        );
    }
}
