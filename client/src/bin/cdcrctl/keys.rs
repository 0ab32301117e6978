//! Key input from a terminal that may be closed at any time.

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

/// crossterm reads a closed terminal in an endless loop, and occupies a core. So it is called only when there
/// is input.
#[derive(Debug, Default)]
pub(crate) struct Keys {
    pressed: VecDeque<KeyEvent>,
}

impl Keys {
    /// The next key. `None` when no key arrived within `timeout`, or a signal interrupted the wait.
    ///
    /// # Errors
    /// [`io::ErrorKind::BrokenPipe`] when the terminal was closed: output is discarded from then on.
    pub(crate) fn next_within(&mut self, timeout: Duration) -> io::Result<Option<KeyEvent>> {
        if self.pressed.is_empty() && is_readable(timeout)? {
            while event::poll(Duration::ZERO)? {
                self.pressed.extend(event::read()?.as_key_event());
            }
        }
        Ok(self.pressed.pop_front())
    }
}

/// Returns the result of drawing; after a failure due to a closed terminal, the error of
/// [`Keys::next_within`].
pub(crate) fn drawn<T>(drawn: io::Result<T>) -> io::Result<T> {
    drawn.or_else(|error| is_readable(Duration::ZERO).and(Err(error)))
}

/// Whether writing to a file would not block: somebody reads the terminal, or it is closed.
pub(crate) fn takes_output(file: &dyn AsFd) -> bool {
    poll_events(file, PollFlags::OUT, Duration::ZERO).is_ok_and(|found| !found.is_empty())
}

fn is_readable(timeout: Duration) -> io::Result<bool> {
    let found = poll_events(&io::stdin(), PollFlags::IN, timeout)?;
    if found.intersects(CLOSED) {
        discard_output()?;
        return Err(io::ErrorKind::BrokenPipe.into());
    }
    Ok(found.contains(PollFlags::IN))
}

/// Events of a file within `timeout`, out of `wanted` and [`CLOSED`]; none after a signal.
fn poll_events(file: &dyn AsFd, wanted: PollFlags, timeout: Duration) -> io::Result<PollFlags> {
    let timeout = Timespec::try_from(timeout).ok();
    let mut polled = [PollFd::new(&file, wanted)];
    match poll(&mut polled, timeout.as_ref()) {
        Err(Errno::INTR) => Ok(PollFlags::empty()),
        count => Ok(count.map(|_| polled[0].revents())?),
    }
}

/// Redirects output: writing to a closed terminal fails, and reporting that failure there panics.
fn discard_output() -> io::Result<()> {
    let null_device = File::options().write(true).open("/dev/null")?;
    let is_closed = |file: &dyn AsFd| {
        let found = poll_events(file, PollFlags::empty(), Duration::ZERO)?;
        Ok::<_, io::Error>(found.intersects(CLOSED))
    };
    if is_closed(&io::stdout())? {
        dup2_stdout(&null_device)?;
    }
    if is_closed(&io::stderr())? {
        dup2_stderr(&null_device)?;
    }
    Ok(())
}
