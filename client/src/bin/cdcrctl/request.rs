use std::thread;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use cdcr_client::{ConnectError, RequestError, Requester, StopError};
use cdcr_shared_types::codes::{Outcome, RequestKind};
use cdcr_shared_types::{Location, Response};

use crate::Done;
use crate::args::Target;
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
        RequestKind::Stop => Requester::stop(location, robot).map_err(not_stopped)?,
        RequestKind::Track => track(&Requester::open(location, robot)?)?,
        _ => Requester::open(location, robot)?.request(kind)?,
    })
}

/// Where no daemon runs, the answer is about the robot, not about how to start one.
fn not_stopped(error: StopError) -> anyhow::Error {
    let StopError::Connect(connect) = &error else {
        return error.into();
    };
    let ConnectError::DaemonNotRunning { place, found, .. } = connect else {
        return error.into();
    };
    anyhow!(
        "nothing was stopped: no daemon is running for {place}: {found}\n\
         if the robot moves, use its emergency stop\n{}\
         a daemon that starts later is not stopped by this: repeat it then",
        connect.elsewhere()
    )
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
