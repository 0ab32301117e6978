use std::path::Path;

use cdcr_chart::{Curve, GREY, ORANGE, Panel, View};
use cdcr_client::{Spiral, counted};

use super::write;
use crate::demo::cycle::Cycle;
use crate::demo::report::DemoReport;
use crate::demo::shape::curve;

/// Draws the path of the tip over the exact curve, from above and from the side, in equal scale.
pub(in crate::demo) fn path(
    file: &Path,
    cycles: &[Cycle],
    spiral: &Spiral,
    report: &DemoReport,
) -> anyhow::Result<()> {
    let panel = |view: View, title: &str| -> Panel {
        let tip = view.line(cycles.iter().map(|cycle| cycle.tip_m));
        let start = tip.first().copied().into_iter().collect();
        let curves = vec![
            Curve::line("reference (exact)", view.line(curve(spiral)), GREY).width(11),
            Curve::line("tip", tip, ORANGE),
            Curve::dots("start", start, ORANGE),
        ];
        view.panel(title, curves)
    };
    let sections = counted(report.sections, "section");
    let title = format!("Path of the tip: simulated spiral, {sections}");
    let side = panel(View::SIDE, "The same from the side");
    write(file, (2, 900), &[panel(View::ABOVE, &title), side])
}
