use std::ops::Range;
use std::path::Path;

use cdcr_chart::{BLUE, GREEN, GREY, ORANGE, PALE};
use cdcr_client::counted;
use plotters::coord::Shift;
use plotters::prelude::*;

use crate::demo::cycle::Cycle;
use crate::demo::report::DemoReport;
use crate::spread::Spread;

const TITLE: (&str, i32) = ("sans-serif", 22);
const LABEL: (&str, i32) = ("sans-serif", 16);
const TICK: (&str, i32) = ("sans-serif", 14);
/// Bars in each factor of ten.
const BARS_PER_DECADE: f64 = 10.0;
/// Times below this are counted here: a logarithm knows no zero \[µs\].
const FLOOR_US: f64 = 0.1;

struct Panel<'a> {
    name: &'static str,
    values_us: Vec<f64>,
    spread: &'a Spread,
    colour: RGBColor,
    /// What has to be done by the deadline has its line.
    deadline_us: Option<f64>,
}

/// Draws how often each latency came, in one scale of time for all three.
pub(in crate::demo) fn timing(
    file: &Path,
    cycles: &[Cycle],
    report: &DemoReport,
    deadline_us: f64,
) -> anyhow::Result<()> {
    let values = |value: fn(&Cycle) -> f64| cycles.iter().map(value).collect::<Vec<_>>();
    let panels = [
        Panel {
            name: "wake-up: due release to start",
            values_us: values(|cycle| cycle.wake_us),
            spread: &report.wake_us,
            colour: BLUE,
            deadline_us: None,
        },
        Panel {
            name: "solve",
            values_us: values(|cycle| cycle.solve_us),
            spread: &report.solve_us,
            colour: GREEN,
            deadline_us: None,
        },
        Panel {
            name: "response: due release to command",
            values_us: values(|cycle| cycle.response_us),
            spread: &report.response_us,
            colour: ORANGE,
            deadline_us: Some(deadline_us),
        },
    ];
    let root = SVGBackend::new(file, (1000, 900)).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "Timing of {}, simulated, {}",
        counted(report.cycles, "cycle"),
        counted(report.sections, "section")
    );
    let areas = root.titled(&title, TITLE)?.split_evenly((3, 1));
    let values_us = panels.iter().flat_map(|panel| &panel.values_us);
    let range_us = decades(values_us.chain([&deadline_us]));
    for (area, panel) in areas.iter().zip(&panels) {
        histogram(area, panel, range_us.clone())?;
    }
    root.present()?;
    Ok(())
}

fn histogram(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    panel: &Panel<'_>,
    range_us: Range<f64>,
) -> anyhow::Result<()> {
    let bars = bars(&panel.values_us, range_us.start);
    let most = bars.iter().map(|bar| bar.1).fold(1.0, f64::max);
    // A little more, or rounding takes the labels from the ends.
    let range_us = 0.999 * range_us.start..1.001 * range_us.end;
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .margin_right(35)
        .x_label_area_size(48)
        .y_label_area_size(70)
        .build_cartesian_2d(range_us.log_scale(), (0.7..10.0 * most).log_scale())?;
    chart
        .configure_mesh()
        .x_desc(format!("{} [µs]", panel.name))
        .y_desc("cycles")
        .axis_desc_style(LABEL)
        .label_style(TICK)
        .x_label_formatter(&|us| tick(*us))
        .y_label_formatter(&|count| format!("{count:.0}"))
        .y_labels(5)
        .bold_line_style(PALE)
        .light_line_style(TRANSPARENT)
        .draw()?;
    let colour = panel.colour;
    let rectangles = bars.iter().map(|(range, count)| {
        Rectangle::new([(range.start, 0.7), (range.end, *count)], colour.filled())
    });
    let Spread { p50, p99, max } = panel.spread;
    chart
        .draw_series(rectangles)?
        .label(format!("p50 {p50:.1} µs, p99 {p99:.1} µs, max {max:.1} µs"))
        .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 20, y + 5)], colour.filled()));
    if let Some(deadline_us) = panel.deadline_us {
        let line = [(deadline_us, 0.7), (deadline_us, 10.0 * most)];
        chart
            .draw_series(LineSeries::new(line, BLACK.stroke_width(2)))?
            .label(format!("deadline, {deadline_us} µs"))
            .legend(|(x, y)| PathElement::new([(x, y), (x + 20, y)], BLACK.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .label_font(TICK)
        .background_style(WHITE.mix(0.9))
        .border_style(GREY)
        .draw()?;
    Ok(())
}

fn tick(us: f64) -> String {
    let all_below = if us < 1.01 * FLOOR_US { "≤ " } else { "" };
    format!("{all_below}{}", us as f32)
}

/// Bars of equal width on the logarithmic axis that are not empty, with their counts.
fn bars(values_us: &[f64], start_us: f64) -> Vec<(Range<f64>, f64)> {
    let edge = |index: usize| start_us * 10_f64.powf(index as f64 / BARS_PER_DECADE);
    let mut counts: Vec<f64> = Vec::new();
    for value_us in values_us {
        let place = BARS_PER_DECADE * (value_us.max(start_us) / start_us).log10();
        let index = place as usize;
        if counts.len() <= index {
            counts.resize(index + 1, 0.0);
        }
        counts[index] += 1.0;
    }
    let bars = counts.into_iter().enumerate();
    let bars = bars.map(|(index, count)| (edge(index)..edge(index + 1), count));
    bars.filter(|(_, count)| *count > 0.0).collect()
}

/// Whole decades around all values.
fn decades<'a>(values_us: impl Iterator<Item = &'a f64>) -> Range<f64> {
    let start = (f64::INFINITY, FLOOR_US);
    let (least, most) = values_us.fold(start, |(least, most), &x| {
        (least.min(x.max(FLOOR_US)), most.max(x))
    });
    // Powers of whole exponents, so that the labels are exact.
    10_f64.powi(least.log10().floor() as i32)..10_f64.powi(most.log10().floor() as i32 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_one_bar() {
        let values = [0.0, 1.0, 9.999, 10.0, 5000.0];
        let bars = bars(&values, 0.1);
        assert!((bars.iter().map(|bar| bar.1).sum::<f64>() - 5.0).abs() < 1e-12);
        assert!(bars.iter().any(|(range, _)| range.contains(&5000.0)));
        let range = decades(values.iter());
        assert!((range.start - 0.1).abs() < 1e-12 && (range.end - 1e4).abs() < 1e-6);
    }
}
