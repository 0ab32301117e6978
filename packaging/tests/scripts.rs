//! The maintainer scripts where systemd is missing, and beside a daemon that was started by hand.

#![allow(clippy::unwrap_used, reason = "in a test a panic is the report")]

use std::fs::{self, File};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::Command;

use cdcr_scratch::Scratch;

const SCRIPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maintainer-scripts");

/// Runs a script with `programs` of the system and `stubs` (name and body) only; its exit status and output.
fn run(folder: &Path, [script, action]: [&str; 2], stubs: &[(&str, &str)]) -> (i32, String) {
    let programs = folder.join("programs");
    fs::create_dir_all(&programs).unwrap();
    for name in ["find", "flock", "readlink", "rm", "true"] {
        let path = ["/usr/bin", "/bin"].map(|folder| Path::new(folder).join(name));
        let path = path.iter().find(|path| path.exists()).unwrap();
        drop(std::os::unix::fs::symlink(path, programs.join(name)));
    }
    for (name, body) in stubs {
        let path = programs.join(name);
        fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    let output = Command::new("/bin/sh")
        .arg(Path::new(SCRIPTS).join(script))
        .arg(action)
        .env("PATH", &programs)
        .env("DPKG_ROOT", folder)
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].concat();
    (
        output.status.code().unwrap(),
        String::from_utf8(text).unwrap(),
    )
}

#[test]
fn without_systemd_the_user_is_created_or_the_command_is_named() {
    let folder = Scratch::temporary().unwrap();
    let nobody = ("getent", "exit 2");
    let run = |stubs: &[_]| run(folder.path(), ["postinst", "configure"], stubs);
    let (status, text) = run(&[nobody]);
    assert_eq!(status, 0, "{text}");
    assert!(text.contains("create it: useradd --system"), "{text}");
    let (status, text) = run(&[nobody, ("useradd", "echo created \"$@\"")]);
    assert_eq!(status, 0, "{text}");
    assert!(
        text.starts_with("created --system") && text.ends_with(" cdcr\n"),
        "{text}"
    );
    let (status, text) = run(&[("getent", "exit 0"), ("useradd", "exit 9")]);
    assert_eq!((status, text.as_str()), (0, ""));
}

/// A daemon that was started by hand, of which systemd knows nothing.
#[test]
fn an_upgrade_names_a_daemon_that_still_runs_the_old_program() {
    let folder = Scratch::temporary().unwrap();
    for (process, exe) in [("12", "/usr/bin/cdcrd"), ("34", "/usr/bin/cdcrd (deleted)")] {
        let process = folder.path().join("proc").join(process);
        fs::create_dir_all(&process).unwrap();
        std::os::unix::fs::symlink(exe, process.join("exe")).unwrap();
    }
    let stubs = [("getent", "exit 0")];
    let (status, text) = run(folder.path(), ["postinst", "configure"], &stubs);
    assert_eq!(status, 0, "{text}");
    let line = "the old cdcrd still runs, process 34: end it when the robot may stop";
    assert!(text.starts_with(line), "{text}");
}

#[test]
fn a_purge_leaves_the_files_of_a_daemon_that_runs() {
    let folder = Scratch::temporary().unwrap();
    let root = folder.path().join("run/cdcr");
    fs::create_dir_all(&root).unwrap();
    let lock = File::create(root.join("cdcr_arm.lock")).unwrap();
    lock.lock().unwrap();
    let purge = || {
        let stubs = [("getent", "exit 2")];
        run(folder.path(), ["postrm", "purge"], &stubs)
    };
    let (status, text) = purge();
    assert_eq!(status, 0, "{text}");
    assert!(
        text.contains("a daemon runs") && text.contains("cdcr_arm.lock"),
        "{text}"
    );
    assert!(root.exists());
    drop(lock);
    assert_eq!(purge(), (0, String::new()));
    assert!(!root.exists());
}
