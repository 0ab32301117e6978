//! Latency from a stop request to zero rates.
//!
//! The robot is sent from one far position to another and stopped at speed. The time of the ramp is subtracted.

use anyhow::{Context, Result, bail, ensure};
use cdcr_client::monotonic_ns;
use cdcr_shared_types::codes::{Mode, Outcome, Reason, RequestKind};

use super::leg::{Passage, Round};
use super::{early_ns, scene};
use crate::subject::phases::Phases;
use crate::subject::stop::{Stop, speed_rad_s};
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

/// Stops the robot until `samples` stops have a result.
pub(super) fn measure(watcher: &mut Watcher, samples: usize, round: &mut Round) -> Result<()> {
    let feed = watcher.connection.reference_feed()?;
    let (mut recorded, mut spoilt, most) = (0, 0, samples + WARM_UP);
    let (mut phases, length_m) = (Phases::default(), scene::length_m(watcher));
    watcher.before_ns = early_ns(watcher);
    watcher.begin()?;
    for number in 0.. {
        scene::send(&feed, scene::aside(number, length_m))?;
        // Rejected if the robot is tracking already; it then follows the new reference.
        ask(watcher, RequestKind::Reset, Outcome::WrongMode)?;
        // The request was so late that the chunk was missing, or no longer in the future.
        if ask(watcher, RequestKind::Track, Outcome::NoReference)? != Outcome::Accepted {
            continue;
        }
        match stop(watcher, &mut phases)? {
            Some((passage, [handover_ns, command_ns])) if number >= WARM_UP => {
                recorded += 1;
                round.record_way("stop.command", passage);
                round.record("stop.zero_handover", handover_ns);
                round.record("stop.zero_command", command_ns);
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
    let is_fast = |seen: &Seen| speed_rad_s(&seen.record) > fast_rad_s;
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
        let rests = |seen: &Seen| seen.is_in(Mode::Stopped) && speed_rad_s(&seen.record) == 0.0;
        if !watcher.waits_for_answer() && records.last().is_some_and(rests) {
            return Ok(evaluate(&records, sent_ns));
        }
    }
    bail!("the robot does not come to rest")
}

/// Passage of the request; times from sending it to the hand-over and to the receipt of the first zero rates, less the
/// ramp \[ns\].
type Stopped = (Passage, [u64; 2]);

/// Evaluates the records of one stop, the last of which is at rest. `None` if a record or command is missing, or if the
/// robot was hardly moving.
fn evaluate(seen: &[Seen], sent_ns: u64) -> Option<Stopped> {
    let stop = Stop::find(seen.iter().map(|seen| &*seen.record))?;
    let (first, rest) = (&seen[stop.first], &seen[stop.rest]);
    let passage = [sent_ns, first.record.gather_ns, first.received_ns?];
    let zeros_ns = [rest.record.handed_over_ns, rest.received_ns?];
    let times_ns = zeros_ns.map(|zero_ns| stop.less_ramp_ns(sent_ns, zero_ns));
    Some((passage, times_ns))
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::Telemetry;

    use super::*;

    /// Tracks at 0.25 rad/s, then slows down by 0.1 rad/s a cycle of 5 ms; every command comes 10 µs after its hand-over.
    fn seen(index: u64) -> Seen {
        let mode = [Mode::Tracking, Mode::Stopped][usize::from(index > 0)];
        let mut record = Box::new(Telemetry {
            mode: mode.code(),
            gather_ns: 5_000_000 * index,
            handed_over_ns: 5_000_000 * index + 50_000,
            period_ns: 5_000_000,
            deceleration_rad_s2: 20.0,
            ..Telemetry::default()
        });
        record.header.sequence = index;
        record.previous_rate_rad_s[0] = [0.25, 0.25, 0.15, 0.05][index as usize];
        record.command.bend_rate_rad_s[0] = [0.25, 0.15, 0.05, 0.0][index as usize];
        let received_ns = Some(record.handed_over_ns + 10_000);
        Seen {
            record,
            received_ns,
        }
    }

    #[test]
    fn a_stop_ends_with_the_receipt_of_zero_rates_and_has_no_result_without_it() {
        let mut records: Vec<Seen> = (0..4).map(seen).collect();
        // Three steps: the ramp is two periods.
        let expected = ([4_000_000, 5_000_000, 5_060_000], [1_050_000, 1_060_000]);
        assert_eq!(evaluate(&records, 4_000_000), Some(expected));
        for lost in [3, 1] {
            records[lost].received_ns = None;
            assert_eq!(evaluate(&records, 4_000_000), None);
            records[lost] = seen(lost as u64);
        }
    }
}
