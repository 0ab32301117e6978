//! Pictures of one run, as SVG.

mod error;
mod path;
mod shape;
mod timing;

pub(super) use error::error;
pub(super) use path::path;
pub(super) use shape::shape;
pub(super) use timing::timing;

use std::fs;
use std::path::Path;

use anyhow::Context;
use cdcr_chart::Panel;

/// Writes panels to a file; `size` is the number of columns and the height of a panel.
fn write(file: &Path, size: (usize, u32), panels: &[Panel]) -> anyhow::Result<()> {
    let svg = cdcr_chart::svg(size, panels)?;
    let name = file.file_name().unwrap_or_default();
    fs::write(file, svg).with_context(|| format!("cannot write {}", name.display()))
}

#[cfg(test)]
mod tests {
    use super::super::cycle::tests::synthetic;
    use super::super::report::tests::report;
    use super::super::shape::Backbone;
    use super::*;
    use cdcr_scratch::Scratch;
    use cdcr_shared_types::Status;

    #[test]
    fn pictures_have_titles_axes_and_units() {
        let folder = Scratch::temporary().expect("a folder");
        // Set this variable to keep the pictures for inspection.
        let folder = std::env::var_os("CDCR_KEEP_PICTURES")
            .map_or_else(|| folder.path().to_owned(), Into::into);
        let (cycles, spiral) = synthetic(994);
        let report = report(&cycles, &Status::default());
        path(&folder.join("path.svg"), &cycles, &spiral, &report).expect("drawn");
        error(&folder.join("error.svg"), &cycles, &report).expect("drawn");
        timing(&folder.join("timing.svg"), &cycles, &report, 5e3).expect("drawn");
        let backbone = Backbone::new(3).expect("the paper's");
        shape(
            &folder.join("shape.svg"),
            &cycles,
            &spiral,
            &backbone,
            &report,
        )
        .expect("drawn");
        let has = |file: &str, words: &[&str]| {
            let svg = fs::read_to_string(folder.join(file)).expect("written");
            for word in words {
                assert!(svg.contains(word), "{word} in {file}");
            }
        };
        has(
            "path.svg",
            &[
                "x [mm]",
                "y [mm]",
                "z [mm]",
                "3 sections",
                "tip",
                "reference",
            ],
        );
        has(
            "shape.svg",
            &[
                "x [mm]",
                "y [mm]",
                "z [mm]",
                "3 sections",
                "backbone",
                "reference",
                "every 0.5 s",
            ],
        );
        // Ten moments in 4.97 s: in each view their tips, and one in the legend.
        let svg = fs::read_to_string(folder.join("shape.svg")).expect("written");
        assert_eq!(svg.matches("<circle").count(), 2 * (10 + 1));
        for file in ["path.svg", "shape.svg", "error.svg", "timing.svg"] {
            has(file, &["simulated"]);
        }
        has("error.svg", &["time [s]", "error [mm]", "mean", "paper"]);
        has(
            "timing.svg",
            &[
                "wake-up",
                "solve",
                "response",
                "µs",
                "cycles",
                "deadline, 5000 µs",
            ],
        );
    }

    #[test]
    fn skipped_periods_break_the_line_and_have_a_legend_only_when_there_are_any() {
        let folder = Scratch::temporary().expect("a folder");
        let folder = std::env::var_os("CDCR_KEEP_PICTURES")
            .map_or_else(|| folder.path().to_owned(), Into::into);
        let (whole, _) = synthetic(400);
        let mut broken = whole.clone();
        broken.drain(100..104);
        broken[100].skipped_periods = 4;
        broken.drain(250..255);
        broken[250].skipped_periods = 5;
        // A lost record is a gap, too, but no skipped period.
        broken.remove(300);
        let draw = |cycles: &[_]| {
            let file = folder.join("gaps.svg");
            error(&file, cycles, &report(cycles, &Status::default())).expect("drawn");
            let svg = fs::read_to_string(file).expect("written");
            let blue = |line: &&str| line.contains("<polyline") && line.contains("#0072B2");
            (
                svg.lines().filter(blue).count(),
                svg.contains("skipped periods"),
            )
        };
        let (lines, is_marked) = draw(&whole);
        assert!(!is_marked);
        let (pieces, is_marked) = draw(&broken);
        assert!(is_marked);
        assert_eq!(pieces, lines + 3);
    }

    #[test]
    fn a_perfect_run_can_be_drawn() {
        let folder = Scratch::temporary().expect("a folder");
        let (mut cycles, spiral) = synthetic(1);
        cycles[0].error_m = 0.0;
        cycles[0].wake_us = 0.0;
        let report = report(&cycles, &Status::default());
        path(&folder.path().join("path.svg"), &cycles, &spiral, &report).expect("drawn");
        error(&folder.path().join("error.svg"), &cycles, &report).expect("drawn");
        let file = folder.path().join("timing.svg");
        timing(&file, &cycles, &report, 5e3).expect("drawn");
        // The ends of the scale have labels.
        let svg = fs::read_to_string(file).expect("written");
        assert!(svg.contains("\n0.1\n") && svg.contains("\n10000\n"));
        let backbone = Backbone::new(3).expect("the paper's");
        let file = folder.path().join("shape.svg");
        shape(&file, &cycles, &spiral, &backbone, &report).expect("drawn");
    }
}
