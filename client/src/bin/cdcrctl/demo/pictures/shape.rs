use std::path::Path;

use cdcr_client::{Spiral, counted};
use plotters::prelude::*;

use super::panel::{Area, HEAD, PANEL, Point, SIDE, TOP, View};
use super::{BLUE, GREY, ORANGE, TICK, TITLE};
use crate::backbone::Position;
use crate::demo::cycle::Cycle;
use crate::demo::report::DemoReport;
use crate::demo::shape::{Backbone, curve, moments};

/// Time between two shapes \[s\].
const STEP_S: f64 = 0.5;
/// How much of its colour the first shape has; the last has all.
const FAINTEST: f64 = 0.25;

/// Draws the backbone every half second over the exact curve, from the side and from above, in equal scale.
pub(in crate::demo) fn shape(
    file: &Path,
    cycles: &[Cycle],
    spiral: &Spiral,
    backbone: &Backbone,
    report: &DemoReport,
) -> anyhow::Result<()> {
    let size = (2 * PANEL.0, PANEL.1 + HEAD);
    let root = SVGBackend::new(file, size).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "Shape of the robot every {STEP_S} s: simulated spiral of Eq. 8, {}",
        counted(report.sections, "section")
    );
    let shown = moments(cycles, STEP_S);
    let shapes: Vec<_> = shown.iter().map(|cycle| backbone.points(cycle)).collect();
    let (head, panels) = root.split_vertically(HEAD);
    head.titled(&title, TITLE)?;
    legend(&head)?;
    let (left, right) = panels.split_horizontally(PANEL.0);
    panel(&left, SIDE, &shapes, spiral)?;
    panel(&right, TOP, &shapes, spiral)?;
    root.present()?;
    Ok(())
}

fn panel(
    area: &Area<'_>,
    view: View,
    shapes: &[Vec<Position>],
    spiral: &Spiral,
) -> anyhow::Result<()> {
    let points = |positions: &[Position]| -> Vec<Point> {
        positions.iter().map(|p| view.point(*p)).collect()
    };
    let reference = points(&curve(spiral));
    let shapes: Vec<Vec<Point>> = shapes.iter().map(|shape| points(shape)).collect();
    let all = reference.iter().chain(shapes.iter().flatten()).copied();
    let mut chart = view.chart(area, all)?;
    chart.draw_series(LineSeries::new(
        reference.iter().copied(),
        reference_style(),
    ))?;
    let last = shapes.len().saturating_sub(1).max(1) as f64;
    for (number, shape) in shapes.iter().enumerate() {
        let strength = FAINTEST + (1.0 - FAINTEST) * number as f64 / last;
        let style = BLUE.mix(strength).stroke_width(2);
        chart.draw_series(LineSeries::new(shape.iter().copied(), style))?;
    }
    let tips = shapes.iter().filter_map(|shape| shape.last());
    chart.draw_series(tips.map(|tip| Circle::new(*tip, 4, ORANGE.filled())))?;
    Ok(())
}

fn reference_style() -> ShapeStyle {
    GREY.stroke_width(4)
}

/// One legend for both panels, outside them: a curve may pass anywhere.
fn legend(head: &Area<'_>) -> anyhow::Result<()> {
    let y = HEAD.cast_signed() - 18;
    let line = |x: i32, style| PathElement::new([(x, y), (x + 30, y)], style);
    let word = |x: i32, text| Text::new(text, (x, y - 8), TICK);
    head.draw(&line(290, BLUE.mix(FAINTEST).stroke_width(2)))?;
    head.draw(&line(320, BLUE.stroke_width(2)))?;
    head.draw(&word(358, "backbone, first to last"))?;
    head.draw(&line(550, reference_style()))?;
    head.draw(&word(588, "reference (exact)"))?;
    head.draw(&Circle::new((745, y), 4, ORANGE.filled()))?;
    head.draw(&word(758, "tip"))?;
    Ok(())
}
