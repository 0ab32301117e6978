use std::path::Path;

use cdcr_shared_types::Location;

use crate::failure::Failure;

/// Location and name of a robot. Missing parts come from the environment, or are defaults.
pub(crate) fn locate(
    robot: Option<&str>,
    prefix: Option<&str>,
    root: Option<&str>,
) -> Result<(Location, String), Failure> {
    let robot = robot.map_or_else(
        || std::env::var("CDCR_ROBOT").unwrap_or("cdcr".to_owned()),
        str::to_owned,
    );
    let location = match (prefix, root.map(Path::new)) {
        (Some(prefix), Some(root)) => Location::new(prefix, root),
        (prefix, root) => Location::from_environment().and_then(|named| {
            let prefix = prefix.unwrap_or(named.prefix());
            Location::new(prefix, root.unwrap_or(named.root()))
        }),
    };
    Ok((location.map_err(Failure::argument)?, robot))
}
