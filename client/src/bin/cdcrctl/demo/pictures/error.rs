use std::path::Path;

use cdcr_chart::{BLUE, Curve, GREEN, ORANGE, PURPLE, Panel, Point, Scale};
use cdcr_client::counted;

use super::write;
use crate::demo::cycle::Cycle;
use crate::demo::report::DemoReport;

/// Smaller errors are drawn here, because the axis is logarithmic \[mm\]. The marks of skipped periods are a
/// decade below.
const FLOOR_MM: f64 = 1e-13;
/// Length of the dash for an isolated cycle \[s\].
const DASH_S: f64 = 0.001;

/// Draws the tracking error over time, with its mean and the paper's. The line is interrupted at missing
/// cycles; skipped periods are marked.
pub(in crate::demo) fn error(
    file: &Path,
    cycles: &[Cycle],
    report: &DemoReport,
) -> anyhow::Result<()> {
    let level =
        |label, error_mm, colour| Curve::level(label, error_mm, 0.0..report.duration_s, colour);
    let (mean_mm, paper_mm) = (report.mean_error_mm, report.paper_mean_error_mm);
    let tip = format!("tip to exact curve (max {:.1e} mm)", report.max_error_mm);
    let mut curves = vec![
        Curve::pieces(tip, pieces(cycles), BLUE).width(3),
        level(format!("mean {mean_mm:.1e} mm"), mean_mm, ORANGE),
        level(format!("paper's mean {paper_mm:.0e} mm"), paper_mm, GREEN),
    ];
    let skips_s = skips_s(cycles);
    if !skips_s.is_empty() {
        let errors_mm = cycles.iter().map(|cycle| point(cycle).1);
        let least_mm = errors_mm.fold(mean_mm.min(paper_mm).max(FLOOR_MM), f64::min);
        // In the decade below all curves.
        let below_mm = 10_f64.powf(least_mm.log10().floor() - 1.0);
        let tick = |time_s| vec![(time_s, below_mm), (time_s, 5.0 * below_mm)];
        let label = format!("skipped periods ({})", report.skipped_periods);
        let ticks = skips_s.into_iter().map(tick).collect();
        curves.push(Curve::pieces(label, ticks, PURPLE));
    }
    let sections = counted(report.sections, "section");
    let title = format!("Tracking error: simulated spiral of Eq. 8, {sections}");
    let floor = 0.1 * FLOOR_MM;
    let scale = Scale::Log { floor };
    let panel = Panel::new(title, ["time [s]", "error [mm]"], scale, curves);
    write(file, (1, 832), &[panel])
}

/// Time \[s\] and error \[mm\].
fn point(cycle: &Cycle) -> Point {
    (cycle.time_s, (1e3 * cycle.error_m).max(FLOOR_MM))
}

/// The curve, split where cycle numbers are not consecutive. An isolated cycle becomes a short dash.
fn pieces(cycles: &[Cycle]) -> Vec<Vec<Point>> {
    let runs = cycles.chunk_by(|a, b| b.number == a.number + 1);
    runs.map(|run| {
        let mut line: Vec<Point> = run.iter().map(point).collect();
        if let [(time_s, error_mm)] = line[..] {
            line.push((time_s + DASH_S, error_mm));
        }
        line
    })
    .collect()
}

/// Times of the skipped periods: the middle of each gap \[s\].
fn skips_s(cycles: &[Cycle]) -> Vec<f64> {
    let before = std::iter::once(None).chain(cycles.iter().map(Some));
    let skips = before
        .zip(cycles)
        .filter(|(_, cycle)| cycle.skipped_periods > 0);
    skips
        .map(|(before, cycle)| {
            let from_s = before.map_or(cycle.time_s, |before| before.time_s);
            f64::midpoint(from_s, cycle.time_s)
        })
        .collect()
}
