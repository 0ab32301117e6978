use std::io::ErrorKind;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener};
use std::time::Duration;

use cdcr_shared_types::{Location, NameHolder};

use super::{InstanceError, runs_already};

/// Attempts to take a name whose holder does not answer: it may just be ending.
const TRIES: usize = 10;
const TRY_AGAIN: Duration = Duration::from_millis(20);

/// Takes the daemon's name for `robot` among the abstract Unix sockets, which nobody can delete: if the lock
/// file was deleted, a second daemon still finds the name taken. `None`, with a log line, if another user has
/// the name or the system has no such names; then only the lock file excludes a second daemon.
pub(super) fn take(
    location: &Location,
    robot: &str,
) -> Result<Option<UnixListener>, InstanceError> {
    for _ in 0..TRIES {
        match listen(&location.daemon_name(robot)) {
            Ok(listener) => return Ok(Some(listener)),
            Err(error) if error.kind() == ErrorKind::AddrInUse => {}
            Err(error) => {
                tracing::warn!(%error, "only the lock file prevents a second daemon: cannot create an abstract socket");
                return Ok(None);
            }
        }
        match location.name_holder(robot) {
            NameHolder::Ours { process_id } => {
                let process = process_id.map_or_else(|| "unknown".to_owned(), |id| id.to_string());
                return Err(runs_already(location, robot, process));
            }
            NameHolder::Foreign => break,
            NameHolder::Nobody => std::thread::sleep(TRY_AGAIN),
        }
    }
    tracing::warn!(
        name = location.daemon_name(robot),
        "only the lock file prevents a second daemon: another user holds the socket name of this daemon"
    );
    Ok(None)
}

fn listen(name: &str) -> std::io::Result<UnixListener> {
    let listener = UnixListener::bind_addr(&SocketAddr::from_abstract_name(name)?)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}
