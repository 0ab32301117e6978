//! Obstacles: which are accepted, for how long, and that no sender excludes another.

use cdcr_shared_types::codes::ObstacleAction;

use super::*;
use crate::kept_obstacles::KeptObstacles;
use crate::obstacles::ObstacleSet;

#[test]
fn an_obstacle_whose_source_died_does_not_expire_while_the_daemon_stands_still() {
    let mut rig = Rig::new("[obstacles]\nsource_timeout_ms = 100.0\n");
    rig.gather();
    rig.send_update(4, ObstacleAction::Upsert, &[50]);
    rig.gather();
    // The last sign of life waits while the daemon stalls for longer than the obstacle's lifetime.
    rig.send_update(4, ObstacleAction::Upsert, &[]);
    rig.next_cycle += 80;
    for _ in 0..3 {
        let inputs = rig.gather();
        assert_eq!(inputs.obstacles.count(), 1);
        assert!(!inputs.obstacle_source_silent, "nobody listened");
    }
    rig.gather_for(100);
    let inputs = rig.gather();
    assert_eq!(inputs.obstacles.count(), 1);
    assert!(inputs.obstacle_source_silent);
}

/// A time stamp from a stall of this thread, after the start of its gather, is not in the future.
#[test]
fn what_was_seen_while_the_gather_stood_still_is_taken() {
    for (stall_ns, outcome) in [(0, Outcome::InTheFuture), (30 * MS, Outcome::Accepted)] {
        let mut rig = Rig::new("");
        rig.gather();
        let seen_ns = rig.gather_ns() + 30 * MS;
        let mut update = rig.update(4, ObstacleAction::Upsert, &[5000]);
        update.obstacles[0].measured_ns = seen_ns;
        rig.obstacles.send_copy(update).unwrap();
        rig.measure_at(5, 0.0, seen_ns);
        rig.clock.step_ns.set(stall_ns);
        rig.gather();
        assert_eq!(rig.counted(outcome), 2, "{stall_ns} ns: {outcome:?}");
    }
}

#[test]
fn a_source_of_obstacles_that_dies_holds_the_robot_and_its_obstacles_stay() {
    let mut rig = Rig::new("[obstacles]\nsource_timeout_ms = 100.0\n");
    let lifetime_ms = 50;
    for _ in 0..5 {
        rig.send_update(4, ObstacleAction::Upsert, &[lifetime_ms]);
        assert!(!rig.gather().obstacle_source_silent);
    }
    let begin_ns = rig.now_ns();
    let mut silent_ns = None;
    for _ in 0..100 {
        let inputs = rig.gather();
        let (count, is_silent) = (inputs.obstacles.count(), inputs.obstacle_source_silent);
        let placed = inputs
            .obstacles
            .iter_at(inputs.gather_ns + PERIOD_NS)
            .collect::<ObstacleSet>();
        assert_eq!((count, placed.count()), (1, 1));
        if is_silent {
            silent_ns.get_or_insert(rig.now_ns() - begin_ns);
        }
    }
    let silent_ns = silent_ns.unwrap();
    assert!(
        (100 * MS..=100 * MS + 2 * PERIOD_NS).contains(&silent_ns),
        "{silent_ns}"
    );
    // The source sends again, without this obstacle.
    rig.send_update(4, ObstacleAction::Upsert, &[]);
    rig.gather();
    let inputs = rig.gather();
    assert!(!inputs.obstacle_source_silent);
    assert_eq!(inputs.obstacles.count(), 0);
    // The source dies again, now without a known obstacle; an operator clears the list.
    rig.gather_for(200);
    assert!(rig.gather().obstacle_source_silent);
    rig.send_update(5, ObstacleAction::Clear, &[]);
    assert!(!rig.gather().obstacle_source_silent);
    rig.gather_for(200);
    assert!(!rig.gather().obstacle_source_silent);
}

#[test]
fn a_source_of_obstacles_that_removes_them_and_ends_holds_nobody_up() {
    let mut rig = Rig::new("[obstacles]\nsource_timeout_ms = 100.0\n");
    rig.send_update(4, ObstacleAction::Upsert, &[50, 5000]);
    rig.gather();
    rig.gather_for(20);
    rig.send_update(4, ObstacleAction::Remove, &[0, 0]);
    assert_eq!(rig.gather().obstacles.count(), 0);
    rig.gather_for(300);
    assert!(!rig.gather().obstacle_source_silent);
    // A source with an obstacle left has not ended, and the obstacle stays.
    rig.send_update(4, ObstacleAction::Upsert, &[50, 50]);
    rig.gather();
    rig.send_update(4, ObstacleAction::Remove, &[0]);
    rig.gather();
    rig.gather_for(300);
    let inputs = rig.gather();
    assert!(inputs.obstacle_source_silent);
    assert_eq!(inputs.obstacles.count(), 1);
}

/// The robot goes on when others have taken over or removed each obstacle that a dead source left.
#[test]
fn a_source_that_died_is_awaited_until_others_have_taken_over_or_removed_all_that_it_had() {
    // A source with obstacles 0 and 1, after 300 ms of silence.
    let dead = || {
        let mut rig = Rig::new("[obstacles]\nsource_timeout_ms = 100.0\n");
        rig.send_update(4, ObstacleAction::Upsert, &[50, 50]);
        rig.gather();
        rig.gather_for(300);
        assert!(rig.gather().obstacle_source_silent);
        rig
    };
    let is_silent_after = |rig: &mut Rig, action: ObstacleAction, lifetimes_ms: &[u64]| {
        rig.send_update(5, action, lifetimes_ms);
        rig.gather().obstacle_source_silent
    };
    // The same program, started again: its client is another one, and is watched now.
    let mut rig = dead();
    assert!(is_silent_after(&mut rig, ObstacleAction::Upsert, &[50]));
    assert!(!is_silent_after(&mut rig, ObstacleAction::Upsert, &[50; 2]));
    rig.gather_for(300);
    assert!(rig.gather().obstacle_source_silent, "it died, too");
    // An operator removes one by one.
    let mut rig = dead();
    assert!(is_silent_after(&mut rig, ObstacleAction::Remove, &[0]));
    assert!(!is_silent_after(&mut rig, ObstacleAction::Remove, &[0, 0]));
    assert_eq!(rig.gather().obstacles.count(), 0);
    rig.gather_for(300);
    assert!(!rig.gather().obstacle_source_silent);
    // Started again before anybody noticed.
    let mut rig = Rig::new("[obstacles]\nsource_timeout_ms = 100.0\n");
    rig.send_update(4, ObstacleAction::Upsert, &[50]);
    rig.gather();
    for _ in 0..60 {
        assert!(!is_silent_after(&mut rig, ObstacleAction::Upsert, &[50]));
    }
}

/// What others did while a source was alive does not end the watch over it, and what it let expire still names it.
#[test]
fn a_source_that_dies_without_an_obstacle_is_awaited_until_another_sends_or_removes_its_newest() {
    for action in [ObstacleAction::Upsert, ObstacleAction::Remove] {
        let mut rig = Rig::new("[obstacles]\nsource_timeout_ms = 100.0\n");
        rig.send_update(4, ObstacleAction::Upsert, &[50, 50]);
        rig.gather();
        rig.send_update(5, ObstacleAction::Remove, &[0, 0]);
        rig.gather();
        rig.gather_for(60);
        rig.send_update(4, ObstacleAction::Upsert, &[]);
        assert_eq!(rig.gather().obstacles.count(), 0);
        rig.gather_for(300);
        assert!(rig.gather().obstacle_source_silent, "{action:?}");
        rig.send_update(5, action, &[]);
        assert!(rig.gather().obstacle_source_silent, "{action:?}");
        rig.send_update(5, action, &[0, 0]);
        assert!(!rig.gather().obstacle_source_silent, "{action:?}");
    }
}

#[test]
fn a_source_whose_own_old_obstacles_take_all_the_room_is_heard() {
    let mut rig = Rig::new("[obstacles]\nsource_timeout_ms = 100.0\nsource_silent = \"keep\"\n");
    rig.send_update(4, ObstacleAction::Upsert, &[50; 64]);
    rig.gather();
    rig.gather_for(300);
    let inputs = rig.gather();
    assert_eq!(inputs.obstacles.count(), 64);
    assert!(
        !inputs.obstacle_source_silent,
        "they are kept, and the robot goes on"
    );
    rig.send_update(4, ObstacleAction::Upsert, &[]);
    rig.gather();
    assert_eq!(rig.gather().obstacles.count(), 0);
}

/// Senders are served in turn: an obstacle may wait longer than another sender's clear that was sent after
/// it.
#[test]
fn an_obstacle_that_was_sent_before_the_list_was_cleared_does_not_come_back() {
    let mut rig = Rig::new("");
    rig.gather();
    let waited = rig.update(4, ObstacleAction::Upsert, &[0]);
    rig.next_cycle += 1;
    rig.send_update(5, ObstacleAction::Clear, &[]);
    rig.obstacles.send_copy(waited).unwrap();
    assert_eq!(rig.gather().obstacles.count(), 0);
    assert_eq!(rig.counted(Outcome::Stale), 1);
    // A later update is accepted, and one without a time of sending.
    rig.send_update(4, ObstacleAction::Upsert, &[0]);
    assert_eq!(rig.gather().obstacles.count(), 1);
    let mut undated = rig.update(6, ObstacleAction::Upsert, &[0, 0]);
    undated.header.sent_ns = 0;
    rig.obstacles.send_copy(undated).unwrap();
    assert_eq!(rig.gather().obstacles.count(), 2);
}

#[test]
fn who_floods_obstacles_neither_keeps_another_out_nor_makes_a_gather_long() {
    let mut rig = Rig::new("");
    let mut crowd = rig.crowd(Service::Obstacles);
    std::mem::swap(&mut crowd[0], &mut rig.obstacles);
    // Accepted, or refused at the last of 64 obstacles, which costs most.
    let taken = |rig: &Rig| rig.update(9, ObstacleAction::Upsert, &[1_000; 8]);
    let refused = |rig: &Rig| {
        let mut update = rig.update(9, ObstacleAction::Upsert, &[1_000; 64]);
        update.obstacles[63].radius_m = -1.0;
        update
    };
    for message in [taken as fn(&Rig) -> _, refused] {
        for _ in 0..20 {
            flood(&crowd, Service::Obstacles, || message(&rig));
            rig.gather();
        }
        let mut mine = rig.update(4, ObstacleAction::Upsert, &[0]);
        mine.obstacles[0].id = 99;
        rig.obstacles.send_copy(mine).unwrap();
        let mut gathers = 0;
        while !rig
            .exchange
            .obstacles
            .known()
            .iter()
            .any(|known| known.id == 99)
        {
            flood(&crowd, Service::Obstacles, || message(&rig));
            let before: u64 = rig.exchange.events.outcomes().iter().sum();
            rig.gather();
            let evaluated = rig.exchange.events.outcomes().iter().sum::<u64>() - before;
            assert_eq!(evaluated, gather::UPDATES_PER_GATHER as u64);
            gathers += 1;
            // Two messages from each of eight senders are 16, and a round may have begun.
            assert!(gathers <= 4);
        }
        // Each outcome is reported.
        let reported = std::iter::from_fn(|| {
            let (events, count) = rig.exchange.events.report(u64::MAX);
            (count > 0).then_some(events)
        });
        assert!(reported.flatten().any(|event| event.sender_id == 4));
        rig.send_update(4, ObstacleAction::Clear, &[]);
        rig.gather_for(100);
    }
    // A gather with less time accepts fewer updates.
    assert_eq!(gather::updates_per_gather(200_000), 8);
    assert_eq!(gather::updates_per_gather(100_000), 4);
    assert_eq!(gather::updates_per_gather(20_000), 1);
}

#[test]
fn a_message_that_is_repeated_or_older_than_its_writers_last_is_refused() {
    let mut rig = Rig::new("");
    let older = rig.update(4, ObstacleAction::Upsert, &[0, 0]);
    let newer = rig.update(4, ObstacleAction::Upsert, &[0]);
    for update in [&newer, &newer, &older] {
        rig.obstacles.send_copy(*update).unwrap();
    }
    assert_eq!(rig.gather().obstacles.count(), 1);
    assert_eq!(rig.counted(Outcome::Stale), 2);
    assert_eq!(rig.exchange.obstacles.refused(), 2);
    // Messages from two writers of one client arrive in any order.
    let crowd = rig.crowd(Service::Obstacles);
    crowd[0].send_copy(older).unwrap();
    assert_eq!(rig.gather().obstacles.count(), 2);
    assert_eq!(rig.counted(Outcome::Stale), 2);
}

#[test]
fn the_first_gather_has_the_obstacles_without_a_lifetime_of_the_daemon_before() {
    let folder = Scratch::in_memory().unwrap();
    let begin = || {
        let mut rig = Rig::new("");
        let kept = KeptObstacles::open(&folder.path().join("a.obstacles")).unwrap();
        rig.exchange.obstacles.keep(kept);
        let first: ObstacleSet = rig.gather().obstacles.iter().copied().collect();
        (rig, first)
    };
    let (mut rig, first) = begin();
    assert_eq!(first.count(), 0);
    rig.send_update(4, ObstacleAction::Upsert, &[0, 50]);
    assert_eq!(rig.gather().obstacles.count(), 2);
    let known = *rig.exchange.obstacles.known();
    let (mut rig, first) = begin();
    let lasting = known.iter().filter(|known| known.expires_ns.is_none());
    assert!(first.count() == 1 && first.iter().eq(lasting), "{first:?}");
    rig.send_update(4, ObstacleAction::Clear, &[]);
    rig.gather();
    assert_eq!(begin().1.count(), 0);
}
