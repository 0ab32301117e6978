use std::path::Path;

use cdcr_client::{Spiral, counted};
use plotters::prelude::*;

use super::panel::{Area, HEAD, PANEL, Point, SIDE, TOP, View};
use super::{GREY, ORANGE, TICK, TITLE};
use crate::demo::cycle::Cycle;
use crate::demo::report::DemoReport;
use crate::demo::shape::curve;

/// Draws the tip's path over the exact curve, from above and from the side, in equal scale.
pub(in crate::demo) fn path(
    file: &Path,
    cycles: &[Cycle],
    spiral: &Spiral,
    report: &DemoReport,
) -> anyhow::Result<()> {
    let size = (2 * PANEL.0, PANEL.1 + HEAD);
    let root = SVGBackend::new(file, size).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "Path of the tip and reference: simulated spiral of Eq. 8, {}",
        counted(report.sections, "section")
    );
    let (head, panels) = root.split_vertically(HEAD);
    head.titled(&title, TITLE)?;
    legend(&head)?;
    let (left, right) = panels.split_horizontally(PANEL.0);
    panel(&left, TOP, cycles, spiral)?;
    panel(&right, SIDE, cycles, spiral)?;
    root.present()?;
    Ok(())
}

fn panel(area: &Area<'_>, view: View, cycles: &[Cycle], spiral: &Spiral) -> anyhow::Result<()> {
    let reference: Vec<Point> = curve(spiral).into_iter().map(|p| view.point(p)).collect();
    let tip: Vec<Point> = cycles.iter().map(|cycle| view.point(cycle.tip_m)).collect();
    let mut chart = view.chart(area, reference.iter().chain(&tip).copied())?;
    let start = tip.iter().copied().take(1);
    let start = start.map(|point| Circle::new(point, 5, ORANGE.filled()));
    chart.draw_series(LineSeries::new(reference, reference_style()))?;
    chart.draw_series(LineSeries::new(tip.iter().copied(), tip_style()))?;
    chart.draw_series(start)?;
    Ok(())
}

fn reference_style() -> ShapeStyle {
    GREY.stroke_width(6)
}

fn tip_style() -> ShapeStyle {
    ORANGE.stroke_width(2)
}

/// One legend for both panels, outside them: a curve may pass anywhere.
fn legend(head: &Area<'_>) -> anyhow::Result<()> {
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
