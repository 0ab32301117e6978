//! What the README promises and no other test shows: the size of the client library, and the environments of the demo.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::path::Path;
use std::process::Command;

use cdcr_test_skip::{Need, skip};
use cdcr_tests::{Place, Program, assert_output, binary, text, until_undisturbed};

use crate::own_mounts::{has_own_mounts, mount, name_of};

fn readme() -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../README.md");
    std::fs::read_to_string(file).unwrap()
}

/// Names of the crates of a build on this system; none where cargo belongs to another user.
fn crates(line: &str) -> Option<BTreeSet<String>> {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args("tree --offline --locked --edges normal,build --prefix none --package".split(' '));
    let output = match cargo.args(line.split(' ')).output() {
        Err(error) if error.kind() == ErrorKind::PermissionDenied => return None,
        output => output.unwrap(),
    };
    assert!(output.status.success(), "{}", text(&output));
    let printed = String::from_utf8(output.stdout).unwrap();
    let crates = printed.lines().filter(|line| !line.ends_with("(*)"));
    let names = crates.map(|line| line.split(" (").next().unwrap().to_owned());
    Some(names.collect())
}

#[test]
fn the_client_library_has_as_many_crates_as_promised() {
    let Some(all) = crates("cdcr-client --no-default-features") else {
        return skip(Need::Root, "cargo belongs to another user");
    };
    let words = format!("the library consists of {} crates", all.len());
    let readme = readme().replace('\n', " ");
    assert!(readme.contains(&words), "{words}: {all:#?}");
    let own = all.difference(&crates("iceoryx2").unwrap()).count();
    assert_eq!(own, 4, "{all:#?}");
}

/// Runs a short demo below `wrapper`, with this folder for temporary files.
fn demo(place: &Place, wrapper: &str, temporary: &Path) -> Program {
    let mut words = wrapper.split(' ');
    let mut command = place.command_of(Path::new(words.next().unwrap()));
    command.args(words).arg(binary("cdcrctl"));
    let demo = "demo --duration 300ms --format json".split(' ');
    Program::start(command.args(demo).env("TMPDIR", temporary))
}

/// The rows of the table that need no other user and no container.
#[test]
fn the_demo_runs_in_a_poor_environment_or_reports_what_it_lacks() {
    let test = &name_of(&the_demo_runs_in_a_poor_environment_or_reports_what_it_lacks);
    if !has_own_mounts(test) {
        return;
    }
    let place = Place::new();
    let (folder, missing) = (place.folder(), place.folder().join("missing"));
    let runs = |wrapper: &str| {
        until_undisturbed("the demo runs", || {
            let output = demo(&place, wrapper, folder).output();
            println!("{wrapper}: {}", text(&output));
            output.status.success().then_some(())
        });
    };
    runs("env -u HOME");
    runs("taskset -c 0");
    // A process of the tests hands on files of its own, which would count.
    let few = folder.join("few-files");
    let closed =
        "for file in /proc/$$/fd/*; do [ ${file##*/} -lt 3 ] || eval \"exec ${file##*/}>&-\"; done";
    std::fs::write(
        &few,
        format!("{closed}\nexec prlimit --nofile=64:64 \"$@\"\n"),
    )
    .unwrap();
    runs(&format!("bash {}", few.display()));
    for files in [16, 32, 48] {
        let mut found = demo(&place, &format!("prlimit --nofile={files}:{files}"), folder);
        let words = [&format!("only {files} files"), "needs 64", "ulimit -n"];
        assert_output(&found.output(), 1, &words);
    }
    let words = ["set TMPDIR to one that can be written"];
    assert_output(&demo(&place, "env", &missing).output(), 1, &words);
    // Docker's default, less, and too little.
    for megabytes in [64, 7, 5] {
        if !mount(&format!(
            "mount -t tmpfs -o size={megabytes}m tmpfs /dev/shm"
        )) {
            return;
        }
        if megabytes > 5 {
            runs("env");
        } else {
            let words = ["MB are needed", "MB are free", "remount,size="];
            assert_output(&demo(&place, "env", folder).output(), 1, &words);
        }
        assert!(mount("umount /dev/shm"));
    }
}
