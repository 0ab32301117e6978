use cdcr_shared_types::Service;
use cdcr_shared_types::codes::Outcome;

use crate::remedy::remedy;
use crate::{LinkError, Liveness, RequestError};

/// Why a trajectory was not fed to its end.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FeedError {
    /// An option is out of range.
    #[error("{name} is {value_s} s; it must be {least_s} to {most_s} s")]
    Option {
        /// Which.
        name: &'static str,
        /// What it is \[s\].
        value_s: f64,
        /// Least allowed \[s\].
        least_s: f64,
        /// Most allowed \[s\].
        most_s: f64,
    },
    /// The trajectory has a duration that is negative, not finite, or longer than a day.
    #[error("the trajectory lasts {duration_s} s; it must be 0 to 86400 s")]
    Duration {
        /// What it says \[s\].
        duration_s: f64,
    },
    /// A request (lease, track) was refused, or not answered by a daemon that runs.
    #[error(transparent)]
    Request(RequestError),
    /// A port failed, or the daemon fell silent or has ended.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The daemon refused a chunk of the reference.
    #[error(
        "the daemon rejected the reference: {outcome}, at point {point} ({time_s:.3} s). {}",
        remedy(*outcome)
    )]
    Refused {
        /// Why.
        outcome: Outcome,
        /// Index of the point in the whole trajectory.
        point: u64,
        /// Its time \[s\] since the start of the trajectory.
        time_s: f64,
    },
    /// The daemon never said what became of the first chunk.
    #[error("the daemon did not react to the reference within 1 s; see cdcrctl status")]
    Ignored,
    /// Another daemon took the place of the one that was fed.
    #[error(
        "the daemon was restarted after {played_s:.2} s of the reference: lease and reference are lost. Feed the \
         reference again"
    )]
    Restarted {
        /// How much of the trajectory was played \[s\].
        played_s: f64,
    },
    /// The daemon does not follow the reference any more.
    #[error(
        "the daemon left tracking after {played_s:.2} s of the reference: it is {mode} because {reason}. \
         {remedy}"
    )]
    LeftTracking {
        /// How much of the trajectory was played \[s\].
        played_s: f64,
        /// Mode of the daemon, in words.
        mode: &'static str,
        /// Its reason, in words.
        reason: &'static str,
        /// What to do.
        remedy: &'static str,
    },
}

impl From<RequestError> for FeedError {
    /// That the daemon has ended matters, and not in which request of the feed this was found.
    fn from(error: RequestError) -> Self {
        match error {
            RequestError::Timeout {
                waited,
                liveness: liveness @ Liveness::Ended,
                ..
            } => LinkError::silent(Service::Control, waited, liveness).into(),
            error => Self::Request(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cdcr_shared_types::codes::RequestKind;
    use std::time::Duration;

    #[test]
    fn a_request_that_an_ended_daemon_did_not_answer_reports_its_end_and_no_lease() {
        let timeout = |liveness| RequestError::Timeout {
            kind: RequestKind::AcquireLease,
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
