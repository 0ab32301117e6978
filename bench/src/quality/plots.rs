//! Error and clearance against the budget, and who gets stuck, drawn.

use anyhow::Result;
use plotters::style::RGBColor;

use super::course::Course;
use super::problem::Field;
use super::report::{VariantRow, endings_of};
use super::restarts::{Contender, Ending, STUCK_SHARE};
use super::variant::{Axis, SOLVERS};
use crate::chart::{BLUE, Curve, DARK, GREEN, GREY, ORANGE, Panel, Scale, sheet};
use crate::dataset::Plot;
use crate::experiment::Solver;

const ERROR_FLOOR_MM: f64 = 1e-9;
/// Less above the best cost is drawn here \[%\].
const EXCESS_FLOOR_PERCENT: f64 = 1e-4;

pub(super) fn plots(rows: &[VariantRow], endings: &[Ending]) -> Result<Vec<Plot>> {
    let timed = |row: &&VariantRow| row.variant.axis == Axis::Budget;
    let rows: Vec<&VariantRow> = rows.iter().filter(timed).collect();
    let of_courses = |panel: fn(Course, &[&VariantRow]) -> Option<Panel>| -> Vec<Panel> {
        let all = Course::ALL.into_iter();
        all.filter_map(|course| panel(course, &rows)).collect()
    };
    let of_fields = Field::ALL.into_iter();
    let all = [
        (
            "quality-error",
            "Mean error against the time of a solve, median over the rounds. A swarm has as many particles and \
             iterations as it has time for.",
            of_courses(errors),
        ),
        (
            "quality-clearance",
            "Smallest clearance of the body against the time of a solve, worst of all rounds. The guard keeps \
             the robot from entering the safe distance by its own motion.",
            of_courses(clearances),
        ),
        (
            "quality-stuck",
            "Random starts, sorted by how far above the best known cost a solver ended. Where a curve crosses \
             the dark line, the rest to its right is stuck.",
            of_fields
                .filter_map(|field| excess(field, endings))
                .collect(),
        ),
    ];
    let drawn = all.into_iter().filter(|(_, _, panels)| !panels.is_empty());
    let plot = |(name, caption, panels): (_, _, Vec<Panel>)| {
        let svg = sheet(&panels, 2, 560)?;
        Ok(Plot { name, caption, svg })
    };
    drawn.map(plot).collect()
}

fn colour(solver: Solver) -> RGBColor {
    match solver {
        Solver::GaussNewton => ORANGE,
        Solver::KpsoRefined => BLUE,
        Solver::Kpso | Solver::KpsoVerbatim => GREEN,
    }
}

/// A value of each budget, for each solver; none when there are no rows.
fn curves(
    course: Course,
    rows: &[&VariantRow],
    across: fn(f64) -> f64,
    value: impl Fn(&VariantRow) -> Option<f64>,
) -> Option<Vec<Curve>> {
    let curve = |solver: Solver| {
        let of = |row: &&&VariantRow| row.variant.course == course && row.variant.solver == solver;
        let points = rows.iter().filter(of).filter_map(|row| {
            let budget_us = row.variant.budget_us?;
            Some((across(budget_us as f64), value(row)?))
        });
        Curve::line(solver.name(), points.collect(), colour(solver))
    };
    let any = |row: &&VariantRow| row.variant.course == course && value(row).is_some();
    rows.iter().any(any).then(|| SOLVERS.map(curve).into())
}

fn errors(course: Course, rows: &[&VariantRow]) -> Option<Panel> {
    Some(Panel {
        title: course.name().to_owned(),
        x: "budget [µs]",
        y: "mean error [mm]",
        scale: Scale::LogLog {
            floor: ERROR_FLOOR_MM,
        },
        curves: curves(course, rows, |us| us, |row| Some(row.metrics.mean_error_mm))?,
    })
}

fn clearances(course: Course, rows: &[&VariantRow]) -> Option<Panel> {
    let mut curves = curves(course, rows, f64::log10, |row| row.metrics.min_clearance_mm)?;
    let budgets = rows.iter().filter_map(|row| row.variant.budget_us);
    let (least, most) = budgets.fold((u64::MAX, 1), |(least, most), us| {
        (least.min(us), most.max(us))
    });
    let across = (least as f64).log10()..(most as f64).log10();
    let safe_mm = 1e3 * course.settings().safe_distance_m;
    curves.push(Curve::level("safe distance", safe_mm, across, DARK));
    Some(Panel {
        title: course.name().to_owned(),
        x: "budget [10^x µs]",
        y: "least clearance [mm]",
        scale: Scale::Linear,
        curves,
    })
}

fn excess(field: Field, endings: &[Ending]) -> Option<Panel> {
    let curve = |contender: Contender| {
        let mut excess: Vec<f64> = endings_of(endings, field, contender)
            .map(|ending| 100.0 * ending.excess_share())
            .collect();
        excess.sort_by(f64::total_cmp);
        let count = excess.len() as f64;
        let points = excess.iter().enumerate();
        let points = points.map(|(i, percent)| (100.0 * (i as f64 + 0.5) / count, *percent));
        let colour = match contender {
            Contender::GaussNewtonRestarted => GREY,
            other => colour(other.solver()),
        };
        Curve::line(contender.name(), points.collect(), colour)
    };
    endings_of(endings, field, Contender::Kpso).next()?;
    let mut curves: Vec<Curve> = Contender::ALL.map(curve).into();
    curves.push(Curve::level("stuck", 100.0 * STUCK_SHARE, 0.0..100.0, DARK));
    Some(Panel {
        title: format!("Between tip and target: {}", field.name()),
        x: "share of the problems [%]",
        y: "cost above the best [%]",
        scale: Scale::Log {
            floor: EXCESS_FLOOR_PERCENT,
        },
        curves,
    })
}
