//! How a task ended, and the exit code that says it.

use std::io;
use std::process::ExitCode;

/// Exit code of a program ended by SIGINT, by convention of shells: 128 + 2.
const EXIT_INTERRUPTED: u8 = 130;
/// Exit code of a recording that ended because the disk is full.
const EXIT_DISK_FULL: u8 = 3;

/// How a task ended without an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Done {
    Good,
    Interrupted,
    DiskFull,
}

/// The exit code for an outcome; prints an error.
pub(crate) fn exit_code(outcome: anyhow::Result<Done>) -> ExitCode {
    match outcome {
        Ok(Done::Good) => ExitCode::SUCCESS,
        Ok(Done::Interrupted) => ExitCode::from(EXIT_INTERRUPTED),
        Ok(Done::DiskFull) => ExitCode::from(EXIT_DISK_FULL),
        // The reader of the output (head, less) has closed it.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) if is_output_full(&error) => {
            tell!("error: cannot write the output: {error}");
            ExitCode::FAILURE
        }
        Err(error) => {
            tell!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Whether the standard output cannot be written: the errors of files name them.
fn is_output_full(error: &anyhow::Error) -> bool {
    let is_named = error.chain().nth(1).is_some();
    let cause = error.downcast_ref::<io::Error>();
    !is_named && cause.is_some_and(|cause| cause.kind() == io::ErrorKind::StorageFull)
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .any(|cause| cause.kind() == io::ErrorKind::BrokenPipe)
}
