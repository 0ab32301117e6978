//! Another user without `cdcr_client` joins a daemon through iceoryx2 directly, and must fail. Run by the
//! test `iceoryx2_by_hand_is_refused_to_another_user` as that user. Arguments: prefix and root of the daemon.

#![allow(
    clippy::unwrap_used,
    reason = "in a helper of a test a panic is the report"
)]

use std::path::Path;

use cdcr_client::{ConnectError, Connection};
use cdcr_shared_types::{Location, ipc};
use cdcr_tests::ROBOT;

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
    // Without the client's check of the owner.
    let by_hand = location.node_builder().unwrap().create::<ipc::Variant>();
    println!("{:?}", by_hand.unwrap_err());
    println!(
        "joined nothing as user {}",
        rustix::process::geteuid().as_raw()
    );
}
