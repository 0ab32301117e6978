use std::collections::{BTreeMap, HashMap};
use std::io::{self, Write};

use anyhow::ensure;
use cdcr_shared_types::codes::{LateCause, Mode, timing};
use cdcr_shared_types::{Header, Telemetry};
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::file::{RecordedMessage, Recording};
use super::repair::repair;
use super::topic::Topic;
use crate::args::{Format, InfoOptions};
use crate::done::Done;
use crate::interrupt::Interrupt;
use crate::tip_error::{TipError, is_along};

pub(crate) fn run(options: &InfoOptions) -> anyhow::Result<Done> {
    if options.repair {
        let interrupt = Interrupt::catch()?;
        return repair(&options.file, || interrupt.is_raised());
    }
    let mut recording = Recording::open(&options.file)?;
    let mut seen = RecordingSummary::default();
    while let Some(message) = recording.next_message()? {
        seen.take(&message);
    }
    let name = options.file.display();
    ensure!(
        !seen.channels.is_empty(),
        "{name} contains no message of cdcrd"
    );
    let mut out = io::stdout().lock();
    match options.format {
        Format::Text => write!(out, "{}", seen.text())?,
        Format::Json => writeln!(out, "{}", seen.json(recording.is_cut()))?,
    }
    recording.warn_of_cut();
    Ok(Done::Good)
}

/// Fixed-point notation, except for values that would round to zero.
fn millimetres(mm: f64) -> String {
    if mm >= 1e-3 {
        format!("{mm:.3}")
    } else {
        format!("{mm:.3e}")
    }
}

/// Content of a recording.
#[derive(Debug, Default)]
struct RecordingSummary {
    channels: BTreeMap<&'static str, ChannelSummary>,
    first_ns: Option<u64>,
    last_ns: u64,
    modes: BTreeMap<u32, u64>,
    deadline_misses: BTreeMap<u32, u64>,
    late_starts: u64,
    skipped_periods: u64,
    /// Largest distance of tip and reference \[m\], with its cycle, and whether it is by the model.
    largest_error: Option<(f64, u64, bool)>,
    /// The same, without the approaches.
    largest_along: Option<(f64, u64, bool)>,
    error: TipError,
    least_clearance: Option<(f64, u64, bool)>,
    refused: u64,
}

/// Messages of one kind.
#[derive(Debug, Default, Serialize)]
struct ChannelSummary {
    #[serde(rename = "messages")]
    count: u64,
    /// Missing sequence numbers, and the number of gaps.
    missing: u64,
    gaps: u64,
    #[serde(skip)]
    last: HashMap<u64, u64>,
}

impl ChannelSummary {
    fn take(&mut self, header: &Header) {
        self.count += 1;
        if let Some(last) = self.last.insert(header.sender_id, header.sequence) {
            let missing = header.sequence.saturating_sub(last.saturating_add(1));
            self.missing = self.missing.saturating_add(missing);
            self.gaps += u64::from(missing > 0);
        }
    }
}

impl RecordingSummary {
    fn take(&mut self, message: &RecordedMessage) {
        let (topic, header) = match message {
            RecordedMessage::Telemetry(record) => {
                self.take_cycle(record);
                (Topic::Telemetry, record.header)
            }
            RecordedMessage::Reference(chunk) => (Topic::Reference, chunk.header),
            RecordedMessage::Obstacles(update) => (Topic::Obstacles, update.header),
            RecordedMessage::Status(status) => (Topic::Status, status.header),
            RecordedMessage::Incident(incident) => (Topic::Incidents, incident.header),
        };
        let channel = self.channels.entry(topic.service().key()).or_default();
        channel.take(&header);
    }

    fn take_cycle(&mut self, record: &Telemetry) {
        self.first_ns.get_or_insert(record.release_ns);
        self.last_ns = record.release_ns;
        *self.modes.entry(record.mode).or_default() += 1;
        if record.timing_flags & timing::DEADLINE_MISS != 0 {
            let cause = record.scheduling.late_cause;
            *self.deadline_misses.entry(cause).or_default() += 1;
        }
        self.late_starts += u64::from(record.timing_flags & timing::LATE_START != 0);
        self.skipped_periods += u64::from(record.skipped_periods);
        let refused = cdcr_client::events(record)
            .iter()
            .filter(|event| event.outcome != 0);
        self.refused += refused.count() as u64;
        self.error.take(record);
        let by_model = self.error.is_by_model(record);
        let keep = |kept: &mut Option<(f64, u64, bool)>,
                    value_m: f64,
                    is_beyond: fn(&f64, &f64) -> bool| {
            if value_m.is_finite() && kept.is_none_or(|(old_m, ..)| is_beyond(&value_m, &old_m)) {
                *kept = Some((value_m, record.cycle, by_model));
            }
        };
        if record.mode == Mode::Tracking.code() {
            keep(&mut self.largest_error, record.position_error_m, f64::gt);
        }
        if is_along(record) {
            keep(&mut self.largest_along, record.position_error_m, f64::gt);
        }
        keep(&mut self.least_clearance, record.clearance_m, f64::lt);
    }

    fn duration_s(&self) -> f64 {
        let first_ns = self.first_ns.unwrap_or(self.last_ns);
        self.last_ns.saturating_sub(first_ns) as f64 * 1e-9
    }

    fn text(&self) -> String {
        let mut lines = vec![format!("{:.3} s", self.duration_s())];
        lines.push(format!(
            "{:<12}{:>10}{:>10}{:>10}",
            "channel", "messages", "missing", "gaps"
        ));
        for (name, channel) in &self.channels {
            let (count, missing, gaps) = (channel.count, channel.missing, channel.gaps);
            lines.push(format!("{name:<12}{count:>10}{missing:>10}{gaps:>10}"));
        }
        let list = |counts: &BTreeMap<u32, u64>, text: fn(u32) -> &'static str| {
            let parts = counts
                .iter()
                .map(|(code, count)| format!("{count} {}", text(*code)));
            let parts: Vec<_> = parts.collect();
            if parts.is_empty() {
                "none".to_owned()
            } else {
                parts.join(", ")
            }
        };
        let (modes, causes) = (&self.modes, &self.deadline_misses);
        lines.push("cycles by mode: ".to_owned() + &list(modes, Mode::text_of));
        lines.push("deadline misses: ".to_owned() + &list(causes, LateCause::text_of));
        lines.push(format!(
            "late starts: {}, skipped periods: {}, refused messages: {}",
            self.late_starts, self.skipped_periods, self.refused
        ));
        for (name, largest) in [
            ("largest error", self.largest_error),
            ("after the approach", self.largest_along),
        ] {
            if let Some((error_m, cycle, by_model)) = largest {
                let error_mm = millimetres(error_m * 1e3);
                let by = if by_model { " by the model" } else { "" };
                lines.push(format!("{name}{by}: {error_mm} mm in cycle {cycle}"));
            }
        }
        if let Some(([mean_m, max_m], _)) = self.error.measured_mean_max_m() {
            let [mean_mm, max_mm] = [mean_m, max_m].map(|m| millimetres(1e3 * m));
            lines.push(format!(
                "as measured after the approach: mean {mean_mm}, largest {max_mm} mm"
            ));
        }
        lines.extend(self.error.strays_text());
        if let Some(percent) = self.error.unused_percent() {
            lines.push(format!(
                "the measured tip was not in use for {percent:.1} % of that time"
            ));
        }
        if let Some((clearance_m, cycle, _)) = self.least_clearance {
            let mm = clearance_m * 1e3;
            lines.push(format!("least clearance: {mm:.3} mm in cycle {cycle}"));
        }
        lines.join("\n") + "\n"
    }

    fn json(&self, is_cut: bool) -> Value {
        let named = |counts: &BTreeMap<u32, u64>, text: fn(u32) -> &'static str| -> Map<_, _> {
            let named = counts
                .iter()
                .map(|(code, count)| (text(*code).to_owned(), json!(count)));
            named.collect()
        };
        let extreme = |found: Option<(f64, u64, bool)>, name: &str| {
            found.map(
                |(value_m, cycle, by_model)| json!({name: value_m, "cycle": cycle, "by_model": by_model}),
            )
        };
        let measured = self.error.measured_mean_max_m().map(
            |([mean_m, max_m], count)| json!({"mean_m": mean_m, "max_m": max_m, "measurements": count}),
        );
        json!({
            "duration_s": self.duration_s(),
            "cut": is_cut,
            "channels": self.channels,
            "modes": named(&self.modes, Mode::text_of),
            "deadline_misses": named(&self.deadline_misses, LateCause::text_of),
            "late_starts": self.late_starts,
            "skipped_periods": self.skipped_periods,
            "refused": self.refused,
            "largest_error": extreme(self.largest_error, "position_error_m"),
            "largest_error_after_approach": extreme(self.largest_along, "position_error_m"),
            "measured_error_after_approach": measured,
            "stray_measurements": self.error.strays(),
            "measured_unused_percent": self.error.unused_percent(),
            "least_clearance": extreme(self.least_clearance, "clearance_m"),
        })
    }
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::{ReferenceState, TipCause};

    use super::*;

    #[test]
    fn a_stray_tip_is_counted_and_no_measured_error() {
        let mut seen = RecordingSummary::default();
        for (cause, x_m) in [
            (TipCause::None, 0.001),
            (TipCause::None, 0.001),
            (TipCause::Far, 0.161),
        ] {
            seen.last_ns += 10;
            let mut record = Telemetry {
                release_ns: seen.last_ns,
                mode: Mode::Tracking.code(),
                tip_measured_ns: seen.last_ns - 5,
                tip_measured_m: [x_m, 0.0, 0.0],
                tip_cause: cause.code(),
                ..Telemetry::default()
            };
            record.reference.state = ReferenceState::Inside.code();
            seen.take_cycle(&record);
        }
        let (text, json) = (seen.text(), seen.json(false));
        for part in [
            "as measured after the approach: mean 1.000, largest 1.000 mm\n1 stray measurement of the tip refused and left out",
            "largest error: 0.000",
        ] {
            assert!(text.contains(part), "{text}");
        }
        assert!(!text.contains("not in use"), "{text}");
        assert_eq!(json["measured_error_after_approach"]["max_m"], 0.001);
        assert_eq!(json["stray_measurements"], 1);
    }

    #[test]
    fn an_error_without_the_measured_tip_is_named_so_with_the_measured_one() {
        let mut seen = RecordingSummary::default();
        for (release_ns, tip_ns) in [(10, 0), (20, 15)] {
            let mut record = Telemetry {
                release_ns,
                mode: Mode::Tracking.code(),
                position_error_m: 0.002,
                tip_measured_ns: tip_ns,
                tip_measured_m: [0.0, 0.161, 0.0],
                tip_cause: TipCause::Frozen.code(),
                ..Telemetry::default()
            };
            record.reference.state = ReferenceState::Inside.code();
            seen.take_cycle(&record);
        }
        let text = seen.text();
        for part in [
            "largest error by the model: 2.000 mm",
            "after the approach by the model: 2.000 mm",
            "as measured after the approach: mean 161.000, largest 161.000 mm",
            "not in use for 100.0 % of that time",
        ] {
            assert!(text.contains(part), "{text}");
        }
        let json = seen.json(false);
        assert_eq!(json["measured_unused_percent"], 100.0);
        assert_eq!(json["measured_error_after_approach"]["max_m"], 0.161);
        assert_eq!(json["largest_error"]["by_model"], true);
    }
}
