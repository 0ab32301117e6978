use std::path::Path;

use cdcr_chart::{BLUE, Curve, GREY, ORANGE, Panel, View};
use cdcr_client::{Spiral, counted};

use super::write;
use crate::demo::cycle::Cycle;
use crate::demo::report::DemoReport;
use crate::demo::shape::{Backbone, curve, moments};

/// Time between two shapes \[s\].
const STEP_S: f64 = 0.5;
/// Opacity of the first shape; the last one has 1.
const FAINTEST: f64 = 0.25;

/// Draws the backbone every half second over the exact curve, from the side and from above, in equal scale.
pub(in crate::demo) fn shape(
    file: &Path,
    cycles: &[Cycle],
    spiral: &Spiral,
    backbone: &Backbone,
    report: &DemoReport,
) -> anyhow::Result<()> {
    let shown = moments(cycles, STEP_S);
    let shapes: Vec<_> = shown.iter().map(|cycle| backbone.points(cycle)).collect();
    let last = shapes.len().saturating_sub(1);
    let panel = |view: View, title: &str| -> Panel {
        let reference = view.line(curve(spiral));
        let mut curves = vec![Curve::line("reference (exact)", reference, GREY).width(8)];
        for (number, shape) in shapes.iter().enumerate() {
            let label = if number == last {
                "backbone, palest first"
            } else {
                ""
            };
            let strength = FAINTEST + (1.0 - FAINTEST) * number as f64 / last.max(1) as f64;
            let points = view.line(shape.iter().copied());
            curves.push(Curve::line(label, points, BLUE).faded(strength));
        }
        let tips = shapes.iter().filter_map(|shape| shape.last().copied());
        curves.push(Curve::dots("tip", view.line(tips), ORANGE));
        view.panel(title, curves)
    };
    let sections = counted(report.sections, "section");
    let title = format!("Shape every {STEP_S} s: simulated spiral, {sections}");
    let above = panel(View::ABOVE, "The same from above");
    write(file, (2, 900), &[panel(View::SIDE, &title), above])
}
