//! Latency from a stop request to zero rates.
//!
//! The robot is sent from one far position to another and stopped at speed. A gather takes the stop, and the
//! cycle of that gather is the first in mode stopped. From that cycle on, the fastest rate decreases by
//! deceleration · T in each cycle, so a speed of n steps is zero in the n-th command. The ramp of n - 1
//! periods belongs to the robot, not to the daemon.

use anyhow::{Context, Result, bail, ensure};
use cdcr_client::{ReferenceFeed, monotonic_ns};
use cdcr_shared_types::codes::{Mode, Outcome, Reason, RequestKind};

use super::inputs::Phases;
use super::leg::{Passage, Round};
use super::{early_ns, scene};
use crate::subject::watcher::{Seen, Watcher};

/// Deceleration of the rates: a stop from the largest rate of the default robot takes 20 cycles of 5 ms.
pub(super) const DECELERATION_RAD_S2: f64 = 20.0;
/// A robot is at speed from this share of its largest rate on.
const AT_SPEED: f64 = 0.4;
const WARM_UP: usize = 1;
/// Releases after which a robot below that speed is sent elsewhere.
const SPEED_UP_MAX: u32 = 100;
/// Releases from there to rest: 15 to 40 are needed, more on a machine that stalls.
const REST_MAX: u32 = 1000;

impl Seen {
    fn speed_rad_s(&self) -> f64 {
        largest(&self.record.command.bend_rate_rad_s)
    }
}

/// Stops the robot until `samples` stops count. A stop without a result has missing records, or the robot was
/// hardly moving.
pub(super) fn measure(
    watcher: &mut Watcher,
    feed: &ReferenceFeed,
    samples: usize,
    round: &mut Round,
) -> Result<()> {
    let (mut recorded, mut spoilt, most) = (0, 0, samples + WARM_UP);
    let (mut phases, length_m) = (Phases::default(), scene::length_m(watcher));
    watcher.before_ns = early_ns(watcher);
    watcher.begin()?;
    for number in 0.. {
        scene::send(feed, scene::aside(number, length_m))?;
        // Rejected if the robot is tracking already; it then follows the new reference.
        ask(watcher, RequestKind::Reset, Outcome::WrongMode)?;
        // The request was so late that the chunk was missing, or no longer in the future.
        if ask(watcher, RequestKind::Track, Outcome::NoReference)? != Outcome::Accepted {
            continue;
        }
        match stop(watcher, &mut phases)? {
            Some(stopped) if number >= WARM_UP => {
                recorded += 1;
                stopped.record(round);
            }
            Some(_) => {}
            None => {
                spoilt += 1;
                round.spoilt_stops += 1;
            }
        }
        ensure!(
            spoilt <= most,
            "{spoilt} of {number} stops could not be evaluated: records are missing, or the robot hardly moves"
        );
        if recorded >= samples {
            break;
        }
    }
    Ok(())
}

fn ask(watcher: &mut Watcher, kind: RequestKind, expected: Outcome) -> Result<Outcome> {
    watcher.ask(kind)?;
    while watcher.waits_for_answer() {
        watcher.watch_release()?;
    }
    let answer = watcher.answers.pop().context("no answer")?;
    if answer.response.outcome == expected.code() {
        return Ok(expected);
    }
    answer.accepted()?;
    Ok(Outcome::Accepted)
}

fn release(watcher: &mut Watcher) -> Result<Vec<Seen>> {
    watcher.watch_release()?;
    let seen = std::mem::take(&mut watcher.seen);
    for seen in &seen {
        let why = Reason::text_of(seen.record.reason);
        ensure!(!seen.is_in(Mode::Faulted), "the robot is faulted: {why}");
    }
    Ok(seen)
}

fn stop(watcher: &mut Watcher, phases: &mut Phases) -> Result<Option<Stopped>> {
    let robot = &watcher.status.robot;
    let sections = robot.section[..robot.sections as usize].iter();
    let rates_rad_s = sections.map(|section| section.rate_max_rad_s);
    let fast_rad_s = AT_SPEED * rates_rad_s.fold(f64::INFINITY, f64::min);
    let is_fast = |seen: &Seen| seen.speed_rad_s() > fast_rad_s;
    let (mut records, mut releases): (Vec<Seen>, _) = (Vec::new(), 0);
    while !records.last().is_some_and(is_fast) {
        releases += 1;
        if releases > SPEED_UP_MAX {
            return Ok(None);
        }
        let seen = release(watcher)?.into_iter();
        // Records come later than answers: the first ones may belong to the stop before.
        records.extend(seen.filter(|seen| seen.is_in(Mode::Tracking)));
    }
    watcher.watch_until(monotonic_ns() + phases.next_ns(watcher.status.period_ns))?;
    let (_, sent_ns) = watcher.ask(RequestKind::Stop)?;
    for _ in 0..REST_MAX {
        records.extend(release(watcher)?);
        for answer in watcher.answers.drain(..) {
            answer.accepted()?;
        }
        let rests = |seen: &Seen| seen.is_in(Mode::Stopped) && seen.speed_rad_s() == 0.0;
        if !watcher.waits_for_answer() && records.last().is_some_and(rests) {
            return Ok(evaluate(&records, sent_ns));
        }
    }
    bail!("the robot does not come to rest")
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stopped {
    first: Passage,
    /// Time from sending to the hand-over of the first zero rates, less the ramp \[ns\].
    zero_handover_ns: u64,
    /// The same until the client has received them \[ns\].
    zero_command_ns: u64,
}

impl Stopped {
    fn record(&self, round: &mut Round) {
        round.record_way("stop.command", self.first);
        round.record("stop.zero_handover", self.zero_handover_ns);
        round.record("stop.zero_command", self.zero_command_ns);
    }
}

/// Evaluates the records of one stop, the last of which is at rest. `None` if a record or command is missing,
/// or if the robot was hardly moving.
fn evaluate(records: &[Seen], sent_ns: u64) -> Option<Stopped> {
    let at = records.iter().position(|kept| kept.is_in(Mode::Stopped))?;
    let (first, before) = (&records[at], records.get(at.checked_sub(1)?)?);
    let is_next = |pair: &[Seen]| {
        let [one, next] = [0, 1].map(|index| pair[index].record.header.sequence);
        one + 1 == next
    };
    let is_whole = records[at - 1..].windows(2).all(is_next);
    let period_ns = first.record.period_ns;
    let step_rad_s = first.record.deceleration_rad_s2 * period_ns as f64 * 1e-9;
    let steps = largest(&first.record.previous_rate_rad_s) / step_rad_s;
    if !is_whole || !before.is_in(Mode::Tracking) || steps < 2.0 {
        return None;
    }
    let mut stopped = records[at..].iter();
    let rest = stopped.find(|kept| kept.speed_rad_s() == 0.0)?;
    // Rounding must not add a step to a speed that is a whole number of steps.
    let ramp_ns = ((steps - 1e-9).ceil() as u64 - 1) * period_ns;
    let without_ramp = |time_ns: u64| time_ns.saturating_sub(sent_ns + ramp_ns);
    Some(Stopped {
        first: [sent_ns, first.record.gather_ns, first.received_ns?],
        zero_handover_ns: without_ramp(rest.record.handed_over_ns),
        zero_command_ns: without_ramp(rest.received_ns?),
    })
}

fn largest(rates_rad_s: &[f64]) -> f64 {
    let sizes = rates_rad_s.iter().map(|rate| rate.abs());
    sizes.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::Telemetry;

    use super::*;

    /// A robot that tracks at 0.95 rad/s and slows down by 0.1 rad/s in each cycle of 5 ms.
    fn stop() -> Vec<Seen> {
        let speed_rad_s = |index: u64| (0.95 - 0.1 * index as f64).max(0.0);
        let kept = |index: u64| {
            let release_ns = 5_000_000 * (index + 1);
            let mode = [Mode::Tracking, Mode::Stopped][usize::from(index > 0)];
            let mut record = Telemetry {
                mode: mode.code(),
                gather_ns: release_ns - 200_000,
                handed_over_ns: release_ns + 50_000,
                period_ns: 5_000_000,
                deceleration_rad_s2: 20.0,
                ..Telemetry::default()
            };
            record.header.sequence = 7 + index;
            record.previous_rate_rad_s[0] = speed_rad_s(index.saturating_sub(1));
            record.command.bend_rate_rad_s[0] = speed_rad_s(index);
            Seen {
                record: Box::new(record),
                received_ns: Some(release_ns + 60_000),
            }
        };
        (0..=10).map(kept).collect()
    }

    #[test]
    fn a_stop_is_counted_without_its_ramp_and_with_a_period_that_was_lost_on_the_way() {
        let (sent_ns, mut records) = (5_300_000, stop());
        let stopped = evaluate(&records, sent_ns).expect("all records are there");
        assert_eq!(stopped.first, [sent_ns, 9_800_000, 10_060_000]);
        // Ten steps: zero in the tenth stopped command, nine periods after the first.
        assert_eq!(stopped.zero_handover_ns, 10_050_000 - sent_ns);
        assert_eq!(stopped.zero_command_ns, 10_060_000 - sent_ns);
        for kept in &mut records[5..] {
            kept.record.handed_over_ns += 5_000_000;
        }
        let stopped = evaluate(&records, sent_ns).expect("all records are there");
        assert_eq!(stopped.zero_handover_ns, 4_750_000 + 5_000_000);
    }

    #[test]
    fn what_is_not_whole_is_not_judged() {
        type Change = fn(&mut Vec<Seen>);
        // A missing record, a command that never came, a robot that hardly moved, or what it did before is
        // unknown, or it does not rest.
        let missing: [Change; 5] = [
            |all| _ = all.remove(4),
            |all| all[10].received_ns = None,
            |all| all[1].record.previous_rate_rad_s[0] = 0.15,
            |all| _ = all.remove(0),
            |all| _ = all.pop(),
        ];
        for change in missing {
            let mut records = stop();
            change(&mut records);
            assert_eq!(evaluate(&records, 5_300_000), None);
        }
    }
}
