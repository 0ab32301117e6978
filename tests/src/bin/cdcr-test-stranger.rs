//! Another user who does not use `cdcr_client`: joins a daemon by iceoryx2 itself, and must not succeed. Run by the test
//! `iceoryx2_by_hand_is_refused_to_another_user`, as that user. Arguments: prefix and root of the daemon.

#![allow(
    clippy::unwrap_used,
    reason = "in a helper of a test a panic is the report"
)]

use std::path::Path;

use cdcr_client::{ConnectError, Connection};
use cdcr_shared_types::Location;
use cdcr_tests::ROBOT;
use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, NodeBuilder, SemanticString, ipc};

fn main() {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let [prefix, root] = given.as_slice() else {
        panic!("prefix and root, not {given:?}");
    };
    let location = Location::new(prefix, Path::new(root)).unwrap();
    let refused = Connection::open(&location, ROBOT).unwrap_err();
    assert!(
        matches!(refused, ConnectError::OtherUser { .. }),
        "{refused:?}"
    );
    // Without the client's look at the owner.
    let by_hand = location.node_builder().unwrap().create::<ipc::Service>();
    println!("{:?}", by_hand.unwrap_err());
    // With a root folder of one's own, and the daemon's names in shared memory.
    let own = tempfile::tempdir().unwrap();
    let mut config = Config::default();
    config.global.prefix = FileName::new(location.file_prefix().as_bytes()).unwrap();
    let path = own.path().as_os_str().as_encoded_bytes();
    config
        .global
        .set_root_path(&iceoryx2::prelude::Path::new(path).unwrap());
    let same_names = NodeBuilder::new().config(&config).create::<ipc::Service>();
    println!("{:?}", same_names.unwrap_err());
    println!(
        "joined nothing as user {}",
        rustix::process::geteuid().as_raw()
    );
}
