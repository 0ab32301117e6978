use std::path::Path;

use plotters::prelude::*;

use super::{BLUE, GREEN, GREY, LABEL, ORANGE, PALE, TICK, TITLE, section_words};
use crate::demo::cycle::Cycle;
use crate::demo::report::Report;

/// Errors below this are drawn here: a logarithm knows no zero \[mm\].
const FLOOR_MM: f64 = 1e-13;

/// Draws the tracking error over time, beside its mean and the paper's.
pub(in crate::demo) fn error(file: &Path, cycles: &[Cycle], report: &Report) -> anyhow::Result<()> {
    let errors: Vec<(f64, f64)> = cycles
        .iter()
        .map(|cycle| (cycle.time_s, (1e3 * cycle.error_m).max(FLOOR_MM)))
        .collect();
    let mean = report.mean_error_mm.max(FLOOR_MM);
    let paper = report.paper_mean_error_mm;
    let root = SVGBackend::new(file, (1000, 520)).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "Tracking error: spiral of Eq. 8, {}",
        section_words(report.sections)
    );
    let mut chart = ChartBuilder::on(&root)
        .caption(title, TITLE)
        .margin(15)
        .x_label_area_size(50)
        .y_label_area_size(85)
        .build_cartesian_2d(
            0.0..report.duration_s,
            decades(&errors, &[mean, paper]).log_scale(),
        )?;
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
    for (label, points, style) in [
        (
            format!("tip to exact curve (max {:.1e} mm)", report.max_error_mm),
            errors,
            BLUE.stroke_width(2),
        ),
        (
            format!("mean {:.1e} mm", report.mean_error_mm),
            level(mean).to_vec(),
            ORANGE.stroke_width(1),
        ),
        (
            format!("paper's mean {paper:.0e} mm"),
            level(paper).to_vec(),
            GREEN.stroke_width(2),
        ),
    ] {
        chart
            .draw_series(LineSeries::new(points, style))?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 25, y)], style));
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

/// Whole decades around everything that is drawn, with room below, and above for the legend.
fn decades(errors: &[(f64, f64)], levels: &[f64]) -> std::ops::Range<f64> {
    let all = || errors.iter().map(|e| e.1).chain(levels.iter().copied());
    let least = all().fold(f64::INFINITY, f64::min);
    let most = all().fold(FLOOR_MM, f64::max);
    10_f64.powf(least.log10().floor() - 1.0)..10_f64.powf(most.log10().ceil() + 2.0)
}
