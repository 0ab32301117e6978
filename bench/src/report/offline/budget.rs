//! How late a solve ends after its budget, as a result: several rounds over all budgets.

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::budget::{self, BUDGETS_US, Overrun, Row};
use crate::chart::{BLUE, Curve, GREEN, GREY, Panel, Scale, sheet};
use crate::csv::csv;
use crate::figures::Figure;
use crate::interrupt;
use crate::metric::{Metric, median};
use crate::progress::Progress;
use crate::section::{Section, Sheet};
use crate::table::{self, Table};

/// What a solve takes beside its budget and the wait before it, about \[s\].
const AROUND_S: f64 = 3e-4;
/// Names of the cases, for the time that they take.
const CASES: usize = 3;

const EXPLANATION: &str = "\
<p>A solve asks a clock whether its budget is spent, and hands over the best solution so far when it is. \
This is how much later than the budget it ends; 0 where it ended earlier. Before each solve a loop without \
work waits for the same budget in the same way: what that loop is late by is the machine's, the rest the \
solver's. No plan may cost more than the warm start. Times are medians of the rounds, the largest of all \
rounds.</p>\n";

#[derive(Debug, Clone, Copy)]
pub struct Options {
    pub rounds: u32,
    /// Solves of each case with each budget in each round.
    pub solves: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            rounds: 3,
            solves: 700,
        }
    }
}

impl Options {
    pub fn quick() -> Self {
        Self {
            rounds: 1,
            solves: 50,
        }
    }
}

/// About how long it takes \[s\].
pub fn expected_s(options: &Options) -> f64 {
    let budgets = BUDGETS_US.iter().map(|us| of_budget_s(*us, options.solves));
    f64::from(options.rounds) * CASES as f64 * budgets.sum::<f64>()
}

/// Twice the budget: once without work.
fn of_budget_s(budget_us: u64, solves: u64) -> f64 {
    solves as f64 * (2e-6 * budget_us as f64 + AROUND_S)
}

/// Measures every case with every budget, round by round.
pub fn run(options: &Options, progress: &mut Progress) -> Result<Report> {
    let cases = budget::cases()?;
    let mut rounds = Vec::new();
    for round in 1..=options.rounds {
        let mut rows = Vec::new();
        for case in &cases {
            for budget_us in BUDGETS_US {
                interrupt::check()?;
                progress.begin(&format!("round {round} of {}", options.rounds));
                rows.push(case.measure(budget_us, options.solves)?);
                progress.advance(of_budget_s(budget_us, options.solves));
            }
        }
        rounds.push(rows);
    }
    Report::of(rounds)
}

#[derive(Debug)]
pub struct Report {
    /// The rows of each round, in the same order.
    rounds: Vec<Vec<Row>>,
    rows: Vec<Row>,
}

impl Report {
    fn of(rounds: Vec<Vec<Row>>) -> Result<Self> {
        let first = rounds.first().context("at least one round is needed")?;
        let together = |index: usize| {
            let rows: Vec<&Row> = rounds.iter().map(|rows| &rows[index]).collect();
            let shares: Vec<f64> = rows.iter().map(|row| row.ended_by_budget_share).collect();
            Row {
                solves: rows.iter().map(|row| row.solves).sum(),
                ended_by_budget_share: shares.iter().sum::<f64>() / shares.len() as f64,
                over_us: overrun(rows.iter().map(|row| row.over_us)),
                bare_over_us: overrun(rows.iter().map(|row| row.bare_over_us)),
                worse_than_warm_start: rows.iter().map(|row| row.worse_than_warm_start).sum(),
                ..rows[0].clone()
            }
        };
        Ok(Self {
            rows: (0..first.len()).map(together).collect(),
            rounds,
        })
    }

    fn panels(&self) -> Vec<Panel> {
        let mut names: Vec<&str> = self.rows.iter().map(|row| row.case).collect();
        names.dedup();
        let panel = |name: &str| {
            let curve = |label: &str, colour, value: fn(&Row) -> f64| {
                let rows = self.rows.iter().filter(|row| row.case == name);
                let points = rows.map(|row| (row.budget_us as f64, value(row))).collect();
                Curve::line(label, points, colour)
            };
            Panel {
                title: format!("Case {name}"),
                x: "budget [µs]",
                y: "later than the budget [µs]",
                scale: Scale::Log { floor: 0.01 },
                curves: vec![
                    curve("solve, p99", BLUE, |row| row.over_us.p99),
                    curve("solve, p50", GREEN, |row| row.over_us.p50),
                    curve("without work, p99", GREY, |row| row.bare_over_us.p99),
                ],
            }
        };
        names.into_iter().map(panel).collect()
    }
}

/// Medians of the rounds, and the largest of all.
fn overrun(rounds: impl Iterator<Item = Overrun>) -> Overrun {
    let rounds: Vec<Overrun> = rounds.collect();
    let middle = |value: fn(&Overrun) -> f64| {
        let values: Vec<f64> = rounds.iter().map(value).collect();
        median(&values).unwrap_or(f64::NAN)
    };
    Overrun {
        p50: middle(|over| over.p50),
        p99: middle(|over| over.p99),
        max: rounds.iter().fold(0.0, |max, over| over.max.max(max)),
    }
}

impl Section for Report {
    fn name(&self) -> &'static str {
        "budget"
    }

    fn heading(&self) -> &'static str {
        "How exactly a solve keeps its budget, offline"
    }

    fn explanation(&self) -> &'static str {
        EXPLANATION
    }

    fn json(&self) -> Result<Value> {
        Ok(json!({ "rounds": self.rounds.len(), "cases": self.rows }))
    }

    fn tables(&self) -> Vec<Table> {
        vec![table::budgets(&self.rows)]
    }

    fn sheets(&self) -> Result<Vec<Sheet>> {
        Ok(vec![Sheet {
            name: "budget".to_owned(),
            csv: csv(&self.rows)?,
        }])
    }

    fn pictures(&self) -> Result<Vec<Figure>> {
        Ok(vec![Figure {
            name: "budget-overrun",
            caption: "How much later than its budget a solve ends, beside a loop that only waits."
                .to_owned(),
            svg: sheet(&self.panels(), 2, 520)?,
        }])
    }

    fn metrics(&self) -> Vec<Metric> {
        let of = |(index, row): (usize, &Row)| {
            let each = |value: fn(&Row) -> f64| {
                let rounds = self.rounds.iter();
                rounds.map(move |rows| value(&rows[index]))
            };
            let path = format!("budget/{}/{}us", row.case, row.budget_us);
            [
                Metric::lower(
                    format!("{path}/over_p50"),
                    "µs",
                    each(|row| row.over_us.p50),
                ),
                Metric::lower(
                    format!("{path}/over_p99"),
                    "µs",
                    each(|row| row.over_us.p99),
                ),
            ]
        };
        self.rows.iter().enumerate().flat_map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(p99: f64, max: f64, share: f64) -> Row {
        let over = Overrun { p50: 1.0, p99, max };
        Row {
            case: "default",
            budget_us: 10,
            solves: 5,
            ended_by_budget_share: share,
            over_us: over,
            bare_over_us: over,
            worse_than_warm_start: 0,
        }
    }

    #[test]
    fn rounds_are_put_together() {
        let rounds = [row(3.0, 9.0, 1.0), row(1.0, 90.0, 0.5), row(2.0, 5.0, 0.0)];
        let report = Report::of(rounds.map(|row| vec![row]).to_vec()).expect("rounds");
        let all = &report.rows[0];
        assert_eq!((all.solves, all.ended_by_budget_share), (15, 0.5));
        assert_eq!((all.over_us.p99, all.over_us.max), (2.0, 90.0));
        assert_eq!(report.metrics()[1].rounds, [3.0, 1.0, 2.0]);
    }

    #[test]
    fn the_cases_are_as_many_as_the_expectation_counts() {
        assert_eq!(budget::cases().expect("cases").len(), CASES);
    }
}
