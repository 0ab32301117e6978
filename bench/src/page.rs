//! One self-contained page: tables beside the paper's figures, and all pictures inside.

use std::fmt::Write as _;

use crate::figures::Figure;
use crate::simulation::Outcome;
use crate::table;

const STYLE: &str = "\
:root { color-scheme: light; }
body { max-width: 62rem; margin: 2rem auto; padding: 0 1.2rem; background: #fff; color: #1a1a1a;
  font: 16px/1.5 system-ui, sans-serif; }
h1, h2 { line-height: 1.2; }
h2 { margin-top: 3rem; border-bottom: 1px solid #ccc; }
figure { margin: 1.5rem 0; }
figure svg { display: block; width: 100%; height: auto; }
figcaption, caption { color: #333; font-size: 0.92rem; text-align: left; padding: 0.3rem 0; }
caption { font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.82rem; margin: 1rem 0; width: 100%; }
th, td { padding: 0.2rem 0.5rem; border-bottom: 1px solid #ddd; white-space: nowrap; }
th { white-space: normal; text-align: right; vertical-align: bottom; border-bottom: 2px solid #888; }
th:nth-child(-n+2), td.word { text-align: left; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
@media print {
  body { max-width: none; margin: 0; font-size: 10pt; }
  figure, tr { break-inside: avoid; }
  h2 { break-before: page; }
  .wide { overflow: visible; }
  table { font-size: 7pt; }
}
";

const INTRODUCTION: &str = "\
<p>What <code>cdcr-bench paper</code> measured: the three simulations of <em>Nonlinear Model Predictive \
Control for Trajectory Tracking of a Class of Continuum Robots</em>, each with the paper's parameters and \
four solvers, beside what the paper states. <code>kpso</code> is the knowledge-based swarm with an inertia \
weight, <code>kpso-verbatim</code> the same with Eq. 6 as printed, <code>gauss-newton</code> damped \
Gauss-Newton steps alone, and <code>kpso-refined</code> those steps after the swarm. Controls are the rates \
of the bend vectors or of the paper's angles.</p>\n\
<p>An error is the distance of the tip from the exact reference at the end of a cycle; the mean of a run \
is taken over all its samples, and of several seeds the median is shown. The time of a solve is that of \
one call, back to back, on the machine that made this page, and the paper's that of MATLAB on an \
i3-2310M. The pictures show the first seed.</p>\n";

const EXPLANATIONS: [&str; 3] = [
    "<p>One, two and three sections follow the spiral that the last section reaches while those below it \
     stay straight: 994 samples of 5 ms, N = 2, 6 particles and 30 iterations.</p>\n",
    "<p>Three sections follow a line from the straight robot, with the tip vertical: 510 samples of 5 ms, \
     N = 2, 15 particles and 70 iterations. The paper names no limit on the rates, so there are two. A \
     straight robot cannot move along its own axis, and the line goes down at once: with any limit the \
     first samples are late, and the less, the faster the sections may bend.</p>\n",
    "<p>One section comes from straight to a circle and goes round once, with a point in its way at \
     t = π/2 from which the whole body keeps the distance D: N = 20, 6 particles and 30 iterations. The paper \
     names neither D nor an error. Outside means after the approach (the error was below 0.02 mm once) and \
     where the reference is at least 2 D from the obstacle; the peak is the largest error after the \
     approach. The printed constants of the circle are rounded, which alone leaves 7.2e-3 mm.</p>\n",
];

const HEADINGS: [&str; 3] = [
    "Simulation 1: a spiral",
    "Simulation 2: a line with a vertical tip",
    "Simulation 3: a circle with an obstacle",
];

/// The page.
pub fn page(outcomes: &[Outcome], figures: &[Vec<Figure>; 3]) -> String {
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>The paper's simulations</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <h1>The paper's simulations</h1>\n{INTRODUCTION}"
    );
    let parts = HEADINGS.iter().zip(EXPLANATIONS);
    let contents = table::simulations(outcomes).into_iter().zip(figures);
    for ((heading, explanation), (table, figures)) in parts.zip(contents) {
        let _ = write!(
            html,
            "<h2>{heading}</h2>\n{explanation}<div class=\"wide\">\n{}</div>\n",
            table.html()
        );
        for figure in figures {
            let _ = write!(
                html,
                "<figure id=\"{}\">\n{}\n<figcaption>{}</figcaption>\n</figure>\n",
                figure.name,
                figure.svg.trim(),
                figure.caption
            );
        }
    }
    html.push_str("</body>\n</html>\n");
    html
}
