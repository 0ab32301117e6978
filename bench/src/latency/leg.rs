//! The measured legs, each from one time stamp to another, and their latencies in one round.

use anyhow::Result;
use cdcr_client::monotonic_ns;

use crate::dataset::Recording;
use crate::named::named;
use crate::quantiles::histogram;

const GATHER: &str = "start of the gather that takes it";
const STOPPED: &str = "first command of mode stopped in the client's hands";
const SENT: &str = "sent_ns of the message, read before it is sent";
const MEASURED: &str = "measured_ns, read before it is sent";
const HANDS: &str = "command in the client's hands";
const FIRST: &str = "first command that uses it in the client's hands";
const ANSWER: &str = "answer in the client's hands";

macro_rules! legs {
    ($($leg:ident = $name:literal: $from:expr => $to:expr;)+) => {
        named! { pub enum Leg { $($leg = $name,)+ } }

        impl Leg {
            pub fn definition(self) -> (&'static str, &'static str) {
                match self {
                    $(Self::$leg => ($from, $to),)+
                }
            }
        }
    };
}

legs! {
    BareOneWay = "bare.one_way": "stamp in the answer, read before it is sent" => "answer received";
    BareRoundTrip = "bare.round_trip": "before a message is sent" => "answer received";
    BareRequest = "bare.request": "before a request is sent" => "its response received";
    CommandRelease = "command.release": "release that its cycle slept for" => HANDS;
    CommandHandover = "command.handover": "handed over by the cycle thread" => HANDS;
    CommandHop = "command.hop": "sent_ns of the command, read by the exchange" => HANDS;
    ReferenceCommand = "reference.command": SENT => FIRST;
    ReferenceGrid = "reference.grid": SENT => GATHER;
    ReferenceMachinery = "reference.machinery": GATHER => FIRST;
    ObstacleCommand = "obstacle.command": SENT => FIRST;
    ObstacleGrid = "obstacle.grid": SENT => GATHER;
    ObstacleMachinery = "obstacle.machinery": GATHER => FIRST;
    MeasurementCommand = "measurement.command": MEASURED => FIRST;
    MeasurementGrid = "measurement.grid": MEASURED => GATHER;
    MeasurementMachinery = "measurement.machinery": GATHER => FIRST;
    LeaseAnswer = "lease.answer": SENT => ANSWER;
    LeaseGrid = "lease.grid": SENT => GATHER;
    LeaseMachinery = "lease.machinery": GATHER => ANSWER;
    TrackAnswer = "track.answer": SENT => ANSWER;
    TrackGrid = "track.grid": SENT => GATHER;
    TrackMachinery = "track.machinery": GATHER => ANSWER;
    StopCommand = "stop.command": SENT => STOPPED;
    StopGrid = "stop.grid": SENT => GATHER;
    StopMachinery = "stop.machinery": GATHER => STOPPED;
    StopZeroHandover = "stop.zero_handover":
        SENT => "first zero rates handed over by the cycle thread, less the ramp";
    StopZeroCommand = "stop.zero_command":
        SENT => "first command of zero rates in the client's hands, less the ramp";
}

impl Leg {
    /// Whether the leg is only the wait for the grid. By design it is spread evenly over a period, so two
    /// runs cannot differ in it.
    pub fn is_grid(self) -> bool {
        matches!(self.name().split_once('.'), Some((_, "grid")))
    }
}

pub(super) struct Round {
    /// Stops without a result: a record or command is missing, or the robot was hardly moving.
    pub(super) spoilt_stops: u64,
    /// Samples whose command the client did not receive, because it was away too long.
    pub(super) without_command: u64,
    began_ns: u64,
    pub(super) legs: Vec<Recording>,
}

/// Times at which a message was sent, gathered and answered \[ns, `CLOCK_MONOTONIC`\].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_field_names, reason = "the unit ends each name")]
pub(super) struct Passage {
    pub(super) sent_ns: u64,
    pub(super) gather_ns: u64,
    pub(super) received_ns: u64,
}

impl Passage {
    pub(super) fn new(sent_ns: u64, gather_ns: u64, received_ns: u64) -> Self {
        Self {
            sent_ns,
            gather_ns,
            received_ns,
        }
    }
}

impl Round {
    pub(super) fn new(began_ns: u64) -> Result<Self> {
        let empty = |leg: Leg| {
            Ok(Recording {
                tag: leg.name().to_owned(),
                start_s: 0.0,
                duration_s: 0.0,
                histogram_ns: histogram()?,
            })
        };
        Ok(Self {
            spoilt_stops: 0,
            without_command: 0,
            began_ns,
            legs: Leg::ALL.into_iter().map(empty).collect::<Result<_>>()?,
        })
    }

    pub(super) fn record(&mut self, leg: Leg, latency_ns: u64) {
        let now_s = monotonic_ns().saturating_sub(self.began_ns) as f64 * 1e-9;
        let recording = &mut self.legs[leg as usize];
        if recording.histogram_ns.is_empty() {
            recording.start_s = now_s;
        }
        recording.duration_s = now_s - recording.start_s;
        recording.histogram_ns.saturating_record(latency_ns);
    }

    /// Adds a whole leg and the two that follow it in the list: its wait for the grid, and the machinery. A
    /// message that came during its gather did not wait.
    pub(super) fn record_way(&mut self, whole: Leg, passage: &Passage) {
        let whole_ns = passage.received_ns.saturating_sub(passage.sent_ns);
        let grid_ns = passage.gather_ns.saturating_sub(passage.sent_ns);
        let grid_ns = grid_ns.min(whole_ns);
        let times_ns = [whole_ns, grid_ns, whole_ns - grid_ns];
        for (part, time_ns) in times_ns.into_iter().enumerate() {
            self.record(Leg::ALL[whole as usize + part], time_ns);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_is_made_of_a_wait_for_the_grid_and_machinery() {
        for grid in Leg::ALL.into_iter().filter(|leg| leg.is_grid()) {
            let (mut round, whole) = (Round::new(0).expect("bounds"), grid as usize - 1);
            round.record_way(Leg::ALL[whole], &Passage::new(100, 400, 1000));
            let way = grid.name().trim_end_matches("grid");
            let legs = &round.legs[whole..whole + 3];
            assert!(legs.iter().all(|leg| leg.tag.starts_with(way)));
            let times_ns = [0, 1, 2].map(|part| legs[part].histogram_ns.max());
            assert_eq!(times_ns, [900, 300, 600]);
        }
    }
}
