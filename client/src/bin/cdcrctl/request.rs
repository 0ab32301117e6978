use std::thread;
use std::time::{Duration, Instant};

use cdcr_client::{RequestError, Requester};
use cdcr_shared_types::codes::{Outcome, RequestKind};
use cdcr_shared_types::{Location, Response};

use crate::args::Target;
use crate::done::Done;
use crate::{unmeasured_tip, wait};

/// Time for which `track` waits for a reference that another program is about to feed, and the retry
/// interval.
const REFERENCE_TIMEOUT: Duration = Duration::from_secs(2);
const ASK_AGAIN: Duration = Duration::from_millis(50);

pub(crate) fn run(
    target: &Target,
    kind: RequestKind,
    wait: Option<Duration>,
) -> anyhow::Result<Done> {
    if let Some(limit) = wait {
        return wait::run(target, kind, limit);
    }
    let (location, robot) = target.location()?;
    wait::print_outcome(kind, &ask(&location, robot, kind)?)?;
    if kind == RequestKind::Track
        && let Ok(connection) = target.connect()
    {
        unmeasured_tip::warn_now(&connection);
    }
    Ok(Done::Good)
}

/// Sends a request to a daemon; a stop by every available means.
pub(crate) fn ask(location: &Location, robot: &str, kind: RequestKind) -> anyhow::Result<Response> {
    Ok(match kind {
        RequestKind::Stop => Requester::stop(location, robot)?,
        RequestKind::Track => track(&Requester::open(location, robot)?)?,
        _ => Requester::open(location, robot)?.request(kind)?,
    })
}

fn track(requester: &Requester) -> Result<Response, RequestError> {
    let deadline = Instant::now() + REFERENCE_TIMEOUT;
    loop {
        match requester.request(RequestKind::Track) {
            Err(RequestError::Refused {
                outcome: Outcome::NoLease | Outcome::NoReference,
                ..
            }) if Instant::now() < deadline => thread::sleep(ASK_AGAIN),
            answer => return answer,
        }
    }
}
