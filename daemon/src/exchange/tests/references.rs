//! References and the lease that they belong to.

use cdcr_controller::reference::ReferenceState;
use cdcr_controller::safety::{LeaseState, Mode, Reason, Request as ModeRequest};
use cdcr_shared_types::codes::ChunkMode;
use cdcr_shared_types::{ReferenceChunk, ReferencePoint};

use super::*;

#[test]
fn who_acquires_a_lease_begins_without_the_reference_of_the_one_before() {
    let mut rig = Rig::new("[reference]\nlease_ms = 20.0\n");
    rig.gather();
    let first = rig.ask(1, RequestKind::AcquireLease);
    rig.gather();
    send_reference(&rig, 1);
    let ahead = |inputs: &CycleInputs, cycle| inputs.window.get(cycle).state;
    let cycle = rig.next_cycle;
    assert_eq!(ahead(rig.gather(), cycle), ReferenceState::Before);
    // The lease expires 20 ms after the gather that accepted the chunk.
    rig.gather_for(15);
    let (second, cycle) = (rig.ask(2, RequestKind::AcquireLease), rig.next_cycle);
    assert_eq!(ahead(rig.gather(), cycle), ReferenceState::None);
    let answer = second.receive().unwrap().unwrap();
    assert_eq!(answer.outcome, Outcome::Accepted.code());
    assert_eq!(answer.lease_holder, 2);
    drop(first);
}

/// Sends a trajectory that begins in half a second.
fn send_reference(rig: &Rig, client: u64) {
    send_points(
        rig,
        client,
        ChunkMode::Replace,
        [500, 1000].map(|ms| ms * MS),
    );
}

/// Sends points at these times from now on.
fn send_points<const N: usize>(rig: &Rig, client: u64, mode: ChunkMode, times_ns: [u64; N]) {
    let mut chunk = ReferenceChunk {
        header: rig.header(client),
        mode: mode.code(),
        count: N as u32,
        ..ReferenceChunk::default()
    };
    for (point, time_ns) in chunk.points.iter_mut().zip(times_ns) {
        *point = ReferencePoint {
            time_ns: rig.now_ns() + time_ns,
            position_m: [0.0, 0.0, 0.89],
            ..ReferencePoint::default()
        };
    }
    rig.references.send_copy(chunk).unwrap();
}

#[test]
fn a_chunk_continues_the_last_one_with_later_points_and_a_refused_one_is_counted() {
    let mut rig = Rig::new("");
    rig.gather();
    let lease = rig.ask(1, RequestKind::AcquireLease);
    rig.gather();
    let (append, replace) = (ChunkMode::Append, ChunkMode::Replace);
    for (mode, times_ns, outcome) in [
        // Nothing was accepted yet, so there is nothing to append to.
        (append, [500 * MS, 600 * MS], Outcome::SequenceGap),
        (replace, [500 * MS; 2], Outcome::TimeNotIncreasing),
        (
            replace,
            [500 * MS, 500 * MS + 999],
            Outcome::TimeNotIncreasing,
        ),
        (replace, [500 * MS, 600 * MS], Outcome::Accepted),
        (append, [700 * MS, 800 * MS], Outcome::Accepted),
        (append, [600 * MS, 900 * MS], Outcome::TimeNotIncreasing),
    ] {
        let before = rig.counted(outcome);
        send_points(&rig, 1, mode, times_ns);
        rig.gather();
        assert_eq!(rig.counted(outcome), before + 1, "{mode:?} {times_ns:?}");
    }
    drop(lease);
}

fn track(lease_number: u32) -> ModeRequest {
    ModeRequest::Track { lease_number }
}

/// The cycle skips the gathers in which the lease passes to another client: before and after, its inputs show
/// a held lease and a reference.
#[test]
fn tracking_does_not_pass_to_a_client_that_did_not_ask_for_it() {
    let mut rig = Rig::new("[reference]\nlease_ms = 20.0\n");
    rig.measure(9, 0.1, 1);
    rig.gather();
    rig.run(1, None);
    let first = rig.ask(1, RequestKind::AcquireLease);
    rig.gather();
    send_reference(&rig, 1);
    rig.gather();
    assert!(matches!(rig.run(3, Some(track(1))), Mode::Tracking { .. }));
    rig.gather_for(15);
    let second = rig.ask(2, RequestKind::AcquireLease);
    rig.gather();
    send_reference(&rig, 2);
    rig.measure(9, 0.1, 1);
    let cycle = rig.next_cycle;
    let inputs = rig.gather();
    assert_eq!(inputs.lease, LeaseState::Held);
    assert_eq!(inputs.window.get(cycle).state, ReferenceState::Before);
    let reason = Reason::LeaseExpired;
    assert_eq!(rig.run(cycle, None), Mode::Holding { reason });
    assert!(matches!(
        rig.run(cycle + 1, Some(track(2))),
        Mode::Tracking { .. }
    ));
    drop((first, second));
}

#[test]
fn who_asked_to_track_and_lost_the_lease_does_not_start_the_next_holders_reference() {
    let mut rig = Rig::new("[reference]\nlease_ms = 20.0\n");
    rig.measure(9, 0.1, 1);
    rig.gather();
    rig.run(1, None);
    let first = rig.ask(1, RequestKind::AcquireLease);
    rig.gather();
    send_reference(&rig, 1);
    let asked = rig.ask(1, RequestKind::Track);
    rig.gather();
    // No cycle carries it out until another client has the lease and a reference.
    rig.gather_for(15);
    let second = rig.ask(2, RequestKind::AcquireLease);
    rig.gather();
    send_reference(&rig, 2);
    rig.measure(9, 0.1, 1);
    let cycle = rig.next_cycle;
    rig.gather();
    let late = rig.ends.requests.pop().unwrap().request;
    assert!(matches!(rig.run(cycle, Some(late)), Mode::Holding { .. }));
    assert!(matches!(
        rig.run(cycle + 1, Some(track(2))),
        Mode::Tracking { .. }
    ));
    drop((first, asked, second));
}

#[test]
fn what_is_reserved_must_be_zero_but_in_a_stop() {
    let mut rig = Rig::new("");
    rig.gather();
    let lease = rig.ask(1, RequestKind::AcquireLease);
    rig.gather();
    let chunk = ReferenceChunk {
        header: rig.header(1),
        reserved: 1,
        ..ReferenceChunk::default()
    };
    rig.references.send_copy(chunk).unwrap();
    let request = |kind: RequestKind| Request {
        header: chunk.header,
        kind: kind.code(),
        // For a reset alone.
        accepts_pose: 1,
        ..Request::default()
    };
    let release = rig.control.send_copy(request(RequestKind::ReleaseLease));
    let stop = rig.control.send_copy(request(RequestKind::Stop));
    assert_eq!(rig.gather().stops, 1);
    assert_eq!(rig.counted(Outcome::UnknownCode), 2);
    drop((lease, release, stop));
}

#[test]
fn who_floods_references_does_not_keep_out_who_holds_the_lease() {
    let mut rig = Rig::new("");
    let mut crowd = rig.crowd(Service::Reference);
    std::mem::swap(&mut crowd[0], &mut rig.references);
    rig.gather();
    let lease = rig.ask(1, RequestKind::AcquireLease);
    rig.gather();
    let mut chunk = ReferenceChunk {
        header: rig.header(1),
        mode: ChunkMode::Replace.code(),
        count: 1,
        ..ReferenceChunk::default()
    };
    chunk.points[0].time_ns = rig.now_ns() + 500 * MS;
    chunk.points[0].position_m = [0.0, 0.0, 0.89];
    let mut flooding = chunk;
    flooding.header.sender_id = 2;
    for _ in 0..20 {
        flood(&crowd, Service::Reference, || flooding);
        rig.gather();
    }
    rig.references.send_copy(chunk).unwrap();
    let mut gathers = 0;
    while !rig.exchange.references.is_fed() {
        flood(&crowd, Service::Reference, || flooding);
        let before = rig.counted(Outcome::NoLease);
        rig.gather();
        assert!(rig.counted(Outcome::NoLease) - before <= gather::CHUNKS_PER_GATHER as u64);
        gathers += 1;
        assert!(gathers <= 8);
    }
    drop(lease);
}

/// A point carries the time at which the tip shall reach it. While points are ahead of the window, it does not matter
/// when their chunks arrive.
#[test]
fn the_jitter_of_a_client_does_not_reach_the_cycle() {
    const STEPS: u64 = 60;
    let mut rigs = [(); 2].map(|()| Rig::new("[reference]\nlease_ms = 2000.0\n"));
    let leases = rigs.each_mut().map(|rig| {
        rig.gather();
        let lease = rig.ask(1, RequestKind::AcquireLease);
        rig.gather();
        lease
    });
    let begin_ns = rigs[0].now_ns() + 1000 * MS;
    // A chunk has three points 100 ms apart. Its delay \[ms\], for a punctual and for another client.
    let delays_ms = [[0; 8], [0, 400, 115, 350, 60, 210, 395, 110]];
    let mut moves = false;
    for now_ms in (0..3000).step_by(5) {
        let windows = [0, 1].map(|client| {
            let rig = &mut rigs[client];
            for (number, delay_ms) in (0..).zip(delays_ms[client]) {
                if 300 * number + delay_ms == now_ms {
                    send_chunk(rig, number, begin_ns);
                }
            }
            let cycle = rig.next_cycle;
            let inputs = rig.gather();
            let steps = cycle..cycle + STEPS;
            steps
                .map(|cycle| inputs.window.get(cycle))
                .collect::<Vec<_>>()
        });
        assert_eq!(windows[0], windows[1], "{now_ms} ms");
        moves |= windows[0][0].position_m != windows[0][1].position_m;
    }
    assert!(moves);
    drop(leases);
}

/// Three points on a line; the first chunk begins a reference, the others continue it.
fn send_chunk(rig: &Rig, number: u64, begin_ns: u64) {
    let mode = [ChunkMode::Append, ChunkMode::Replace][usize::from(number == 0)];
    let mut chunk = ReferenceChunk {
        header: rig.header(1),
        mode: mode.code(),
        count: 3,
        ..ReferenceChunk::default()
    };
    for (point, index) in chunk.points.iter_mut().zip(3 * number..3 * number + 3) {
        *point = ReferencePoint {
            time_ns: begin_ns + 100 * index * MS,
            position_m: [0.001 * index as f64, 0.0, 0.89],
            ..ReferencePoint::default()
        };
    }
    rig.references.send_copy(chunk).unwrap();
}
