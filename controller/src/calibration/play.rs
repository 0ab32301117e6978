//! The play between motors, where encoders measure, and cables.

use super::CalibrationRow;
use crate::robot::CABLES_MAX;

/// Rows with the lengths of the cables, from rows that have those of their motors, in the order of measurement: a motor that reverses
/// takes its cable along after the play `play_m` (m).
///
/// Where a cable stands in its play is not known at first: rows are left out until every cable that moves by the play has done so. Noise
/// of the encoders takes part of the play for motion, of about its largest value.
pub fn behind_play(rows: &[CalibrationRow], play_m: f64) -> Vec<CalibrationRow> {
    let Some(first) = rows.first().filter(|_| play_m > 0.0) else {
        return rows.to_vec();
    };
    let mut cables_m = first.cable_length_m;
    let behind = rows.iter().map(|row| {
        for (cable_m, motor_m) in cables_m.iter_mut().zip(row.cable_length_m) {
            *cable_m = cable_m.clamp(motor_m - 0.5 * play_m, motor_m + 0.5 * play_m);
        }
        CalibrationRow {
            cable_length_m: cables_m,
            ..*row
        }
    });
    behind.collect::<Vec<_>>().split_off(unknown(rows, play_m))
}

/// Number of rows until each cable that ever moves by the play has moved by it.
fn unknown(rows: &[CalibrationRow], play_m: f64) -> usize {
    let until = |cable: usize| {
        let (mut least_m, mut most_m) = (f64::INFINITY, f64::NEG_INFINITY);
        rows.iter().position(|row| {
            let length_m = row.cable_length_m[cable];
            (least_m, most_m) = (least_m.min(length_m), most_m.max(length_m));
            most_m - least_m >= play_m
        })
    };
    let moving = (0..CABLES_MAX).filter_map(until);
    moving.max().unwrap_or(0)
}
