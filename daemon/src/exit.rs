//! The cause of the process's end, as exit status for a service manager.
//!
//! Numbers from 64 to 78 have their meaning from BSD's `sysexits.h`. 80 to 83 are our own.

use std::process::ExitCode;

use crate::config::ConfigError;
use crate::instance::InstanceError;
use crate::services::ServiceError;

/// Declares the causes: number, meaning, and whether a restart helps; `docs/service.md` has the generated table.
macro_rules! exit_causes {
    ($($name:ident = $code:literal: $meaning:literal, $restart:expr;)+) => {
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u8)]
        pub enum ExitCause { $(#[doc = $meaning] $name = $code,)+ }

        impl ExitCause {
            /// Each cause with its meaning and the use of a restart; `None`: a restart does not help.
            pub const ALL: &[(Self, &str, Option<&str>)] = &[$((Self::$name, $meaning, $restart),)+];
        }
    };
}

exit_causes! {
    Asked = 0: "the daemon was asked to end (SIGTERM, SIGINT), and the robot came to rest", Some("not needed");
    Other = 1: "an error without its own number; see the message", Some("perhaps");
    Usage = 2: "the command line is wrong", None;
    AlreadyRuns = 69: "another daemon controls this robot already", None;
    Panicked = 70: "a thread panicked: a bug in the program", Some("until it happens again");
    SharedMemory = 71: "shared memory cannot be used: it is full, has too few inodes or services of another version; or the limit of open files is too low (`ulimit -n`)",
        Some("with enough space, one version, or a higher limit");
    Root = 73: "the root folder cannot be used or belongs to another user", None;
    RootLocked = 75: "another process has locked the root folder", Some("when that process releases the lock");
    NotRealtime = 77: "real time is required and not granted", None;
    Configuration = 78: "the configuration is wrong", None;
    CycleHung = 80: "the cycle thread made no progress", Some("yes");
    ExchangeHung = 81: "the exchange, the reporter or the status thread made no progress, or did not end", Some("yes");
    NotAtRest = 82: "the daemon was asked to end, and the robot did not come to rest within 10 s (deceleration too small for its rates); or the last command that was sent is not rest",
        Some("yes, but configure it better");
    PlaceLost = 83: "the root folder was emptied or replaced while the daemon ran; the robot came to rest first", Some("yes");
}

impl ExitCause {
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
    use std::fmt::Write as _;

    use super::*;

    #[test]
    fn the_generated_table_of_the_page_is_what_is_declared() {
        const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/service.md");
        const BEGIN: &str = "<!-- generated: exit statuses -->\n";
        let page = std::fs::read_to_string(PAGE).unwrap();
        let (before, rest) = page.split_once(BEGIN).unwrap();
        let (_, after) = rest.split_once("\n\n").unwrap();
        let mut table = "| exit status | means | does a restart help? |\n|---|---|---|".to_owned();
        for (cause, meaning, restart) in ExitCause::ALL {
            let (status, helps) = (cause.code(), restart.unwrap_or("no"));
            write!(table, "\n| {status} | {meaning} | {helps} |").unwrap();
        }
        let made = format!("{before}{BEGIN}{table}\n\n{after}");
        if std::env::var_os("CDCR_GENERATE").is_some() {
            std::fs::write(PAGE, made).unwrap();
            return;
        }
        assert!(
            made == page,
            "run `CDCR_GENERATE=1 cargo test -p cdcr-daemon --lib generated` and commit what it writes"
        );
    }

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
