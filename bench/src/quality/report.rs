//! Results of the runs as rows, plots and single numbers.

use anyhow::Result;
use serde_json::{Value, json};

use super::course::Course;
use super::restarts::{CONTENDERS, Contender, Field, STUCK_SHARE, arrives, excess_share, is_stuck};
use crate::chart::{Curve, DARK, Panel, Scale, of_rows, of_solvers};
use crate::dataset::{Dataset, by_rows, number, together};
use crate::metric::median;
use crate::study::Rounds;

pub(super) const PROBLEMS: &str = "problems";

/// Smaller errors count as equal in a comparison of two runs: a nanometre \[mm\].
const METRIC_FLOOR_MM: f64 = 1e-6;
/// Smaller errors and excess costs are drawn at these values \[mm, %\].
const ERRORS: Scale = Scale::LogLog { floor: 1e-14 };
const EXCESS: Scale = Scale::Log { floor: 1e-4 };

pub(super) fn dataset(rounds: u32, found: &Rounds) -> Result<Dataset> {
    let mut dataset = Dataset::new("quality", include_str!("quality.toml"));
    let mut rows = Vec::new();
    for axis in ["budget", "swarm", "horizon"] {
        let mut of_axis = Vec::new();
        for mut of_row in by_rows(found.get(axis)) {
            let row = together(&of_row, &["rounds".to_owned()]);
            for round in &mut of_row {
                if let Some(mm) = number(round, "mean_error_mm") {
                    round["mean_error_mm"] = mm.max(METRIC_FLOOR_MM).into();
                }
            }
            dataset.compare(axis, &row, &of_row);
            of_axis.push(row);
        }
        rows.extend_from_slice(&of_axis);
        dataset.add(axis, of_axis);
    }
    let of_rounds = found.get(PROBLEMS);
    let problems = of_rounds.concat();
    let mut stuck = Vec::new();
    for field in Field::ALL {
        for contender in &CONTENDERS {
            let path = format!("quality/restarts/{}/{}/stuck", field.name(), contender.name);
            let of_rounds = of_rounds.iter().map(|round| ended(round, field, contender));
            let percent = of_rounds.map(|rows| 100.0 * share(&rows, is_stuck));
            dataset.lower(path, "%", percent);
            stuck.extend(stuck_row(&ended(&problems, field, contender)));
        }
    }
    plot(&mut dataset, &rows, &problems)?;
    dataset.add("restarts", stuck);
    dataset.add("cases", rows);
    dataset.add(PROBLEMS, problems);
    dataset.fact("rounds", rounds);
    dataset.fact("stuck_above_share", STUCK_SHARE);
    Ok(dataset)
}

fn ended<'a>(problems: &'a [Value], field: Field, contender: &Contender) -> Vec<&'a Value> {
    let is_it = |row: &&Value| row["field"] == field.name() && row["contender"] == contender.name;
    problems.iter().filter(is_it).collect()
}

fn share(rows: &[&Value], is_so: fn(&Value) -> bool) -> f64 {
    rows.iter().filter(|row| is_so(row)).count() as f64 / rows.len() as f64
}

fn stuck_row(rows: &[&Value]) -> Option<Value> {
    let first = rows.first()?;
    let excess = || rows.iter().map(|row| excess_share(row));
    Some(json!({
        "field": first["field"],
        "contender": first["contender"],
        "problems": rows.len(),
        "stuck_share": share(rows, is_stuck),
        "missed_share": share(rows, |row| !arrives(row)),
        "excess_share_p50": median(excess()),
        "excess_share_max": excess().reduce(f64::max),
        "time_ms_p50": median(rows.iter().filter_map(|row| number(row, "time_ms"))),
    }))
}

fn plot(dataset: &mut Dataset, rows: &[Value], problems: &[Value]) -> Result<()> {
    let of_courses = |y, key, scale| -> Vec<Panel> {
        let panel = |course: &Course| panel(*course, rows, y, key, scale);
        Course::ALL.iter().filter_map(panel).collect()
    };
    let errors = of_courses("mean error [mm]", "mean_error_mm", ERRORS);
    let clearances = of_courses("least clearance [mm]", "min_clearance_mm", Scale::LogAcross);
    let excess = |field| excess(field, problems);
    let excess: Vec<Panel> = Field::ALL.into_iter().filter_map(excess).collect();
    dataset.plot("quality-error", &errors)?;
    dataset.plot("quality-clearance", &clearances)?;
    dataset.plot("quality-stuck", &excess)
}

/// A number over the budget of a solve, for each solver; `None` without measurements.
fn panel(
    course: Course,
    rows: &[Value],
    y: &'static str,
    key: &str,
    scale: Scale,
) -> Option<Panel> {
    let is_it = |row: &&Value| {
        row["axis"] == "budget" && row["course"] == course.name() && !row[key].is_null()
    };
    let rows: Vec<&Value> = rows.iter().filter(is_it).collect();
    let mut curves = of_solvers(|solver, colour| {
        let ours = rows.iter().filter(|row| row["solver"] == solver.name());
        of_rows(solver.name(), ours.copied(), "budget_us", key, colour)
    });
    if scale == Scale::LogAcross {
        let safe_mm = 1e3 * course.settings().safe_distance_m;
        let across = number(rows.first()?, "budget_us")?..number(rows.last()?, "budget_us")?;
        curves.push(Curve::level("safe distance", safe_mm, across, DARK));
    }
    let axes = ["budget [µs]", y];
    (!rows.is_empty()).then(|| Panel::new(course.name(), axes, scale, curves).tapered())
}

fn excess(field: Field, problems: &[Value]) -> Option<Panel> {
    let curve = |contender: &Contender| {
        let rows = ended(problems, field, contender);
        let mut percent: Vec<f64> = rows.iter().map(|row| 100.0 * excess_share(row)).collect();
        percent.sort_by(f64::total_cmp);
        let share = |index: usize| 100.0 * (index as f64 + 0.5) / rows.len() as f64;
        let points = percent.into_iter().enumerate();
        let points = points.map(|(index, percent)| (share(index), percent));
        Curve::line(contender.name, points.collect(), contender.colour)
    };
    let mut curves: Vec<Curve> = CONTENDERS.iter().map(curve).collect();
    curves.retain(|curve| !curve.is_empty());
    (!curves.is_empty()).then(|| {
        curves.push(Curve::level("stuck", 100.0 * STUCK_SHARE, 0.0..100.0, DARK));
        let title = format!("Between tip and target: {}", field.name());
        let axes = ["share of the problems [%]", "cost above the best [%]"];
        Panel::new(title, axes, EXCESS, curves)
    })
}
