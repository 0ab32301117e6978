//! Recordings: MCAP files of all services, and their evaluation.

pub(crate) mod convert;
mod examination;
pub(crate) mod file;
pub(crate) mod info;
mod intake;
mod invocation;
mod play;
pub(crate) mod record;
pub(crate) mod replay;
pub(crate) mod report;
pub(crate) mod scope;
mod sink;
mod what_if;
mod when;

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context, bail};
use cdcr_client::channels as topic;

/// Creates a file that must not exist yet. `or`: what the user can do instead of removing it.
fn new_file(path: &Path, or: &str) -> anyhow::Result<File> {
    let name = path.display();
    match File::create_new(path) {
        Err(cause) if cause.kind() == ErrorKind::AlreadyExists => {
            bail!("{name} exists: remove it {or}")
        }
        made => made.with_context(|| format!("cannot make {name}")),
    }
}
