//! What a test run that was killed left behind: its places in shared memory and in the folder for temporary files,
//! and the programs that it ran there.

use std::fs;
use std::io::Write as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::Once;

use rustix::process::{Pid, Signal, geteuid, kill_process};

/// What the names of all places begin with. The number of the process follows.
const PREFIX: &str = "cdcrtest_";

/// Name of place `number` of `process`.
pub(crate) fn place_name(process: u32, number: u32) -> String {
    format!("{PREFIX}{process}_{number}_")
}

/// Sweeps when a process asks for it the first time, and says on standard error what was there.
pub(crate) fn sweep_once() {
    static SWEPT: Once = Once::new();
    SWEPT.call_once(|| {
        for line in sweep() {
            // Not by a macro: the test harness hides what the macros print in a test that passes.
            let _ = std::io::stderr().write_all(format!("swept: {line}\n").as_bytes());
        }
    });
}

/// Ends the programs and removes the files of this user whose test process is gone. Returns what they were.
///
/// A process number that was given to another process since keeps its files.
fn sweep() -> Vec<String> {
    let mut swept = end_programs();
    for folder in [Path::new("/dev/shm"), &std::env::temp_dir()] {
        for path in entries(folder) {
            let name = path.file_name().unwrap_or_default();
            if is_abandoned(name.as_bytes()) && is_ours(&path) && remove(&path) {
                swept.push(path.display().to_string());
            }
        }
    }
    swept
}

/// The programs first, because they would go on writing files.
fn end_programs() -> Vec<String> {
    let mut ended = Vec::new();
    for process in entries(Path::new("/proc")) {
        let Some(id) = number(process.file_name().unwrap_or_default().as_bytes()) else {
            continue;
        };
        // Another user's environment cannot be read, except by root.
        let environment = fs::read(process.join("environ")).unwrap_or_default();
        let is_abandoned = environment
            .split(|byte| *byte == 0)
            .filter_map(|variable| variable.strip_prefix(b"CDCR_PREFIX="))
            .any(is_abandoned);
        if is_abandoned
            && is_ours(&process)
            && is_built_with_us(&process)
            && is_beside_us(&process)
            && let Some(pid) = Pid::from_raw(id.cast_signed())
            && kill_process(pid, Signal::KILL).is_ok()
        {
            ended.push(format!("process {id}"));
        }
    }
    ended
}

/// Whether it runs one of the programs that were built with this test: nobody else's process has its end here, whatever
/// its environment says.
fn is_built_with_us(process: &Path) -> bool {
    let is_in = |folder: &Path| {
        fs::read_link(process.join("exe")).is_ok_and(|program| program.starts_with(folder))
    };
    let test = std::env::current_exe().unwrap_or_default();
    // target/<profile>/deps/<test>
    id_of(process) != std::process::id()
        && test.ancestors().nth(2).is_some_and(is_in)
        && !fs::read_link(process.join("exe"))
            .is_ok_and(|program| program.parent() == test.parent())
}

fn id_of(process: &Path) -> u32 {
    let name = process.file_name().unwrap_or_default();
    number(name.as_bytes()).unwrap_or_default()
}

/// Whether process numbers mean the same to it and to us: a container counts its own.
fn is_beside_us(process: &Path) -> bool {
    let of = |process: &Path| fs::read_link(process.join("ns/pid")).ok();
    let ours = of(Path::new("/proc/self"));
    ours.is_some() && of(process) == ours
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).collect()
}

/// Whether this is a name of a place whose process is gone.
fn is_abandoned(name: &[u8]) -> bool {
    let Some(rest) = name.strip_prefix(PREFIX.as_bytes()) else {
        return false;
    };
    let digits = rest.split(|byte| *byte == b'_').next();
    digits
        .and_then(number)
        .is_some_and(|process| !Path::new(&format!("/proc/{process}")).exists())
}

fn number(digits: &[u8]) -> Option<u32> {
    std::str::from_utf8(digits).ok()?.parse().ok()
}

fn is_ours(path: &Path) -> bool {
    path.symlink_metadata()
        .is_ok_and(|file| file.uid() == geteuid().as_raw())
}

/// Removes a file, or a folder with all that is in it; no link is followed.
fn remove(path: &Path) -> bool {
    let is_folder = path.symlink_metadata().is_ok_and(|file| file.is_dir());
    let removed = if is_folder {
        fs::remove_dir_all(path)
    } else {
        fs::remove_file(path)
    };
    removed.is_ok()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use std::os::unix::process::ExitStatusExt as _;
    use std::process::{Child, Command, Stdio};

    use super::*;

    /// A process that waits for its input to end.
    fn waiting(prefix: &str) -> Child {
        let mut command = Command::new("cat");
        command.env("CDCR_PREFIX", prefix).stdin(Stdio::piped());
        command.spawn().unwrap()
    }

    #[test]
    fn what_a_killed_process_left_is_swept_and_what_a_living_one_has_is_not() {
        let mut test = waiting("");
        let name = place_name(test.id(), 0);
        let memory = Path::new("/dev/shm").join(format!("{name}memory"));
        let folder = std::env::temp_dir().join(format!("{name}folder"));
        fs::write(&memory, "").unwrap();
        fs::create_dir_all(folder.join("root")).unwrap();
        fs::write(folder.join("root/file"), "").unwrap();
        let mut daemon = Command::new(crate::binary("cdcrd"));
        daemon.args(["bare", "--duration", "60s"]);
        let mut daemon = daemon
            .env("CDCR_PREFIX", &name)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        // What somebody else runs with a variable that was left over in a shell.
        let mut foreign = waiting(&name);

        sweep();
        assert!(memory.exists() && folder.join("root/file").exists());
        assert!(daemon.try_wait().unwrap().is_none());

        test.kill().unwrap();
        test.wait().unwrap();
        sweep();
        assert!(!memory.exists() && !folder.exists());
        assert_eq!(daemon.wait().unwrap().signal(), Some(libc::SIGKILL));
        assert!(foreign.try_wait().unwrap().is_none());
        foreign.kill().unwrap();
        foreign.wait().unwrap();
    }

    #[test]
    fn only_names_of_places_are_swept() {
        // No system has so many processes.
        let gone = 4_000_000_000_u32;
        assert!(is_abandoned(place_name(gone, 3).as_bytes()));
        for name in [
            place_name(std::process::id(), 3),
            place_name(1, 0),
            PREFIX.to_owned(),
            format!("{PREFIX}unfinished_{gone}_left"),
            format!("cdcr-bench-{gone}-0_"),
        ] {
            assert!(!is_abandoned(name.as_bytes()), "{name}");
        }
    }
}
