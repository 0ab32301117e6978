//! Tables for people: the same rows as text and as HTML.

use std::fmt::Write as _;

use cdcr_controller::nmpc::Coordinates;

use crate::budget;
use crate::growth::Growth;
use crate::page::escape;
use crate::simulation::{LineFigures, Outcome, Simulation};
use crate::solver::Case;

/// Cells with more letters than this are no words.
const SENTENCE: usize = 32;

/// Cells under heads; the first columns are words, the rest numbers.
pub struct Table {
    pub title: String,
    heads: Vec<String>,
    words: usize,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table whose first `words` columns are words. Each row has a cell for each head.
    pub fn new(
        title: impl Into<String>,
        heads: &[&str],
        words: usize,
        rows: Vec<Vec<String>>,
    ) -> Self {
        debug_assert!(rows.iter().all(|row| row.len() == heads.len()));
        Self {
            title: title.into(),
            heads: heads.iter().map(ToString::to_string).collect(),
            words,
            rows,
        }
    }

    pub fn text(&self) -> String {
        let width = |column: usize| {
            let cells = self.rows.iter().map(|row| row[column].chars().count());
            cells
                .chain([self.heads[column].chars().count()])
                .max()
                .unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.heads.len()).map(width).collect();
        let mut text = format!("{}\n", self.title);
        for row in std::iter::once(&self.heads).chain(&self.rows) {
            let mut line = String::new();
            for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
                let _ = if column < self.words {
                    write!(line, "{cell:<width$}  ")
                } else {
                    write!(line, "{cell:>width$}  ")
                };
            }
            let _ = writeln!(text, "{}", line.trim_end());
        }
        text
    }

    pub fn html(&self) -> String {
        let class = |column| {
            if column < self.words {
                "word"
            } else {
                "number"
            }
        };
        let mut html = format!(
            "<table>\n<caption>{}</caption>\n<thead><tr>",
            escape(&self.title)
        );
        for (column, head) in self.heads.iter().enumerate() {
            let (class, head) = (class(column), escape(head));
            let _ = write!(html, "<th scope=\"col\" class=\"{class}\">{head}</th>");
        }
        html.push_str("</tr></thead>\n<tbody>\n");
        for row in &self.rows {
            html.push_str("<tr>");
            for (column, cell) in row.iter().enumerate() {
                // A sentence may take several lines, a word may not.
                let long = if cell.chars().count() > SENTENCE {
                    " text"
                } else {
                    ""
                };
                let (class, cell) = (class(column), escape(cell));
                let _ = write!(html, "<td class=\"{class}{long}\">{cell}</td>");
            }
            html.push_str("</tr>\n");
        }
        html.push_str("</tbody>\n</table>\n");
        html
    }
}

/// One table for each of the paper's simulations that is among the outcomes.
pub fn simulations(outcomes: &[Outcome]) -> Vec<Table> {
    let of = |name: &str| -> Vec<&Simulation> {
        let rows = outcomes.iter().map(|outcome| &outcome.row);
        rows.filter(|row| row.name == name).collect()
    };
    vec![
        spiral(&of("spiral")),
        line(&of("line")),
        circle(&of("circle")),
    ]
}

fn spiral(rows: &[&Simulation]) -> Table {
    let cells = |row: &&Simulation| {
        let mut cells = names(row);
        cells.push(row.sections.to_string());
        cells.extend([error(row.mean_error_mm), error(row.max_error_mm)]);
        cells.push(optional(row.paper.mean_error_mm));
        cells.extend(times(row));
        cells
    };
    Table::new(
        "Simulation 1: spiral (Eq. 8)",
        &[
            "solver",
            "coordinates",
            "sections",
            "mean error mm",
            "max mm",
            "paper's mean mm",
            "mean µs",
            "p50 µs",
            "p99 µs",
            "paper's mean ms",
        ],
        2,
        rows.iter().map(cells).collect(),
    )
}

fn line(rows: &[&Simulation]) -> Table {
    let cells = |row: &&Simulation| {
        let mut cells = names(row);
        let line = row.line.as_ref();
        let own = |value: fn(&LineFigures) -> f64| optional(line.map(value));
        cells.push(line.map_or_else(String::new, |line| line.rate_limit_rad_s.to_string()));
        cells.extend([error(row.mean_error_mm), error(row.max_error_mm)]);
        cells.push(optional(row.paper.mean_error_mm));
        cells.extend([own(|l| l.max_theta_rad), own(|l| l.max_psi_rad)]);
        cells.extend(times(row));
        cells
    };
    Table::new(
        "Simulation 2: line with a vertical tip (Eq. 9), 3 sections",
        &[
            "solver",
            "coordinates",
            "limit rad/s",
            "mean error mm",
            "max mm",
            "paper's mean mm",
            "max |Θ| rad",
            "max |Ψ| rad",
            "mean µs",
            "p50 µs",
            "p99 µs",
            "paper's mean ms",
        ],
        2,
        rows.iter().map(cells).collect(),
    )
}

fn circle(rows: &[&Simulation]) -> Table {
    let cells = |row: &&Simulation| {
        let mut cells = names(row);
        let Some(circle) = &row.circle else {
            return cells;
        };
        cells.push(circle.safe_distance_mm.to_string());
        cells.push(format!("{:.4}", circle.min_clearance_mm));
        cells.push(optional(circle.mean_error_outside_mm));
        let peak_mm = circle.peak_error_mm;
        cells.push(peak_mm.map_or_else(|| "-".into(), |peak| format!("{peak:.2}")));
        cells.push(row.seeds.to_string());
        cells.extend(times(row));
        cells
    };
    Table::new(
        "Simulation 3: circle around an obstacle, 1 section",
        &[
            "solver",
            "coordinates",
            "D mm",
            "min clearance mm",
            "mean error outside mm",
            "peak mm",
            "seeds",
            "mean µs",
            "p50 µs",
            "p99 µs",
            "paper's mean ms",
        ],
        2,
        rows.iter().map(cells).collect(),
    )
}

fn names(row: &Simulation) -> Vec<String> {
    vec![row.solver.name().into(), coordinates(row).into()]
}

pub fn coordinates(row: &Simulation) -> &'static str {
    match row.coordinates {
        Coordinates::BendVector => "bend-vector",
        Coordinates::BendAngles => "bend-angles",
    }
}

fn times(row: &Simulation) -> [String; 4] {
    let us = |value: f64| format!("{value:.2}");
    [
        us(row.solve_us.mean),
        us(row.solve_us.p50),
        us(row.solve_us.p99),
        row.paper.mean_solve_ms.to_string(),
    ]
}

fn error(value: f64) -> String {
    format!("{value:.1e}")
}

fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), error)
}

/// All cases of the solver benchmark.
pub fn cases(cases: &[Case]) -> Table {
    let cells = |case: &Case| {
        vec![
            case.solver.name().into(),
            case.curve.into(),
            format!("{:?}", case.path).to_lowercase(),
            case.sections.to_string(),
            case.horizon.to_string(),
            case.swarm.to_string(),
            case.iterations.to_string(),
            case.obstacles.to_string(),
            format!("{:.2}", case.p50_us),
            format!("{:.2}", case.p99_us),
            format!("{:.1}x", case.speedup_vs_scalar),
        ]
    };
    Table::new(
        "Time of a solve on every path of this processor",
        &[
            "solver",
            "curve",
            "path",
            "sections",
            "horizon",
            "swarm",
            "iterations",
            "obstacles",
            "p50 µs",
            "p99 µs",
            "speed-up",
        ],
        3,
        cases.iter().map(cells).collect(),
    )
}

pub fn growth(growths: &[Growth]) -> Table {
    let cells = |growth: &Growth| {
        let factor = growth.factor_per_doubling;
        vec![
            growth.solver.name().into(),
            growth.per.name().into(),
            format!("{} to {}", growth.from, growth.to),
            format!("{:.2}", growth.p50_us_from),
            format!("{:.2}", growth.p50_us_to),
            format!("{:.3}", growth.us_per_unit),
            factor.map_or_else(|| "-".into(), |factor| format!("{factor:.2}x")),
        ]
    };
    Table::new(
        "Growth of the median on the fastest path, all else as in the paper's spiral with 3 sections",
        &[
            "solver",
            "per",
            "range",
            "first µs",
            "last µs",
            "µs for one more",
            "for twice as many",
        ],
        3,
        growths.iter().map(cells).collect(),
    )
}

pub fn budgets(rows: &[budget::Row]) -> Table {
    let cells = |row: &budget::Row| {
        let (over, bare) = (row.over_us, row.bare_over_us);
        let mut cells = vec![
            row.case.into(),
            row.budget_us.to_string(),
            row.solves.to_string(),
            format!("{:.1}", 100.0 * row.ended_by_budget_share),
        ];
        let times_us = [over.p50, over.p99, over.max, bare.p50, bare.p99, bare.max];
        cells.extend(times_us.map(|us| format!("{us:.2}")));
        cells.push(row.worse_than_warm_start.to_string());
        cells
    };
    Table::new(
        "How much later than its budget a solve ends, beside a loop without work",
        &[
            "case",
            "budget µs",
            "solves",
            "ended by it %",
            "over p50 µs",
            "p99 µs",
            "max µs",
            "bare p50 µs",
            "p99 µs",
            "max µs",
            "worse than warm start",
        ],
        1,
        rows.iter().map(cells).collect(),
    )
}
