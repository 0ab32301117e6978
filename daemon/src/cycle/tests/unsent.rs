use super::trial::{PERIOD_S, Trial};
use super::{DIRECT, MOST_RAD_S2, bits};
use crate::config::Interface;
use cdcr_controller::plant::RobotPreset;
use cdcr_controller::robot::Configuration;

const BOTH: [Interface; 2] = [Interface::Position, Interface::Velocity];
/// By then the ramp is over, and the leaky bucket, which counts stale inputs, is not yet full.
const HELD_UP: usize = 35;
/// A command is valid for twenty periods: many are computed before the inputs are stale.
const LONG: &str = "command_valid_ms = 100.0\n";

fn largest_apart(a: &Configuration, b: &Configuration) -> f64 {
    let pairs = a.as_slice().iter().zip(b.as_slice());
    pairs.fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

/// Tracks, then stalls the exchange for `cycles`. Returns the motion of the commands that were not sent
/// \[rad\].
fn hold_up(trial: &mut Trial, cycles: usize) -> f64 {
    trial.turns(3);
    trial.begin_tracking();
    trial.turns(300);
    trial.is_held_up = true;
    let mut way_rad = [0.0; 6];
    for _ in 0..cycles {
        let record = trial.cycle(0);
        for (way, rate) in way_rad.iter_mut().zip(record.rates.as_slice()) {
            *way += rate * PERIOD_S;
        }
    }
    trial.is_held_up = false;
    way_rad.iter().fold(0.0, |most, way| most.max(way.abs()))
}

/// The last command sent remains the commanded position, however many were computed since. When the exchange
/// continues, a robot with the position interface does not move.
#[test]
fn commands_that_did_not_leave_move_no_position() {
    for cycles in [2, 5, 21, 25, HELD_UP] {
        let mut trial = Trial::with(Interface::Position, RobotPreset::Laboratory.flaws(), LONG);
        hold_up(&mut trial, cycles);
        let sent = trial.sent.unwrap();
        // The newest command is sent before the next gather.
        let newest = trial.last().rates;
        for (i, rate) in newest.as_slice().iter().enumerate() {
            let moved_rad = sent.bend_target_rad[i] + PERIOD_S * rate;
            assert_eq!(trial.target_rad[i].to_bits(), moved_rad.to_bits());
        }
        let target_rad = bits(&trial.target_rad);
        trial.turns(20);
        if cycles == HELD_UP {
            assert_eq!(bits(&trial.target_rad), target_rad);
        }
    }
}

/// The model matches the robot: it executed only the last command sent, until that expired.
#[test]
fn the_model_knows_of_commands_that_did_not_leave() {
    for interface in BOTH {
        let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), LONG);
        let way_rad = hold_up(&mut trial, HELD_UP);
        let reported = trial.last();
        let beside_rad = largest_apart(&reported.present, &trial.at_release);
        println!("{interface:?}: {beside_rad:.4} rad beside, {way_rad:.4} rad were not sent");
        assert!(way_rad > 0.01, "{way_rad}");
        // Zero and droop of the laboratory's robot are 0.1 mm each, 0.008 rad.
        assert!(beside_rad < 0.02, "{interface:?}: {beside_rad}");
        let first = trial.turn();
        assert!(first.following.largest_rad() < 0.02 + 0.2 * way_rad);
        assert!(largest_apart(&first.configuration, &reported.configuration) < 0.005);
        // Tracking then continues normally.
        trial.begin_tracking();
        assert!(trial.turns(200).following.largest_rad() < 0.1);
    }
}

/// A late gather alone changes nothing: its command was sent.
#[test]
fn a_late_gather_takes_no_command_back() {
    let mut trial = Trial::new(Interface::Position);
    trial.turns(3);
    trial.begin_tracking();
    trial.turns(100);
    for _ in 0..3 {
        let before = trial.target_rad.clone();
        let record = trial.cycle(0);
        for (i, rate) in record.rates.as_slice().iter().enumerate() {
            let moved = before[i] + PERIOD_S * rate;
            assert_eq!(trial.target_rad[i].to_bits(), moved.to_bits());
        }
        trial.turn();
    }
}

/// However long the exchange is held up, the command that leaves then is caught up without a jump: motors that
/// obey positions grow from where they stand, inside the acceleration.
#[test]
fn a_set_point_that_was_held_up_is_not_caught_up_in_a_jump() {
    for (valid, cycles) in [("", 1..5), (LONG, 1..15)] {
        for cycles in cycles {
            let more = format!("{valid}{DIRECT}");
            let mut trial =
                Trial::with(Interface::Position, RobotPreset::Laboratory.flaws(), &more);
            trial.turns(3);
            trial.begin_tracking();
            let fastest = |trial: &Trial, from: &[f64]| {
                let pairs = trial.target_rad.iter().zip(from);
                pairs.fold(0.0, |most: f64, (to, from)| most.max((to - from).abs())) / PERIOD_S
            };
            let rate_rad_s = {
                trial.turns(11);
                let before = trial.target_rad.clone();
                trial.turn();
                fastest(&trial, &before)
            };
            assert!(rate_rad_s > 1.5, "{rate_rad_s}");
            let stands_at = trial.target_rad.clone();
            trial.is_held_up = true;
            for _ in 0..cycles {
                trial.cycle(0);
            }
            // One missed period goes on; after that the set point has stood.
            let most_rad_s = match cycles {
                1 => rate_rad_s + MOST_RAD_S2 * PERIOD_S,
                _ => MOST_RAD_S2 * PERIOD_S,
            };
            let led_rad_s = fastest(&trial, &stands_at);
            assert!(
                led_rad_s < most_rad_s + 1e-9,
                "{valid}{cycles}: {led_rad_s} rad/s"
            );
        }
    }
}
