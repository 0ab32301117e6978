//! A reference that leads the tip into the robot's own base, sent as it is.

use cdcr_controller::plant::RobotPreset;
use cdcr_controller::robot::Configuration;

use super::super::DIRECT;
use super::super::trial::{TRACK, Trial};
use crate::config::Interface;

/// What a robot did whose reference led into its base and out again.
#[derive(Debug)]
struct Seen {
    /// Deepest overlap of the true body \[m\].
    deepest_m: f64,
    /// Cycles in which the rule changed the command.
    guarded: u32,
    /// Distance by which the true body may be nearer to itself than the commanded one: by its bends beside the commanded ones \[m\].
    beside_m: f64,
    /// Overlap at the end, and distance of the tip from its reference \[m\].
    left_m: f64,
    error_m: f64,
}

fn into_the_base(interface: Interface, overlap_max_m: f64) -> Seen {
    let more = format!("{DIRECT}[robot]\nself_overlap_max_m = {overlap_max_m}\n");
    let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), &more);
    trial.turns(3);
    let mut seen = Seen {
        deepest_m: 0.0,
        guarded: 0,
        beside_m: 0.0,
        left_m: 0.0,
        error_m: 0.0,
    };
    let mut follow = |trial: &mut Trial, turns: u32| {
        for _ in 0..turns {
            let record = trial.turn();
            let (truth, at) = (trial.plant.truth(), trial.plant.configuration());
            let contact = truth.self_contact(&at, 0.0);
            seen.left_m = contact.map_or(0.0, |contact| contact.overlap_m);
            if seen.left_m > seen.deepest_m {
                seen.deepest_m = seen.left_m;
                let target = Configuration::from_slice(&trial.target_rad).unwrap();
                let mut off_rad = [0.0; 6];
                for (j, off_rad) in off_rad.iter_mut().enumerate() {
                    let ([u, v], [to_u, to_v]) = (at.section(j), target.section(j));
                    *off_rad = (u - to_u).hypot(v - to_v);
                }
                let travel_m = truth.travel_m(&off_rad);
                seen.beside_m = travel_m[truth.section_count() - 1];
            }
            seen.guarded += u32::from(record.limits_hit.self_contact);
            seen.error_m = (record.tip.position_m - record.reference.position_m).norm();
        }
    };
    trial.feed_line([0.3, 0.0, 0.3], [-0.06, 0.0, -0.056], 0.0);
    trial.ask(TRACK);
    follow(&mut trial, 1000);
    trial.feed_line([0.05, 0.0, 0.05], [0.06, 0.0, 0.07], 0.0);
    follow(&mut trial, 800);
    seen
}

/// Without the rule the tip goes deep into the first section. With it the commanded body overlaps by 2 mm at most, and the true one by
/// the motion between them more: by motors that lag, hang back and are measured beside. It comes free with the reference.
#[test]
fn a_reference_into_the_base_leads_the_body_no_deeper_than_allowed() {
    const ALLOWED_M: f64 = 0.002;
    for interface in [Interface::Position, Interface::Velocity] {
        let (free, kept) = (
            into_the_base(interface, 1.0),
            into_the_base(interface, ALLOWED_M),
        );
        println!("{interface:?}: {free:?}, with the rule {kept:?}");
        assert!(free.deepest_m > 0.02 && free.guarded == 0);
        assert!(kept.deepest_m <= ALLOWED_M + kept.beside_m);
        assert!(kept.deepest_m < 0.2 * free.deepest_m && kept.guarded > 50);
        assert!(kept.left_m == 0.0 && kept.error_m < 1e-3);
    }
}
