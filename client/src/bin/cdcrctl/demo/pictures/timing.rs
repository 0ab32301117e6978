use std::path::Path;

use cdcr_chart::{BLUE, Curve, DARK, GREEN, ORANGE, Panel, Point, Scale};
use cdcr_client::counted;

use super::write;
use crate::demo::cycle::Cycle;
use crate::demo::report::DemoReport;
use crate::spread::Spread;

/// Bars per decade.
const BARS_PER_DECADE: f64 = 10.0;
/// Smaller times are counted here, because the axis is logarithmic \[µs\].
const FLOOR_US: f64 = 0.1;
/// Lower end of the count axis: below 1, so that a single cycle has a bar.
const LEAST: f64 = 0.7;

/// Draws the histograms of the three latencies on one time scale.
pub(in crate::demo) fn timing(
    file: &Path,
    cycles: &[Cycle],
    report: &DemoReport,
    deadline_us: f64,
) -> anyhow::Result<()> {
    let panel = |title: &str, value_us: fn(&Cycle) -> f64, spread: &Spread, colour| {
        let Spread { p50, p99, max } = spread;
        let label = format!("p50 {p50:.1} µs, p99 {p99:.1} µs, max {max:.1} µs");
        let bars = Curve::bars(label, bars(cycles.iter().map(value_us)), colour);
        let axes = ["time [µs], in the first bar 0.1 and less", "cycles"];
        Panel::new(title, axes, Scale::LogLog { floor: LEAST }, vec![bars])
    };
    let title = format!(
        "Timing of {}, simulated, {}: wake-up, from the due release to the start",
        counted(report.cycles, "cycle"),
        counted(report.sections, "section")
    );
    let wake = panel(&title, |cycle| cycle.wake_us, &report.wake_us, BLUE);
    let solve = panel("solve", |cycle| cycle.solve_us, &report.solve_us, GREEN);
    let title = "response: due release to command";
    let response = |cycle: &Cycle| cycle.response_us;
    let mut response = panel(title, response, &report.response_us, ORANGE);
    let line = vec![(deadline_us, LEAST), (deadline_us, cycles.len() as f64)];
    let deadline = Curve::line(format!("deadline, {deadline_us} µs"), line, DARK);
    response.curves.push(deadline);
    write(file, (1, 500), &[wake, solve, response])
}

/// Non-empty bars of equal width on the logarithmic axis: both ends \[µs\], each with the count.
fn bars(values_us: impl Iterator<Item = f64>) -> Vec<[Point; 2]> {
    // Integer powers are exact.
    let edge_us = |index: usize| 10_f64.powf(index as f64 / BARS_PER_DECADE - 1.0);
    let mut counts: Vec<f64> = Vec::new();
    for value_us in values_us {
        let index = (BARS_PER_DECADE * (value_us.max(FLOOR_US) / FLOOR_US).log10()) as usize;
        counts.resize(counts.len().max(index + 1), 0.0);
        counts[index] += 1.0;
    }
    let bars = counts.into_iter().enumerate();
    let bars = bars.filter(|(_, count)| *count > 0.0);
    bars.map(|(index, count)| [index, index + 1].map(|end| (edge_us(end), count)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_one_bar() {
        let bars = bars([0.0, 1.0, 9.999, 10.0, 5000.0].into_iter());
        let all: f64 = bars.iter().map(|[(_, count), _]| count).sum();
        assert!((all - 5.0).abs() < 1e-12);
        let [(first_us, _), _] = bars[0];
        assert!((first_us - FLOOR_US).abs() < 1e-12);
        let holds = |[(from, _), (to, _)]: &[Point; 2]| (*from..*to).contains(&5000.0);
        assert!(bars.iter().any(holds));
    }
}
