use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::{LABEL, PALE, TICK};

pub(super) const PANEL: (u32, u32) = (560, 520);
/// Title and legend.
pub(super) const HEAD: u32 = 70;
const MARGIN: u32 = 15;
const LABEL_LEFT: u32 = 65;
const LABEL_BOTTOM: u32 = 50;
/// Room for the last tick label.
const MARGIN_RIGHT: u32 = 30;

/// A point in a picture \[mm\].
pub(super) type Point = (f64, f64);
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Chart<'a, 'b> =
    ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// A view along one axis: names and numbers of the two others.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    pub(super) across: (usize, &'static str),
    pub(super) up: (usize, &'static str),
}

/// From above.
pub(super) const TOP: View = View {
    across: (0, "x [mm]"),
    up: (1, "y [mm]"),
};
/// From the side.
pub(super) const SIDE: View = View {
    across: (0, "x [mm]"),
    up: (2, "z [mm]"),
};

impl View {
    /// Where a position \[m\] is seen.
    pub(super) fn point(&self, position_m: [f64; 3]) -> Point {
        (1e3 * position_m[self.across.0], 1e3 * position_m[self.up.0])
    }

    /// Axes around all points, in equal scale.
    pub(super) fn chart<'a, 'b>(
        &self,
        area: &'a Area<'b>,
        points: impl Iterator<Item = Point> + Clone,
    ) -> anyhow::Result<Chart<'a, 'b>> {
        let (across, up) = equal_ranges(points);
        let mut chart = ChartBuilder::on(area)
            .margin(MARGIN)
            .margin_right(MARGIN_RIGHT)
            .x_label_area_size(LABEL_BOTTOM)
            .y_label_area_size(LABEL_LEFT)
            .build_cartesian_2d(across, up)?;
        chart
            .configure_mesh()
            .x_desc(self.across.1)
            .y_desc(self.up.1)
            .axis_desc_style(LABEL)
            .label_style(TICK)
            .x_labels(7)
            .y_labels(7)
            .x_label_formatter(&|mm| format!("{mm}"))
            .y_label_formatter(&|mm| format!("{mm}"))
            .bold_line_style(PALE)
            .light_line_style(TRANSPARENT)
            .draw()?;
        Ok(chart)
    }
}

/// Ranges around all points in which one millimetre is as long across as up.
fn equal_ranges(points: impl Iterator<Item = Point> + Clone) -> (Range<f64>, Range<f64>) {
    let width = f64::from(PANEL.0 - MARGIN - MARGIN_RIGHT - LABEL_LEFT);
    let height = f64::from(PANEL.1 - 2 * MARGIN - LABEL_BOTTOM);
    let (left, right) = extent(points.clone().map(|p| p.0));
    let (low, high) = extent(points.map(|p| p.1));
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
