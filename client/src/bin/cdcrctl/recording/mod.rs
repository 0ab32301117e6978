//! Recordings: MCAP files of all services, and their evaluation.

pub(crate) mod convert;
mod examination;
pub(crate) mod file;
pub(crate) mod info;
mod intake;
mod invocation;
mod play;
pub(crate) mod record;
mod repair;
pub(crate) mod replay;
pub(crate) mod report;
pub(crate) mod scope;
mod sink;
mod what_if;
mod when;

use cdcr_client::channels as topic;
