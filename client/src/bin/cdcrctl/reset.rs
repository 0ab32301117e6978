//! `cdcrctl reset`.

use cdcr_client::Requester;
use cdcr_shared_types::codes::RequestKind;

use crate::args::{ResetOptions, Target};
use crate::{Done, wait};

pub(crate) fn run(target: &Target, options: &ResetOptions) -> anyhow::Result<Done> {
    let (kind, accept_pose) = (RequestKind::Reset, options.accept_pose);
    if let Some(limit) = options.wait.wait {
        return wait::run_by(target, kind, limit, |connection| {
            connection.reset(accept_pose)
        });
    }
    let (location, robot) = target.location()?;
    let response = Requester::open(&location, robot)?.reset(accept_pose)?;
    wait::print_outcome(kind, &response)?;
    Ok(Done::Good)
}
