//! The cause of the process's end, as exit status for a service manager.
//!
//! Numbers from 64 to 78 have their meaning from BSD's `sysexits.h`. 80 to 83 are our own. `docs/faults.md`
//! has the remedy for each.

use std::process::ExitCode;

use crate::config::ConfigError;
use crate::instance::InstanceError;
use crate::services::ServiceError;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum ExitCause {
    /// Requested, and the robot came to rest.
    Asked = 0,
    /// A cause without a number of its own.
    Other = 1,
    /// The command line is wrong.
    Usage = 2,
    /// Another daemon already controls this robot.
    AlreadyRuns = 69,
    /// A thread panicked: a defect of the program.
    Panicked = 70,
    /// Shared memory cannot be used: it is full, or holds services of another version.
    SharedMemory = 71,
    /// The root folder cannot be used or belongs to another user.
    Root = 73,
    /// Another process has locked the root folder.
    RootLocked = 75,
    /// Real time is required and not granted.
    NotRealtime = 77,
    /// The configuration is wrong.
    Configuration = 78,
    /// The cycle thread made no progress.
    CycleHung = 80,
    /// The exchange, the reporter or the status thread made no progress, or did not end.
    ExchangeHung = 81,
    /// The end was requested, and the robot did not come to rest in time.
    NotAtRest = 82,
    /// The root folder was emptied or replaced while the daemon ran.
    PlaceLost = 83,
}

impl ExitCause {
    pub const ALL: [Self; 14] = [
        Self::Asked,
        Self::Other,
        Self::Usage,
        Self::AlreadyRuns,
        Self::Panicked,
        Self::SharedMemory,
        Self::Root,
        Self::RootLocked,
        Self::NotRealtime,
        Self::Configuration,
        Self::CycleHung,
        Self::ExchangeHung,
        Self::NotAtRest,
        Self::PlaceLost,
    ];

    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The cause of an error, found anywhere in its chain.
    pub fn from_error(error: &anyhow::Error) -> Self {
        let known = error.chain().find_map(|cause| {
            if let Some(ended) = cause.downcast_ref::<Ended>() {
                return Some(ended.cause);
            }
            match cause.downcast_ref::<InstanceError>() {
                Some(InstanceError::Runs { .. }) => return Some(Self::AlreadyRuns),
                Some(InstanceError::RootLocked { .. }) => return Some(Self::RootLocked),
                Some(full) if full.is_full() => return Some(Self::SharedMemory),
                Some(_) => return Some(Self::Root),
                None => {}
            }
            if cause.is::<ConfigError>() {
                return Some(Self::Configuration);
            }
            match cause.downcast_ref::<ServiceError>() {
                Some(ServiceError::Taken { .. }) => Some(Self::AlreadyRuns),
                Some(_) => Some(Self::SharedMemory),
                None => None,
            }
        });
        known.unwrap_or(Self::Other)
    }
}

impl From<ExitCause> for ExitCode {
    fn from(cause: ExitCause) -> Self {
        Self::from(cause.code())
    }
}

/// An end whose cause has no other error type.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Ended {
    pub cause: ExitCause,
    /// Text with a remedy.
    pub message: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_is_found_under_its_context() {
        let ended = Ended {
            cause: ExitCause::CycleHung,
            message: "hung".to_owned(),
        };
        let error = anyhow::Error::new(ended).context("ending");
        assert_eq!(ExitCause::from_error(&error), ExitCause::CycleHung);
        assert_eq!(
            ExitCause::from_error(&anyhow::anyhow!("?")),
            ExitCause::Other
        );
        let service = "cdcr/a/telemetry".to_owned();
        let taken = anyhow::Error::new(ServiceError::Taken { service });
        assert_eq!(ExitCause::from_error(&taken), ExitCause::AlreadyRuns);
    }
}
