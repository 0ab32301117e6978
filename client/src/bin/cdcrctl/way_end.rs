//! Where the tip is at the end of `goto` and `jog`.

use std::io::Write;

use anyhow::bail;
use cdcr_shared_types::Telemetry;

use crate::standing::distance_m;

/// Prints the final distance to the point, estimated and, unless `fresh_ns` have passed since, measured; fails when
/// either exceeds `limit_m`. `unmeasured`: why the estimate is that of the model.
pub(crate) fn print(
    end: &Telemetry,
    unmeasured: Option<String>,
    fresh_ns: u64,
    goal_m: [f64; 3],
    limit_m: f64,
) -> anyhow::Result<()> {
    let estimated_m = distance_m(end.tip_position_m, goal_m);
    let (mut largest_m, mut by) = (estimated_m, String::new());
    if end.release_ns < end.tip_measured_ns + fresh_ns {
        let measured_m = distance_m(end.tip_measured_m, goal_m);
        largest_m = largest_m.max(measured_m);
        by = format!(" ({:.3} mm as measured)", 1e3 * measured_m);
    }
    if let Some(cause) = unmeasured {
        by = format!(" by the model{by}; {cause}");
    }
    let left = 1e3 * estimated_m;
    if largest_m > limit_m {
        let limit = 1e3 * limit_m;
        bail!("the tip is {left:.3} mm from the point{by}, more than --max-error, {limit:.3} mm");
    }
    writeln!(
        std::io::stdout(),
        "the tip is {left:.3} mm from the point{by}"
    )?;
    Ok(())
}

#[cfg(test)]
mod tests {
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
        let check = |end: &Telemetry, x_m: f64, limit_m: f64| {
            print(end, None, 100_000_000, [x_m, 0.0, 0.8], limit_m)
        };
        let text = check(&end, 0.1, 0.002).expect_err("measured beside");
        let text = text.to_string();
        assert!(
            text.contains("0.000 mm from the point (3.000 mm as measured)"),
            "{text}"
        );
        assert!(check(&end, 0.1, 0.004).is_ok());
        let cause = Some("the measured tip is not in use".to_owned());
        let text =
            print(&end, cause, 100_000_000, [0.1, 0.0, 0.8], 0.002).expect_err("measured beside");
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
}
