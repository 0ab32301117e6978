//! Services of another version, which the client rejects. Other users are tested in `access`.

use cdcr_client::{ConnectError, Connection};
use cdcr_shared_types::message::Struct as _;
use cdcr_shared_types::{ReferenceChunk, Service, Status, ipc};
use cdcr_tests::{Place, ROBOT};
use iceoryx2::prelude::{Node, ZeroCopySend};

fn node(place: &Place) -> Node<ipc::Variant> {
    let builder = place.location().node_builder().unwrap();
    builder.create().unwrap()
}

/// The same bytes as the status, with another meaning: only the name differs.
#[derive(Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("cdcr.Status.v999")]
struct OtherStatus(Status);

#[test]
fn a_service_of_the_same_size_and_another_version_is_refused_and_not_misread() {
    let place = Place::new();
    // Opened before, and correct.
    let _reference = node(&place)
        .service_builder(&Service::Reference.name(ROBOT).unwrap())
        .publish_subscribe::<ReferenceChunk>()
        .create()
        .unwrap();
    let other = node(&place)
        .service_builder(&Service::Status.name(ROBOT).unwrap())
        .publish_subscribe::<OtherStatus>()
        .history_size(1)
        .create()
        .unwrap();
    let publisher = other.publisher_builder().create().unwrap();
    let mut status = OtherStatus(Status::default());
    status.0.header.sent_ns = cdcr_client::monotonic_ns();
    publisher.send_copy(status).unwrap();
    let error = Connection::open(place.location(), ROBOT).expect_err("another type");
    assert!(
        matches!(
            error,
            ConnectError::VersionMismatch {
                service: "status",
                ..
            }
        ),
        "{error:?}"
    );
    let ours = Status::default().layout().type_name;
    let parts = [
        "of the status service",
        "cdcr.Status.v999",
        ours,
        "of the same version",
    ];
    place.checked("cdcrctl status", 1, &parts);
}

#[test]
fn a_service_of_another_pattern_is_refused() {
    let place = Place::new();
    let _other = node(&place)
        .service_builder(&Service::Status.name(ROBOT).unwrap())
        .event()
        .create()
        .unwrap();
    let error = Connection::open(place.location(), ROBOT).expect_err("another pattern");
    assert!(
        matches!(
            error,
            ConnectError::VersionMismatch { .. } | ConnectError::DaemonNotRunning { .. }
        ),
        "{error:?}"
    );
}
