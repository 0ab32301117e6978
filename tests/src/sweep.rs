//! What a test run that was killed left behind: its places in shared memory and in the folder for temporary files,
//! and the programs that it ran there.

use std::fs::{self, File, TryLockError};
use std::io::Write as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::Once;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, geteuid, kill_process};

/// What the names of all places begin with. The number of the process follows.
const PREFIX: &str = "cdcrtest_";

/// How long a killed program may take to end: it writes its files until then.
const END_TIMEOUT: Duration = Duration::from_secs(10);

/// Name of place `number` of `process`.
pub(crate) fn place_name(process: u32, number: u32) -> String {
    format!("{PREFIX}{process}_{number}_")
}

/// Makes the folder of a place, and locks it: a process of another container has no number here, so its lock is what
/// says that it lives.
pub(crate) fn locked_folder(name: &str) -> (tempfile::TempDir, File) {
    loop {
        let builder = tempfile::Builder::new().prefix(name).tempdir();
        let folder = builder.expect("a folder");
        // Another sweep may have been faster than the lock.
        let lock = File::open(folder.path()).and_then(|lock| lock.lock().map(|()| lock));
        if let Ok(lock) = lock
            && folder.path().exists()
        {
            return (folder, lock);
        }
    }
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
    let temporary = std::env::temp_dir();
    let used = places_in_use(&temporary);
    for folder in [Path::new("/dev/shm"), &temporary] {
        for path in entries(folder) {
            let name = path.file_name().unwrap_or_default().as_bytes();
            let is_used = used.iter().any(|place| name.starts_with(place));
            if is_abandoned(name) && !is_used && is_ours(&path) && remove(&path) {
                swept.push(path.display().to_string());
            }
        }
    }
    swept
}

/// The names of the places whose folder somebody holds locked.
fn places_in_use(temporary: &Path) -> Vec<Vec<u8>> {
    let folders = entries(temporary).into_iter();
    let names = folders.filter_map(|folder| {
        let place = place_of(folder.file_name()?.as_bytes())?.to_owned();
        is_locked(&folder).then_some(place)
    });
    names.collect()
}

/// The name of the place that a file belongs to: process and number, up to the third underscore.
fn place_of(name: &[u8]) -> Option<&[u8]> {
    let mut underscores = name.iter().enumerate().filter(|(_, byte)| **byte == b'_');
    let (end, _) = underscores.nth(2)?;
    name.starts_with(PREFIX.as_bytes()).then(|| &name[..=end])
}

fn is_locked(folder: &Path) -> bool {
    // Shared, so that two sweeps at a time do not take each other for the test.
    let lock = File::open(folder).map(|folder| folder.try_lock_shared());
    matches!(lock, Ok(Err(TryLockError::WouldBlock)))
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
            wait_for_end(&process);
            ended.push(format!("process {id}"));
        }
    }
    ended
}

/// Waits until a process has ended; one that nobody waited for has no program any more.
fn wait_for_end(process: &Path) {
    let end = Instant::now() + END_TIMEOUT;
    while fs::read_link(process.join("exe")).is_ok() && Instant::now() < end {
        std::thread::sleep(Duration::from_millis(1));
    }
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

/// Removes a file, or a folder with all that is in it, unless somebody locked it; no link is followed.
fn remove(path: &Path) -> bool {
    let is_folder = path.symlink_metadata().is_ok_and(|file| file.is_dir());
    if is_folder {
        // Held until it is gone: see `locked_folder`.
        let Ok(lock) = File::open(path) else {
            return false;
        };
        lock.try_lock().is_ok() && fs::remove_dir_all(path).is_ok()
    } else {
        fs::remove_file(path).is_ok()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use std::os::unix::process::ExitStatusExt as _;
    use std::process::{Child, Command, Stdio};
    use std::sync::Mutex;

    use super::*;

    /// One sweep at a time: while one removes a folder, another takes it for one in use.
    static ONE: Mutex<()> = Mutex::new(());

    /// A process that waits for its input to end.
    fn waiting(prefix: &str) -> Child {
        let mut command = Command::new("cat");
        command.env("CDCR_PREFIX", prefix).stdin(Stdio::piped());
        command.spawn().unwrap()
    }

    #[test]
    fn what_a_killed_process_left_is_swept_and_what_a_living_one_has_is_not() {
        let _one = ONE.lock();
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
        // A program that begins has no environment yet.
        let environment = PathBuf::from(format!("/proc/{}/environ", daemon.id()));
        crate::wait_until("the daemon has its environment", || {
            let environment = fs::read(&environment).unwrap();
            String::from_utf8_lossy(&environment).contains(&name)
        });
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

    /// As of a process of another container: its number means nothing here.
    #[test]
    fn a_place_that_is_locked_is_not_swept() {
        let _one = ONE.lock();
        // No system has so many processes.
        let name = place_name(4_000_000_001, 0);
        let memory = Path::new("/dev/shm").join(format!("{name}memory"));
        fs::write(&memory, "").unwrap();
        let (folder, lock) = locked_folder(&name);
        sweep();
        assert!(memory.exists() && folder.path().exists());
        drop(lock);
        sweep();
        assert!(!memory.exists() && !folder.path().exists());
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
        assert_eq!(
            place_of(b"cdcrtest_12_3_left_"),
            Some(&b"cdcrtest_12_3_"[..])
        );
        assert_eq!(place_of(b"cdcrtest_12"), None);
    }
}
