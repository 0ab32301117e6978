//! Results of `cdcr-bench paper`, from runs of a few cycles.

use std::path::Path;

use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::dataset::Dataset;
use cdcr_bench::experiment::{Experiment, Task};
use cdcr_bench::paper::{Effort, run};
use cdcr_bench::progress::Progress;
use cdcr_bench::report::Start;
use cdcr_bench::run_options::RunOptions;
use cdcr_controller::nmpc::{Coordinates, SolverKind};
use cdcr_scratch::Scratch;

use crate::{dataset_is_sound, needs_nothing_else, number};

const QUICK: Effort = Effort {
    seeds: 1,
    cycles_max: 12,
};

fn report(effort: Effort) -> Dataset {
    effort.run(&mut Progress::silent()).expect("all run")
}

#[test]
fn every_experiment_has_a_row_with_the_fields_of_its_simulation() {
    let report = report(QUICK);
    let rows = report.rows("simulations");
    assert_eq!(rows.len(), Experiment::all().len());
    for row in rows {
        let own: &[&str] = match row["name"].as_str() {
            Some("spiral") => &["max_error_mm"],
            Some("line") => &["max_psi_rad", "max_theta_rad", "rate_limit_rad_s"],
            _ => &["min_clearance_mm", "safe_distance_mm"],
        };
        assert!(own.iter().all(|key| row[key].is_f64()), "{row}");
        let is_circle = row["name"] == "circle";
        let is_clearest = row["solver"] == "kpso-refined" && is_circle;
        assert_eq!(row["seeds"], if is_clearest { 20 } else { 1 }, "{row}");
        // The tip does not reach the circle in a few cycles, so there is neither mean nor peak.
        assert!(row["mean_error_outside_mm"].is_null() && row["peak_error_mm"].is_null());
        assert_eq!(row["paper"]["mean_error_mm"].is_f64(), !is_circle);
    }
    // Each experiment has two metrics, with a value for every seed.
    assert_eq!(report.metrics.len(), 2 * rows.len());
    dataset_is_sound(&report, &[1, 20]);
}

#[test]
fn the_folder_holds_figures_a_page_and_tables() {
    let place = Scratch::temporary().expect("a folder");
    let folder = place.path().join("new").join("paper");
    let start = Start::now(RunOptions::default()).expect("a machine");
    let files = start.files_of(&report(QUICK)).expect("all formats");
    cdcr_bench::report::write(&files, &folder).expect("written");
    let mut figures = 0;
    let page = &files["paper.html"];
    let is_picture = |name: &&String| Path::new(name).extension().is_some_and(|end| end == "svg");
    for name in files.keys().filter(is_picture) {
        let text = std::fs::read_to_string(folder.join(name)).expect("a text");
        let picture = roxmltree::Document::parse(&text).expect("XML");
        let texts = picture.descendants().filter_map(|node| node.text());
        let texts: Vec<_> = texts.map(str::trim).collect();
        let axes = ["time [s]", "x [mm]", "share of the cycles"];
        for words in [&axes[..], &["Simulated"]] {
            let is_there = |text: &&str| words.iter().any(|word| text.starts_with(word));
            assert!(texts.iter().any(is_there), "{words:?} in {name}");
        }
        let has_period = texts.contains(&"period 5 ms");
        assert_eq!(has_period, name.ends_with("-times.svg"), "{name}");
        let id = name.trim_end_matches(".svg");
        for link in ["<a href=\"#plot-ID\">", "<figure id=\"plot-ID\">"] {
            assert!(page.contains(&link.replace("ID", id)), "{link} {id}");
        }
        figures += 1;
    }
    assert_eq!(figures, 18);
    assert_eq!(page.matches("<svg").count(), figures);
    // One for each simulation, and one for the machine.
    assert_eq!(page.matches("<pre").count(), 3 + 1);
    needs_nothing_else(page);
    assert!(folder.join("paper.json").exists() && folder.join("paper.csv").exists());
}

/// A whole simulation with one seed.
fn whole(task: Task, solver: SolverKind) -> impl Fn(&str) -> f64 {
    let mut effort = QUICK;
    effort.cycles_max = u64::MAX;
    let experiment = Experiment::new(task, (solver, false), Coordinates::BendVector);
    let row = run(experiment, effort, || ()).expect("it runs").row;
    move |key| number(&row, key)
}

#[test]
fn each_simulation_is_at_least_as_exact_as_in_the_paper_and_keeps_its_bounds() {
    for (sections, paper_mm) in [(1, 5e-9), (2, 7e-4), (3, 5e-3)] {
        use SolverKind::{GaussNewton, Kpso, KpsoRefined};
        for (solver, bound_mm) in [(Kpso, paper_mm), (GaussNewton, 1e-10), (KpsoRefined, 1e-10)] {
            let row = whole(Task::Spiral { sections }, solver);
            let (error_mm, swarm) = (row("mean_error_mm"), row("swarm_ran_share"));
            assert!(error_mm <= bound_mm, "{sections}, {solver:?}: {error_mm}");
            assert_eq!(swarm > 0.5, solver == Kpso, "{solver:?}: {swarm}");
        }
    }
    for (rate_limit_rad_s, bound_mm) in [(2.0, 2.6e-3), (8.0, 2e-4)] {
        let row = whole(Task::Line { rate_limit_rad_s }, SolverKind::KpsoRefined);
        assert!(row("mean_error_mm") <= bound_mm, "{}", row("mean_error_mm"));
        assert!(row("max_theta_rad") <= 1e-2 && row("max_psi_rad") <= 1e-2);
    }
    // Without a wide detour.
    for safe_distance_m in [0.01, 0.02, 0.04] {
        let row = whole(Task::Circle { safe_distance_m }, SolverKind::GaussNewton);
        let (safe_mm, peak_mm) = (row("safe_distance_mm"), row("peak_error_mm"));
        assert!(row("min_clearance_mm") >= safe_mm - 0.01);
        assert!(row("mean_error_outside_mm") <= 8e-3);
        assert!(peak_mm <= 1.25 * safe_mm, "{peak_mm}");
    }
}
