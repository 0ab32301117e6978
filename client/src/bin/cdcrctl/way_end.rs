//! Where the tip is at the end of `goto` and `jog`.

use std::io::Write;

use anyhow::bail;
use cdcr_shared_types::Telemetry;

use crate::bend_limit::WAY_OUT;
use crate::standing::distance_m;
use crate::tip_error::TipError;

/// Prints the final distance to the point, estimated and, while it is fresh, measured; fails when either exceeds `limit_m`,
/// and names the bend limit at which the way ended. `unmeasured`: why the estimate is that of the model, unless that is a stray
/// measurement. `way` has taken the records up to `end`.
pub(crate) fn print(
    end: &Telemetry,
    unmeasured: Option<String>,
    way: &TipError,
    goal_m: [f64; 3],
    limit_m: f64,
) -> anyhow::Result<()> {
    let estimated_m = distance_m(end.tip_position_m, goal_m);
    let (mut largest_m, mut by) = (estimated_m, String::new());
    let mut cause = unmeasured;
    if let Some((measured_ns, tip_m, is_fresh)) = way.measured_tip(end) {
        if is_fresh {
            let measured_m = distance_m(tip_m, goal_m);
            largest_m = largest_m.max(measured_m);
            by = format!(" ({:.3} mm as measured)", 1e3 * measured_m);
        }
        if !way.is_by_model(end) {
            cause = None;
            // A late camera, or lost pictures: it does not show the end yet.
            if !is_fresh {
                let age_s = end.release_ns.saturating_sub(measured_ns) as f64 * 1e-9;
                by = format!("; the tip was measured last {age_s:.2} s before");
            }
        }
    }
    if let Some(cause) = cause {
        by = format!(" by the model{by}; {cause}");
    }
    if let Some(strays) = way.strays_text() {
        by = format!("{by}; {strays}");
    }
    let left = 1e3 * estimated_m;
    if largest_m > limit_m {
        let limit = 1e3 * limit_m;
        let held_back = way.at_limit().map(|bend| format!(": {bend}; {WAY_OUT}"));
        bail!(
            "the tip is {left:.3} mm from the point{by}, more than --max-error, {limit:.3} mm{}",
            held_back.unwrap_or_default()
        );
    }
    writeln!(
        std::io::stdout(),
        "the tip is {left:.3} mm from the point{by}"
    )?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::{Mode, ReferenceState, TipCause};

    use super::*;

    #[test]
    fn the_end_of_a_way_is_where_the_estimate_and_the_sensor_say() {
        let mut end = Telemetry {
            release_ns: 1_000_000_000,
            tip_position_m: [0.1, 0.0, 0.8],
            tip_measured_m: [0.103, 0.0, 0.8],
            tip_measured_ns: 995_000_000,
            ..Telemetry::default()
        };
        let taken = |end: &Telemetry| {
            let mut way = TipError::default();
            way.take(end);
            way
        };
        let check = |end: &Telemetry, x_m: f64, limit_m: f64| {
            print(end, None, &taken(end), [x_m, 0.0, 0.8], limit_m)
        };
        let text = check(&end, 0.1, 0.002).expect_err("measured beside");
        let text = text.to_string();
        assert!(
            text.contains("0.000 mm from the point (3.000 mm as measured)"),
            "{text}"
        );
        assert!(check(&end, 0.1, 0.004).is_ok());
        let cause = Some("the measured tip is not in use".to_owned());
        end.tip_cause = TipCause::Frozen.code();
        let text =
            print(&end, cause, &taken(&end), [0.1, 0.0, 0.8], 0.002).expect_err("measured beside");
        let text = text.to_string();
        assert!(
            text.contains("0.000 mm from the point by the model (3.000 mm as measured); the measured tip is not in use, more"),
            "{text}"
        );
        // A silent sensor does not decide about the end; the estimate does.
        end.tip_measured_ns = 800_000_000;
        assert!(check(&end, 0.1, 0.002).is_ok());
        assert!(check(&end, 0.103, 0.002).is_err());
    }

    /// The last of the measurements may be a stray one, or be lost.
    #[test]
    fn a_stray_tip_does_not_decide_the_end_of_a_way() {
        let mut end = Telemetry {
            tip_position_m: [0.1, 0.0, 0.8],
            measurement_jump_limit: 3,
            mode: Mode::Tracking.code(),
            ..Telemetry::default()
        };
        end.reference.state = ReferenceState::Inside.code();
        let mut way = TipError::default();
        for (frame, x_m, cause) in [(1, 0.1005, TipCause::None), (2, 0.25, TipCause::Jumps)] {
            end.tip_measured_ns = 1_000_000_000 + frame * 33_000_000;
            end.release_ns = end.tip_measured_ns + 5_000_000;
            (end.tip_measured_m, end.tip_cause) = ([x_m, 0.0, 0.8], cause.code());
            way.take(&end);
        }
        let text = |end: &Telemetry| {
            let cause = Some("the measured tip is not in use".to_owned());
            let failed = print(end, cause, &way, [0.104, 0.0, 0.8], 0.003);
            failed.expect_err("by 4 mm").to_string()
        };
        let found = text(&end);
        let (measured, strays) = (
            "the tip is 4.000 mm from the point (3.500 mm as measured); ",
            "1 stray measurement of the tip refused and left out, more",
        );
        assert!(found.starts_with(&format!("{measured}{strays}")), "{found}");
        end.release_ns += 95_000_000;
        let found = text(&end);
        assert!(
            found.contains("from the point; the tip was measured last 0.13 s before; 1 stray"),
            "{found}"
        );
    }

    #[test]
    fn a_way_that_ends_at_a_bend_limit_names_it_and_the_way_out() {
        let mut end = Telemetry {
            release_ns: 1_000_000_000,
            mode: Mode::Tracking.code(),
            tip_position_m: [0.1, 0.0, 0.25],
            ..Telemetry::default()
        };
        end.reference.state = ReferenceState::Inside.code();
        end.robot.sections = 1;
        (end.robot.cable_speed_max_m_s, end.robot.cable_stroke_max_m) = (1.0, 0.2);
        let section = &mut end.robot.section[0];
        (section.length_m, section.cable_radius_m) = (0.3, 0.02);
        (section.bend_max_rad, section.rate_max_rad_s) = (2.0, 4.0);
        let mut text_at = |bend_rad: f64| {
            end.bend_rad[0] = bend_rad;
            let mut way = TipError::default();
            way.take(&end);
            print(&end, None, &way, [0.109, 0.0, 0.25], 0.002)
                .expect_err("beside")
                .to_string()
        };
        let text = text_at(2.0);
        for part in [
            "9.000 mm from the point, more than --max-error, 2.000 mm: section 1 is at its bend limit, robot.sections[0].bend_max_rad = 2; in another shape",
            "cdcrctl home, then this again",
        ] {
            assert!(text.contains(part), "{text}");
        }
        assert!(!text_at(1.5).contains("limit,"), "not at a limit");
    }
}
