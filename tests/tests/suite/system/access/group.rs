//! A group to which the daemon opened its root folder: its members observe, feed and command, others do not.
//!
//! The daemon runs as its own user, so that nothing works only because of root's rights.

use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use cdcr_shared_types::Location;
use cdcr_tests::{Place, Program, STALL_TOLERANT, assert_output, binary, text, wait_until};
use rustix::fs::{XattrFlags, getxattr, setxattr};
use rustix::process::Signal;

use super::stranger::{
    EXIT_ROOT, NOBODY, attempts, have_a_stranger, in_view, of_stranger, open_to_all, paths_below,
    stranger,
};

/// User and group of the daemon, which need no names.
const DAEMON: u32 = 64_320;
/// The group of the robot.
const GROUP: u32 = 64_321;

/// Attribute of the access control list.
const LIST: &str = "system.posix_acl_access";

/// A root folder as made by a service manager: owned by the daemon, inside a folder of root.
struct Shared {
    place: Place,
    root: PathBuf,
    cdcrd: PathBuf,
    cdcrctl: PathBuf,
}

impl Shared {
    /// `None` if the test cannot change its user.
    fn new() -> Option<Self> {
        if !have_a_stranger() {
            return None;
        }
        let place = Place::new();
        in_view(&place);
        let root = place.location().root().join("robot");
        fs::create_dir_all(&root).unwrap();
        fs::set_permissions(place.location().root(), Permissions::from_mode(0o755)).unwrap();
        // A daemon without a group has run here.
        let nodes = root.join("nodes");
        fs::create_dir(&nodes).unwrap();
        fs::set_permissions(&root, Permissions::from_mode(0o700)).unwrap();
        fs::set_permissions(&nodes, Permissions::from_mode(0o750)).unwrap();
        for folder in [&root, &nodes] {
            chown(folder, Some(DAEMON), Some(DAEMON)).unwrap();
        }
        let [cdcrd, cdcrctl] = ["cdcrd", "cdcrctl"].map(|name| open_to_all(&place, &binary(name)));
        Some(Self {
            place,
            root,
            cdcrd,
            cdcrctl,
        })
    }

    fn daemon(&self, root: &Path, group: &str) -> Command {
        let text = format!("{STALL_TOLERANT}[transport]\ngroup = \"{group}\"\n");
        let config = self.place.write(&format!("robot{group}.toml"), &text);
        fs::set_permissions(&config, Permissions::from_mode(0o644)).unwrap();
        let mut command = of_stranger(&self.cdcrd, self.place.location().prefix(), root);
        command.uid(DAEMON).gid(DAEMON);
        command.args(["run", "--config"]).arg(config);
        command
    }

    /// Starts a daemon for the group, or for none, and waits until it runs.
    fn running(&self, group: &str) -> Program {
        let daemon = Program::start(&mut self.daemon(&self.root, group));
        let location = Location::new(self.place.location().prefix(), &self.root).unwrap();
        wait_until("the daemon runs", || {
            fs::read_to_string(location.lock_file(cdcr_tests::ROBOT))
                .is_ok_and(|text| text.trim() == daemon.id().to_string())
        });
        daemon
    }

    /// Starts the daemon for the group and waits until a member is served.
    fn started(&self) -> Program {
        let daemon = Program::start(&mut self.daemon(&self.root, &GROUP.to_string()));
        let process = format!("process {},", daemon.id());
        wait_until("a member is served", || {
            text(&self.asked(GROUP, "status")).contains(&process)
        });
        daemon
    }

    /// `cdcrctl` of another user, whose umask hides its files from all others.
    fn cdcrctl(&self, group: u32, words: &str) -> Command {
        let shell = Path::new("/bin/sh");
        let mut command = of_stranger(shell, self.place.location().prefix(), &self.root);
        command
            .gid(group)
            .args(["-c", r#"umask 077; exec "$0" "$@""#]);
        command.arg(&self.cdcrctl).args(words.split(' '));
        command
    }

    fn asked(&self, group: u32, words: &str) -> Output {
        self.cdcrctl(group, words).output().unwrap()
    }

    /// Files of the other user below the root folder.
    fn left(&self) -> Vec<PathBuf> {
        let is_theirs = |path: &PathBuf| {
            path.symlink_metadata()
                .is_ok_and(|file| file.uid() == NOBODY)
        };
        paths_below(&self.root)
            .into_iter()
            .filter(is_theirs)
            .collect()
    }
}

#[test]
fn a_member_of_the_group_observes_feeds_and_commands_and_no_other_does() {
    let Some(shared) = Shared::new() else { return };
    let mut daemon = shared.started();
    for (words, printed) in [
        ("echo telemetry --count 1", "holding"),
        (
            "obstacle add --id 7 --at 5,5,5 --radius 0.01",
            "obstacles: accepted",
        ),
        (
            "ref line --duration 300ms --lead 1s --track",
            "fed and tracked to its end",
        ),
        ("settings set horizon_steps=5", "accepted"),
        ("stop", "the daemon is stopped"),
        ("reset", "accepted"),
    ] {
        let refusal = shared.asked(NOBODY, words);
        assert_output(&refusal, 1, &["belongs to user 64320", "transport.group"]);
        assert_output(&shared.asked(GROUP, words), 0, &[printed]);
    }
    // Root could be led out of the folder, too.
    let refusal = shared.cdcrctl(GROUP, "status").uid(0).output().unwrap();
    assert_output(&refusal, 1, &["belongs to user 64320"]);
    let files = paths_below(&shared.root);
    assert!(files.len() > 20, "{}", files.len());
    assert_eq!(attempts(&files, NOBODY), Vec::<String>::new());
    daemon.signal(Signal::TERM);
    assert_output(&daemon.output(), 0, &[]);
    assert_eq!(shared.left(), Vec::<PathBuf>::new());
}

#[test]
fn what_a_killed_member_left_is_cleared_away_by_the_daemon() {
    let Some(shared) = Shared::new() else { return };
    let daemon = shared.started();
    let mut member = Program::start(&mut shared.cdcrctl(GROUP, "echo telemetry"));
    // One that is killed while it makes a file leaves it with a mode that excludes the daemon.
    wait_until("the member reads", || member.lines() > 0);
    assert!(shared.left().len() > 3);
    member.signal(Signal::KILL);
    member.output();
    wait_until("nothing of it is left", || shared.left().is_empty());
    drop(daemon);
}

/// Undesired, but true of any memory shared by two processes; docs/security.md warns administrators who
/// select the members.
#[test]
fn a_member_that_makes_its_own_files_shorter_ends_the_daemon() {
    let Some(shared) = Shared::new() else { return };
    let mut daemon = shared.started();
    let feeds = "ref spiral --duration 20s";
    let _member = Program::start(&mut shared.cdcrctl(GROUP, feeds));
    let is_data = |path: &PathBuf| path.extension().is_some_and(|end| end == "data");
    wait_until("the member feeds", || shared.left().iter().any(is_data));
    wait_until("the daemon has ended", || {
        for path in shared.left().into_iter().filter(|path| path.is_file()) {
            let file = fs::OpenOptions::new().write(true).open(path);
            let _ = file.and_then(|file| file.set_len(0));
        }
        !daemon.runs()
    });
    let ended_by = daemon.output().status.signal();
    assert_eq!(ended_by, Some(Signal::BUS.as_raw()));
}

#[test]
fn a_folder_that_was_open_to_a_group_is_refused_without_it_until_it_is_closed() {
    let Some(shared) = Shared::new() else { return };
    // Killed, so that its folders and its lock file remain. Another daemon with the group can use them.
    for _ in 0..2 {
        let mut daemon = shared.started();
        daemon.signal(Signal::KILL);
        daemon.output();
    }
    let refused = Program::start(&mut shared.daemon(&shared.root, "")).output();
    assert_output(&refused, EXIT_ROOT, &["mode 0770", "chmod go-rwx"]);
    fs::set_permissions(&shared.root, Permissions::from_mode(0o700)).unwrap();
    let mut daemon = shared.running("");
    let refusal = shared.asked(GROUP, "status");
    assert_output(&refusal, 1, &["belongs to user 64320"]);
    daemon.signal(Signal::TERM);
    assert_output(&daemon.output(), 0, &[]);
}

#[test]
fn who_may_use_a_folder_does_not_change_under_a_daemon() {
    let Some(shared) = Shared::new() else { return };
    let group = GROUP.to_string();
    let other_group = NOBODY.to_string();
    for (first, second) in [("", &*group), (&group, ""), (&group, &other_group)] {
        let mut daemon = shared.running(first);
        let mode = fs::metadata(&shared.root).unwrap().mode();
        let mut command = shared.daemon(&shared.root, second);
        let refused = Program::start(command.args(["--robot", "other"])).output();
        let process = format!("\"{}\" (process {})", cdcr_tests::ROBOT, daemon.id());
        assert_output(
            &refused,
            EXIT_ROOT,
            &[&process, "transport.group", "--root"],
        );
        assert_eq!(fs::metadata(&shared.root).unwrap().mode(), mode);
        if first.is_empty() {
            assert_eq!(
                attempts(&paths_below(&shared.root), GROUP),
                Vec::<String>::new()
            );
        }
        daemon.signal(Signal::TERM);
        assert_output(&daemon.output(), 0, &[]);
        // The daemon has ended, but members of the group may have left files.
        fs::set_permissions(&shared.root, Permissions::from_mode(0o700)).unwrap();
    }
}

#[test]
fn a_list_that_somebody_changed_is_set_back() {
    let Some(shared) = Shared::new() else { return };
    let daemon = shared.started();
    let files = paths_below(&shared.root);
    let mut list = [0; 64];
    let length = getxattr(&shared.root, LIST, &mut list).unwrap();
    // Another group in place of the robot's, with the same mode.
    let at = list.windows(4).position(|part| part == GROUP.to_le_bytes());
    let at = at.expect("the group is in the list");
    list[at..at + 4].copy_from_slice(&NOBODY.to_le_bytes());
    setxattr(&shared.root, LIST, &list[..length], XattrFlags::empty()).unwrap();
    let readable = |group| {
        let mut reads = stranger("/bin/ls");
        let read = reads.gid(group).arg(&shared.root).output();
        read.unwrap().status.success()
    };
    wait_until("it is set back", || !readable(NOBODY) && readable(GROUP));
    assert_eq!(attempts(&files, NOBODY), Vec::<String>::new());
    drop(daemon);
}

#[test]
fn a_group_shares_no_folder_that_somebody_else_could_have_made() {
    let Some(shared) = Shared::new() else { return };
    let root =
        Path::new(Location::MEMORY).join(format!("{}open", shared.place.location().prefix()));
    let group = GROUP.to_string();
    let refused = Program::start(&mut shared.daemon(&root, &group)).output();
    let words = ["owned by root", "install -d -o", "transport.group"];
    assert_output(&refused, EXIT_ROOT, &words);
    // Root shares no folder: it could be led out of it.
    let mut of_root = shared.daemon(&shared.root, &group);
    chown(&shared.root, Some(0), Some(0)).unwrap();
    let refused = Program::start(of_root.uid(0).gid(0)).output();
    assert_output(&refused, EXIT_ROOT, &["runs as root", "transport.group"]);
    // A client does not trust a root folder of another user in any group, either.
    fs::set_permissions(&root, Permissions::from_mode(0o770)).unwrap();
    chown(&root, None, Some(GROUP)).unwrap();
    let mut client = of_stranger(&shared.cdcrctl, shared.place.location().prefix(), &root);
    let refusal = client.gid(GROUP).arg("status").output().unwrap();
    assert_output(&refusal, 1, &["belongs to user 64320"]);
    fs::remove_dir_all(&root).unwrap();
}
