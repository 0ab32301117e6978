use std::io::{self, Write};

use anyhow::ensure;
use cdcr_shared_types::codes::SolverStatus;
use cdcr_shared_types::{Telemetry, codes::guard};
use serde::Serialize;
use serde_json::json;

use super::file::Recording;
use super::replay::each_cycle;
use crate::args::{Format, ReplayOptions};
use crate::done::Done;
use crate::setting::SettingChange;

/// Compares the recorded commands with those of other settings, each cycle separately.
pub(super) fn run(options: &ReplayOptions) -> anyhow::Result<Done> {
    ensure!(
        !options.with.iter().any(SettingChange::is_auto),
        "a running daemon chooses the number for auto: give one (cdcrctl settings shows that of a daemon)"
    );
    let mut recording = Recording::open(&options.file)?;
    let mut compared = Compared::default();
    each_cycle(&mut recording, |cycle, replayer| {
        let mut settings = cycle.record.settings;
        let recorded = settings.rate_weight;
        options
            .with
            .iter()
            .for_each(|change| change.apply(&mut settings, recorded));
        if let Some(found) = replayer.what_if(&cycle, &settings)? {
            let record = &cycle.record;
            compared.cycles += 1;
            compared.cut_short += u64::from(record.report.budget_spent != 0);
            compared.recorded.take(
                record.report.evaluations,
                record.guard_flags & guard::CLEARANCE != 0,
                record.report.status == SolverStatus::Converged.code(),
            );
            let other = (found.evaluations, found.guarded, found.converged);
            compared.other.take(other.0, other.1, other.2);
            compared.rates_rad_s.take(found.rates_apart_rad_s, record);
            compared.tips_m.take(found.tips_apart_m, record);
        }
        Ok(())
    })?;
    let name = options.file.display();
    ensure!(
        compared.cycles > 0,
        "{name} contains no solved cycle with a known reference"
    );
    let mut out = io::stdout().lock();
    match options.format {
        Format::Text => write!(out, "{}", compared.text())?,
        Format::Json => writeln!(out, "{}", compared.json())?,
    }
    recording.warn_of_cut();
    Ok(Done::Good)
}

#[derive(Debug, Default)]
struct Compared {
    cycles: u64,
    /// Recorded solves ended by their time budget. The recomputed ones have no such limit.
    cut_short: u64,
    recorded: Solves,
    other: Solves,
    rates_rad_s: Apart,
    tips_m: Apart,
}

/// Statistics of the solves with one group of settings.
#[derive(Debug, Default, Serialize)]
struct Solves {
    evaluations: u64,
    converged: u64,
    guarded: u64,
}

impl Solves {
    fn take(&mut self, evaluations: u32, guarded: bool, converged: bool) {
        self.evaluations += u64::from(evaluations);
        self.guarded += u64::from(guarded);
        self.converged += u64::from(converged);
    }
}

/// Differences between two commands.
#[derive(Debug, Default)]
struct Apart {
    sum: f64,
    max: f64,
    max_cycle: u64,
}

impl Apart {
    fn take(&mut self, apart: f64, record: &Telemetry) {
        self.sum += apart;
        if apart > self.max {
            (self.max, self.max_cycle) = (apart, record.cycle);
        }
    }
}

impl Compared {
    fn text(&self) -> String {
        let cycles = self.cycles as f64;
        let row = |name: &str, recorded: f64, other: f64| {
            format!("{name:<34}{recorded:>12.1}{other:>12.1}")
        };
        let apart = |name: &str, apart: &Apart, scale: f64| {
            let (mean, max) = (scale * apart.sum / cycles, scale * apart.max);
            format!(
                "{name:<34}{mean:>12.3e}{max:>12.3e}   in cycle {}",
                apart.max_cycle
            )
        };
        let share = |count: u64| 100.0 * count as f64 / cycles;
        let (recorded, other) = (&self.recorded, &self.other);
        let lines = [
            format!(
                "{} solved cycles, each with its recorded inputs",
                self.cycles
            ),
            format!(
                "{} of them cut short by their budget; none with these settings",
                self.cut_short
            ),
            format!("{:<34}{:>12}{:>12}", "", "recorded", "with these"),
            row(
                "evaluations, mean",
                recorded.evaluations as f64 / cycles,
                other.evaluations as f64 / cycles,
            ),
            row(
                "converged [%]",
                share(recorded.converged),
                share(other.converged),
            ),
            row(
                "changed by the clearance guard [%]",
                share(recorded.guarded),
                share(other.guarded),
            ),
            format!(
                "{:<34}{:>12}{:>12}",
                "difference of the commands", "mean", "max"
            ),
            apart("  rates [rad/s]", &self.rates_rad_s, 1.0),
            apart("  tip after a period [mm]", &self.tips_m, 1e3),
        ];
        lines.join("\n") + "\n"
    }

    fn json(&self) -> serde_json::Value {
        let apart = |apart: &Apart| json!({"mean": apart.sum / self.cycles as f64, "max": apart.max, "max_cycle": apart.max_cycle});
        json!({
            "cycles": self.cycles,
            "recorded_cut_short": self.cut_short,
            "recorded": self.recorded,
            "with": self.other,
            "rates_apart_rad_s": apart(&self.rates_rad_s),
            "tips_apart_m": apart(&self.tips_m),
        })
    }
}
