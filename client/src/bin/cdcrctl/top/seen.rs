//! Observed state of a daemon for `top`: the newest record and status, recent series of numbers, and events.

use std::collections::VecDeque;

use cdcr_client::channels::{Happening, Level, happenings};
use cdcr_client::model::{obstacle_of, robot_of};
use cdcr_client::{counted, obstacles, section_lengths_m};
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::codes::{LateCause, ObstacleShape, RequestKind, SolverStatus};
use cdcr_shared_types::{Obstacle, Status, Telemetry};

use super::recent::Recent;
use crate::backbone::{Position, backbone};
use crate::picture::{Scene, Solid, Window};

/// Length of the series \[s\].
const KEPT_S: f64 = 10.0;
/// Interval between the kept points of tip and reference \[s\].
const POINT_EVERY_S: f64 = 0.02;
const POINTS_MAX: usize = 500;
const LINES_MAX: usize = 200;
/// Time for which newer events do not displace an answer \[s\].
const ANSWER_S: f64 = 10.0;

/// An event.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct EventLine {
    /// Time since the first record \[s\].
    pub(super) time_s: f64,
    pub(super) text: String,
    pub(super) is_bad: bool,
    /// Whether it reports a late cycle.
    is_late: bool,
    /// The request to which it is the newest answer.
    answered: Option<RequestKind>,
}

#[derive(Debug, Clone, Default)]
pub(super) struct Seen {
    pub(super) record: Option<Box<Telemetry>>,
    pub(super) status: Option<Box<Status>>,
    pub(super) error_mm: Recent,
    pub(super) response_us: Recent,
    pub(super) solve_us: Recent,
    pub(super) lines: VecDeque<EventLine>,
    /// Release and cause of the newest late cycle.
    pub(super) last_late: Option<(u64, LateCause)>,
    pub(super) lost: u64,
    robot: Option<Robot>,
    /// Releases of the last second \[ns\].
    releases_ns: VecDeque<u64>,
    begun_ns: u64,
    tips: VecDeque<Position>,
    references: VecDeque<Position>,
    point_ns: u64,
}

impl Seen {
    pub(super) fn note(&mut self, record: &Telemetry, lost: u64) {
        let before = self.record.take();
        let is_other = before
            .as_ref()
            .is_none_or(|before| before.header.sender_id != record.header.sender_id);
        if is_other {
            self.begin(record, before.is_some());
        }
        let before = before.filter(|_| !is_other);
        self.note_changes(record, before.as_deref(), lost);
        self.note_numbers(record);
        self.record = Some(Box::new(*record));
    }

    /// Starts with the first record of a daemon.
    fn begin(&mut self, record: &Telemetry, is_next: bool) {
        let (lines, lost) = (std::mem::take(&mut self.lines), self.lost);
        let begun_ns = if is_next {
            self.begun_ns
        } else {
            record.release_ns
        };
        let kept = (KEPT_S * 1e9 / record.period_ns.max(1) as f64).ceil() as usize;
        *self = Self {
            error_mm: Recent::new(kept),
            response_us: Recent::new(kept),
            solve_us: Recent::new(kept),
            status: self.status.take(),
            robot: robot_of(&record.robot).ok(),
            lines,
            lost,
            begun_ns,
            ..Self::default()
        };
        if is_next {
            self.add_event(record.release_ns, "another daemon started", true);
        }
    }

    fn note_changes(&mut self, record: &Telemetry, before: Option<&Telemetry>, lost: u64) {
        let now_ns = record.release_ns;
        let cause = LateCause::try_from(record.scheduling.late_cause).unwrap_or(LateCause::None);
        let mut found = happenings(record, before);
        // The report of lateness is the last event.
        let late = found.pop_if(|_| cause != LateCause::None);
        for Happening { text, level } in found {
            self.add_event(now_ns, text, level > Level::Info);
        }
        if lost > self.lost {
            let text = counted(lost - self.lost, "record") + " did not arrive here";
            self.add_event(now_ns, text, true);
            self.lost = lost;
        }
        if let Some(Happening { text, level }) = late {
            self.last_late = Some((now_ns, cause));
            // A late cycle replaces the one right before it, unless that is worse: on a stalling machine,
            // late cycles would fill the list.
            let is_bad = level > Level::Info;
            match self.lines.back().map(|line| (line.is_late, line.is_bad)) {
                Some((true, true)) if !is_bad => return,
                Some((true, _)) => drop(self.lines.pop_back()),
                _ => {}
            }
            self.add_event(now_ns, text, is_bad);
            if let Some(line) = self.lines.back_mut() {
                line.is_late = true;
            }
        }
    }

    fn note_numbers(&mut self, record: &Telemetry) {
        let us = |to_ns: u64, from_ns: u64| to_ns.saturating_sub(from_ns) as f64 * 1e-3;
        self.error_mm.push(1e3 * record.position_error_m);
        self.response_us
            .push(us(record.handed_over_ns, record.due_ns));
        self.solve_us
            .push(if record.report.status == SolverStatus::Idle.code() {
                f64::NAN
            } else {
                us(record.solve_end_ns, record.solve_start_ns)
            });
        self.releases_ns.push_back(record.release_ns);
        while self
            .releases_ns
            .front()
            .is_some_and(|first| record.release_ns - first > 1_000_000_000)
        {
            self.releases_ns.pop_front();
        }
        if us(record.release_ns, self.point_ns) * 1e-6 >= POINT_EVERY_S {
            self.point_ns = record.release_ns;
            keep(&mut self.tips, record.tip_position_m);
            if record.position_error_m.is_finite() {
                keep(&mut self.references, record.reference.position_m);
            }
        }
    }

    /// Adds the answer to a request.
    pub(super) fn add_answer(&mut self, kind: RequestKind, answer: Result<String, String>) {
        let now_ns = self
            .record
            .as_ref()
            .map_or(self.begun_ns, |record| record.release_ns);
        let is_bad = answer.is_err();
        let text = answer.unwrap_or_else(|error| format!("{kind}: {error}"));
        for line in &mut self.lines {
            line.answered.take_if(|answered| *answered == kind);
        }
        self.add_event(now_ns, text, is_bad);
        if let Some(line) = self.lines.back_mut() {
            line.answered = Some(kind);
        }
    }

    /// The newest events that fit into `rows`, the newest last. Newer events displace the answers of the last
    /// [`ANSWER_S`] only where one of these events would have no row: on a stalling machine, as many events as there are rows may come
    /// between two pictures.
    pub(super) fn newest_lines(&self, rows: usize) -> Vec<&EventLine> {
        let newest_ns = (self.record.as_ref()).map_or(self.begun_ns, |record| record.release_ns);
        let since_s = self.time_s(newest_ns) - ANSWER_S;
        let stays = |line: &&EventLine| line.answered.is_some() && line.time_s > since_s;
        let answers = self.lines.iter().filter(stays).count();
        let mut room = rows.saturating_sub(answers).max(1);
        let mut fits = |line: &&EventLine| {
            stays(line) || {
                let is_room = room > 0;
                room = room.saturating_sub(1);
                is_room
            }
        };
        let newest = self.lines.iter().rev().filter(|line| fits(line));
        let mut lines: Vec<_> = newest.take(rows).collect();
        lines.reverse();
        lines
    }

    /// Time since the first record \[s\].
    fn time_s(&self, at_ns: u64) -> f64 {
        at_ns.saturating_sub(self.begun_ns) as f64 * 1e-9
    }

    fn add_event(&mut self, now_ns: u64, text: impl Into<String>, is_bad: bool) {
        if self.lines.len() == LINES_MAX {
            self.lines.pop_front();
        }
        // An error may have several lines.
        let text = text.into().replace('\n', "; ");
        self.lines.push_back(EventLine {
            time_s: self.time_s(now_ns),
            text,
            is_bad,
            is_late: false,
            answered: None,
        });
    }

    /// Cycles per second, over the last second.
    pub(super) fn rate_hz(&self) -> Option<f64> {
        let (first, last) = (self.releases_ns.front()?, self.releases_ns.back()?);
        let seconds = (last - first) as f64 * 1e-9;
        (seconds > 0.0).then(|| (self.releases_ns.len() - 1) as f64 / seconds)
    }

    pub(super) fn scene(&self) -> Scene {
        let (Some(record), Some(robot)) = (&self.record, &self.robot) else {
            return Scene::default();
        };
        let bend_rad = &record.present_rad[..2 * robot.section_count()];
        let bent = Configuration::from_slice(bend_rad);
        let body = bent.map(|bent| robot.body(&bent));
        let solid = |obstacle: &Obstacle| {
            let is_rod = obstacle.shape == ObstacleShape::Capsule.code();
            Solid {
                start_m: obstacle.start_m,
                end_m: if is_rod {
                    obstacle.end_m
                } else {
                    obstacle.start_m
                },
                radius_m: obstacle.radius_m,
                is_near: body.as_ref().zip(obstacle_of(obstacle)).is_some_and(
                    |(body, obstacle)| {
                        body.clearance_m(&obstacle) < record.settings.safe_distance_m
                    },
                ),
            }
        };
        Scene {
            obstacles: obstacles(record).iter().map(solid).collect(),
            reference: self.references.iter().copied().collect(),
            trail: self.tips.iter().copied().collect(),
            backbone: backbone(robot, bend_rad),
        }
    }

    /// Window with the whole robot and a margin, or a zoomed part around its tip.
    pub(super) fn window(&self, zoom: f64) -> Window {
        let record = self.record.as_ref();
        let length_m = record.map_or(1.0, |record| section_lengths_m(&record.robot).iter().sum());
        let whole_m = [0.0, 0.0, 0.5 * length_m];
        let tip_m = record.map_or(whole_m, |record| record.tip_position_m);
        let share = 1.0 - 1.0 / zoom.max(1.0);
        Window {
            middle_m: core::array::from_fn(|i| whole_m[i] + share * (tip_m[i] - whole_m[i])),
            size_m: 1.2 * length_m / zoom,
        }
    }
}

fn keep(points: &mut VecDeque<Position>, point: Position) {
    if points.len() == POINTS_MAX {
        points.pop_front();
    }
    points.push_back(point);
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::{Mode, timing};

    use super::*;

    fn record(cycle: u64, sender_id: u64) -> Telemetry {
        let mut record = Telemetry {
            cycle,
            release_ns: 5_000_000 * cycle,
            period_ns: 5_000_000,
            mode: Mode::Holding.code(),
            ..Telemetry::default()
        };
        record.header.sender_id = sender_id;
        record
    }

    fn texts(seen: &Seen) -> Vec<&str> {
        seen.lines.iter().map(|line| line.text.as_str()).collect()
    }

    #[test]
    fn a_change_is_shown_once_and_the_rate_is_that_of_the_last_second() {
        let mut seen = Seen::default();
        for cycle in 0..500 {
            let mut record = record(cycle, 1);
            record.obstacle_count = u32::from(cycle > 200);
            if cycle > 400 {
                record.mode = Mode::Stopped.code();
            }
            seen.note(&record, u64::from(cycle > 300));
        }
        let texts = texts(&seen);
        assert_eq!(texts.len(), 4, "{texts:?}");
        assert_eq!(texts[1..3], ["1 obstacle", "1 record did not arrive here"]);
        assert!(
            texts[3].starts_with("stopped") && seen.lines[3].is_bad,
            "{texts:?}"
        );
        assert!((seen.rate_hz().expect("a rate") - 200.0).abs() < 1e-9);
    }

    #[test]
    fn a_late_start_does_not_hide_the_deadline_that_was_missed_right_before() {
        let mut seen = Seen::default();
        seen.note(&record(1, 1), 0);
        for (cycle, flags) in [(2, 0), (3, timing::DEADLINE_MISS), (4, 0)] {
            let mut record = record(cycle, 1);
            record.timing_flags = flags;
            record.scheduling.late_cause = LateCause::Load.code();
            seen.note(&record, 0);
        }
        let late: Vec<_> = seen.lines.iter().filter(|line| line.is_late).collect();
        assert!(late.len() == 1 && late[0].is_bad, "{:?}", texts(&seen));
    }

    #[test]
    fn another_daemon_begins_anew_and_what_happened_stays() {
        let mut seen = Seen::default();
        (0..10).for_each(|cycle| seen.note(&record(cycle, 1), 0));
        seen.add_answer(RequestKind::Hold, Err("refused\nremedy".to_owned()));
        seen.note(&record(20, 2), 0);
        let texts = texts(&seen);
        assert_eq!(
            texts[1..3],
            ["hold: refused; remedy", "another daemon started"]
        );
        assert_eq!(seen.rate_hz(), None);
    }

    #[test]
    fn an_answer_stays_for_a_while_beside_the_newest_event() {
        let mut seen = Seen::default();
        let mut cycles = 1..;
        let mut pass = |seen: &mut Seen, count, changes: bool| {
            for cycle in cycles.by_ref().take(count) {
                let mut record = record(cycle, 1);
                record.obstacle_count = u32::from(changes) * (cycle % 2) as u32;
                seen.note(&record, 0);
            }
        };
        let shown = |seen: &Seen, rows| -> Vec<String> {
            let lines = seen.newest_lines(rows).into_iter();
            lines.map(|line| line.text.clone()).collect()
        };
        pass(&mut seen, 1, false);
        seen.add_answer(RequestKind::Stop, Ok("an older answer".to_owned()));
        seen.add_answer(RequestKind::Hold, Err("refused".to_owned()));
        seen.add_answer(RequestKind::Stop, Ok("stop: accepted".to_owned()));
        pass(&mut seen, 9, true);
        let answers = ["hold: refused", "stop: accepted"];
        let events = ["1 obstacle", "0 obstacles"];
        assert_eq!(shown(&seen, 4), [answers, events].concat());
        // The newest event has a row in any case, and all of them fit.
        for rows in 1..4 {
            let lines = shown(&seen, rows);
            assert_eq!(lines.len(), rows);
            assert_eq!(lines[rows - 1], "0 obstacles");
        }
        assert_eq!(shown(&seen, 0).len(), 0);
        pass(&mut seen, 2000, false);
        pass(&mut seen, 4, true);
        let texts = shown(&seen, 4);
        assert!(
            texts.iter().all(|text| text.contains("obstacle")),
            "{texts:?}"
        );
    }

    #[test]
    fn late_cycles_leave_room_for_all_else() {
        let mut seen = Seen::default();
        (0..10).for_each(|cycle| seen.note(&record(cycle, 1), 0));
        for cycle in 0..100 {
            let mut record = record(cycle, 2);
            record.scheduling.late_cause = LateCause::Load.code();
            record.obstacle_count = u32::from(cycle > 50);
            seen.note(&record, 0);
        }
        let texts = texts(&seen);
        let words = [
            "another daemon started",
            "holding",
            "cycle 50: late",
            "1 obstacle",
            "cycle 99: late",
        ];
        assert_eq!(texts.len(), 1 + words.len(), "{texts:?}");
        for (text, words) in texts[1..].iter().zip(words) {
            assert!(text.starts_with(words), "{texts:?}");
        }
    }

    #[test]
    fn however_long_it_runs_it_keeps_little() {
        let mut seen = Seen::default();
        for cycle in 0..20_000 {
            let mut record = record(cycle, 1);
            record.mode = (cycle % 2) as u32;
            seen.note(&record, 0);
        }
        assert_eq!(seen.lines.len(), LINES_MAX);
        assert!(seen.tips.len() <= POINTS_MAX && seen.releases_ns.len() <= 201);
    }

    #[test]
    fn zoom_leads_to_the_tip() {
        let mut seen = Seen::default();
        let mut record = record(1, 1);
        record.robot.sections = 1;
        record.robot.section[0].length_m = 0.5;
        record.tip_position_m = [0.1, 0.0, 0.45];
        seen.note(&record, 0);
        let whole = seen.window(1.0);
        assert_eq!((whole.middle_m, whole.size_m), ([0.0, 0.0, 0.25], 0.6));
        let near = seen.window(50.0);
        assert!((near.middle_m[0] - 0.098).abs() < 1e-9 && near.size_m < 0.013);
    }
}
