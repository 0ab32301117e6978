//! Folders for results.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use rustix::fs::{Access, access};

/// Creates the folder for results, if it does not exist, and checks that files can be created in it: before a
/// long run, which would otherwise be lost.
pub fn output_folder(folder: &Path) -> Result<()> {
    let name = folder.display();
    fs::create_dir_all(folder).with_context(|| format!("cannot create the folder {name}"))?;
    check_writable(folder)
}

/// Fails when this user cannot create files in the folder.
pub fn check_writable(folder: &Path) -> Result<()> {
    access(folder, Access::WRITE_OK | Access::EXEC_OK)
        .with_context(|| format!("cannot write into {}", folder.display()))
}

/// Fills the folder, which is created if needed, with the files that `write` puts into a temporary one. They are moved
/// when all are complete, so that a full disk leaves older files unchanged. Errors of `write` name files without the
/// temporary folder, which is then gone.
pub fn fill_folder(folder: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    output_folder(folder)?;
    let name = folder.display();
    let fresh = tempfile::Builder::new().prefix(".new-").tempdir_in(folder);
    let fresh = fresh.with_context(|| format!("cannot write into {name}"))?;
    let cannot = || format!("cannot fill {name}; its older files are unchanged");
    write(fresh.path()).with_context(cannot)?;
    move_files(fresh.path(), folder)
}

fn move_files(from: &Path, to: &Path) -> Result<()> {
    output_folder(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let (file, place) = (entry.path(), to.join(entry.file_name()));
        if file.is_dir() {
            move_files(&file, &place)?;
        } else {
            let cannot = || format!("cannot write {}", place.display());
            fs::rename(&file, &place).with_context(cannot)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    #[test]
    fn a_folder_holds_the_files_and_nothing_else_or_the_older_ones() {
        let place = Scratch::temporary().unwrap();
        let folder = place.path().join("new");
        let write = |text: &'static str| {
            move |fresh: &Path| {
                output_folder(&fresh.join("deep"))?;
                fs::write(fresh.join("deep/file"), text)?;
                Ok(())
            }
        };
        fill_folder(&folder, write("old")).unwrap();
        fill_folder(&folder, write("new")).unwrap();
        let broken = |fresh: &Path| write("broken")(fresh).and_then(|()| anyhow::bail!("full"));
        let error = fill_folder(&folder, broken).unwrap_err();
        let (error, name) = (format!("{error:#}"), folder.display());
        let expected = format!("cannot fill {name}; its older files are unchanged: full");
        assert_eq!(error, expected);
        assert_eq!(fs::read_to_string(folder.join("deep/file")).unwrap(), "new");
        let entries = fs::read_dir(&folder).unwrap().count();
        assert_eq!(entries, 1, "no temporary file is left");
    }
}
