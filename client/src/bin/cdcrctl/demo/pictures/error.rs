use std::path::Path;

use cdcr_client::counted;
use plotters::prelude::*;

use super::{BLUE, GREEN, GREY, LABEL, ORANGE, PALE, PURPLE, TICK, TITLE};
use crate::demo::cycle::Cycle;
use crate::demo::report::DemoReport;

/// Errors below this are drawn here: a logarithm knows no zero \[mm\].
const FLOOR_MM: f64 = 1e-13;
/// Length of the dash that stands for one lone cycle \[s\].
const DASH_S: f64 = 0.001;

/// A point of the curve: time \[s\] and error \[mm\].
type Point = (f64, f64);

/// Draws the tracking error over time, beside its mean and the paper's. The line breaks where cycles are
/// missing; skipped periods have a mark.
pub(in crate::demo) fn error(
    file: &Path,
    cycles: &[Cycle],
    report: &DemoReport,
) -> anyhow::Result<()> {
    let errors: Vec<Point> = cycles.iter().map(point).collect();
    let mean = report.mean_error_mm.max(FLOOR_MM);
    let paper = report.paper_mean_error_mm;
    let range_mm = decades(&errors, &[mean, paper]);
    let root = SVGBackend::new(file, (1000, 520)).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "Tracking error: simulated spiral of Eq. 8, {}",
        counted(report.sections, "section")
    );
    let mut chart = ChartBuilder::on(&root)
        .caption(title, TITLE)
        .margin(15)
        .x_label_area_size(50)
        .y_label_area_size(85)
        .build_cartesian_2d(0.0..report.duration_s, range_mm.clone().log_scale())?;
    chart
        .configure_mesh()
        .x_desc("time [s]")
        .y_desc("error [mm]")
        .axis_desc_style(LABEL)
        .label_style(TICK)
        .x_labels(11)
        .y_labels(12)
        .y_label_formatter(&|error| format!("{error:.0e}"))
        .bold_line_style(PALE)
        .light_line_style(TRANSPARENT)
        .draw()?;
    let level = |error: f64| [(0.0, error), (report.duration_s, error)];
    for (label, lines, style) in [
        (
            format!("tip to exact curve (max {:.1e} mm)", report.max_error_mm),
            pieces(cycles),
            BLUE.stroke_width(2),
        ),
        (
            format!("mean {:.1e} mm", report.mean_error_mm),
            vec![level(mean).to_vec()],
            ORANGE.stroke_width(1),
        ),
        (
            format!("paper's mean {paper:.0e} mm"),
            vec![level(paper).to_vec()],
            GREEN.stroke_width(2),
        ),
    ] {
        chart
            .draw_series(lines.into_iter().map(|line| PathElement::new(line, style)))?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 25, y)], style));
    }
    let marks = skips_s(cycles);
    if !marks.is_empty() {
        // In the decade below all curves.
        let tick = |time_s: f64| [(time_s, range_mm.start), (time_s, 5.0 * range_mm.start)];
        let style = PURPLE.stroke_width(2);
        chart
            .draw_series(marks.iter().map(|&s| PathElement::new(tick(s), style)))?
            .label(format!("skipped periods ({})", report.skipped_periods))
            .legend(move |(x, y)| PathElement::new([(x + 12, y - 6), (x + 12, y + 6)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font(TICK)
        .background_style(WHITE.mix(0.9))
        .border_style(GREY)
        .draw()?;
    root.present()?;
    Ok(())
}

fn point(cycle: &Cycle) -> Point {
    (cycle.time_s, (1e3 * cycle.error_m).max(FLOOR_MM))
}

/// The curve, cut where the numbers of the cycles do not follow each other. A lone cycle
/// is a short dash.
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

/// Times \[s\] of the skipped periods: the middle of each gap.
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

/// Whole decades around everything that is drawn, with room below, and above for the legend.
fn decades(errors: &[Point], levels: &[f64]) -> std::ops::Range<f64> {
    let all = || errors.iter().map(|e| e.1).chain(levels.iter().copied());
    let least = all().fold(f64::INFINITY, f64::min);
    let most = all().fold(FLOOR_MM, f64::max);
    10_f64.powf(least.log10().floor() - 1.0)..10_f64.powf(most.log10().ceil() + 2.0)
}
