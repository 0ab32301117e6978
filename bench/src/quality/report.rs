//! What the runs say, as rows, plots and single numbers.

use anyhow::Result;
use serde::Serialize;
use serde_json::{Value, json};

use super::problem::Field;
use super::restarts::{Contender, Ending, STUCK_SHARE};
use super::trial::RunMetrics;
use super::variant::{Axis, Variant};
use super::{Case, plots};
use crate::dataset::{Column, Dataset, Sheet, fixed, percent, plain, power, word};
use crate::metric::{Better, Metric, median, range};

/// Errors below this are equal to people who compare two runs: a nanometre \[mm\].
const METRIC_FLOOR_MM: f64 = 1e-6;

const EXPLANATION: &str = "<p>The controller in a closed loop with an ideal robot, without a daemon: three simulations of the \
         paper (their first seconds), a gap between two posts, a ball that crosses the body, a reference that jumps. The \
         desired rates pass the limits and the clearance guard, as in the daemon.</p>\
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
#[derive(Debug, Clone, Serialize)]
pub(super) struct VariantRow {
    #[serde(flatten)]
    pub variant: Variant,
    pub value: String,
    pub rounds: usize,
    #[serde(flatten)]
    pub metrics: RunMetrics,
}

impl Case {
    fn values(&self, value: impl Fn(&RunMetrics) -> Option<f64>) -> impl Iterator<Item = f64> {
        self.rounds.iter().filter_map(value)
    }

    fn row(&self) -> VariantRow {
        let middle = |value: fn(&RunMetrics) -> f64| {
            median(self.values(|metrics| Some(value(metrics)))).unwrap_or(f64::NAN)
        };
        let ends = |value: fn(&RunMetrics) -> Option<f64>| range(self.values(value));
        let max_error_mm = ends(|f| Some(f.max_error_mm)).map_or(f64::NAN, |(_, most)| most);
        VariantRow {
            variant: self.variant,
            value: self.variant.value(),
            rounds: self.rounds.len(),
            metrics: RunMetrics {
                mean_error_mm: middle(|f| f.mean_error_mm),
                max_error_mm,
                min_clearance_mm: ends(|f| f.min_clearance_mm).map(|(least, _)| least),
                below_safe_ms: ends(|f| f.below_safe_ms).map(|(_, most)| most),
                mean_cost: middle(|f| f.mean_cost),
                cut_short_share: middle(|f| f.cut_short_share),
                guarded_share: middle(|f| f.guarded_share),
                solve_p50_us: middle(|f| f.solve_p50_us),
                solve_p99_us: middle(|f| f.solve_p99_us),
            },
        }
    }
}

/// The endings of a contender in a field.
pub(super) fn endings_of(
    endings: &[Ending],
    field: Field,
    contender: Contender,
) -> impl Iterator<Item = &Ending> {
    let is_it = move |ending: &&Ending| ending.field == field && ending.contender == contender;
    endings.iter().filter(is_it)
}

/// One contender in one field, over all rounds.
fn stuck_row(endings: &[Ending], field: Field, contender: Contender) -> Option<Value> {
    let all: Vec<&Ending> = endings_of(endings, field, contender).collect();
    let share =
        |is: fn(&Ending) -> bool| all.iter().filter(|e| is(e)).count() as f64 / all.len() as f64;
    let values = |value: fn(&Ending) -> f64| all.iter().map(move |ending| value(ending));
    let (_, excess_share_max) = range(values(Ending::excess_share))?;
    Some(json!({
        "field": field,
        "contender": contender,
        "problems": all.len(),
        // Share that ended more than 1 % above the best known cost.
        "stuck_share": share(Ending::is_stuck),
        // Share whose plan does not lead to within 10 mm of the target.
        "missed_share": share(|ending| !ending.arrives()),
        // Excess over the best known cost, as a share of that.
        "excess_share_p50": median(values(Ending::excess_share)),
        "excess_share_max": excess_share_max,
        "time_ms_p50": median(values(|ending| ending.time_ms)),
    }))
}

/// Of every variant, course by course, and the endings of every round.
pub(super) fn dataset(cases: &[Case], rounds: &[Vec<Ending>]) -> Result<Dataset> {
    let mut dataset = Dataset {
        name: "quality",
        heading: "What time buys",
        explanation: EXPLANATION,
        ..Dataset::default()
    };
    for case in cases {
        let name = |what: &str| format!("quality/{}/{what}", case.variant.key());
        let errors_mm = case.values(|f| Some(f.mean_error_mm.max(METRIC_FLOOR_MM)));
        dataset.lower(name("mean_error"), "mm", errors_mm);
        let clearances_mm = case.values(|f| f.min_clearance_mm);
        let metric = Metric::new(name("least_clearance"), "mm", Better::Higher, clearances_mm);
        dataset
            .metrics
            .extend(Some(metric).filter(|metric| !metric.rounds.is_empty()));
    }
    let endings = rounds.concat();
    let mut stuck = Vec::new();
    for (field, contender) in Field::ALL
        .iter()
        .flat_map(|f| Contender::ALL.map(|c| (*f, c)))
    {
        let name = format!(
            "quality/restarts/{}/{}/stuck",
            field.name(),
            contender.name()
        );
        let shares = rounds.iter().filter_map(|endings| {
            let row = stuck_row(endings, field, contender)?;
            Some(100.0 * row["stuck_share"].as_f64()?)
        });
        dataset.lower(name, "%", shares);
        stuck.extend(stuck_row(&endings, field, contender));
    }
    let rows: Vec<VariantRow> = cases.iter().map(Case::row).collect();
    for axis in Axis::ALL {
        let rows: Vec<&VariantRow> = rows.iter().filter(|row| row.variant.axis == axis).collect();
        let sheet = Sheet::new(&rows)?.table(title(axis), &columns(axis));
        dataset.sheets.push(sheet);
    }
    let restarts = Sheet::new(&stuck)?
        .key("restarts")
        .file("quality-restarts")
        .table(
            "Random starts: how often a solver ends more than 1 % above the best plan known",
            &STUCK,
        );
    dataset.sheets.insert(1, restarts);
    dataset.sheets.push(
        Sheet::new(&rows)?
            .key("cases")
            .file("quality")
            .order(&columns(Axis::Budget)),
    );
    let problems = Sheet::new(&endings)?
        .key("problems")
        .file("quality-problems");
    dataset.sheets.push(problems);
    dataset.plots = plots::plots(&rows, &endings)?;
    dataset.fact("rounds", rounds.len());
    dataset.fact("stuck_above_share", STUCK_SHARE);
    Ok(dataset)
}
