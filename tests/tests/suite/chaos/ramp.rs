//! Invariant: a robot that must rest slows down at the deceleration and never accelerates again.

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{Interface, MeasurementState, Mode, guard, timing};
use cdcr_shared_types::limits::COORDINATES_MAX;
use cdcr_tests::record::largest;

use crate::chaos::integral::runs_out_in_cycle;
use crate::chaos::{CheckResult, ensure};

/// Rounding error of a rate \[rad/s\].
const TOLERANCE_RAD_S: f64 = 1e-9;

/// Checks the rates of a record that holds, is stopped, faulted or starting against the previous rates: all
/// shrink by one factor, the fastest by deceleration · period. Clearance guard and limits may reduce them
/// further; no component grows.
pub(crate) fn check(record: &Telemetry, period_s: f64) -> CheckResult {
    let mode = Mode::try_from(record.mode).map_err(|unknown| unknown.to_string())?;
    let runs_out = runs_out_in_cycle(record, record.solve_end_ns);
    ensure(runs_out == (record.ran_out_in_solve != 0), || {
        format!("the last command runs out by the end of the solve: {runs_out}")
    })?;
    let moves = record.moves_to_begin != 0;
    ensure(!moves || may_move_to_begin(record), || {
        format!("{mode}: the commanded position moves to where control begins")
    })?;
    if moves || matches!(mode, Mode::Tracking | Mode::Homing) {
        return Ok(());
    }
    let previous = if runs_out {
        [0.0; COORDINATES_MAX]
    } else {
        record.previous_rate_rad_s
    };
    let fastest = largest(&previous);
    let left = (fastest - record.deceleration_rad_s2 * period_s).max(0.0);
    let shrink = if fastest > 0.0 { left / fastest } else { 0.0 };
    let ramp = previous.map(|rate| rate * shrink);
    let rates = &record.command.bend_rate_rad_s;
    ensure(fastest > 0.0 || largest(rates) == 0.0, || {
        format!("{mode}: at rest, and the rates are {rates:?}")
    })?;
    if record.guard_flags == 0 {
        let apart = core::array::from_fn::<f64, 12, _>(|i| rates[i] - ramp[i]);
        return ensure(largest(&apart) <= TOLERANCE_RAD_S, || {
            format!("{mode}: the rates are {rates:?}, and the ramp is at {ramp:?}")
        });
    }
    let is_shorter =
        |i: usize| rates[i].abs() <= ramp[i].abs() + TOLERANCE_RAD_S && rates[i] * ramp[i] >= 0.0;
    ensure((0..rates.len()).all(is_shorter), || {
        format!("{mode}: the rates {rates:?} are beyond the ramp, {ramp:?}")
    })
}

/// Whether the commanded position may be on its way to the robot, where control begins.
fn may_move_to_begin(record: &Telemetry) -> bool {
    record.mode == Mode::Holding.code()
        && record.control_begins != 0
        && record.command.interface == Interface::Position.code()
}

/// Whether a record is the first with a known robot, where control begins.
pub(crate) fn is_first_measurement(before: &Telemetry, record: &Telemetry) -> bool {
    before.measurement_state == MeasurementState::None.code()
        && record.measurement_state == MeasurementState::Used.code()
}

/// Whether control may restart in a record: a latched mode was left, and the robot has not come to rest
/// since.
pub(crate) fn control_may_begin(before: &Telemetry, record: &Telemetry) -> bool {
    let is_latched = |record: &Telemetry| Mode::is_latched(record.mode);
    !is_latched(record) && (is_latched(before) || record.control_begins != 0)
}

/// Checks that a robot at rest in both records is commanded to stay at its position, to the bit.
pub(crate) fn check_rest(before: &Telemetry, record: &Telemetry) -> CheckResult {
    let rests = |record: &Telemetry, last_rad_s: &[f64]| {
        let moves_on = [Mode::Tracking, Mode::Homing].map(Mode::code);
        !moves_on.contains(&record.mode) && largest(last_rad_s) == 0.0
    };
    // Meanwhile the position may return to where the last command that left led; `Integral` checks it.
    let is_stale = record.timing_flags & timing::STALE_INPUTS != 0;
    let (last, now) = (&before.previous_rate_rad_s, &before.command.bend_rate_rad_s);
    let begins = is_first_measurement(before, record) || control_may_begin(before, record);
    if begins || is_stale || !rests(before, last) || !rests(record, now) {
        return Ok(());
    }
    let bits = |record: &Telemetry| record.commanded_rad.map(f64::to_bits);
    ensure(bits(before) == bits(record), || {
        format!(
            "at rest the commanded position goes from {:?} to {:?}",
            before.commanded_rad, record.commanded_rad
        )
    })
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::Reason;

    use super::*;

    #[test]
    fn a_commanded_position_that_creeps_is_found() {
        let mut before = Telemetry {
            mode: Mode::Holding.code(),
            measurement_state: MeasurementState::Used.code(),
            ..Telemetry::default()
        };
        let mut record = before;
        assert_eq!(check_rest(&before, &record), Ok(()));
        record.commanded_rad[3] = 1e-300;
        assert!(check_rest(&before, &record).is_err());
        // For any new mode: it holds for another reason, or is latched.
        record.reason = Reason::InputsStale.code();
        assert!(check_rest(&before, &record).is_err());
        record.mode = Mode::Stopped.code();
        assert!(check_rest(&before, &record).is_err());
        // After a latched mode control restarts, at once or when the motors have arrived.
        (before.mode, record.mode) = (Mode::Stopped.code(), Mode::Holding.code());
        assert_eq!(check_rest(&before, &record), Ok(()));
        before.mode = Mode::Holding.code();
        assert!(check_rest(&before, &record).is_err());
        record.control_begins = 1;
        assert_eq!(check_rest(&before, &record), Ok(()));
        // Allowed at the first measurement, and during a move.
        record.control_begins = 0;
        before.measurement_state = MeasurementState::None.code();
        assert_eq!(check_rest(&before, &record), Ok(()));
        before.measurement_state = MeasurementState::Used.code();
        before.previous_rate_rad_s[0] = 0.1;
        assert_eq!(check_rest(&before, &record), Ok(()));
    }

    #[test]
    fn only_the_ramp_is_allowed() {
        let mut record = Telemetry {
            mode: Mode::Stopped.code(),
            deceleration_rad_s2: 20.0,
            ..Telemetry::default()
        };
        record.previous_rate_rad_s[..2].copy_from_slice(&[1.0, -0.5]);
        for (rates, holds, shortened) in [
            ([0.9, -0.45], true, true),
            ([0.8, -0.40], false, true),
            ([0.9, -0.46], false, false),
            ([1.0, -0.5], false, false),
            ([0.0, 0.0], false, true),
        ] {
            record.command.bend_rate_rad_s[..2].copy_from_slice(&rates);
            record.guard_flags = 0;
            assert_eq!(check(&record, 0.005).is_ok(), holds, "{rates:?}");
            for flag in [guard::CLEARANCE, guard::BEND] {
                record.guard_flags = flag;
                assert_eq!(check(&record, 0.005).is_ok(), shortened, "{rates:?}");
            }
        }
        // From rest, not even rounding causes a motion.
        record.previous_rate_rad_s = [0.0; 12];
        record.command.bend_rate_rad_s = [0.0; 12];
        assert_eq!(check(&record, 0.005), Ok(()));
        record.command.bend_rate_rad_s[0] = 1e-300;
        assert!(check(&record, 0.005).is_err());
        record.mode = Mode::Tracking.code();
        record.command.bend_rate_rad_s[0] = 2.0;
        assert_eq!(check(&record, 0.005), Ok(()));
    }
}
