//! Removes what a killed measurement or test run left: its files in shared memory, among the temporary files
//! and on a disk, and the programs that a test ran there.
//!
//! These folders are writable for everyone. Therefore the sweep touches only files of this user with the
//! project's prefix, follows no link and never blocks.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::Write as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::Once;
use std::time::{Duration, Instant};

use rustix::fs::OFlags;
use rustix::process::{Pid, Signal, geteuid, kill_process};

/// Prefix of the names of all swept files. The process id and a counter follow.
pub const PREFIX: &str = "cdcrbed_";

/// Time limit for a killed program to end; until then it may write files.
const END_TIMEOUT: Duration = Duration::from_secs(10);

/// Sweeps at the first call in a process, and reports the removed files on standard error.
pub(super) fn sweep_once() {
    static SWEPT: Once = Once::new();
    SWEPT.call_once(|| {
        for line in sweep() {
            // Without a macro: the test harness hides the output of macros in tests that pass.
            let line = format!("swept: {line}, left by a program that was killed\n");
            let _ = std::io::stderr().write_all(line.as_bytes());
        }
    });
}

/// Ends the programs and removes the files of this user whose test process has ended. Returns a description
/// of each.
///
/// Files remain when another process has got the process id since.
pub fn sweep() -> Vec<String> {
    let mut swept = end_programs();
    let parents = super::parents();
    let found: Vec<PathBuf> = parents.iter().flat_map(|parent| entries(parent)).collect();
    let found = found
        .into_iter()
        .filter(|path| is_abandoned(name(path)) && is_ours(path));
    let found: Vec<PathBuf> = found.collect();
    // Places with a locked part are in use, even by a process of another container, whose id is unknown here.
    let locked = found.iter().filter(|path| is_locked(path));
    let used: Vec<&[u8]> = locked.filter_map(|path| place_of(name(path))).collect();
    for path in &found {
        let is_used = used.iter().any(|place| name(path).starts_with(place));
        if !is_used && remove(path) {
            swept.push(path.display().to_string());
        }
    }
    swept
}

fn name(path: &Path) -> &[u8] {
    path.file_name().unwrap_or_default().as_bytes()
}

/// The place's part of a file name, up to the third underscore: prefix, process id and counter.
fn place_of(name: &[u8]) -> Option<&[u8]> {
    let mut underscores = name.iter().enumerate().filter(|(_, byte)| **byte == b'_');
    let (end, _) = underscores.nth(2)?;
    name.starts_with(PREFIX.as_bytes()).then(|| &name[..=end])
}

/// Opens a file without following links or waiting for a pipe.
fn open(path: &Path) -> std::io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let mut options = OpenOptions::new();
    options.read(true).custom_flags(flags.bits().cast_signed());
    options.open(path)
}

fn is_locked(path: &Path) -> bool {
    // Shared, so that concurrent sweeps do not mistake each other for the owner of the place.
    let lock = open(path).map(|file| file.try_lock_shared());
    matches!(lock, Ok(Err(TryLockError::WouldBlock)))
}

/// Runs before files are removed, because the programs would go on writing files.
fn end_programs() -> Vec<String> {
    let mut ended = Vec::new();
    let Some(programs) = folder_of_test_programs() else {
        return ended;
    };
    for process in entries(Path::new("/proc")) {
        let Some(id) = number(process.file_name().unwrap_or_default().as_bytes()) else {
            continue;
        };
        // Only root can read the environment of another user's process.
        let environment = fs::read(process.join("environ")).unwrap_or_default();
        let is_abandoned = environment
            .split(|byte| *byte == 0)
            .filter_map(|variable| variable.strip_prefix(b"CDCR_PREFIX="))
            .any(is_abandoned);
        if is_abandoned
            && is_ours(&process)
            && runs_from(&programs, &process)
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

/// Waits until a process has ended. A zombie counts as ended: it has no executable.
fn wait_for_end(process: &Path) {
    let end = Instant::now() + END_TIMEOUT;
    while fs::read_link(process.join("exe")).is_ok() && Instant::now() < end {
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Folder of the programs that were built with a test: the parent of `target/<profile>/deps`. `None` for any
/// other program, whose daemons end with it.
pub(super) fn folder_of_test_programs() -> Option<PathBuf> {
    let test = std::env::current_exe().ok()?;
    let folder = test.parent().filter(|folder| folder.ends_with("deps"))?;
    folder.parent().map(Path::to_owned)
}

/// Whether a process runs one of these programs, and is not a test. No other process is ended, whatever its
/// environment contains.
fn runs_from(programs: &Path, process: &Path) -> bool {
    let program = fs::read_link(process.join("exe")).unwrap_or_default();
    program.starts_with(programs) && !program.starts_with(programs.join("deps"))
}

/// Whether a process has the PID namespace of this process; a container has its own.
fn is_beside_us(process: &Path) -> bool {
    let of = |process: &Path| fs::read_link(process.join("ns/pid")).ok();
    let ours = of(Path::new("/proc/self"));
    ours.is_some() && of(process) == ours
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).collect()
}

/// Whether `name` belongs to a place whose process has ended.
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

/// Removes a file, or a folder with its contents, unless a process holds its lock.
fn remove(path: &Path) -> bool {
    // The lock is held during the removal, so that a new process of this name creates another folder.
    open(path).is_ok_and(|file| {
        file.try_lock().is_ok()
            && (fs::remove_file(path).is_ok() || fs::remove_dir_all(path).is_ok())
    })
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader};
    use std::os::unix::process::ExitStatusExt as _;
    use std::process::{Child, Command, Stdio};
    use std::sync::{Mutex, MutexGuard, PoisonError};

    use cdcr_test_skip::{Need, skip};

    use super::*;
    use crate::{MEMORY, Scratch};

    /// Marks the second run of a test program, which is to be killed.
    const VICTIM: &str = "CDCR_TEST_VICTIM";

    /// Serialises the sweeps of the tests: a sweep takes a folder that another one removes for a folder in
    /// use. The sweep of the first folder runs before.
    fn alone() -> MutexGuard<'static, ()> {
        static ONE: Mutex<()> = Mutex::new(());
        sweep_once();
        ONE.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Prefix of the files of a process.
    fn prefix_of(process: u32) -> String {
        format!("{PREFIX}{process}_0_")
    }

    /// Starts a process that waits for the end of its input.
    fn waiting(program: &Path, prefix: &str) -> Child {
        let mut command = Command::new(program);
        command.env("CDCR_PREFIX", prefix).stdin(Stdio::piped());
        command.spawn().unwrap()
    }

    #[test]
    fn what_a_killed_process_left_is_swept_and_named_and_what_a_living_one_has_is_not() {
        if std::env::var_os(VICTIM).is_some() {
            let makers = [Scratch::temporary, Scratch::in_memory, Scratch::on_disk];
            let folders = makers.map(|make| make().unwrap());
            for folder in &folders {
                fs::write(folder.path().join("file"), "").unwrap();
                // Without a macro: the test harness would hide the line.
                let line = format!("has {}\n", folder.path().display());
                std::io::stdout().write_all(line.as_bytes()).unwrap();
            }
            std::thread::sleep(Duration::from_secs(600));
            return;
        }
        let _alone = alone();
        let test = std::thread::current().name().unwrap().to_owned();
        let mut victim = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", &test, "--test-threads=2", "--nocapture"])
            .env(VICTIM, "1")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let reported = BufReader::new(victim.stdout.take().unwrap()).lines();
        let reported = reported.map_while(Result::ok);
        let has = reported.filter_map(|line| line.strip_prefix("has ").map(PathBuf::from));
        let folders: Vec<PathBuf> = has.take(3).collect();
        assert_eq!(folders.len(), 3, "{folders:?}");

        sweep();
        assert!(folders.iter().all(|folder| folder.join("file").exists()));

        victim.kill().unwrap();
        victim.wait().unwrap();
        let swept = sweep();
        for folder in folders {
            assert!(!folder.exists());
            let folder = fs::canonicalize(folder.parent().unwrap())
                .unwrap()
                .join(folder.file_name().unwrap());
            assert!(swept.contains(&folder.display().to_string()), "{swept:?}");
        }
    }

    #[test]
    fn a_program_of_a_killed_test_is_ended_and_no_other() {
        let _alone = alone();
        let built = Scratch::on_disk().unwrap();
        let is_built = folder_of_test_programs().is_some_and(|all| built.path().starts_with(all));
        if !is_built {
            skip(Need::Disk, "the target folder cannot be written");
            return;
        }
        let mut test = waiting(Path::new("cat"), "");
        let prefix = prefix_of(test.id());
        let program = built.path().join("cat");
        fs::copy("/bin/cat", &program).unwrap();
        let mut program = waiting(&program, &prefix);
        // A process of another program, with a variable left over in its shell.
        let mut foreign = waiting(Path::new("cat"), &prefix);
        // A new process has no environment yet.
        for child in [&program, &foreign] {
            let environment = PathBuf::from(format!("/proc/{}/environ", child.id()));
            while !String::from_utf8_lossy(&fs::read(&environment).unwrap()).contains(&prefix) {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        sweep();
        assert!(program.try_wait().unwrap().is_none());

        test.kill().unwrap();
        test.wait().unwrap();
        let named = format!("process {}", program.id());
        assert!(sweep().contains(&named));
        assert_eq!(
            program.wait().unwrap().signal(),
            Some(Signal::KILL.as_raw())
        );
        assert!(foreign.try_wait().unwrap().is_none());
        foreign.kill().unwrap();
        foreign.wait().unwrap();
    }

    #[test]
    fn what_is_another_users_is_not_swept() {
        let _alone = alone();
        if !geteuid().is_root() {
            skip(Need::Root, "a folder of another user");
            return;
        }
        // Larger than any process id.
        let prefix = prefix_of(4_000_000_003);
        for parent in crate::parents() {
            let folder = parent.join(format!("{prefix}folder"));
            fs::create_dir(&folder).unwrap();
            std::os::unix::fs::chown(&folder, Some(65_534), None).unwrap();
            let swept = sweep();
            let is_there = folder.exists();
            std::os::unix::fs::chown(&folder, Some(0), None).unwrap();
            assert!(is_there, "{swept:?}");
            let swept = sweep();
            assert!(swept.contains(&folder.display().to_string()), "{swept:?}");
        }
    }

    /// A locked file stands for a process of another container, whose id is unknown here.
    #[test]
    fn what_is_locked_is_not_swept() {
        let _alone = alone();
        let prefix = prefix_of(4_000_000_001);
        let parts = [Path::new(MEMORY), &std::env::temp_dir()];
        let [memory, folder] = parts.map(|folder| folder.join(format!("{prefix}part")));
        for locked in [&memory, &folder] {
            fs::write(&memory, "").unwrap();
            fs::create_dir(&folder).unwrap();
            let lock = File::open(locked).unwrap();
            lock.lock().unwrap();
            sweep();
            assert!(memory.exists() && folder.exists());
            drop(lock);
            sweep();
            assert!(!memory.exists() && !folder.exists());
        }
    }

    #[test]
    fn a_pipe_or_a_link_with_a_name_of_ours_holds_up_nothing() {
        let _alone = alone();
        let prefix = std::env::temp_dir().join(prefix_of(4_000_000_002));
        let kept = Scratch::temporary().unwrap();
        let [pipe, link] = ["pipe", "link"].map(|part| format!("{}{part}", prefix.display()));
        let made = Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());
        std::os::unix::fs::symlink(kept.path(), &link).unwrap();
        sweep();
        assert!(kept.path().exists());
        for left in [pipe, link] {
            let _ = fs::remove_file(left);
        }
    }

    #[test]
    fn only_names_of_ours_are_swept() {
        // Larger than any process id.
        let gone = 4_000_000_000_u32;
        assert!(is_abandoned(prefix_of(gone).as_bytes()));
        for name in [
            prefix_of(std::process::id()),
            prefix_of(1),
            PREFIX.to_owned(),
            format!("{PREFIX}unfinished_{gone}_left"),
            format!("cdcr-bench-{gone}-0_"),
        ] {
            assert!(!is_abandoned(name.as_bytes()), "{name}");
        }
        assert_eq!(place_of(b"cdcrbed_12_3_left_"), Some(&b"cdcrbed_12_3_"[..]));
        assert_eq!(place_of(b"cdcrbed_12"), None);
    }
}
