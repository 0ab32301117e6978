use std::path::Path;

use anyhow::Context;
use cdcr_client::{Spiral, Trajectory};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{LateCause, Mode, ReferenceState, SolverStatus, Winner, timing};
use cdcr_shared_types::limits::COORDINATES_MAX;

use crate::standing::distance_m;

/// The data of one tracking cycle for the report, the table and the pictures.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cycle {
    pub(super) number: u64,
    pub(super) release_ns: u64,
    /// The release that was due: lateness counts from here.
    pub(super) due_ns: u64,
    /// Time of the release since the start of the curve \[s\].
    pub(super) time_s: f64,
    pub(super) tip_m: [f64; 3],
    /// Exact point of the curve at the release \[m\].
    pub(super) exact_m: [f64; 3],
    pub(super) error_m: f64,
    pub(super) wake_us: f64,
    pub(super) solve_us: f64,
    pub(super) response_us: f64,
    pub(super) late_start: bool,
    pub(super) deadline_miss: bool,
    /// Cause of lateness in the record.
    pub(super) late_cause: LateCause,
    pub(super) skipped_periods: u32,
    bend_rad: [f64; COORDINATES_MAX],
    bend_rate_rad_s: [f64; COORDINATES_MAX],
    solver_status: u32,
    winner: u32,
    evaluations: u32,
    cost: f64,
}

impl Cycle {
    /// The cycle of a record. `None` when the daemon did not track, or the release is outside the reference:
    /// the solves before the start are trivial.
    pub(super) fn from_record(record: &Telemetry, spiral: &Spiral, start_ns: u64) -> Option<Self> {
        let inside = record.reference.state == ReferenceState::Inside.code();
        if record.mode != Mode::Tracking.code() || !inside {
            return None;
        }
        // Both are times of one clock, far below 2⁶³ ns.
        let time_s = record
            .release_ns
            .cast_signed()
            .wrapping_sub(start_ns.cast_signed()) as f64
            * 1e-9;
        let exact_m = spiral.position_m(time_s);
        Some(Self {
            number: record.cycle,
            release_ns: record.release_ns,
            due_ns: record.due_ns,
            time_s,
            tip_m: record.tip_position_m,
            exact_m,
            error_m: distance_m(record.tip_position_m, exact_m),
            wake_us: between_us(record.due_ns, record.start_ns),
            solve_us: between_us(record.solve_start_ns, record.solve_end_ns),
            response_us: between_us(record.due_ns, record.handed_over_ns),
            late_start: record.timing_flags & timing::LATE_START != 0,
            deadline_miss: record.timing_flags & timing::DEADLINE_MISS != 0,
            late_cause: LateCause::try_from(record.scheduling.late_cause).unwrap_or_default(),
            skipped_periods: record.skipped_periods,
            bend_rad: record.present_rad,
            bend_rate_rad_s: record.command.bend_rate_rad_s,
            solver_status: record.report.status,
            winner: record.report.winner,
            evaluations: record.report.evaluations,
            cost: record.report.cost,
        })
    }

    /// The bend vector at the release \[rad\].
    pub(super) fn bend_rad(&self, sections: usize) -> &[f64] {
        &self.bend_rad[..2 * sections]
    }

    fn cells(&self, sections: usize) -> Vec<String> {
        let numbers = |values: &[f64]| values.iter().map(|x| format!("{x:e}")).collect::<Vec<_>>();
        let mut cells = vec![
            self.number.to_string(),
            self.release_ns.to_string(),
            self.due_ns.to_string(),
            format!("{:.9}", self.time_s),
        ];
        cells.extend(numbers(&self.tip_m));
        cells.extend(numbers(&self.exact_m));
        cells.extend(numbers(&[self.error_m]));
        for value_us in [self.wake_us, self.solve_us, self.response_us] {
            cells.push(format!("{value_us:.3}"));
        }
        cells.push(u8::from(self.deadline_miss).to_string());
        cells.push(self.skipped_periods.to_string());
        cells.push(SolverStatus::text_of(self.solver_status).to_owned());
        cells.push(Winner::text_of(self.winner).to_owned());
        cells.push(self.evaluations.to_string());
        cells.extend(numbers(&[self.cost]));
        cells.extend(numbers(&self.bend_rad[..2 * sections]));
        cells.extend(numbers(&self.bend_rate_rad_s[..2 * sections]));
        cells
    }
}

/// Names and units of the columns, in the order of [`Cycle::cells`].
fn header(sections: usize) -> Vec<String> {
    let fixed = "cycle,release_ns,due_ns,time_s,tip_x_m,tip_y_m,tip_z_m,\
        reference_x_m,reference_y_m,reference_z_m,error_m,wake_us,solve_us,response_us,\
        deadline_miss,skipped_periods,solver_status,winner,evaluations,cost";
    let mut names: Vec<String> = fixed.split(',').map(str::to_owned).collect();
    for (quantity, unit) in [("bend", "rad"), ("bend_rate", "rad_s")] {
        for section in 1..=sections {
            names.extend(["u", "v"].map(|axis| format!("{quantity}_{axis}{section}_{unit}")));
        }
    }
    names
}

/// Writes one row per cycle.
pub(super) fn write_csv(path: &Path, cycles: &[Cycle], sections: usize) -> anyhow::Result<()> {
    let name = path.file_name().unwrap_or_default();
    let context = || format!("cannot write {}", name.display());
    let mut writer = csv::Writer::from_path(path).with_context(context)?;
    writer
        .write_record(header(sections))
        .with_context(context)?;
    for cycle in cycles {
        writer
            .write_record(cycle.cells(sections))
            .with_context(context)?;
    }
    writer.flush().with_context(context)
}

fn between_us(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-3
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A record of a daemon that tracks the spiral with an error of `offset_m`.
    fn record(spiral: &Spiral, start_ns: u64, time_ns: u64, offset_m: f64) -> Telemetry {
        let release_ns = start_ns + time_ns;
        let [x, y, z] = spiral.position_m(time_ns as f64 * 1e-9);
        let mut record = Telemetry {
            mode: Mode::Tracking.code(),
            release_ns,
            due_ns: release_ns,
            start_ns: release_ns + 20_000,
            solve_start_ns: release_ns + 22_000,
            solve_end_ns: release_ns + 52_000,
            handed_over_ns: release_ns + 55_000,
            tip_position_m: [x, y, z + offset_m],
            ..Telemetry::default()
        };
        record.reference.state = ReferenceState::Inside.code();
        // As in the paper: the last of three sections draws the spiral.
        let (bend_rad, direction_rad) = spiral_angles(spiral, time_ns as f64 * 1e-9);
        record.present_rad[4] = bend_rad * direction_rad.cos();
        record.present_rad[5] = bend_rad * direction_rad.sin();
        record
    }

    /// θ = 2t/15, φ = t
    fn spiral_angles(spiral: &Spiral, time_s: f64) -> (f64, f64) {
        let t = spiral.start_rad + time_s.clamp(0.0, spiral.duration_s);
        (2.0 * t / 15.0, t)
    }

    /// A synthetic run for tests of arithmetic and pictures.
    pub(in crate::demo) fn synthetic(count: u64) -> (Vec<Cycle>, Spiral) {
        let spiral = Spiral::for_sections(&[0.3; 3]);
        let cycle = |k: u64| {
            let noise = (k * 7919 % 101) as f64 / 101.0;
            let record = record(
                &spiral,
                1_000_000_000,
                5_000_000 * k + 1_234_567,
                1e-10 * (1.0 + noise),
            );
            let mut cycle = Cycle::from_record(&record, &spiral, 1_000_000_000)?;
            cycle.number = k;
            cycle.wake_us += 60.0 * noise.powi(4) + if k % 331 == 330 { 6000.0 } else { 0.0 };
            cycle.solve_us += 25.0 * noise * noise;
            cycle.response_us = cycle.wake_us + cycle.solve_us + 5.0;
            cycle.late_start = cycle.wake_us > 1000.0;
            cycle.deadline_miss = cycle.response_us > 5000.0;
            Some(cycle)
        };
        ((0..count).filter_map(cycle).collect(), spiral)
    }

    #[test]
    fn the_error_is_against_the_exact_curve_at_the_release() {
        let spiral = Spiral::for_sections(&[0.3]);
        let record = record(&spiral, 7_000_000_000, 2_501_000, 3e-6);
        let cycle = Cycle::from_record(&record, &spiral, 7_000_000_000).expect("tracking");
        assert!((cycle.error_m - 3e-6).abs() < 1e-15);
        assert!((cycle.time_s - 0.002_501).abs() < 1e-15);
        assert!((cycle.wake_us - 20.0).abs() < 1e-12);
        assert!((cycle.solve_us - 30.0).abs() < 1e-12);
        assert!((cycle.response_us - 55.0).abs() < 1e-12);
    }

    #[test]
    fn a_stall_shows_in_wake_up_and_response() {
        let spiral = Spiral::for_sections(&[0.3]);
        let mut record = record(&spiral, 7_000_000_000, 30_000_000, 0.0);
        record.due_ns -= 15_000_000;
        let cycle = Cycle::from_record(&record, &spiral, 7_000_000_000).expect("tracking");
        assert!((cycle.wake_us - 15_020.0).abs() < 1e-9);
        assert!((cycle.response_us - 15_055.0).abs() < 1e-9);
        assert!((cycle.solve_us - 30.0).abs() < 1e-12);
    }

    #[test]
    fn cycles_that_did_not_track_or_lie_outside_the_reference_do_not_count() {
        let spiral = Spiral::for_sections(&[0.3]);
        let inside = record(&spiral, 0, 0, 0.0);
        assert!(Cycle::from_record(&inside, &spiral, 0).is_some());
        let mut holding = inside;
        holding.mode = Mode::Holding.code();
        assert_eq!(Cycle::from_record(&holding, &spiral, 0), None);
        for state in [
            ReferenceState::None,
            ReferenceState::Before,
            ReferenceState::Ended,
        ] {
            let mut outside = inside;
            outside.reference.state = state.code();
            assert_eq!(Cycle::from_record(&outside, &spiral, 0), None, "{state:?}");
        }
    }
}
