//! A tip that an obstacle or a pause kept from its reference returns to it at its pace.

use super::*;

const FROM_M: [f64; 3] = [0.1, 0.0, 0.8];
const LINE_M_S: [f64; 3] = [0.032, 0.0, -0.015];
const LINE_SPEED_M_S: f64 = 0.0353;
const PLAY: &str = "[actuator]\nplay_m = 1.5e-3\n";
const LAG: &str = "[actuator]\ndelay_ms = 5.0\ntime_constant_ms = 25.0\n";
/// Of speeds over ten cycles, with the noise of encoders.
const TOLERANCE: f64 = 1.05;

fn is_tracking(record: &CycleRecord) -> bool {
    matches!(record.mode, Mode::Tracking { .. })
}

/// The laboratory's robot, with noise, on its way along the line.
fn on_the_line(approach: &str, more: &str) -> Trial {
    let mut flaws = RobotPreset::Laboratory.flaws();
    if more == PLAY {
        flaws.actuator.play_m = 1.5e-3;
    }
    let more = format!("[motion]\napproach = \"{approach}\"\n{more}");
    let mut trial = Trial::with(Interface::Position, flaws, &more);
    trial.turns(100);
    // In steps that are near enough for every approach.
    for step in 0..=10 {
        let part = f64::from(step) / 10.0;
        trial.feed_line([0.1 * part, 0.0, 0.9 - 0.1 * part], [0.0; 3], 0.0);
        trial.ask(TRACK);
        trial.turns(200);
    }
    trial.feed_line(FROM_M, LINE_M_S, 0.0);
    let record = trial.turns(600);
    assert!(is_tracking(&record), "{:?}", record.mode);
    trial
}

/// Largest speed of the true tip over ten cycles \[m/s\], and its distance from the reference at the end \[m\].
fn fastest_and_error(trial: &mut Trial, count: u32) -> (f64, f64) {
    let tips_m: Vec<_> = (0..count)
        .map(|_| {
            assert!(is_tracking(&trial.turn()), "{:?}", trial.last().mode);
            trial.tip_m
        })
        .collect();
    let speeds = (tips_m.windows(11)).map(|tips| (tips[10] - tips[0]).norm() / (10.0 * PERIOD_S));
    let error_m = error_m(&trial.last());
    let fastest_m_s = speeds.fold(0.0, f64::max);
    println!("{fastest_m_s} m/s, {error_m} m");
    (fastest_m_s, error_m)
}

fn error_m(record: &CycleRecord) -> f64 {
    (record.tip.position_m - record.reference.position_m).norm()
}

#[test]
fn a_tip_returns_at_its_pace_when_the_obstacle_that_held_it_is_gone() {
    for more in ["", LAG, PLAY] {
        for approach in ["smooth", "direct"] {
            let mut trial = on_the_line(approach, more);
            trial.put_ball(Vector3::new(0.45, 0.0, 0.7), 0.2);
            let (held_m_s, away_m) = fastest_and_error(&mut trial, 700);
            let is_calm = held_m_s < 0.05 || approach == "direct";
            assert!(is_calm && away_m > 0.05, "{held_m_s} {away_m}");
            trial.inputs.obstacles.fill(core::iter::empty());
            let (fastest_m_s, error_m) = fastest_and_error(&mut trial, 650);
            let is_gentle = fastest_m_s < TOLERANCE * (APPROACH_M_S + LINE_SPEED_M_S);
            assert_eq!(is_gentle, approach == "smooth", "{fastest_m_s}");
            assert!(error_m < 1e-3, "{error_m}");
        }
    }
}

#[test]
fn a_tip_returns_at_its_pace_behind_an_obstacle_on_its_way() {
    let mut trial = Trial::with(Interface::Position, RobotPreset::Laboratory.flaws(), LAG);
    trial.turns(100);
    trial.put_ball(Vector3::new(0.0, 0.2, 0.837), 0.03);
    trial.begin_tracking();
    let mut lag_m = 0.0_f64;
    for _ in 0..10 {
        let (fastest_m_s, error_m) = fastest_and_error(&mut trial, 300);
        // The circle is joined in motion.
        assert!(fastest_m_s < 1.52 * 0.3 + APPROACH_M_S, "{fastest_m_s}");
        lag_m = lag_m.max(error_m);
    }
    // It goes round, whenever it meets the ball.
    let error_m = error_m(&trial.last());
    assert!(lag_m < 0.1 && error_m < 1e-3, "{lag_m} {error_m}");
}

#[test]
fn a_tip_returns_at_its_pace_after_a_pause() {
    for approach in ["smooth", "direct"] {
        let mut trial = on_the_line(approach, "[cycle]\nmiss_limit = 1000\n");
        trial.late_turn(60);
        assert!(error_m(&trial.last()) > 5e-3);
        let (fastest_m_s, error_m) = fastest_and_error(&mut trial, 400);
        let is_gentle = fastest_m_s < TOLERANCE * (APPROACH_M_S + LINE_SPEED_M_S);
        assert_eq!(is_gentle, approach == "smooth", "{fastest_m_s}");
        assert!(error_m < 1e-3, "{error_m}");
    }
}

/// One sample has no speed of its own: the one of the cycle before counts.
#[test]
fn a_horizon_of_one_step_follows_a_fast_reference() {
    let more = "[controller]\nhorizon_steps = 1\n";
    let mut trial = Trial::with(Interface::Position, RobotPreset::Laboratory.flaws(), more);
    trial.turns(100);
    trial.begin_tracking();
    trial.turns(1200);
    let error_m = error_m(&trial.last());
    assert!(error_m < 2e-3, "{error_m}");
}
