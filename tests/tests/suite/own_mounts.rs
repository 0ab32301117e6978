//! A test in a process with private mounts: a small shared memory, another journal.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use cdcr_shared_types::Location;
use cdcr_test_skip::{Need, skip};
use cdcr_tests::text;
use rustix::fs::{FallocateFlags, StatVfs, fallocate, statvfs};
use rustix::io::Errno;

/// Set for a process with private mounts.
const INSIDE: &str = "CDCR_TEST_INSIDE";

/// The name by which a test program runs this test.
pub(crate) fn name_of<T: Fn()>(_: &T) -> String {
    let (_, name) = std::any::type_name::<T>().split_once("::").unwrap();
    name.to_owned()
}

/// Whether this process has private mounts. Otherwise, runs the test of this name in a process that has them,
/// to its end.
pub(crate) fn has_own_mounts(test: &str) -> bool {
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let mut command = Command::new("unshare");
    if !rustix::process::geteuid().is_root() {
        command.arg("--map-root-user");
    }
    command.arg("--mount").arg(std::env::current_exe().unwrap());
    command.args(["--exact", test, "--nocapture"]);
    match command.env(INSIDE, "").output() {
        // The status of its own failure; that of a test is 101.
        Ok(output) if output.status.code() == Some(1) => {
            skip(
                Need::Mount,
                format!("no mounts of its own: {}", text(&output)),
            );
        }
        Ok(output) => {
            let printed = text(&output);
            assert!(printed.contains("1 passed"), "{printed}");
            print!("{printed}");
        }
        Err(cause) => skip(Need::UtilLinux, format!("no unshare: {cause}")),
    }
    false
}

/// Runs a script with mounts. False, with a message, if the system does not permit it.
pub(crate) fn mount(script: &str) -> bool {
    let output = Command::new("sh").args(["-c", script]).output().unwrap();
    if !output.status.success() {
        skip(Need::Mount, format!("{script}: {}", text(&output)));
    }
    output.status.success()
}

pub(crate) fn mount_memory(options: &str) -> bool {
    let memory = Location::MEMORY;
    mount(&format!("mount -t tmpfs -o {options} tmpfs {memory}"))
}

fn memory() -> StatVfs {
    statvfs(Location::MEMORY).unwrap()
}

/// Shared memory that stays full until this is dropped.
pub(crate) struct Filled(PathBuf);

impl Filled {
    fn path() -> PathBuf {
        Path::new(Location::MEMORY).join("fill")
    }

    /// Takes all free memory but `kilobytes` kB.
    pub(crate) fn but_kilobytes(kilobytes: u64) -> Self {
        let filled = Self(Self::path());
        let file = File::create(&filled.0).unwrap();
        loop {
            let free = memory().f_bavail * memory().f_frsize;
            let take = free.saturating_sub(1024 * kilobytes).max(1);
            match fallocate(&file, FallocateFlags::empty(), 0, take) {
                // Another process took some meanwhile.
                Err(Errno::NOSPC) if kilobytes > 0 || memory().f_bavail > 0 => {}
                Err(Errno::NOSPC) | Ok(()) => return filled,
                Err(cause) => panic!("{cause}"),
            }
        }
    }

    /// Takes all free files but `files`.
    pub(crate) fn but_files(files: u64) -> Self {
        let filled = Self(Self::path());
        fs::create_dir(&filled.0).unwrap();
        // The daemon may still remove files of the previous client: three times the same number means that it
        // has finished.
        let (mut taken, mut calm) = (0, 0);
        while calm < 3 {
            let free = memory().f_ffree;
            if free == files {
                calm += 1;
                std::thread::sleep(Duration::from_millis(100));
                continue;
            }
            calm = 0;
            if free > files {
                taken += 1;
                let _ = File::create(filled.0.join(taken.to_string()));
            } else {
                fs::remove_file(filled.0.join(taken.to_string())).unwrap();
                taken -= 1;
            }
        }
        filled
    }
}

impl Drop for Filled {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0).or_else(|_| fs::remove_dir_all(&self.0));
    }
}
