use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

use cdcr_shared_types::Location;

use super::{InstanceError, file_error};

/// Where Linux keeps shared memory that has a name.
const SHARED_MEMORY: &str = "/dev/shm";
/// All that group and others may do.
const OTHERS: u32 = 0o077;
/// More than iceoryx2's management file has ever needed (16 bytes).
const MANAGEMENT_BYTES_MAX: u64 = 4096;

/// Sees that no other user has put a file where ours will be. Anybody may make files in `/dev/shm`, and
/// iceoryx2 would wait for one that is empty, or use one that looks like its own.
pub(super) fn check_owners(location: &Location) -> Result<(), InstanceError> {
    let user = rustix::process::geteuid().as_raw();
    for path in location.memory_files() {
        // One that is gone meanwhile is in nobody's way.
        let Ok(file) = std::fs::symlink_metadata(&path) else {
            continue;
        };
        if file.uid() != user && file.uid() != 0 {
            return Err(InstanceError::ForeignMemory {
                path: path.display().to_string(),
                owner: file.uid(),
            });
        }
    }
    Ok(())
}

/// Closes the one file that iceoryx2 opens to everybody (mode 0666): its management file, which every program
/// that joins the location has to open. Another user could make it empty, and clients would wait for ever, also
/// `cdcrctl stop`. It is replaced and not only closed, so that who opened it before has nothing in hand. False:
/// there is none.
pub(super) fn close_management_file(location: &Location) -> Result<bool, InstanceError> {
    let user = rustix::process::geteuid().as_raw();
    let mut all = location.memory_files().into_iter();
    let Some(path) = all.find(|path| path.extension().is_some_and(|end| end == "global_mgmt"))
    else {
        return Ok(false);
    };
    let failed = |cause| file_error(&path, cause);
    let file = match std::fs::symlink_metadata(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(false),
        file => file.map_err(failed)?,
    };
    if file.mode() & OTHERS == 0 {
        return Ok(true);
    }
    if file.uid() != user {
        tracing::warn!(
            path = %path.display(),
            owner = file.uid(),
            "is open to all users, who can keep clients from connecting; end the programs that its owner runs \
             with this root folder, remove it, and start again"
        );
        return Ok(true);
    }
    let private = format!("{}closing_{}", location.file_prefix(), std::process::id());
    let private = Path::new(SHARED_MEMORY).join(private);
    match replace(&path, &private) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
        result => result.map(|()| true).map_err(failed),
    }
}

/// Puts a private copy in the place of `path`.
fn replace(path: &Path, private: &Path) -> std::io::Result<()> {
    let mut bytes = Vec::new();
    File::open(path)?
        .take(MANAGEMENT_BYTES_MAX)
        .read_to_end(&mut bytes)?;
    if bytes.is_empty() {
        let cause = "another program made it empty";
        return Err(Error::new(ErrorKind::UnexpectedEof, cause));
    }
    let mut copy = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(private)?;
    let replaced = copy
        .write_all(&bytes)
        .and_then(|()| std::fs::rename(private, path));
    if replaced.is_err() {
        // The first error tells more.
        let _ = std::fs::remove_file(private);
    }
    replaced
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::super::Instance;
    use super::*;

    #[test]
    fn every_file_of_a_location_is_closed_to_others_and_none_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let prefix = format!("cdcr_instance_{}_", std::process::id());
        let location = Location::new(&prefix, &folder.path().join("root")).expect("legal");
        let first = Instance::claim(&location, "first").expect("nobody is there");
        // A second daemon finds the file closed, and leaves it so.
        let second = Instance::claim(&location, "second").expect("another robot");
        let all = location.memory_files();
        assert!(!all.is_empty());
        for path in &all {
            let mode = std::fs::metadata(path).expect("it is there").mode();
            assert_eq!(mode & 0o077, 0, "{} {mode:o}", path.display());
        }
        drop(first);
        assert!(
            !location.memory_files().is_empty(),
            "the second still needs it"
        );
        drop(second);
        assert_eq!(location.memory_files(), Vec::<PathBuf>::new());
    }

    #[test]
    fn an_empty_file_is_not_taken_over() {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, private) = (folder.path().join("a"), folder.path().join("b"));
        File::create(&path).expect("a file");
        let error = replace(&path, &private).expect_err("it is empty");
        assert!(error.to_string().contains("empty"), "{error}");
        assert!(!private.exists());
    }
}
