//! A test that this machine cannot run is skipped with [`skip`], which names what is missing. It fails instead
//! where `CDCR_REQUIRE` names the same need, so that nothing is silently untested there.

#![allow(clippy::missing_panics_doc, reason = "in a test a panic is the report")]

mod run;

use std::fmt::{self, Display};
use std::io::Write as _;
use std::panic::Location;

pub use run::Run;

/// Environment variable with the needs that this machine meets, separated by commas: nothing may be skipped for them.
pub const REQUIRE: &str = "CDCR_REQUIRE";

/// What a test can need of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Programs of other users, and their files.
    Root,
    /// Threads with `SCHED_FIFO`.
    Realtime,
    /// Two cores.
    Cores,
    /// To stop a single thread of a child.
    Ptrace,
    /// Mounts that only one process sees.
    Mount,
    /// Counts and switches that some kernels are built without.
    Kernel,
    /// To set the clock of the machine.
    Clock,
    /// Nine of ten releases of a real-time loop on time.
    OnTime,
    /// No other daemon, and no other real-time thread on its core.
    Alone,
    /// A target folder on a disk, which may be written.
    Disk,
    /// `unshare`, `setpriv`.
    UtilLinux,
    /// `cyclictest`.
    Cyclictest,
    /// `stress-ng`.
    StressNg,
}

impl Need {
    /// Each of them.
    pub const ALL: [Self; 13] = [
        Self::Root,
        Self::Realtime,
        Self::Cores,
        Self::Ptrace,
        Self::Mount,
        Self::Kernel,
        Self::Clock,
        Self::OnTime,
        Self::Alone,
        Self::Disk,
        Self::UtilLinux,
        Self::Cyclictest,
        Self::StressNg,
    ];

    /// Its word in [`REQUIRE`].
    pub fn word(self) -> &'static str {
        match self {
            Self::Root => "root",
            Self::Realtime => "realtime",
            Self::Cores => "cores",
            Self::Ptrace => "ptrace",
            Self::Mount => "mount",
            Self::Kernel => "kernel",
            Self::Clock => "clock",
            Self::OnTime => "on-time",
            Self::Alone => "alone",
            Self::Disk => "disk",
            Self::UtilLinux => "util-linux",
            Self::Cyclictest => "cyclictest",
            Self::StressNg => "stress-ng",
        }
    }

    /// How a machine comes to meet it.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::Root => "run the tests as root",
            Self::Realtime => {
                "run the tests as root, or grant the user rtprio 99 (packaging/limits.conf); in a container: --cap-add \
                 SYS_NICE"
            }
            Self::Cores => "run the tests on two cores or more",
            Self::Ptrace => {
                "run the tests as root, or with kernel.yama.ptrace_scope at most 1; in a container: --cap-add SYS_PTRACE"
            }
            Self::Mount => {
                "run the tests as root, or allow user namespaces; in a container: --cap-add SYS_ADMIN"
            }
            Self::Kernel => "run the tests on a kernel with what the reason names",
            Self::Clock => {
                "run the tests as root with CDCR_TEST_SET_CLOCK=1, on a machine where the clock may jump"
            }
            Self::OnTime => {
                "run the tests on a machine that stalls for less than a tenth of the time"
            }
            Self::Alone => "run the tests where no other daemon and no real-time program runs",
            Self::Disk => "build into a target folder on a disk that the tests may write to",
            Self::UtilLinux => "install util-linux",
            Self::Cyclictest => "install cyclictest (Debian: apt install rt-tests)",
            Self::StressNg => "install stress-ng",
        }
    }
}

impl Display for Need {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// The needs of a list such as `realtime,root`.
///
/// # Errors
/// The word that names no need, with those that do.
pub fn required(list: &str) -> Result<Vec<Need>, String> {
    let words = list
        .split(',')
        .map(str::trim)
        .filter(|word| !word.is_empty());
    words
        .map(|word| {
            let need = Need::ALL.into_iter().find(|need| need.word() == word);
            need.ok_or_else(|| {
                let known = Need::ALL.map(Need::word).join(", ");
                format!("{REQUIRE}: unknown need '{word}': use one of {known}")
            })
        })
        .collect()
}

/// The needs that [`REQUIRE`] names.
///
/// # Errors
/// See [`required()`].
pub fn required_here() -> Result<Vec<Need>, String> {
    required(&std::env::var(REQUIRE).unwrap_or_default())
}

/// Says that the test of this thread cannot run here: at once, and at the end of the run. The test then returns.
///
/// Fails the test where [`REQUIRE`] names the need.
#[track_caller]
pub fn skip(need: Need, why: impl Display) {
    let thread = std::thread::current();
    // With one test at a time, the test runs on the main thread, which has no name of a test.
    let test = match thread.name() {
        None | Some("main") => Location::caller().to_string(),
        Some(name) => name.to_owned(),
    };
    let needs = required_here().unwrap_or_else(|error| panic!("{error}"));
    assert!(
        !needs.contains(&need),
        "{test} cannot run, and {REQUIRE} names {need}: {why}. Remedy: {}",
        need.remedy()
    );
    let line = format!("skipped: {test}: needs {need}: {why}\n");
    // Not by a macro: the test harness hides what the macros print in a test that passes.
    let _ = std::io::stderr().write_all(line.as_bytes());
    Run::this().note(&line);
}

#[cfg(test)]
mod tests;
