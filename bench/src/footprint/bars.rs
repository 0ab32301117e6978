//! A picture of shares: one pair of bars for each thread.

use std::fmt::Write as _;

pub(super) struct Bar {
    pub(super) label: String,
    pub(super) idle_percent: f64,
    pub(super) tracking_percent: f64,
}

const WIDTH: f64 = 800.0;
const LABEL: f64 = 150.0;
/// Room for the number behind a bar.
const NUMBER: f64 = 90.0;
const LINE: f64 = 52.0;
const THICK: f64 = 18.0;
const TOP: f64 = 44.0;
/// As in the charts: colours that colour-blind people can tell apart.
const COLOURS: [(&str, &str); 2] = [("tracking", "#0072b2"), ("idle", "#969696")];

/// Horizontal bars from zero, as SVG.
pub(super) fn svg(bars: &[Bar]) -> String {
    let height = TOP + LINE * bars.len() as f64;
    let all = bars
        .iter()
        .flat_map(|bar| [bar.idle_percent, bar.tracking_percent]);
    let longest = all.fold(f64::MIN_POSITIVE, f64::max);
    let scale = (WIDTH - LABEL - NUMBER) / longest;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" \
         font-family=\"sans-serif\" font-size=\"15\">\n\
         <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for (index, (name, colour)) in COLOURS.iter().enumerate() {
        let x = LABEL + 110.0 * index as f64;
        let _ = writeln!(
            svg,
            "<rect x=\"{x}\" y=\"14\" width=\"14\" height=\"14\" fill=\"{colour}\"/>\
             <text x=\"{}\" y=\"26\">{name}</text>",
            x + 20.0
        );
    }
    for (index, bar) in bars.iter().enumerate() {
        let y = TOP + LINE * index as f64;
        let label = escaped(&bar.label);
        let middle = y + THICK + 5.0;
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"{middle}\" text-anchor=\"end\">{label}</text>",
            LABEL - 10.0
        );
        let values = [bar.tracking_percent, bar.idle_percent];
        for (row, (percent, (_, colour))) in values.iter().zip(COLOURS).enumerate() {
            let y = y + (THICK + 2.0) * row as f64;
            let length = percent.max(0.0) * scale;
            let _ = writeln!(
                svg,
                "<rect x=\"{LABEL}\" y=\"{y}\" width=\"{length:.2}\" height=\"{THICK}\" \
                 fill=\"{colour}\"/><text x=\"{:.2}\" y=\"{}\">{percent:.3} %</text>",
                LABEL + length + 6.0,
                y + 14.0
            );
        }
    }
    svg.push_str("</svg>\n");
    svg
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    #![allow(
        clippy::unwrap_used,
        reason = "in a test a panic is the report, in its helpers, too"
    )]

    use super::*;

    #[test]
    fn the_longest_bar_fills_the_room_and_zero_has_no_length() {
        let bar = |label: &str, idle_percent, tracking_percent| Bar {
            label: label.to_owned(),
            idle_percent,
            tracking_percent,
        };
        let svg = svg(&[bar("a<b", 1.0, 2.0), bar("c", 0.0, 0.0)]);
        let document = roxmltree::Document::parse(&svg).unwrap();
        let bars = document
            .descendants()
            .filter(|node| node.attribute("height") == Some("18") && node.has_tag_name("rect"));
        let lengths: Vec<_> = bars.map(|bar| bar.attribute("width").unwrap()).collect();
        assert_eq!(lengths, ["560.00", "280.00", "0.00", "0.00"]);
        assert!(
            document
                .descendants()
                .any(|node| node.text() == Some("a<b"))
        );
    }

    #[test]
    fn nothing_is_a_picture_too() {
        assert!(roxmltree::Document::parse(&svg(&[])).is_ok());
    }
}
