//! `cdcrd`: the process. Everything else is in the library.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

use anyhow::Result;
use cdcr_daemon::cli::{Cli, execute};
use cdcr_daemon::exit::ExitCause;
use cdcr_daemon::log::Log;
use cdcr_daemon::rt::sys::take_signal;
use clap::Parser;
use signal_hook::consts::SIGUSR1;

fn main() -> ExitCode {
    let cli = Cli::parse();
    // Only the cycle thread accepts the signal: every other thread may be starved.
    take_signal(SIGUSR1, false);
    let log = Log::start();
    let status = status_of(|| execute(cli), |message| log.write_line(message));
    log.end();
    status
}

/// Runs `work` and reports its error. A panic has already been reported.
fn status_of(work: impl FnOnce() -> Result<ExitCode>, report: impl FnOnce(&str)) -> ExitCode {
    // No state of the interrupted work is used afterwards.
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(status)) => status,
        Ok(Err(error)) => {
            report(&format!("{error:#}"));
            ExitCause::from_error(&error).into()
        }
        Err(_) => ExitCause::Panicked.into(),
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use cdcr_daemon::exit::Ended;

    use super::*;

    /// The status as text, because it has no equality, and the reported messages.
    fn end_of(work: impl FnOnce() -> Result<ExitCode>) -> (String, Vec<String>) {
        let reported = RefCell::<Vec<String>>::default();
        let report = |message: &str| RefCell::borrow_mut(&reported).push(message.to_owned());
        let status = status_of(work, report);
        (format!("{status:?}"), reported.into_inner())
    }

    fn code(status: u8) -> String {
        format!("{:?}", ExitCode::from(status))
    }

    #[test]
    fn a_panic_of_the_main_thread_ends_with_70_and_is_logged_once() {
        assert_eq!(end_of(|| panic!("a test of panics")), (code(70), vec![]));
    }

    #[test]
    fn an_error_is_reported_once_and_ends_with_its_own_number() {
        let ended = Ended {
            cause: ExitCause::CycleHung,
            message: "it hangs".to_owned(),
        };
        let end = end_of(|| Err(anyhow::Error::new(ended).context("the loop")));
        assert_eq!(end, (code(80), vec!["the loop: it hangs".to_owned()]));
        assert_eq!(end_of(|| Ok(ExitCode::SUCCESS)), (code(0), vec![]));
    }
}
