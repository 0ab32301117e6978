//! The paper's figures and tables on one page.

use super::Page;
use crate::figures::Figure;
use crate::simulation::Outcome;
use crate::table;

pub(crate) const INTRODUCTION: &str = "\
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
    let mut page = Page::new("The paper's simulations");
    page.text(INTRODUCTION);
    let parts = HEADINGS.iter().zip(EXPLANATIONS);
    let contents = table::simulations(outcomes).into_iter().zip(figures);
    for ((heading, explanation), (table, figures)) in parts.zip(contents) {
        page.heading(heading, None);
        page.text(explanation);
        page.table(&table);
        for figure in figures {
            page.figure(figure.name, figure);
        }
    }
    page.end()
}
