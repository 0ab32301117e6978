//! What the runs say, for people and for programs.

use anyhow::Result;
use serde::Serialize;

use super::problem::Field;
use super::restarts::{Contender, Ending, STUCK_SHARE};
use super::trial::Figures;
use super::variant::{Axis, Variant};
use super::{Case, pictures};
use crate::csv::csv;
use crate::figures::Figure;
use crate::metric::{Metric, median, range};
use crate::section::{Section, Sheet};
use crate::table::Table;

/// Errors below this are equal to people who compare two runs: a nanometre \[mm\].
const METRIC_FLOOR_MM: f64 = 1e-6;

#[derive(Debug)]
pub struct Report {
    pub rounds: u32,
    pub cases: Vec<Case>,
    pub endings: Vec<Vec<Ending>>,
}

/// One variant: medians over the rounds, but the worst error, clearance and time below the safe distance of
/// all of them.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Row {
    #[serde(flatten)]
    pub variant: Variant,
    pub rounds: usize,
    #[serde(flatten)]
    pub figures: Figures,
}

/// One contender in one field, over all rounds.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct StuckRow {
    pub field: Field,
    pub contender: Contender,
    pub problems: usize,
    /// Share that ended more than 1 % above the best known cost.
    pub stuck_share: f64,
    /// Share whose plan does not lead to within 10 mm of the target.
    pub missed_share: f64,
    /// Median excess over the best known cost, as a share of that.
    pub excess_share_p50: f64,
    pub excess_share_max: f64,
    /// Median time to the end \[ms\].
    pub time_ms_p50: f64,
}

#[derive(Serialize)]
struct Document<'a> {
    rounds: u32,
    cases: Vec<Row>,
    restarts: Vec<StuckRow>,
    stuck_above_share: f64,
    problems: Vec<&'a Ending>,
}

impl Case {
    pub(super) fn values(&self, value: impl Fn(&Figures) -> Option<f64>) -> Vec<f64> {
        self.rounds.iter().filter_map(value).collect()
    }

    fn row(&self) -> Row {
        let middle = |value: fn(&Figures) -> f64| {
            median(&self.values(|figures| Some(value(figures)))).unwrap_or(f64::NAN)
        };
        let ends = |value: fn(&Figures) -> Option<f64>| range(&self.values(value));
        let max_error_mm = ends(|f| Some(f.max_error_mm)).map_or(f64::NAN, |(_, most)| most);
        Row {
            variant: self.variant,
            rounds: self.rounds.len(),
            figures: Figures {
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

impl StuckRow {
    fn of(field: Field, contender: Contender, all: &[&Ending]) -> Self {
        let count = all.len();
        let share = |is: fn(&Ending) -> bool| {
            all.iter().filter(|ending| is(ending)).count() as f64 / count as f64
        };
        let values = |value: fn(&Ending) -> f64| -> Vec<f64> {
            all.iter().map(|ending| value(ending)).collect()
        };
        let excess = values(Ending::excess_share);
        Self {
            field,
            contender,
            problems: count,
            stuck_share: share(Ending::is_stuck),
            missed_share: share(|ending| !ending.arrives()),
            excess_share_p50: median(&excess).unwrap_or(f64::NAN),
            excess_share_max: range(&excess).map_or(f64::NAN, |(_, most)| most),
            time_ms_p50: median(&values(|ending| ending.time_ms)).unwrap_or(f64::NAN),
        }
    }
}

impl Report {
    pub fn rows(&self) -> Vec<Row> {
        self.cases.iter().map(Case::row).collect()
    }

    pub fn stuck_rows(&self) -> Vec<StuckRow> {
        let mut rows = Vec::new();
        for field in Field::ALL {
            for contender in Contender::ALL {
                let all: Vec<&Ending> = self.endings_of(field, contender).collect();
                if !all.is_empty() {
                    rows.push(StuckRow::of(field, contender, &all));
                }
            }
        }
        rows
    }

    /// The endings of a contender in a field, in all rounds.
    pub(super) fn endings_of(
        &self,
        field: Field,
        contender: Contender,
    ) -> impl Iterator<Item = &Ending> {
        let all = self.endings.iter().flatten();
        all.filter(move |ending| ending.field == field && ending.contender == contender)
    }

    fn axis_table(&self, axis: Axis) -> Table {
        let rows: Vec<Row> = self.rows();
        let rows = rows.iter().filter(|row| row.variant.axis == axis);
        Table::new(
            title(axis),
            &[
                "course",
                "solver",
                axis.name(),
                "mean error mm",
                "max mm",
                "least clearance mm",
                "too near ms",
                "guarded %",
                "mean cost",
                "cut short %",
                "solve p50 µs",
                "p99 µs",
            ],
            3,
            rows.map(cells).collect(),
        )
    }

    fn stuck_table(&self) -> Table {
        let cells = |row: &StuckRow| {
            let mut cells = vec![
                row.field.name().to_owned(),
                row.contender.name().to_owned(),
                row.problems.to_string(),
            ];
            let shares = [
                row.stuck_share,
                row.missed_share,
                row.excess_share_p50,
                row.excess_share_max,
            ];
            cells.extend(shares.map(percent));
            cells.push(format!("{:.1}", row.time_ms_p50));
            cells
        };
        Table::new(
            "Random starts: how often a solver ends more than 1 % above the best plan known",
            &[
                "between",
                "solver",
                "problems",
                "stuck %",
                "does not arrive %",
                "cost above the best p50 %",
                "max %",
                "time p50 ms",
            ],
            2,
            self.stuck_rows().iter().map(cells).collect(),
        )
    }
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

fn cells(row: &Row) -> Vec<String> {
    let (variant, figures) = (&row.variant, &row.figures);
    let optional = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    vec![
        variant.course.name().to_owned(),
        variant.solver.name().to_owned(),
        variant.value(),
        format!("{:.1e}", figures.mean_error_mm),
        format!("{:.1e}", figures.max_error_mm),
        optional(figures.min_clearance_mm, 2),
        optional(figures.below_safe_ms, 0),
        percent(figures.guarded_share),
        format!("{:.1e}", figures.mean_cost),
        percent(figures.cut_short_share),
        format!("{:.1}", figures.solve_p50_us),
        format!("{:.1}", figures.solve_p99_us),
    ]
}

fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

impl Section for Report {
    fn name(&self) -> &'static str {
        "quality"
    }

    fn heading(&self) -> &'static str {
        "What time buys"
    }

    fn explanation(&self) -> &'static str {
        "<p>The controller in a closed loop with an ideal robot, without a daemon, on three simulations of the \
         paper (their first seconds) and on three harder courses. In the gap the tip goes through \
         between two posts that leave 4 mm on either side of the body and its safe distance, and then to one \
         side. In the crossing a ball of 30 mm crosses the body at 0.2 m/s while the tip follows a line. In the \
         jump the reference steps by 0.15 m, and back. The wishes of the solver pass the limits and the \
         clearance guard, as in the daemon, so no motion of the robot brings it below the safe distance; how \
         often the guard had to intervene stands beside it.</p>\
         <p>With a budget, a solve has more work than it can do: 64 particles with up to 1000 iterations, up to \
         50 Gauss-Newton steps. With both, the swarm is sized to half of the budget by a measurement before the \
         run, because it goes first. These runs go by the clock of this machine, the others are repeatable to \
         the bit. Errors are medians over rounds with another seed each; the largest error, the smallest \
         clearance and the time below the safe distance are the worst of all rounds. Costs are those of the \
         chosen plans, judged afterwards; with another horizon they are sums over another number of steps.</p>\
         <p>Random starts are single problems: from a random shape at rest to a target 0.25 to 0.6 m away, \
         0.9 s ahead, with nothing, a ball, or three posts between. Each solver goes on from its own plan until \
         two solves bring no more than 0.01 %. The best plan of all of them counts as the optimum; nobody knows \
         whether there is a better one. A solver that ends more than 1 % above it is stuck: in a local minimum, or because its \
         steps became too small. The times are those to the end, and differ by solver.</p>"
    }

    fn json(&self) -> Result<serde_json::Value> {
        Ok(serde_json::to_value(Document {
            rounds: self.rounds,
            cases: self.rows(),
            restarts: self.stuck_rows(),
            stuck_above_share: STUCK_SHARE,
            problems: self.endings.iter().flatten().collect(),
        })?)
    }

    fn tables(&self) -> Vec<Table> {
        let axes = Axis::ALL.into_iter().map(|axis| self.axis_table(axis));
        let mut tables: Vec<Table> = axes.collect();
        tables.insert(1, self.stuck_table());
        tables
    }

    fn sheets(&self) -> Result<Vec<Sheet>> {
        let problems: Vec<&Ending> = self.endings.iter().flatten().collect();
        let sheet = |name: &str, csv| Sheet {
            name: name.to_owned(),
            csv,
        };
        Ok(vec![
            sheet("quality", csv(&self.rows())?),
            sheet("quality-restarts", csv(&self.stuck_rows())?),
            sheet("quality-problems", csv(&problems)?),
        ])
    }

    fn pictures(&self) -> Result<Vec<Figure>> {
        pictures::pictures(self)
    }

    fn metrics(&self) -> Vec<Metric> {
        let mut metrics = Vec::new();
        for case in &self.cases {
            let name = |what: &str| format!("quality/{}/{what}", case.variant.key());
            let errors_mm = case.values(|f| Some(f.mean_error_mm.max(METRIC_FLOOR_MM)));
            metrics.push(Metric::lower(name("mean_error"), "mm", errors_mm));
            let clearances_mm = case.values(|f| f.min_clearance_mm);
            if !clearances_mm.is_empty() {
                metrics.push(Metric::higher(name("least_clearance"), "mm", clearances_mm));
            }
        }
        for field in Field::ALL {
            for contender in Contender::ALL {
                let name = format!(
                    "quality/restarts/{}/{}/stuck",
                    field.name(),
                    contender.name()
                );
                let rounds = self.endings.iter().filter_map(|endings| {
                    let of = |e: &&Ending| e.field == field && e.contender == contender;
                    let all: Vec<&Ending> = endings.iter().filter(of).collect();
                    let row = StuckRow::of(field, contender, &all);
                    (!all.is_empty()).then_some(100.0 * row.stuck_share)
                });
                metrics.push(Metric::lower(name, "%", rounds));
            }
        }
        metrics
    }
}
