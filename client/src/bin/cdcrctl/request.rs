use std::io::Write;

use cdcr_shared_types::codes::{Mode, RequestKind};

use crate::Done;
use crate::args::Target;

/// `cdcrctl track`, `hold`, `home`, `stop`, `reset`
pub(crate) fn run(target: &Target, kind: RequestKind) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    let response = connection.request(kind)?;
    writeln!(
        std::io::stdout(),
        "{kind}: accepted in cycle {}, the daemon is {}",
        response.cycle,
        Mode::text_of(response.mode)
    )?;
    Ok(Done::Good)
}
