//! Threads of another process, by name: the test stops a single one as a debugger does.

use cdcr_test_skip::{Need, skip};
use nix::sys::ptrace;
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::Pid;

/// A thread of another process, stopped until this is dropped.
#[derive(Debug)]
pub struct Hung {
    thread: Pid,
}

impl Hung {
    /// Stops the thread of `process` with this name. `None`, with a message, if the system does not permit
    /// it.
    pub fn new(process: u32, name: &str) -> Option<Self> {
        let thread = Pid::from_raw(thread_of(process, name));
        if let Err(cause) = ptrace::seize(thread, ptrace::Options::empty()) {
            skip(
                Need::Ptrace,
                format!("the thread {name} cannot be stopped: {cause}"),
            );
            return None;
        }
        ptrace::interrupt(thread).unwrap();
        waitpid(thread, Some(WaitPidFlag::__WALL)).unwrap();
        Some(Self { thread })
    }

    /// Detaches a thread that died with its process, so that the process can be waited for.
    pub fn reap(&self) {
        let _ = waitpid(
            self.thread,
            Some(WaitPidFlag::__WALL | WaitPidFlag::WNOHANG),
        );
    }
}

impl Drop for Hung {
    fn drop(&mut self) {
        // A dead thread cannot be detached.
        let _ = ptrace::detach(self.thread, None);
        self.reap();
    }
}

fn thread_of(process: u32, name: &str) -> i32 {
    find_thread(process, name).unwrap_or_else(|| panic!("process {process} has no thread {name}"))
}

pub fn find_thread(process: u32, name: &str) -> Option<i32> {
    let entries = std::fs::read_dir(format!("/proc/{process}/task")).unwrap();
    entries.flatten().find_map(|entry| {
        let comm = std::fs::read_to_string(entry.path().join("comm")).ok()?;
        let id = entry.file_name().to_str()?.parse().ok()?;
        (comm.trim() == name).then_some(id)
    })
}
