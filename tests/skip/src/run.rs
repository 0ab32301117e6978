//! The skipped tests of one run of all test programs: a file beside the programs, named after their parent
//! process.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// Prefix of the file names.
const MARK: &str = "skipped-";

/// All test programs started by one process, for example `cargo test`.
#[derive(Debug)]
pub struct Run {
    folder: PathBuf,
    starter: String,
}

impl Run {
    /// The run of this program.
    pub fn this() -> Self {
        Self::started_by(std::os::unix::process::parent_id())
    }

    /// The run of the programs started by a process.
    pub fn started_by(process: u32) -> Self {
        let program = std::env::current_exe().expect("the test has a path");
        Self {
            folder: program.parent().expect("a folder").to_owned(),
            starter: mark_of(process),
        }
    }

    fn file(&self) -> PathBuf {
        self.folder.join(format!("{MARK}{}", self.starter))
    }

    fn open(&self) -> io::Result<File> {
        let mut options = OpenOptions::new();
        options.create(true).append(true).open(self.file())
    }

    /// Adds a line.
    pub fn note(&self, line: &str) {
        // One write, so that lines of several programs do not mix. If it fails, the line was printed, and
        // `take` fails.
        let _ = self
            .open()
            .and_then(|mut file| file.write_all(line.as_bytes()));
    }

    /// Returns all lines, sorted, and removes them. Also removes the files of ended runs.
    ///
    /// # Errors
    /// Where no line could have been added.
    pub fn take(&self) -> io::Result<Vec<String>> {
        self.open()?;
        let text = fs::read_to_string(self.file())?;
        fs::remove_file(self.file())?;
        forget_ended(&self.folder);
        let mut lines: Vec<_> = text.lines().map(str::to_owned).collect();
        lines.sort();
        Ok(lines)
    }
}

/// Id and start time of a process, because ids are reused.
fn mark_of(process: u32) -> String {
    // The start time is field 22. Field 2, the name, may contain spaces.
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let start = after_name.split_whitespace().nth(19).unwrap_or("ended");
    format!("{process}-{start}")
}

fn forget_ended(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let mark = name.to_str().and_then(|name| name.strip_prefix(MARK));
        let Some((mark, (process, _))) = mark.and_then(|mark| Some((mark, mark.split_once('-')?)))
        else {
            continue;
        };
        if process
            .parse()
            .is_ok_and(|process| mark_of(process) != mark)
        {
            let _ = fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_nothing_can_be_written_what_was_skipped_is_not_known() {
        let run = Run {
            folder: PathBuf::from("/proc"),
            starter: "1-1".to_owned(),
        };
        run.note("skipped: a test\n");
        assert!(run.take().is_err());
    }
}
