//! `docs/tutorial.md`, and the session of the README, typed from the beginning to the end.

use std::fs;
use std::path::Path;

use cdcr_client::Connection;
use cdcr_tests::{Daemon, Place, ROBOT, STALL_TOLERANT, text, until_undisturbed, wait_until};
use rustix::process::Signal;

use super::examples::shell;

/// The command blocks of a page.
fn blocks(page: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(page);
    let page = fs::read_to_string(path).unwrap();
    let blocks = page.split("```").skip(1).step_by(2);
    let blocks = blocks.filter_map(|block| block.strip_prefix("sh\n"));
    blocks
        .map(|block| block.replace("./target/release/", ""))
        .collect()
}

/// Its output; `None` if it failed, for example when the machine stalls for longer than the lead of a
/// reference.
fn typed(place: &Place, block: &str) -> Option<String> {
    let output = shell(place, &format!("set -e\n{block}")).output();
    let reported = text(&output);
    if !output.status.success() {
        println!("{block}\n{reported}");
        return None;
    }
    Some(reported)
}

#[test]
fn the_session_of_the_readme_works_as_typed() {
    let reported = until_undisturbed("the session of the README", type_the_session);
    assert!(
        reported.contains("cycles reproduced") && reported.contains("run.html"),
        "{reported}"
    );
}

fn type_the_session() -> Option<String> {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    fs::create_dir(place.folder().join("configs")).unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/scene.json");
    fs::copy(scene, place.folder().join("configs/scene.json")).unwrap();
    let all = blocks("README.md");
    let mut sessions = all.iter().filter(|block| block.contains("cdcrctl record"));
    let session = sessions.next().unwrap();
    for word in [
        "obstacle file",
        "ref helix",
        "top",
        "info",
        "replay --verify",
        "report",
    ] {
        assert!(session.contains(word), "{word}");
    }
    assert_eq!(sessions.next(), None);
    typed(place, session)
}

#[test]
fn the_tutorial_works_as_typed() {
    let place = until_undisturbed("the tutorial", type_the_tutorial);
    let info = place.json("info loop.mcap");
    // A robot that differs from its model, beside an obstacle off its path. The robot had to approach from
    // the straight shape first.
    let error_m = |of: &str| info[of]["position_error_m"].as_f64().unwrap();
    let along_m = error_m("largest_error_after_approach");
    assert!(along_m > 0.0, "{info}");
    assert!(2.0 * along_m < error_m("largest_error"), "{info}");
    assert!(place.folder().join("loop.html").exists());
}

fn type_the_tutorial() -> Option<Place> {
    let place = Place::new();
    let mut daemon = None;
    for block in blocks("docs/tutorial.md") {
        if block.starts_with("cdcrd run") {
            daemon = Some(shell(&place, &format!("exec {block}")));
            let location = place.location();
            wait_until("the daemon is up", || {
                Connection::open(location, ROBOT).is_ok()
            });
            continue;
        }
        typed(&place, &block)?;
    }
    let mut daemon = daemon.expect("a block that starts the daemon");
    daemon.signal(Signal::INT);
    assert!(daemon.output().status.success());
    Some(place)
}
