//! What each part of the controller is for: a figure of a robot that needs it, with the part and without.

use serde_json::{Value, json};

use crate::dataset::{Column, Sheet, number, word};

/// A part that is switched off, the robot that shows it, and in which figure.
struct Shown {
    part: &'static str,
    /// The controller without it.
    without: &'static str,
    robot: &'static str,
    figure: &'static str,
    key: &'static str,
}

const SHOWN: [Shown; 11] = [
    Shown {
        part: "filter of cables and bends",
        without: "no filter",
        robot: "30 µm of noise",
        figure: "rate change rms, rad/s",
        key: "rate_change_rms",
    },
    Shown {
        part: "filter of the tip",
        without: "no filter",
        robot: "tip alone, 0.5 mm",
        figure: "mean error, mm",
        key: "mean_error_mm",
    },
    Shown {
        part: "filter of the tip",
        without: "no filter",
        robot: "tip alone, 0.5 mm, 3 sections, through straight",
        figure: "mean error, mm",
        key: "mean_error_mm",
    },
    Shown {
        part: "model of the motors",
        without: "no actuator model",
        robot: "lag 30 ms, delay 15 ms",
        figure: "mean error, mm",
        key: "mean_error_mm",
    },
    Shown {
        part: "model of the play",
        without: "no actuator model",
        robot: "play of 0.5 mm",
        figure: "mean error, mm",
        key: "mean_error_mm",
    },
    Shown {
        part: "offset of the tip",
        without: "no tip",
        robot: "wrong model",
        figure: "settled error, mm",
        key: "settled_error_mm",
    },
    Shown {
        part: "that offset along the way",
        without: "no offset along the way",
        robot: "wrong model, spiral",
        figure: "settled error, mm",
        key: "settled_error_mm",
    },
    Shown {
        part: "that offset along the way",
        without: "no offset along the way",
        robot: "wrong model, 5 % shorter",
        figure: "settled error, mm",
        key: "settled_error_mm",
    },
    Shown {
        part: "weight on rates",
        without: "no weight on rates",
        robot: "laboratory",
        figure: "largest rate at rest, rad/s",
        key: "rest_rate_rad_s",
    },
    Shown {
        part: "margin of the clearance",
        without: "no margin",
        robot: "5 % longer, ball",
        figure: "least clearance, mm (safe distance 10)",
        key: "min_clearance_mm",
    },
    Shown {
        part: "all of it",
        without: "first version",
        robot: "slow",
        figure: "mean error, mm",
        key: "mean_error_mm",
    },
];

const COLUMNS: [Column; 5] = [
    word("part", "part"),
    word("robot", "robot"),
    word("figure", "figure"),
    word("with it", "with"),
    word("without", "without"),
];

/// From the rows of a result, position interface; what they do not have is left out.
pub(super) fn table(rows: &[Value]) -> Sheet {
    let rows = SHOWN.iter().filter_map(|shown| {
        let of = |controller: &str| {
            let mut rows = rows.iter().filter(|row| row["interface"] == "position");
            let row =
                rows.find(|row| row["name"] == shown.robot && row["controller"] == controller)?;
            number(row, shown.key)
        };
        Some(json!({
            "part": shown.part,
            "robot": shown.robot,
            "figure": shown.figure,
            "with": text(of("full")?),
            "without": text(of(shown.without)?),
        }))
    });
    let title =
        "What each part is for: with all that the controller does, and with that part switched off";
    Sheet::of(title, &COLUMNS, rows.collect())
}

/// To three digits.
fn text(value: f64) -> String {
    let before_point = value.abs().log10().floor();
    let digits = (2.0 - before_point).clamp(0.0, 4.0) as usize;
    format!("{value:.digits$}")
}
