use std::ops::Range;
use std::path::Path;

use cdcr_client::{Spiral, Trajectory};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::{GREY, LABEL, ORANGE, PALE, TICK, TITLE, section_words};
use crate::demo::cycle::Cycle;
use crate::demo::report::Report;

const PANEL: (u32, u32) = (560, 520);
/// Title and legend.
const HEAD: u32 = 70;
const MARGIN: u32 = 15;
const LABEL_LEFT: u32 = 65;
const LABEL_BOTTOM: u32 = 50;
/// Room for the last tick label.
const MARGIN_RIGHT: u32 = 30;
/// Samples of the exact curve.
const CURVE_SAMPLES: u32 = 500;

/// One view of the path: names of the axes and points in mm.
struct View {
    axes: [&'static str; 2],
    reference: Vec<(f64, f64)>,
    tip: Vec<(f64, f64)>,
}

/// Draws the tip's path over the exact curve, from above and from the side, in equal scale.
pub(in crate::demo) fn path(
    file: &Path,
    cycles: &[Cycle],
    spiral: &Spiral,
    report: &Report,
) -> anyhow::Result<()> {
    let size = (2 * PANEL.0, PANEL.1 + HEAD);
    let root = SVGBackend::new(file, size).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "Path of the tip and reference: spiral of Eq. 8, {}",
        section_words(report.sections)
    );
    let (head, panels) = root.split_vertically(HEAD);
    head.titled(&title, TITLE)?;
    legend(&head)?;
    let (left, right) = panels.split_horizontally(PANEL.0);
    panel(&left, &view(cycles, spiral, (0, "x [mm]"), (1, "y [mm]")))?;
    panel(&right, &view(cycles, spiral, (0, "x [mm]"), (2, "z [mm]")))?;
    root.present()?;
    Ok(())
}

fn view(
    cycles: &[Cycle],
    spiral: &Spiral,
    (across, name_across): (usize, &'static str),
    (up, name_up): (usize, &'static str),
) -> View {
    let mm = |p: [f64; 3]| (1e3 * p[across], 1e3 * p[up]);
    let step_s = spiral.duration_s / f64::from(CURVE_SAMPLES);
    let exact = |k: u32| mm(spiral.position_m(f64::from(k) * step_s));
    View {
        axes: [name_across, name_up],
        reference: (0..=CURVE_SAMPLES).map(exact).collect(),
        tip: cycles.iter().map(|cycle| mm(cycle.tip_m)).collect(),
    }
}

fn panel(area: &DrawingArea<SVGBackend<'_>, Shift>, view: &View) -> anyhow::Result<()> {
    let (across, up) = equal_ranges(view);
    let mut chart = ChartBuilder::on(area)
        .margin(MARGIN)
        .margin_right(MARGIN_RIGHT)
        .x_label_area_size(LABEL_BOTTOM)
        .y_label_area_size(LABEL_LEFT)
        .build_cartesian_2d(across, up)?;
    chart
        .configure_mesh()
        .x_desc(view.axes[0])
        .y_desc(view.axes[1])
        .axis_desc_style(LABEL)
        .label_style(TICK)
        .x_labels(7)
        .y_labels(7)
        .x_label_formatter(&|mm| format!("{mm}"))
        .y_label_formatter(&|mm| format!("{mm}"))
        .bold_line_style(PALE)
        .light_line_style(TRANSPARENT)
        .draw()?;
    let start = view.tip.iter().copied().take(1);
    chart.draw_series(LineSeries::new(
        view.reference.iter().copied(),
        reference_style(),
    ))?;
    chart.draw_series(LineSeries::new(view.tip.iter().copied(), tip_style()))?;
    chart.draw_series(start.map(|point| Circle::new(point, 5, ORANGE.filled())))?;
    Ok(())
}

fn reference_style() -> ShapeStyle {
    GREY.stroke_width(6)
}

fn tip_style() -> ShapeStyle {
    ORANGE.stroke_width(2)
}

/// One legend for both panels, outside them: a curve may pass anywhere.
fn legend(head: &DrawingArea<SVGBackend<'_>, Shift>) -> anyhow::Result<()> {
    let y = HEAD.cast_signed() - 18;
    let line = |x: i32, style| PathElement::new([(x, y), (x + 30, y)], style);
    let word = |x: i32, text| Text::new(text, (x, y - 8), TICK);
    head.draw(&line(330, reference_style()))?;
    head.draw(&word(368, "reference (exact)"))?;
    head.draw(&line(540, tip_style()))?;
    head.draw(&word(578, "tip"))?;
    head.draw(&Circle::new((655, y), 5, ORANGE.filled()))?;
    head.draw(&word(668, "start"))?;
    Ok(())
}

/// Ranges around all points in which one millimetre is as long across as up.
fn equal_ranges(view: &View) -> (Range<f64>, Range<f64>) {
    let width = f64::from(PANEL.0 - MARGIN - MARGIN_RIGHT - LABEL_LEFT);
    let height = f64::from(PANEL.1 - 2 * MARGIN - LABEL_BOTTOM);
    let points = || view.reference.iter().chain(&view.tip);
    let (left, right) = extent(points().map(|p| p.0));
    let (low, high) = extent(points().map(|p| p.1));
    let mm_per_pixel = ((right - left) / width).max((high - low) / height);
    // A tenth of room, and never an empty range.
    let mm_per_pixel = (1.15 * mm_per_pixel).max(1e-6);
    let around = |a: f64, b: f64, pixels: f64| {
        let (middle, half) = (f64::midpoint(a, b), 0.5 * pixels * mm_per_pixel);
        middle - half..middle + half
    };
    (around(left, right, width), around(low, high, height))
}

fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), x| {
        (least.min(x), most.max(x))
    })
}
