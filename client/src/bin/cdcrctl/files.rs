//! Files that this program reads whole, or creates.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

use anyhow::{Context, bail, ensure};
use cdcr_process::check_writable;

/// Largest text that is read; a device has no end.
const BYTES_MAX: u64 = 128_000_000;

/// The text of a file.
pub(crate) fn read_text(path: &Path) -> anyhow::Result<String> {
    let name = path.display();
    let mut text = String::new();
    let read = File::open(path)
        .and_then(|file| file.take(BYTES_MAX + 1).read_to_string(&mut text))
        .with_context(|| format!("cannot read {name}"))?;
    ensure!(
        read as u64 <= BYTES_MAX,
        "cannot read {name}: it is larger than 128 MB"
    );
    Ok(text)
}

/// Creates a file that must not exist yet. `or`: what the user can do instead of removing it.
pub(crate) fn new_file(path: &Path, or: &str) -> anyhow::Result<File> {
    let name = path.display();
    match File::create_new(path) {
        Err(cause) if cause.kind() == ErrorKind::AlreadyExists => {
            bail!("{name} exists: remove it {or}")
        }
        made => made.with_context(|| format!("cannot make {name}")),
    }
}

/// Fails where [`new_file`] will fail, before a program waits, computes or moves anything for the file.
pub(crate) fn check_new(path: &Path, or: &str) -> anyhow::Result<()> {
    let name = path.display();
    ensure!(!path.exists(), "{name} exists: remove it {or}");
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    check_writable(folder.unwrap_or(Path::new(".")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_without_an_end_is_refused() {
        let error = read_text(Path::new("/dev/zero")).unwrap_err().to_string();
        assert_eq!(error, "cannot read /dev/zero: it is larger than 128 MB");
    }
}
