//! A stop is sent → zero rates.
//!
//! The robot is sent to one far place after another and stopped at speed. A stop is taken by a gather, the
//! cycle of that gather is the first of mode stopped, and from it on the fastest rate shrinks by
//! deceleration · T in each cycle: a speed of n steps is zero in the n-th command. The ramp, which is the
//! robot's and not the daemon's, is n - 1 periods.

use std::mem;

use anyhow::{Context, Result, ensure};
use cdcr_client::{ReferenceFeed, monotonic_ns};
use cdcr_shared_types::codes::{Mode, Outcome, Reason, RequestKind};
use cdcr_shared_types::{Command, Telemetry};

use super::asker::{Answer, Asker};
use super::hands::{Errand, Hands, Seen};
use super::inputs::Phases;
use super::leg::Leg;
use super::round::{Passage, Round};
use super::scene;

/// How fast the rates shrink: a stop from the largest rate of the default robot takes 20 cycles of 5 ms.
pub(super) const DECELERATION_RAD_S2: f64 = 20.0;
/// A robot is at speed at this part of its largest rate.
const AT_SPEED: f64 = 0.4;
const WARM_UP: usize = 1;
/// Releases that one stop may take at most: it needs 15 to 40.
const TURNS_OF_A_STOP: u64 = 200;
/// A robot that is not at speed after so many releases is sent elsewhere.
const SPEED_UP_MAX: u32 = 100;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    /// A new reference, and out of the stop before.
    Reset,
    Track,
    /// Wait until it is fast; so many releases were waited for.
    SpeedUp(u32),
    Stop,
    Rest,
}

/// A record, and when its command was in the client's hands.
#[derive(Debug, Clone)]
struct Kept {
    record: Telemetry,
    received_ns: Option<u64>,
}

impl Kept {
    fn is_in(&self, mode: Mode) -> bool {
        self.record.mode == mode.code()
    }

    /// Of the fastest component of its command.
    fn speed_rad_s(&self) -> f64 {
        largest(&self.record.command.bend_rate_rad_s)
    }
}

pub(super) struct Stops<'a> {
    asker: &'a mut Asker,
    feed: ReferenceFeed,
    length_m: f64,
    fast_rad_s: f64,
    samples: usize,
    recorded: usize,
    /// Stops that do not count: records are missing, or the robot was hardly moving.
    spoilt: usize,
    turn: u32,
    phases: Phases,
    step: Step,
    due_ns: u64,
    sent_ns: u64,
    records: Vec<Kept>,
}

impl<'a> Stops<'a> {
    pub(super) fn new(
        hands: &Hands,
        feed: ReferenceFeed,
        asker: &'a mut Asker,
        samples: usize,
    ) -> Result<Self> {
        let robot = &hands.status.robot;
        let sections = &robot.section[..robot.sections as usize];
        let rates = sections.iter().map(|section| section.rate_max_rad_s);
        let slowest_rad_s = rates
            .reduce(f64::min)
            .context("the robot has no sections")?;
        Ok(Self {
            asker,
            feed,
            length_m: hands.length_m(),
            fast_rad_s: AT_SPEED * slowest_rad_s,
            samples,
            recorded: 0,
            spoilt: 0,
            turn: 0,
            phases: Phases::default(),
            step: Step::Reset,
            due_ns: 0,
            sent_ns: 0,
            records: Vec::new(),
        })
    }

    fn begin(&mut self) {
        self.turn += 1;
        self.step = Step::Reset;
        self.due_ns = 0;
        self.records.clear();
    }

    fn answered(&mut self, answer: &Answer) -> Result<()> {
        let outcome = Outcome::try_from(answer.outcome);
        match (self.step, answer.kind, outcome) {
            // Refused to a robot that follows already: it goes on to the new reference.
            (Step::Reset, RequestKind::Reset, Ok(Outcome::Accepted | Outcome::WrongMode)) => {
                self.step = Step::Track;
                self.due_ns = 0;
            }
            (Step::Track, RequestKind::Track, Ok(Outcome::Accepted)) => {
                self.step = Step::SpeedUp(0);
            }
            // It came so late that the chunk was not there, or no longer ahead.
            (Step::Track, RequestKind::Track, Ok(Outcome::NoReference)) => self.begin(),
            (_, RequestKind::Stop, Ok(Outcome::Accepted)) => {}
            _ => answer.accepted()?,
        }
        Ok(())
    }

    /// The robot is on its way: stop it at a time within the next period.
    fn speed_up(&mut self, newest: &Kept, releases: u32, round: &mut Round) {
        if newest.is_in(Mode::Tracking) && newest.speed_rad_s() > self.fast_rad_s {
            self.step = Step::Stop;
            self.due_ns = monotonic_ns() + self.phases.next_ns(newest.record.period_ns);
        } else if releases >= SPEED_UP_MAX {
            self.spoil(round);
            self.begin();
        } else {
            self.step = Step::SpeedUp(releases + 1);
        }
    }

    fn spoil(&mut self, round: &mut Round) {
        self.spoilt += 1;
        round.unmeasured.spoilt_stops += 1;
    }

    fn end(&mut self, round: &mut Round) {
        let records = mem::take(&mut self.records);
        match evaluate(&records, self.sent_ns) {
            Some(stop) if self.turn as usize >= WARM_UP => {
                self.recorded += 1;
                stop.record(round);
            }
            Some(_) => {}
            None => self.spoil(round),
        }
        self.begin();
    }
}

impl Errand for Stops<'_> {
    fn due_ns(&self) -> u64 {
        let acts = matches!(self.step, Step::Reset | Step::Track | Step::Stop);
        if acts && self.asker.waits_since_ns().is_none() {
            self.due_ns
        } else {
            u64::MAX
        }
    }

    fn act(&mut self, _newest: Option<&Command>) -> Result<()> {
        match self.step {
            Step::Reset => {
                scene::send(&self.feed, scene::aside(self.turn, self.length_m))?;
                self.asker.ask(RequestKind::Reset)?;
            }
            Step::Track => _ = self.asker.ask(RequestKind::Track)?,
            Step::Stop => {
                (_, self.sent_ns) = self.asker.ask(RequestKind::Stop)?;
                self.step = Step::Rest;
            }
            Step::SpeedUp(_) | Step::Rest => {}
        }
        Ok(())
    }

    fn look(&mut self, _release_ns: u64) -> Result<bool> {
        if let Some(answer) = self.asker.look()? {
            self.answered(&answer)?;
        }
        Ok(true)
    }

    fn seen(&mut self, cycle: &Seen<'_>, round: &mut Round) -> Result<()> {
        let kept = Kept {
            record: *cycle.record,
            received_ns: cycle.received_ns,
        };
        ensure!(
            !kept.is_in(Mode::Faulted),
            "the robot is faulted: {}",
            Reason::text_of(cycle.record.reason)
        );
        match self.step {
            Step::Reset | Step::Track => {}
            Step::SpeedUp(releases) => {
                self.speed_up(&kept, releases, round);
                // Records come later than answers: the first ones may be of the stop before.
                if kept.is_in(Mode::Tracking) && self.step != Step::Reset {
                    self.records.push(kept);
                }
            }
            Step::Stop | Step::Rest => {
                let rests = kept.is_in(Mode::Stopped) && kept.speed_rad_s() == 0.0;
                self.records.push(kept);
                if rests && self.asker.waits_since_ns().is_none() {
                    self.end(round);
                }
            }
        }
        let most = self.samples + WARM_UP;
        ensure!(
            self.spoilt <= most,
            "{} of {} stops could not be judged: records are missing, or the robot hardly moves",
            self.spoilt,
            self.turn
        );
        Ok(())
    }

    fn is_done(&self) -> bool {
        self.recorded >= self.samples
    }

    fn turns(&self) -> u64 {
        TURNS_OF_A_STOP * (self.samples + WARM_UP) as u64 + 1000
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stopped {
    first: Passage,
    /// From sending to the first zero rates handed over, less the ramp \[ns\].
    zero_handover_ns: u64,
    /// The same until the client has them \[ns\].
    zero_command_ns: u64,
}

impl Stopped {
    fn record(&self, round: &mut Round) {
        round.record_way(Leg::StopCommand, &self.first);
        round.record(Leg::StopZeroHandover, self.zero_handover_ns);
        round.record(Leg::StopZeroCommand, self.zero_command_ns);
    }
}

/// From the records of one stop, the last of which is at rest. None when one is missing, a command never
/// came, or the robot was hardly moving any more.
fn evaluate(records: &[Kept], sent_ns: u64) -> Option<Stopped> {
    let at = records.iter().position(|kept| kept.is_in(Mode::Stopped))?;
    let (first, before) = (&records[at], records.get(at.checked_sub(1)?)?);
    let is_next = |pair: &[Kept]| {
        let [one, next] = [0, 1].map(|index| pair[index].record.header.sequence);
        one + 1 == next
    };
    let is_whole = records[at - 1..].windows(2).all(is_next);
    let Telemetry {
        period_ns,
        deceleration_rad_s2,
        previous_rate_rad_s,
        ..
    } = &first.record;
    let step_rad_s = deceleration_rad_s2 * *period_ns as f64 * 1e-9;
    let steps = largest(previous_rate_rad_s) / step_rad_s;
    if !is_whole || !before.is_in(Mode::Tracking) || steps < 2.0 {
        return None;
    }
    let mut stopped = records[at..].iter();
    let rest = stopped.find(|kept| kept.speed_rad_s() == 0.0)?;
    // Rounding must not make a step more of a speed that is a whole number of them.
    let ramp_ns = ((steps - 1e-9).ceil() as u64 - 1) * period_ns;
    let without_ramp = |time_ns: u64| time_ns.saturating_sub(sent_ns + ramp_ns);
    Some(Stopped {
        first: Passage {
            sent_ns,
            gather_ns: first.record.gather_ns,
            received_ns: first.received_ns?,
        },
        zero_handover_ns: without_ramp(rest.record.handed_over_ns),
        zero_command_ns: without_ramp(rest.received_ns?),
    })
}

/// The largest of some rates, without their signs \[rad/s\].
fn largest(rates_rad_s: &[f64]) -> f64 {
    rates_rad_s
        .iter()
        .fold(0.0, |most, rate| rate.abs().max(most))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that tracks at 0.95 rad/s and slows down by 0.1 rad/s in each cycle of 5 ms.
    fn stop() -> Vec<Kept> {
        let speeds_rad_s = [
            0.95, 0.85, 0.75, 0.65, 0.55, 0.45, 0.35, 0.25, 0.15, 0.05, 0.0,
        ];
        let kept = |index: usize| {
            let release_ns = 5_000_000 * (index as u64 + 1);
            let mode = if index == 0 {
                Mode::Tracking
            } else {
                Mode::Stopped
            };
            let mut record = Telemetry {
                mode: mode.code(),
                gather_ns: release_ns - 200_000,
                handed_over_ns: release_ns + 50_000,
                period_ns: 5_000_000,
                deceleration_rad_s2: 20.0,
                ..Telemetry::default()
            };
            record.header.sequence = 7 + index as u64;
            record.previous_rate_rad_s[0] = speeds_rad_s[index.saturating_sub(1)];
            record.command.bend_rate_rad_s[0] = speeds_rad_s[index];
            Kept {
                record,
                received_ns: Some(release_ns + 60_000),
            }
        };
        (0..speeds_rad_s.len()).map(kept).collect()
    }

    #[test]
    fn a_stop_is_counted_without_its_ramp_and_with_a_period_that_was_lost_on_the_way() {
        let (sent_ns, mut records) = (5_300_000, stop());
        let stopped = evaluate(&records, sent_ns).expect("all records are there");
        assert_eq!(stopped.first.gather_ns, 9_800_000);
        assert_eq!(stopped.first.received_ns, 10_060_000);
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
        let missing: [(fn(&mut Vec<Kept>), &str); 5] = [
            (|all| _ = all.remove(4), "a record is missing"),
            (|all| all[10].received_ns = None, "a command never came"),
            (
                |all| all[1].record.previous_rate_rad_s[0] = 0.15,
                "it hardly moved",
            ),
            (|all| _ = all.remove(0), "nothing says what it did before"),
            (|all| _ = all.pop(), "it does not rest"),
        ];
        for (change, why) in missing {
            let mut records = stop();
            change(&mut records);
            assert_eq!(evaluate(&records, 5_300_000), None, "{why}");
        }
    }
}
