//! Recordings: MCAP files of all that passes on the services, and what is made of them.

pub(crate) mod convert;
mod file;
pub(crate) mod info;
mod play;
pub(crate) mod record;
pub(crate) mod replay;
pub(crate) mod report;
mod topic;
mod what_if;
mod when;
