//! Plots of benchmark results, on top of `cdcr_chart`.

pub(crate) use cdcr_chart::{
    BLUE, Curve, DARK, GREEN, GREY, ORANGE, PURPLE, Panel, Point, RGBColor, SKY, Scale, View,
    YELLOW,
};
use cdcr_controller::nmpc::SolverKind;
use hdrhistogram::Histogram;
use hdrhistogram::iterators::IterationValue;
use serde_json::Value;

use crate::dataset::number;

const SHORTEST_US: f64 = 0.1;

/// Points of one number over another, one for each row that has both.
pub(crate) fn of_rows<'a>(
    label: &str,
    rows: impl IntoIterator<Item = &'a Value>,
    x: &str,
    y: &str,
    colour: RGBColor,
) -> Curve {
    let point = |row| Some((number(row, x)?, number(row, y)?));
    let points = rows.into_iter().filter_map(point);
    Curve::line(label, points.collect(), colour)
}

/// A curve for each solver, in its colour; those without points are left out.
pub(crate) fn of_solvers(curve: impl Fn(SolverKind, RGBColor) -> Curve) -> Vec<Curve> {
    let solvers = SolverKind::ALL.into_iter().zip([GREEN, ORANGE, BLUE]);
    let curves = solvers.map(|(solver, colour)| curve(solver, colour));
    curves.filter(|curve| !curve.is_empty()).collect()
}

/// Share of longer times over each time \[µs\], with one step for each bucket of the histogram.
pub(crate) fn longer(times_ns: &Histogram<u64>) -> Vec<Point> {
    let (total, mut left) = (times_ns.len(), times_ns.len());
    let point = |value: IterationValue<u64>| {
        let us = (value.value_iterated_to() as f64 * 1e-3).max(SHORTEST_US);
        let share = left as f64 / total as f64;
        left -= value.count_since_last_iteration();
        (us, share)
    };
    times_ns.iter_recorded().map(point).collect()
}
