//! A test that this machine cannot run calls [`skip`], which names the missing need. If `CDCR_REQUIRE` names
//! the same need, the test fails instead, so that no test is skipped unnoticed there.

#![allow(clippy::missing_panics_doc, reason = "in a test a panic is the report")]

mod run;

use std::fmt::{self, Display};
use std::io::Write as _;
use std::panic::Location;

pub use run::Run;

/// Environment variable with the needs that this machine meets, separated by commas: no test may be skipped
/// for them.
pub const REQUIRE: &str = "CDCR_REQUIRE";

/// Declares the needs of tests: the word of each need in [`REQUIRE`], and how a machine can meet it.
macro_rules! needs {
    ($($(#[$meta:meta])* $need:ident = $word:literal: $remedy:literal,)+) => {
        /// A need of a test.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Need { $($(#[$meta])* $need,)+ }

        impl Need {
            /// All needs.
            pub const ALL: [Self; [$($word),+].len()] = [$(Self::$need),+];

            /// The word in [`REQUIRE`].
            pub fn word(self) -> &'static str {
                match self { $(Self::$need => $word,)+ }
            }

            /// How a machine can meet the need.
            pub fn remedy(self) -> &'static str {
                match self { $(Self::$need => $remedy,)+ }
            }
        }
    };
}

needs! {
    /// Programs and files of other users.
    Root = "root": "run the tests as root",
    /// Threads with `SCHED_FIFO`.
    Realtime = "realtime": "run the tests as root, or grant the user rtprio 90 (packaging/limits.conf); in a container: --cap-add SYS_NICE",
    /// Two cores.
    Cores = "cores": "run the tests on two cores or more",
    /// To stop a single thread of a child.
    Ptrace = "ptrace": "run the tests as root, or with kernel.yama.ptrace_scope at most 1; in a container: --cap-add SYS_PTRACE",
    /// Mounts that are visible to one process only.
    Mount = "mount": "run the tests as root, or allow user namespaces; in a container: --cap-add SYS_ADMIN",
    /// Kernel features that some kernels are built without.
    Kernel = "kernel": "run the tests on a kernel with what the reason names",
    /// To set the clock of the machine.
    Clock = "clock": "run the tests as root with CDCR_TEST_SET_CLOCK=1, on a machine where the clock may jump",
    /// Nine of ten releases of a real-time loop on time.
    OnTime = "on-time": "run the tests on a machine that stalls for less than a tenth of the time",
    /// No other daemon, and no other real-time thread on its core.
    Alone = "alone": "run the tests where no other daemon and no real-time program runs",
    /// A writable target folder on a disk.
    Disk = "disk": "build into a target folder on a disk that the tests may write to",
    /// A processor with AVX2.
    Avx2 = "avx2": "run the tests on a processor that has it",
    /// A processor with AVX-512.
    Avx512 = "avx512": "run the tests on a processor that has it",
    /// `unshare`, `setpriv`.
    UtilLinux = "util-linux": "install util-linux",
    /// `cyclictest`.
    Cyclictest = "cyclictest": "install cyclictest (Debian: apt install rt-tests)",
    /// A C++ compiler named `c++`.
    Cpp = "c++": "install a compiler of C++ (Debian: apt install g++)",
    /// `chromium`.
    Chromium = "chromium": "install chromium",
    /// `stress-ng`.
    StressNg = "stress-ng": "install stress-ng",
}

impl Display for Need {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// Parses the needs of a list such as `realtime,root`.
///
/// # Errors
/// The first unknown word, with the known ones.
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

/// The needs in [`REQUIRE`].
///
/// # Errors
/// See [`required()`].
pub fn required_here() -> Result<Vec<Need>, String> {
    required(&std::env::var(REQUIRE).unwrap_or_default())
}

/// Reports that the test of this thread cannot run here, at once and at the end of the run. The test must
/// return after the call.
///
/// Fails the test if [`REQUIRE`] names the need.
#[track_caller]
pub fn skip(need: Need, why: impl Display) {
    let thread = std::thread::current();
    // With one test at a time, tests run on the main thread, whose name is not that of a test.
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
    // Without a macro: the test harness hides the output of macros in tests that pass.
    let _ = std::io::stderr().write_all(line.as_bytes());
    Run::this().note(&line);
}

#[cfg(test)]
mod tests;
