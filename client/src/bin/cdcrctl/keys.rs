//! Keys that are pressed at a terminal, which may be closed.

use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::os::fd::AsFd;
use std::time::Duration;

use ratatui::crossterm::event::{self, KeyEvent};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::stdio::{dup2_stderr, dup2_stdout};

const CLOSED: PollFlags = PollFlags::HUP.union(PollFlags::ERR).union(PollFlags::NVAL);

/// crossterm reads a terminal that was closed again and again, and holds a core for ever. So it is asked only where there is something
/// to read.
#[derive(Debug, Default)]
pub(crate) struct Keys {
    pressed: VecDeque<KeyEvent>,
}

impl Keys {
    /// The next key. None: no key came within `timeout`, or before a signal.
    ///
    /// # Errors
    /// [`io::ErrorKind::BrokenPipe`] when the terminal was closed: what is written to it from then on is thrown away.
    pub(crate) fn next_within(&mut self, timeout: Duration) -> io::Result<Option<KeyEvent>> {
        if self.pressed.is_empty() && is_readable(timeout)? {
            while event::poll(Duration::ZERO)? {
                self.pressed.extend(event::read()?.as_key_event());
            }
        }
        Ok(self.pressed.pop_front())
    }
}

/// What was drawn; where that failed because the terminal was closed, the error of [`Keys::next_within`].
pub(crate) fn drawn<T>(drawn: io::Result<T>) -> io::Result<T> {
    drawn.or_else(|error| is_readable(Duration::ZERO).and(Err(error)))
}

fn is_readable(timeout: Duration) -> io::Result<bool> {
    let found = look_at(&io::stdin(), PollFlags::IN, timeout)?;
    if found.intersects(CLOSED) {
        write_nowhere()?;
        return Err(io::ErrorKind::BrokenPipe.into());
    }
    Ok(found.contains(PollFlags::IN))
}

/// What is true of a file within `timeout`, of `wanted` or of [`CLOSED`]; nothing after a signal.
fn look_at(file: &dyn AsFd, wanted: PollFlags, timeout: Duration) -> io::Result<PollFlags> {
    let timeout = Timespec::try_from(timeout).ok();
    let mut looked_at = [PollFd::new(&file, wanted)];
    match poll(&mut looked_at, timeout.as_ref()) {
        Err(Errno::INTR) => Ok(PollFlags::empty()),
        count => Ok(count.map(|_| looked_at[0].revents())?),
    }
}

/// Whoever writes to a closed terminal fails, and whoever tells of that there panics.
fn write_nowhere() -> io::Result<()> {
    let nowhere = File::options().write(true).open("/dev/null")?;
    let is_closed = |file: &dyn AsFd| {
        let found = look_at(file, PollFlags::empty(), Duration::ZERO)?;
        Ok::<_, io::Error>(found.intersects(CLOSED))
    };
    if is_closed(&io::stdout())? {
        dup2_stdout(&nowhere)?;
    }
    if is_closed(&io::stderr())? {
        dup2_stderr(&nowhere)?;
    }
    Ok(())
}
