//! What the runs say, as rows, plots and single numbers.

use anyhow::Result;
use plotters::style::RGBColor;
use serde_json::{Value, json};

use super::Case;
use super::course::Course;
use super::problem::Field;
use super::restarts::{Contender, Ending, STUCK_SHARE};
use super::variant::{Axis, SOLVERS};
use crate::chart::{BLUE, Curve, DARK, GREEN, GREY, ORANGE, Panel, SKY, Scale, YELLOW, plot};
use crate::dataset::{
    Column, Dataset, Plot, Sheet, each, fixed, joined, number, percent, plain, power, together,
    word,
};
use crate::experiment::Solver;
use crate::metric::median;

/// Errors below this are equal to people who compare two runs: a nanometre \[mm\].
const METRIC_FLOOR_MM: f64 = 1e-6;
/// Errors and excess costs below these are drawn on them \[mm, %\].
const ERROR_FLOOR_MM: f64 = 1e-9;
const EXCESS_FLOOR_PERCENT: f64 = 1e-4;

const EXPLANATION: &str = "<p>The controller in a closed loop with an ideal robot, without a daemon: three simulations of the \
         paper (their first seconds), a gap between two posts, a ball that crosses the body, a reference that jumps. The \
         desired rates pass the limits and the clearance guard of the daemon, for a robot that gets every command and stops at once.</p>\
         <p>With a budget, a solve has more work than it can do, and ends by the clock of this machine; the other runs are \
         repeatable to the bit. Errors are medians over rounds with another seed each; the largest error, the smallest \
         clearance and the time below the safe distance are the worst of all rounds. Costs are those of the \
         chosen plans; with another horizon they are sums over another number of steps.</p>\
         <p>Random starts are single problems from a random shape at rest to a target 0.25 to 0.6 m away, with nothing, \
         a ball, or three posts between. The best plan of all solvers counts as the optimum; nobody knows whether there is \
         a better one. A solver that ends more than 1 % above it is stuck.</p>";

const STUCK: [Column; 8] = [
    word("between", "field"),
    word("solver", "contender"),
    plain("problems", "problems"),
    percent("stuck %", "stuck_share", 1),
    percent("does not arrive %", "missed_share", 1),
    percent("cost above the best p50 %", "excess_share_p50", 1),
    percent("max %", "excess_share_max", 1),
    fixed("time p50 ms", "time_ms_p50", 1),
];

fn columns(axis: Axis) -> [Column; 12] {
    [
        word("course", "course"),
        word("solver", "solver"),
        word(axis.name(), "value"),
        power("mean error mm", "mean_error_mm"),
        power("max mm", "max_error_mm"),
        fixed("least clearance mm", "min_clearance_mm", 2),
        fixed("too near ms", "below_safe_ms", 0),
        percent("guarded %", "guarded_share", 1),
        power("mean cost", "mean_cost"),
        percent("cut short %", "cut_short_share", 1),
        fixed("solve p50 µs", "solve_p50_us", 1),
        fixed("p99 µs", "solve_p99_us", 1),
    ]
}

fn title(axis: Axis) -> &'static str {
    match axis {
        Axis::Budget => "What the time of a solve buys (on the clock)",
        Axis::Swarm => "What particles and iterations buy (without a budget)",
        Axis::Horizon => {
            "What a longer horizon buys (without a budget, with the swarm of the course)"
        }
    }
}

/// One variant: medians over the rounds, but the worst error, clearance and time below the safe distance of
/// all of them.
fn variant_row(case: &Case) -> Value {
    let own = json!({
        "value": case.variant.value(),
        "rounds": case.rounds.len(),
        "below_safe_ms": each(&case.rounds, "below_safe_ms").reduce(f64::max),
    });
    joined([json!(case.variant), together(&case.rounds, &[]), own])
}

fn endings_of(endings: &[Ending], field: Field, contender: Contender) -> Vec<&Ending> {
    let is_it = |ending: &&Ending| ending.field == field && ending.contender == contender;
    endings.iter().filter(is_it).collect()
}

fn stuck_share(all: &[&Ending]) -> f64 {
    all.iter().filter(|ending| ending.is_stuck()).count() as f64 / all.len() as f64
}

fn stuck_row(all: &[&Ending]) -> Option<Value> {
    let first = all.first()?;
    let excess = || all.iter().map(|ending| ending.excess_share());
    let missed = all.iter().filter(|ending| !ending.arrives()).count();
    Some(json!({
        "field": first.field,
        "contender": first.contender,
        "problems": all.len(),
        // Share that ended more than 1 % above the best known cost.
        "stuck_share": stuck_share(all),
        // Share whose plan does not lead to within 10 mm of the target.
        "missed_share": missed as f64 / all.len() as f64,
        // Excess over the best known cost, as a share of that.
        "excess_share_p50": median(excess()),
        "excess_share_max": excess().reduce(f64::max),
        "time_ms_p50": median(all.iter().map(|ending| ending.time_ms)),
    }))
}

/// Of every variant, course by course, and the endings of every round.
pub(super) fn dataset(cases: &[Case], rounds: &[Vec<Ending>]) -> Result<Dataset> {
    let mut dataset = Dataset::new("quality", "What time buys", EXPLANATION);
    for case in cases {
        let name = |what: &str| format!("quality/{}/{what}", case.variant.key());
        let errors_mm = each(&case.rounds, "mean_error_mm").map(|mm| mm.max(METRIC_FLOOR_MM));
        dataset.lower(name("mean_error"), "mm", errors_mm);
        let clearances_mm = each(&case.rounds, "min_clearance_mm");
        dataset.higher(name("least_clearance"), "mm", clearances_mm);
    }
    let endings = rounds.concat();
    let mut stuck = Vec::new();
    for field in Field::ALL {
        for contender in Contender::ALL {
            let of = |endings| endings_of(endings, field, contender);
            let name = format!(
                "quality/restarts/{}/{}/stuck",
                field.name(),
                contender.name()
            );
            let shares = rounds
                .iter()
                .map(|endings| 100.0 * stuck_share(&of(endings)));
            dataset.lower(name, "%", shares);
            stuck.extend(stuck_row(&of(&endings)));
        }
    }
    let rows: Vec<Value> = cases.iter().map(variant_row).collect();
    for axis in Axis::ALL {
        let of_axis = rows.iter().filter(|row| row["axis"] == axis.name());
        let table = Sheet::of(title(axis), &columns(axis), of_axis.cloned().collect());
        dataset.sheets.push(table);
    }
    let restarts = "Random starts: how often a solver ends more than 1 % above the best plan known";
    let restarts = Sheet::of(restarts, &STUCK, stuck)
        .key("restarts")
        .file("quality-restarts");
    dataset.sheets.insert(1, restarts);
    dataset.plots = plots(&rows, &endings)?;
    let problems: Vec<Value> = endings.iter().map(|ending| json!(ending)).collect();
    dataset.sheets.push(
        Sheet::of("", &columns(Axis::Budget), rows)
            .key("cases")
            .file("quality"),
    );
    dataset.sheets.push(
        Sheet::of("", &[], problems)
            .key("problems")
            .file("quality-problems"),
    );
    dataset.fact("rounds", rounds.len());
    dataset.fact("stuck_above_share", STUCK_SHARE);
    Ok(dataset)
}

fn plots(rows: &[Value], endings: &[Ending]) -> Result<Vec<Plot>> {
    let of_courses = |y, key, scale| -> Vec<Panel> {
        let panel = |course: &Course| panel(*course, rows, y, key, scale);
        Course::ALL.iter().filter_map(panel).collect()
    };
    let errors = Scale::LogLog {
        floor: ERROR_FLOOR_MM,
    };
    let excess = Field::ALL
        .iter()
        .filter_map(|field| excess(*field, endings));
    let all: [(_, _, Vec<Panel>); 3] = [
        (
            "quality-error",
            "Mean error against the time of a solve, median over the rounds. A swarm has as many particles and \
             iterations as it has time for.",
            of_courses("mean error [mm]", "mean_error_mm", errors),
        ),
        (
            "quality-clearance",
            "Smallest clearance of the body against the time of a solve, worst of all rounds. The guard keeps \
             the robot from entering the safe distance by its own motion.",
            of_courses("least clearance [mm]", "min_clearance_mm", Scale::LogAcross),
        ),
        (
            "quality-stuck",
            "Random starts, sorted by how far above the best known cost a solver ended. Where a curve crosses \
             the dark line, the rest to its right is stuck.",
            excess.collect(),
        ),
    ];
    let drawn = all.into_iter().filter(|(_, _, panels)| !panels.is_empty());
    drawn
        .map(|(name, caption, panels)| plot(name, caption, (2, 560), &panels))
        .collect()
}

fn colour(solver: Solver) -> RGBColor {
    match solver {
        Solver::GaussNewton => ORANGE,
        Solver::KpsoRefined => BLUE,
        Solver::Kpso | Solver::KpsoVerbatim => GREEN,
    }
}

/// A number against the budget of a solve, for each solver; none where nothing of it was measured.
fn panel(
    course: Course,
    rows: &[Value],
    y: &'static str,
    key: &str,
    scale: Scale,
) -> Option<Panel> {
    let is_it = |row: &&Value| {
        row["axis"] == Axis::Budget.name() && row["course"] == course.name() && !row[key].is_null()
    };
    let rows: Vec<&Value> = rows.iter().filter(is_it).collect();
    let curve = |solver: Solver| {
        let ours = rows
            .iter()
            .copied()
            .filter(|row| row["solver"] == solver.name());
        Curve::of_rows(solver.name(), ours, "budget_us", key, colour(solver))
    };
    let mut curves: Vec<Curve> = SOLVERS.map(curve).into();
    let across = number(rows.first()?, "budget_us")?..number(rows.last()?, "budget_us")?;
    if scale == Scale::LogAcross {
        let safe_mm = 1e3 * course.settings().safe_distance_m;
        curves.push(Curve::level("safe distance", safe_mm, across, DARK));
    }
    Some(Panel::new(course.name(), ["budget [µs]", y], scale, curves))
}

fn excess(field: Field, endings: &[Ending]) -> Option<Panel> {
    let curve = |contender: Contender| {
        let all = endings_of(endings, field, contender);
        let mut excess: Vec<f64> = all
            .iter()
            .map(|ending| 100.0 * ending.excess_share())
            .collect();
        excess.sort_by(f64::total_cmp);
        let share = |index: usize| 100.0 * (index as f64 + 0.5) / all.len() as f64;
        let points = excess
            .iter()
            .enumerate()
            .map(|(index, percent)| (share(index), *percent));
        let colour = match contender {
            Contender::GaussNewtonRestarted => GREY,
            Contender::KpsoRefined20Ms => SKY,
            Contender::KpsoRefined5Ms => YELLOW,
            other => colour(other.solver()),
        };
        Curve::line(contender.name(), points.collect(), colour)
    };
    endings.iter().find(|ending| ending.field == field)?;
    let mut curves: Vec<Curve> = Contender::ALL.map(curve).into();
    curves.push(Curve::level("stuck", 100.0 * STUCK_SHARE, 0.0..100.0, DARK));
    Some(Panel::new(
        format!("Between tip and target: {}", field.name()),
        ["share of the problems [%]", "cost above the best [%]"],
        Scale::Log {
            floor: EXCESS_FLOOR_PERCENT,
        },
        curves,
    ))
}
