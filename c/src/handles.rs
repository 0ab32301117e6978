use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};

use cdcr_client::Driver;

use crate::code::Code;
use crate::failure::Failure;
use crate::session::Session;

/// A type with handles. A handle is a number in the form of a pointer and is never dereferenced. A closed
/// handle, one of another thread and an invalid one are not found, without further effect.
pub(crate) trait Handled: Sized {
    const NAME: &'static str;
    fn table(open: &mut Open) -> &mut HashMap<usize, Self>;
}

impl Handled for Session {
    const NAME: &'static str = "connection";
    fn table(open: &mut Open) -> &mut HashMap<usize, Self> {
        &mut open.sessions
    }
}

impl Handled for Driver {
    const NAME: &'static str = "driver";
    fn table(open: &mut Open) -> &mut HashMap<usize, Self> {
        &mut open.drivers
    }
}

/// Open handles of this thread. iceoryx2's ports cannot leave their thread; they are closed when it ends.
#[derive(Debug, Default)]
pub(crate) struct Open {
    process: u32,
    sessions: HashMap<usize, Session>,
    drivers: HashMap<usize, Driver>,
}

impl Open {
    /// A forked process has the memory of its parent, but must not close the parent's ports.
    fn forget_inherited_ports(&mut self) {
        let process = std::process::id();
        if self.process != process {
            core::mem::forget(core::mem::take(&mut self.sessions));
            core::mem::forget(core::mem::take(&mut self.drivers));
            self.process = process;
        }
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        self.forget_inherited_ports();
    }
}

thread_local! {
    static OPEN: RefCell<Open> = RefCell::default();
}

/// Last number of a handle; numbers are never reused.
static LAST: AtomicUsize = AtomicUsize::new(0);

/// Calls `work` with the table of this thread.
fn with_table<T: Handled, R>(
    work: impl FnOnce(&mut HashMap<usize, T>) -> Result<R, Failure>,
) -> Result<R, Failure> {
    let unusable = |()| {
        Failure::new(
            Code::Handle,
            "handles cannot be used while their thread ends, or in a signal handler",
        )
    };
    OPEN.try_with(|open| {
        let mut open = open.try_borrow_mut().map_err(|_| ()).map_err(unusable)?;
        open.forget_inherited_ports();
        work(T::table(&mut open))
    })
    .map_err(|_| ())
    .map_err(unusable)?
}

fn unknown<T: Handled>() -> Failure {
    let name = T::NAME;
    Failure::new(
        Code::Handle,
        format!(
            "not an open {name} of this thread: it is NULL or closed, or another thread or the parent process opened it. \
             Open one in each thread that uses one"
        ),
    )
}

/// Stores a value and returns its handle.
pub(crate) fn store<T: Handled>(opened: T) -> Result<*mut T, Failure> {
    with_table(|table| {
        let number = LAST.fetch_add(1, Ordering::Relaxed) + 1;
        table.insert(number, opened);
        Ok(core::ptr::without_provenance_mut(number))
    })
}

/// Calls `work` with the value of a handle.
pub(crate) fn with<T: Handled, R>(
    handle: *mut T,
    work: impl FnOnce(&mut T) -> Result<R, Failure>,
) -> Result<R, Failure> {
    with_table(|table| work(table.get_mut(&handle.addr()).ok_or_else(unknown::<T>)?))
}

/// Closes a handle; NULL is ignored.
pub(crate) fn close<T: Handled>(handle: *mut T) -> Result<(), Failure> {
    if handle.is_null() {
        return Ok(());
    }
    let closed = with_table(|table: &mut HashMap<usize, T>| {
        table.remove(&handle.addr()).ok_or_else(unknown::<T>)
    })?;
    drop(closed);
    Ok(())
}
