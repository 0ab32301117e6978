mod frames;
mod measured;
mod silence;

use std::io::Write;

use anyhow::{Context, bail};
use cdcr_client::{counted, section_lengths_m};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{MeasurementKind, Mode, ReferenceState, guard};

use crate::bend_limit::BendShare;
use crate::unmeasured_tip::SILENT_NS;
use frames::Frames;
use measured::{MeasuredError, Sums};
use silence::Silence;

/// Distance between tip and reference while the robot tracked. The approach is counted separately.
#[derive(Debug, Default)]
pub(crate) struct TipError {
    /// Time from which the reference was fed \[ns\]. Earlier records belong to another reference.
    pub(crate) fed_ns: u64,
    /// Start of the reference \[ns\].
    pub(crate) start_ns: u64,
    period_ns: u64,
    /// Cycles before the tip followed the reference itself.
    approach_cycles: u64,
    approach_max_m: f64,
    cycles: u64,
    /// Cycles in which limits or guard changed the command.
    limited_cycles: u64,
    /// Cycles, also of the approach, in which the body would have touched itself.
    self_contact_cycles: u64,
    /// Cycles in which no fresh measured tip was in use: their error is by the model.
    unused_cycles: u64,
    sum_m: f64,
    max_m: f64,
    /// Whether the body was beside an obstacle at the largest error.
    max_beside_obstacle: bool,
    final_m: f64,
    /// The section that was at its bend limit in the last cycle.
    at_limit: Option<BendShare>,
    /// The tip has been at its reference, and no obstacle was in its way since.
    arrived: bool,
    /// The largest estimated error after an arrival.
    farthest: Farthest,
    frames: Frames,
    measured: MeasuredError,
    silence: Silence,
    /// Why the final error is by the model, if it is.
    final_by_model: Option<String>,
    /// Why no tip was ever measured, if so: all errors are by the model.
    pub(crate) unheard: Option<String>,
}

/// A place of the reference that the tip was away from.
#[derive(Debug, Default, Clone, Copy)]
struct Farthest {
    error_m: f64,
    release_ns: u64,
    point_m: [f64; 3],
}

/// Without a limit, a reference that ends with the tip farther away was not followed \[m\]: a robot that lags
/// 0.1 s behind at 0.2 m/s is as far away.
pub(crate) const ENDED_OFF_M: f64 = 0.02;
/// Without a limit, a reference that the tip had reached and then was this far from was not followed: a point of it
/// is an outlier, or it is too fast \[m\]. More than [`ENDED_OFF_M`]: a machine that stalls for 0.2 s does not decide.
/// Obstacles may keep the tip away; after them, it has to arrive again.
pub(crate) const PASSED_OFF_M: f64 = 0.05;
/// A largest error beside an obstacle is attributed to it from here on \[m\]; without one, a path that is slow enough has less.
const DETOUR_M: f64 = 1e-3;
/// A body within this share of the robot's length of the safe distance is beside an obstacle.
const BESIDE: f64 = 0.02;

/// Whether the tip follows the reference itself, after the approach.
pub(crate) fn is_along(record: &Telemetry) -> bool {
    record.mode == Mode::Tracking.code() && is_inside(record) && !is_approach(record)
}

fn is_inside(record: &Telemetry) -> bool {
    record.reference.state == ReferenceState::Inside.code()
}

fn is_approach(record: &Telemetry) -> bool {
    record.approach.duration_ns.max(record.approach.joining_ns) > 0
}

/// Whether an obstacle may keep the tip from its reference: the clearance guard acts, or the body is near its safe distance.
fn is_beside_obstacle(record: &Telemetry) -> bool {
    let reach_m: f64 = section_lengths_m(&record.robot).iter().sum();
    let near_m = record.settings.safe_distance_m + BESIDE * reach_m;
    record.guard_flags & guard::CLEARANCE != 0
        || record.obstacle_count > 0 && record.clearance_m <= near_m
}

impl TipError {
    /// For a reference that is fed from now on \[ns\].
    pub(crate) fn since(fed_ns: u64) -> Self {
        Self {
            fed_ns,
            ..Self::default()
        }
    }

    /// Adds a record, if its cycle tracked.
    pub(crate) fn take(&mut self, record: &Telemetry) {
        let frame = self.frames.take(record);
        self.measured.settle(frame, self.frames.is_refused());
        if record.mode != Mode::Tracking.code() || record.release_ns < self.fed_ns {
            self.measured.is_left = true;
            return;
        }
        self.self_contact_cycles += u64::from(record.guard_flags & guard::SELF_CONTACT != 0);
        if is_approach(record) {
            self.approach_cycles += 1;
            self.approach_max_m = self.approach_max_m.max(record.position_error_m);
            self.period_ns = record.period_ns;
            self.measured.is_left = true;
        } else if is_inside(record) && record.release_ns >= self.start_ns {
            self.cycles += 1;
            self.limited_cycles += u64::from(record.guard_flags != 0);
            self.unused_cycles += self.silence.take(record, &self.frames);
            self.sum_m += record.position_error_m;
            if record.position_error_m > self.max_m {
                self.max_m = record.position_error_m;
                self.max_beside_obstacle = is_beside_obstacle(record);
            }
            self.final_m = record.position_error_m;
            self.at_limit = BendShare::at_limit_of(record);
            self.take_farthest(record);
            self.measured.take(record, frame);
            // Until its interval is known, a sensor may be slow.
            let fresh_ns = match self.measured.interval_ns {
                0 => SILENT_NS,
                _ => self.measured.fresh_ns(),
            };
            self.final_by_model = self.silence.present_cause(record, &self.frames, fresh_ns);
        }
    }

    fn take_farthest(&mut self, record: &Telemetry) {
        let error_m = record.position_error_m;
        self.arrived = !is_beside_obstacle(record) && (self.arrived || error_m <= ENDED_OFF_M);
        if self.arrived && error_m > self.farthest.error_m {
            self.farthest = Farthest {
                error_m,
                release_ns: record.release_ns,
                point_m: record.reference.position_m,
            };
        }
    }

    /// Text with the newest error, also by the tip sensor if there is one; `None` before the first tracked
    /// cycle.
    pub(crate) fn live(&self) -> Option<String> {
        if self.cycles == 0 {
            return None;
        }
        let measured = self.measured.newest_m();
        let measured = measured.map_or_else(String::new, |m| format!(", measured {:.3}", 1e3 * m));
        Some(format!("error {:.3}{measured} mm", 1e3 * self.final_m))
    }

    /// The section that was at its bend limit in the last cycle.
    pub(crate) fn at_limit(&self) -> Option<BendShare> {
        self.at_limit
    }

    /// Whether no tip was measured yet, the measured one was refused for longer, or its sensor silent, in this record, which was
    /// taken last: tip and error are those of the model.
    pub(crate) fn is_by_model(&self, record: &Telemetry) -> bool {
        let is_tip_alone = record.measurement.kind == MeasurementKind::TipPose.code();
        self.frames.is_by_model(record.release_ns) || self.frames.is_unmeasured() && !is_tip_alone
    }

    /// When and where the tip was measured last, stray tips left out, and whether that belongs to this record, not to the
    /// path before it \[ns, m\].
    pub(crate) fn measured_tip(&self, record: &Telemetry) -> Option<(u64, [f64; 3], bool)> {
        let (measured_ns, tip_m) = self.frames.kept()?;
        let is_fresh = record.release_ns < measured_ns + self.measured.fresh_ns();
        Some((measured_ns, tip_m, is_fresh))
    }

    /// Prints the error, and fails if the estimated or measured one exceeds `limit_m`; without a limit, if the
    /// last one exceeds [`ENDED_OFF_M`], or one on the way [`PASSED_OFF_M`]. Names a limit that the model decided.
    pub(crate) fn print(&self, limit_m: Option<f64>) -> anyhow::Result<()> {
        self.show()?;
        let Some(limit_m) = limit_m else {
            return self.check_followed();
        };
        self.check(limit_m)?;
        // Where no tip was measured at all, the line above says so.
        let decided = self.decided_by_model().filter(|_| self.unheard.is_none());
        if let Some(decided) = decided {
            writeln!(std::io::stdout(), "--max-error was {decided}")?;
        }
        Ok(())
    }

    /// Prints the error.
    pub(crate) fn show(&self) -> anyhow::Result<()> {
        let (approached_mm, approached_s) = (
            1e3 * self.approach_max_m,
            (self.approach_cycles * self.period_ns) as f64 * 1e-9,
        );
        if self.approach_cycles > 0 && self.cycles == 0 {
            bail!(
                "the tip, up to {approached_mm:.1} mm away, did not reach the reference in {approached_s:.2} s: bring it nearer \
                 first (cdcrctl goto), use a longer reference, or increase motion.approach_speed_m_s and \
                 motion.approach_acceleration_m_s2"
            );
        }
        if self.approach_cycles > 0 {
            writeln!(
                std::io::stdout(),
                "approached in {approached_s:.2} s from {approached_mm:.1} mm"
            )?;
        }
        if let Some(error_m) = self.mean_max_final_m() {
            let by = match (&self.unheard, self.unused_percent()) {
                (Some(_), _) => " by the model".to_owned(),
                (None, Some(percent)) => format!(
                    " by the model (the measured tip was not in use for {percent:.1} % of the time)"
                ),
                (None, None) => String::new(),
            };
            let [mean, max, last] = error_m.map(|m| 1e3 * m);
            writeln!(
                std::io::stdout(),
                "tip error{by}: mean {mean:.3}, max {max:.3}, final {last:.3} mm in {} cycles, of which limits or guard changed {:.1} %",
                self.cycles,
                100.0 * self.limited_cycles as f64 / self.cycles as f64
            )?;
        }
        if self.max_beside_obstacle && self.max_m >= DETOUR_M {
            writeln!(
                std::io::stdout(),
                "the largest error was beside an obstacle, which was in the way (cdcrctl obstacle list)"
            )?;
        }
        if self.self_contact_cycles > 0 {
            writeln!(
                std::io::stdout(),
                "held back in {} cycles: two parts of the body would have overlapped by more than robot.self_overlap_max_m; use another path",
                self.self_contact_cycles
            )?;
        }
        if let Some(([mean_m, max_m], count)) = self.measured_mean_max_m() {
            let [mean, max] = [mean_m, max_m].map(|m| 1e3 * m);
            writeln!(
                std::io::stdout(),
                "measured by the tip sensor: mean {mean:.3}, max {max:.3} mm in {count} measurements, noise included"
            )?;
        }
        if let Some(strays) = self.strays_text() {
            writeln!(std::io::stdout(), "{strays}")?;
        }
        if let Some(note) = self.unmeasured_note() {
            writeln!(std::io::stdout(), "{note}")?;
        }
        Ok(())
    }

    fn check_followed(&self) -> anyhow::Result<()> {
        let last_m = self.final_m.max(self.measured.newest_m().unwrap_or(0.0));
        if last_m > ENDED_OFF_M {
            let [last, limit] = [last_m, ENDED_OFF_M].map(|m| 1e3 * m);
            bail!(
                "the tip was {last:.3} mm from its reference at the end, more than {limit} mm: {}; --max-error allows another error",
                match self.at_limit {
                    Some(bend) => bend.to_string(),
                    None if self.self_contact_cycles > 0 =>
                        "the body would have touched itself".to_owned(),
                    None => "limits or obstacles held it back, or it began too far away".to_owned(),
                }
            );
        }
        let Farthest {
            error_m,
            release_ns,
            point_m: [x, y, z],
        } = self.farthest;
        if error_m > PASSED_OFF_M {
            let time_s = release_ns.saturating_sub(self.start_ns) as f64 * 1e-9;
            let [most, limit] = [error_m, PASSED_OFF_M].map(|m| 1e3 * m);
            let cause = if self.self_contact_cycles > 0 {
                "the body would have touched itself: use another path"
            } else {
                "a point there is an outlier or the reference too fast (cdcrctl ref --dry-run shows both without moving), or the machine stalled \
                 (cdcrctl incidents)"
            };
            bail!(
                "the tip was up to {most:.3} mm from its reference at {time_s:.2} s, ({x:.4}, {y:.4}, {z:.4}) m, more than {limit} mm: {cause}; \
                 --max-error allows another error"
            );
        }
        Ok(())
    }

    /// Mean, maximum and final error after the approach \[m\]; `None` without such cycles.
    pub(crate) fn mean_max_final_m(&self) -> Option<[f64; 3]> {
        let mean_m = self.sum_m / self.cycles as f64;
        (self.cycles > 0).then_some([mean_m, self.max_m, self.final_m])
    }

    /// Mean and maximum of the measured error \[m\], and the number of measurements; `None` without one.
    pub(crate) fn measured_mean_max_m(&self) -> Option<([f64; 2], u64)> {
        let Sums {
            count,
            sum_m,
            max_m,
        } = self.measured.sums();
        (count > 0).then_some(([sum_m / count as f64, max_m], count))
    }

    /// Tips that the daemon refused one by one.
    pub(crate) fn strays(&self) -> u64 {
        self.measured.strays()
    }

    /// Names them; `None` without one.
    pub(crate) fn strays_text(&self) -> Option<String> {
        let strays = self.strays();
        let them = counted(strays, "stray measurement");
        (strays > 0).then(|| format!("{them} of the tip refused and left out"))
    }

    /// The newest measured error of a reference that is being tracked \[m\].
    pub(crate) fn measured_now_m(&self) -> Option<f64> {
        let is_now = self.cycles > 0 && !self.measured.is_left;
        is_now.then(|| self.measured.newest_m()).flatten()
    }

    /// Names silence of the tip sensor, and the final error that is by the model.
    fn unmeasured_note(&self) -> Option<String> {
        const REMEDY: &str = "check the tip sensor (cdcrctl status, docs/drivers.md)";
        if let Some(unheard) = &self.unheard {
            return Some(format!("all errors are by the model: {unheard}"));
        }
        let silent = self.silence.text().map(|silent| {
            format!("{silent}: the errors of that time are by the model, with the offset of the tip as it was last")
        });
        let last = self.final_by_model.as_ref();
        Some(match (silent, last) {
            (Some(silent), None) => format!("{silent}; {REMEDY}"),
            (Some(silent), Some(cause)) => {
                format!("{silent}, also the final one ({cause}); {REMEDY}")
            }
            (None, Some(cause)) => format!("the final error is by the model: {cause}; {REMEDY}"),
            (None, None) => return None,
        })
    }

    /// The share of the time in which no fresh measured tip was in use \[%\]; `None`: one always was, or there is none.
    pub(crate) fn unused_percent(&self) -> Option<f64> {
        let percent = 100.0 * self.unused_cycles as f64 / self.cycles as f64;
        (self.unused_cycles > 0).then_some(percent)
    }

    fn check(&self, limit_m: f64) -> anyhow::Result<()> {
        let cycles = (self.cycles > 0).then_some(self.cycles);
        cycles.context(
            "no cycle tracked the reference, so --max-error cannot be checked: use --track",
        )?;
        // Errors of the estimate appear in the measured error only.
        let measured_max_m = self.measured.sums().max_m;
        let (by, max_m) = if measured_max_m > self.max_m {
            (" as measured", measured_max_m)
        } else {
            ("", self.max_m)
        };
        if max_m > limit_m {
            let [max, limit] = [max_m, limit_m].map(|m| 1e3 * m);
            let decided = self.decided_by_model().map(|it| format!("; it was {it}"));
            bail!(
                "the tip was up to {max:.3} mm from its reference{by}, more than --max-error, {limit:.3} mm{}",
                decided.unwrap_or_default()
            );
        }
        Ok(())
    }

    /// For how much of the time the error of the model decided about a limit; `None`: a measured tip was always in use, or there is none.
    fn decided_by_model(&self) -> Option<String> {
        if self.unheard.is_some() {
            let decided = "decided by the model, because no measured tip was in use";
            return Some(decided.to_owned());
        }
        let percent = self.unused_percent()?;
        Some(format!(
            "decided by the model for {percent:.1} % of the time, in which the measured tip was not in use"
        ))
    }
}

#[cfg(test)]
mod tests;
