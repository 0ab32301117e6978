use std::io::Write;

use cdcr_client::Requester;
use cdcr_shared_types::codes::{Mode, RequestKind};

use crate::Done;
use crate::args::Target;

/// `cdcrctl track`, `hold`, `home`, `stop`, `reset`
pub(crate) fn run(target: &Target, kind: RequestKind) -> anyhow::Result<Done> {
    let (location, robot) = target.location()?;
    let response = match kind {
        RequestKind::Stop => Requester::stop(&location, robot)?,
        _ => Requester::open(&location, robot)?.request(kind)?,
    };
    writeln!(
        std::io::stdout(),
        "{kind}: accepted in cycle {}, the daemon is {}",
        response.cycle,
        Mode::text_of(response.mode)
    )?;
    Ok(Done::Good)
}
