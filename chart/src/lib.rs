//! Sheets of charts as SVG: lines, dots and bars over labelled axes, each with a legend above it.
//!
//! They are drawn at twice the intended size, because the library rounds all positions to whole pixels.

#![allow(
    missing_docs,
    clippy::missing_errors_doc,
    reason = "the library of two programs: nobody reads its rustdoc, and a comment that repeats a name helps nobody"
)]

use std::ops::Range;

use anyhow::Result;
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
pub use plotters::style::RGBColor;

// A palette for colour-blind readers (Okabe and Ito).
pub const BLUE: RGBColor = RGBColor(0, 114, 178);
pub const ORANGE: RGBColor = RGBColor(213, 94, 0);
pub const GREEN: RGBColor = RGBColor(0, 158, 115);
pub const PURPLE: RGBColor = RGBColor(204, 121, 167);
pub const SKY: RGBColor = RGBColor(86, 180, 233);
pub const YELLOW: RGBColor = RGBColor(230, 159, 0);
pub const GREY: RGBColor = RGBColor(150, 150, 150);
pub const DARK: RGBColor = RGBColor(40, 40, 40);
/// Grid lines.
pub const PALE: RGBColor = RGBColor(225, 225, 225);

const WIDTH: u32 = 1600;
const TITLE: (&str, u32) = ("sans-serif", 32);
const LABEL: (&str, u32) = ("sans-serif", 27);
const TICK: (&str, u32) = ("sans-serif", 25);
/// Approximate width of a letter in a legend.
const LETTER: u32 = 15;
const LINE_OF_TEXT: u32 = 38;
const LABEL_LEFT: u32 = 128;
const LABEL_BOTTOM: u32 = 84;
const MARGIN: u32 = 20;
/// The library centres a vertical label on the left edge of its area.
const MARGIN_LEFT: u32 = 22;
/// Space for half of the last tick label.
const MARGIN_RIGHT: u32 = 45;
const SWATCH: u32 = 45;
const DOT: i32 = 8;

pub type Point = (f64, f64);

pub struct Curve {
    label: String,
    pieces: Vec<Vec<Point>>,
    style: ShapeStyle,
    mark: Mark,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Mark {
    Line,
    Dots,
    Bars,
}

impl Curve {
    /// A line; one with an empty label is not in the legend.
    pub fn line(label: impl Into<String>, points: Vec<Point>, colour: RGBColor) -> Self {
        Self::pieces(label, vec![points], colour)
    }

    pub fn pieces(label: impl Into<String>, pieces: Vec<Vec<Point>>, colour: RGBColor) -> Self {
        Self {
            label: label.into(),
            pieces,
            style: colour.stroke_width(4),
            mark: Mark::Line,
        }
    }

    /// Points without a line between them.
    pub fn dots(label: impl Into<String>, points: Vec<Point>, colour: RGBColor) -> Self {
        Self {
            mark: Mark::Dots,
            style: colour.filled(),
            ..Self::line(label, points, colour)
        }
    }

    /// Bars from the lower end of a logarithmic axis up to their counts, each between its two x values.
    pub fn bars(label: impl Into<String>, bars: Vec<[Point; 2]>, colour: RGBColor) -> Self {
        let bars = bars.into_iter().map(Vec::from).collect();
        Self {
            mark: Mark::Bars,
            style: colour.filled(),
            ..Self::pieces(label, bars, colour)
        }
    }

    pub fn level(label: impl Into<String>, y: f64, x: Range<f64>, colour: RGBColor) -> Self {
        Self::line(label, vec![(x.start, y), (x.end, y)], colour).width(3)
    }

    /// A vertical line from `least` to 1, the range of the shares.
    pub fn upright(label: impl Into<String>, x: f64, least: f64, colour: RGBColor) -> Self {
        Self::line(label, vec![(x, least), (x, 1.0)], colour)
    }

    #[must_use]
    pub fn width(mut self, width: u32) -> Self {
        self.style.stroke_width = width;
        self
    }

    /// Reduces the opacity to `share`, 0 to 1.
    #[must_use]
    pub fn faded(mut self, share: f64) -> Self {
        self.style.color = self.style.color.mix(share);
        self
    }

    pub fn is_empty(&self) -> bool {
        self.points().next().is_none()
    }

    fn points(&self) -> impl Iterator<Item = &Point> {
        self.pieces.iter().flatten()
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    Linear,
    /// A logarithmic y axis; values below the floor are drawn on it, and its label says so.
    Log {
        floor: f64,
    },
    /// Both axes are logarithmic; values below the floor are drawn on it. All x are positive.
    LogLog {
        floor: f64,
    },
    /// A logarithmic x axis; all x are positive.
    LogAcross,
    /// Both axes are linear, with the same scale.
    Equal,
}

pub struct Panel {
    title: String,
    x: String,
    y: String,
    scale: Scale,
    pub curves: Vec<Curve>,
}

impl Panel {
    pub fn new(
        title: impl Into<String>,
        [x, y]: [&str; 2],
        scale: Scale,
        curves: Vec<Curve>,
    ) -> Self {
        Self {
            title: title.into(),
            x: x.to_owned(),
            y: y.to_owned(),
            scale,
            curves,
        }
    }

    /// Draws each curve thinner than those before it, so that none hides another.
    #[must_use]
    pub fn tapered(mut self) -> Self {
        for (later, curve) in self.curves.iter_mut().rev().enumerate() {
            curve.style.stroke_width += 3 * later as u32;
        }
        self
    }

    fn is_log(&self) -> bool {
        matches!(self.scale, Scale::Log { .. } | Scale::LogLog { .. })
    }

    fn is_log_across(&self) -> bool {
        matches!(self.scale, Scale::LogLog { .. } | Scale::LogAcross)
    }

    /// Whether all points of all curves are below `y`.
    pub fn is_below(&self, y: f64) -> bool {
        let mut points = self.curves.iter().flat_map(Curve::points);
        points.all(|point| point.1 < y)
    }
}

/// Two axes of the base frame, horizontal and vertical, for projections of paths and robot shapes.
#[derive(Debug, Clone, Copy)]
pub struct View([usize; 2]);

impl View {
    pub const ABOVE: Self = Self([0, 1]);
    pub const SIDE: Self = Self([0, 2]);
    pub const FRONT: Self = Self([1, 2]);

    /// Projection \[mm\] of a position \[m\].
    pub fn point(self, position_m: [f64; 3]) -> Point {
        (1e3 * position_m[self.0[0]], 1e3 * position_m[self.0[1]])
    }

    pub fn line(self, positions_m: impl IntoIterator<Item = [f64; 3]>) -> Vec<Point> {
        let positions_m = positions_m.into_iter();
        positions_m.map(|p_m| self.point(p_m)).collect()
    }

    /// A panel with axes of equal scale around all curves.
    pub fn panel(self, title: impl Into<String>, curves: Vec<Curve>) -> Panel {
        let [x, y] = self.0.map(|axis| ["x [mm]", "y [mm]", "z [mm]"][axis]);
        Panel::new(title, [x, y], Scale::Equal, curves)
    }
}

/// Draws panels in rows of `columns`, each `height` high. Panels with the same logarithmic x axis share its
/// range, so that they can be compared.
pub fn svg((columns, height): (usize, u32), panels: &[Panel]) -> Result<String> {
    let rows = panels.len().div_ceil(columns);
    let mut svg = String::new();
    {
        let size = (WIDTH, height * rows as u32);
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        for (area, panel) in root.split_evenly((rows, columns)).iter().zip(panels) {
            draw(area, panel, common(panel, panels))?;
        }
        root.present()?;
    }
    Ok(svg)
}

/// The x range of a panel with a logarithmic x axis: it covers all panels with the same axis.
fn common(panel: &Panel, panels: &[Panel]) -> Option<Range<f64>> {
    let is_compared = |other: &&Panel| other.is_log_across() && other.x == panel.x;
    let compared = panels.iter().filter(is_compared);
    let widest = |a: Range<f64>, b: Range<f64>| a.start.min(b.start)..a.end.max(b.end);
    let across = compared.map(powers_across).reduce(widest);
    across.filter(|_| panel.is_log_across())
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn draw(area: &Area<'_>, panel: &Panel, common: Option<Range<f64>>) -> Result<()> {
    let (width, height) = area.dim_in_pixel();
    let entries = legend(panel, width - MARGIN_LEFT - LABEL_LEFT - MARGIN_RIGHT);
    let head = LINE_OF_TEXT * (entries.last().map_or(0, |entry| entry.line + 1) + 1) + MARGIN;
    let (top, chart) = area.split_vertically(head);
    let left = (MARGIN_LEFT + LABEL_LEFT).cast_signed();
    top.draw(&Text::new(
        panel.title.clone(),
        (left, 8),
        TITLE.into_font().color(&DARK),
    ))?;
    for entry in entries {
        let x = left + entry.offset.cast_signed();
        let y = (LINE_OF_TEXT * (entry.line + 1)).cast_signed() + 24;
        let end = x + SWATCH.cast_signed();
        let style = entry.curve.style;
        match entry.curve.mark {
            Mark::Dots => top.draw(&Circle::new((i32::midpoint(x, end), y), DOT, style))?,
            Mark::Bars => top.draw(&Rectangle::new([(x, y - DOT), (end, y + DOT)], style))?,
            Mark::Line => top.draw(&PathElement::new([(x, y), (end, y)], style))?,
        }
        let label = entry.curve.label.clone();
        top.draw(&Text::new(
            label,
            (end + 10, y - 14),
            TICK.into_font().color(&DARK),
        ))?;
    }
    let (own, up) = ranges(panel, (width, height - head));
    let across = common.unwrap_or(own);
    match panel.scale {
        Scale::Log { floor } => fill(&chart, panel, across, up.log_scale(), floor),
        Scale::LogLog { floor } => fill(&chart, panel, across.log_scale(), up.log_scale(), floor),
        Scale::LogAcross => fill(&chart, panel, across.log_scale(), up, f64::NEG_INFINITY),
        Scale::Linear | Scale::Equal => fill(&chart, panel, across, up, f64::NEG_INFINITY),
    }
}

struct Entry<'a> {
    curve: &'a Curve,
    line: u32,
    offset: u32,
}

/// The curves with a label, in lines not longer than `width_max`.
fn legend(panel: &Panel, width_max: u32) -> Vec<Entry<'_>> {
    let (mut line, mut offset) = (0, 0);
    let labelled = panel.curves.iter().filter(|curve| !curve.label.is_empty());
    labelled
        .map(|curve| {
            let width = SWATCH + 35 + LETTER * curve.label.chars().count() as u32;
            if offset > 0 && offset + width > width_max {
                (line, offset) = (line + 1, 0);
            }
            let entry = Entry {
                curve,
                line,
                offset,
            };
            offset += width;
            entry
        })
        .collect()
}

fn fill<X, Y>(area: &Area<'_>, panel: &Panel, across: X, up: Y, floor: f64) -> Result<()>
where
    X: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y: AsRangedCoord<Value = f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let is_wide = area.dim_in_pixel().0 > WIDTH / 2;
    let lines = panel.curves.iter().filter(|curve| curve.mark == Mark::Line);
    let is_cut = lines.flat_map(Curve::points).any(|point| point.1 < floor);
    let height = |y: &f64| {
        let sign = ["", "≤"][usize::from(is_cut && *y < 1.01 * floor)];
        format!("{sign}{}", tick(*y, panel.is_log()))
    };
    let mut chart = ChartBuilder::on(area)
        .margin_left(MARGIN_LEFT)
        .margin_right(MARGIN_RIGHT)
        .margin_bottom(MARGIN)
        .x_label_area_size(LABEL_BOTTOM)
        .y_label_area_size(LABEL_LEFT)
        .build_cartesian_2d(across, up)?;
    chart
        .configure_mesh()
        .x_desc(&*panel.x)
        .y_desc(&*panel.y)
        .axis_desc_style(LABEL.into_font().color(&DARK))
        .label_style(TICK.into_font().color(&DARK))
        .axis_style(GREY)
        .x_labels(if is_wide { 12 } else { 7 })
        .y_labels(8)
        .x_label_formatter(&|x| tick(*x, panel.is_log_across()))
        .y_label_formatter(&height)
        .bold_line_style(PALE.stroke_width(2))
        .light_line_style(TRANSPARENT)
        .draw()?;
    for curve in &panel.curves {
        let pieces = curve.pieces.iter();
        match curve.mark {
            Mark::Dots => {
                let dot = |point: &Point| Circle::new(*point, DOT, curve.style);
                chart.draw_series(curve.points().map(dot))?;
            }
            Mark::Bars => {
                let ends = |bar: &Vec<Point>| [(bar[0].0, floor), bar[1]];
                let bar = |bar| Rectangle::new(ends(bar), curve.style);
                chart.draw_series(pieces.map(bar))?;
            }
            Mark::Line => {
                let drawn = |&(x, y): &Point| (x, y.max(floor));
                let line = |piece: &Vec<Point>| piece.iter().map(drawn).collect::<Vec<_>>();
                let line = |piece| PathElement::new(line(piece), curve.style);
                chart.draw_series(pieces.map(line))?;
            }
        }
    }
    Ok(())
}

/// A tick label: a plain number on a linear axis and where that is short, otherwise a power of ten. Steps
/// between plain ticks are above 1e-6; adding zero removes the sign of a negative zero.
fn tick(value: f64, is_log: bool) -> String {
    if !is_log || (9e-3..2e4).contains(&value) {
        return format!("{}", (value * 1e6).round() / 1e6 + 0.0);
    }
    let text = format!("{value:.2e}");
    let (digits, power) = text.split_once('e').unwrap_or((&text, "0"));
    let digits = digits.trim_end_matches('0').trim_end_matches('.');
    format!("{digits}e{power}")
}

fn ranges(panel: &Panel, (width, height): (u32, u32)) -> (Range<f64>, Range<f64>) {
    let points = || panel.curves.iter().flat_map(Curve::points);
    let (left, right) = extent(points().map(|p| p.0));
    let (low, high) = extent(points().map(|p| p.1));
    match panel.scale {
        Scale::Linear => (left..right, widened(low, high)),
        Scale::Log { floor } => (left..right, decades_above(floor, low, high)),
        Scale::LogLog { floor } => (powers_across(panel), decades_above(floor, low, high)),
        Scale::LogAcross => (powers_across(panel), widened(low, high)),
        Scale::Equal => {
            let plot_width = f64::from(width - MARGIN_LEFT - LABEL_LEFT - MARGIN_RIGHT);
            let plot_height = f64::from(height - LABEL_BOTTOM - MARGIN);
            let unit = ((right - left) / plot_width).max((high - low) / plot_height);
            let unit = (1.12 * unit).max(1e-9);
            let around = |a: f64, b: f64, pixels: f64| {
                let (middle, half) = (f64::midpoint(a, b), 0.5 * pixels * unit);
                middle - half..middle + half
            };
            (
                around(left, right, plot_width),
                around(low, high, plot_height),
            )
        }
    }
}

fn powers_across(panel: &Panel) -> Range<f64> {
    let points = panel.curves.iter().flat_map(Curve::points);
    let (left, right) = extent(points.map(|point| point.0));
    decades(if left > 0.0 { left } else { 0.1 * right }, right)
}

/// Minimum and maximum of the finite values, never equal; 0 and 1 without any.
fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let all = values.filter(|value| value.is_finite());
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
        (low.min(x), high.max(x))
    });
    if low > high {
        (0.0, 1.0)
    } else if low == high {
        (low - 0.5, high + 0.5)
    } else {
        (low, high)
    }
}

fn widened(low: f64, high: f64) -> Range<f64> {
    let margin = 0.05 * (high - low);
    low - margin..high + margin
}

/// A floor that is not a power of ten becomes the end of the range.
fn decades_above(floor: f64, low: f64, high: f64) -> Range<f64> {
    let decades = decades(low.max(floor), high.max(floor));
    decades.start.max(0.999 * floor)..decades.end
}

fn decades(low: f64, high: f64) -> Range<f64> {
    let (first, last) = (low.log10().floor(), high.log10().ceil());
    // Slightly wider, because rounding would remove the labels at the ends.
    0.999 * 10_f64.powf(first)..1.001 * 10_f64.powf(last.max(first + 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panel_without_points_can_be_drawn() {
        let (log, log_log) = (Scale::Log { floor: 1e-3 }, Scale::LogLog { floor: 1e-3 });
        for scale in [Scale::Linear, log, log_log, Scale::LogAcross, Scale::Equal] {
            let panel = Panel::new(
                "nothing",
                ["x", "y"],
                scale,
                vec![Curve::line("", Vec::new(), BLUE)],
            );
            let drawn = svg((1, 500), &[panel]).expect("drawn");
            assert!(drawn.contains("nothing"));
        }
    }

    #[test]
    fn an_axis_that_cuts_values_off_says_so_and_no_curve_hides_another() {
        let drawn = |least| {
            let curve = |label| Curve::line(label, vec![(0.0, least), (1.0, 10.0)], BLUE);
            let curves = vec![curve("one"), curve("other")];
            let panel = Panel::new("", ["x", "y"], Scale::Log { floor: 0.01 }, curves);
            svg((1, 500), &[panel.tapered()]).expect("drawn")
        };
        assert!(drawn(1e-5).contains("≤0.01") && !drawn(0.02).contains('≤'));
        let count = |width: &str| drawn(0.02).matches(width).count();
        let counts = ["stroke-width=\"4\"", "stroke-width=\"7\""].map(count);
        assert_eq!(counts, [2, 2], "each in legend and chart");
    }

    #[test]
    fn panels_over_one_knob_have_one_axis() {
        let panel = |x, scale, points| {
            let curve = Curve::line("", points, BLUE);
            Panel::new("", [x, "y"], scale, vec![curve])
        };
        let log_log = Scale::LogLog { floor: 1e-4 };
        let panels = [
            panel("weight", Scale::LogAcross, vec![(2e-10, 1.0), (1e-6, 2.0)]),
            panel("weight", log_log, vec![(1e-8, 1.0), (2e-5, 2.0)]),
            panel("time", Scale::LogAcross, vec![(15.0, 1.0), (900.0, 2.0)]),
            panel("time", Scale::Linear, vec![(15.0, 1.0), (900.0, 2.0)]),
        ];
        let [error, change, other, linear] =
            [0, 1, 2, 3].map(|place| common(&panels[place], &panels));
        assert_eq!(error, change);
        assert_eq!(error, Some(decades(2e-10, 2e-5)));
        assert_eq!(other, Some(decades(15.0, 900.0)));
        assert_eq!(linear, None);
    }
}
