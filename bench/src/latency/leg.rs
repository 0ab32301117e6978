//! The ways that are timed, each from one stamp to another.
//!
//! A request may also be taken by the daemon's last look, shortly before the release and after the gather
//! (`LastLook` in `daemon/src/exchange/mod.rs`: 50 µs before its cycle thread wakes up). A stop or a request to
//! track that it takes did not wait for a gather: its `grid` is 0, its `machinery` is the whole. A renewal of the
//! lease is stamped by that look, so its `grid` ends there.

use crate::named::named;
named! {
    pub enum Leg {
        /// Two processes and iceoryx2, nothing else: one way.
        BareOneWay = "bare.one_way",
        BareRoundTrip = "bare.round_trip",
        BareRequest = "bare.request",
        /// A command from the release of its cycle.
        CommandRelease = "command.release",
        /// A command from its hand-over by the cycle thread.
        CommandHandover = "command.handover",
        /// A command from the stamp in its header.
        CommandHop = "command.hop",
        ReferenceCommand = "reference.command",
        /// The part of it that waits for the grid.
        ReferenceGrid = "reference.grid",
        ReferenceMachinery = "reference.machinery",
        ObstacleCommand = "obstacle.command",
        /// The part of it that waits for the grid.
        ObstacleGrid = "obstacle.grid",
        ObstacleMachinery = "obstacle.machinery",
        MeasurementCommand = "measurement.command",
        /// The part of it that waits for the grid.
        MeasurementGrid = "measurement.grid",
        MeasurementMachinery = "measurement.machinery",
        /// A renewal of the lease, whole: the exchange answers it.
        LeaseAnswer = "lease.answer",
        /// The part of it that waits for the grid.
        LeaseGrid = "lease.grid",
        LeaseMachinery = "lease.machinery",
        /// A request to track, whole: the cycle decides it.
        TrackAnswer = "track.answer",
        /// The part of it that waits for the grid.
        TrackGrid = "track.grid",
        TrackMachinery = "track.machinery",
        /// A stop until the first command of mode stopped.
        StopCommand = "stop.command",
        /// The part of it that waits for the grid.
        StopGrid = "stop.grid",
        StopMachinery = "stop.machinery",
        /// A stop until zero rates are handed over, without the ramp.
        StopZeroHandover = "stop.zero_handover",
        /// A stop until zero rates are in the client's hands, without the ramp.
        StopZeroCommand = "stop.zero_command",
    }
}

impl Leg {
    pub fn definition(self) -> (&'static str, &'static str) {
        const GATHER: &str = "start of the gather that takes it";
        // The last look, too, takes requests.
        const LOOK: &str = "start of the gather or last look that takes it";
        const CYCLE: &str =
            "start of the gather of its cycle; sending itself, if the last look takes it";
        const STOPPED: &str = "first command of mode stopped in the client's hands";
        const SENT: &str = "sent_ns of the message, read before it is sent";
        const HANDS: &str = "command in the client's hands";
        const FIRST: &str = "first command that uses it in the client's hands";
        const ANSWER: &str = "answer in the client's hands";
        match self {
            Self::BareOneWay => (
                "stamp in the answer, read before it is sent",
                "answer received",
            ),
            Self::BareRoundTrip => ("before a message is sent", "answer received"),
            Self::BareRequest => ("before a request is sent", "its response received"),
            Self::CommandRelease => ("release that its cycle slept for", HANDS),
            Self::CommandHandover => ("handed over by the cycle thread", HANDS),
            Self::CommandHop => ("sent_ns of the command, read by the exchange", HANDS),
            Self::ReferenceCommand | Self::ObstacleCommand => (SENT, FIRST),
            Self::MeasurementCommand => ("measured_ns, read before it is sent", FIRST),
            Self::ReferenceGrid | Self::ObstacleGrid => (SENT, GATHER),
            Self::LeaseGrid => (SENT, LOOK),
            Self::TrackGrid | Self::StopGrid => (SENT, CYCLE),
            Self::MeasurementGrid => ("measured_ns, read before it is sent", GATHER),
            Self::ReferenceMachinery | Self::ObstacleMachinery | Self::MeasurementMachinery => {
                (GATHER, FIRST)
            }
            Self::LeaseAnswer | Self::TrackAnswer => (SENT, ANSWER),
            Self::LeaseMachinery => (LOOK, ANSWER),
            Self::TrackMachinery => (CYCLE, ANSWER),
            Self::StopCommand => (SENT, STOPPED),
            Self::StopMachinery => (CYCLE, STOPPED),
            Self::StopZeroHandover => (
                SENT,
                "first zero rates handed over by the cycle thread, less the ramp",
            ),
            Self::StopZeroCommand => (
                SENT,
                "first command of zero rates in the client's hands, less the ramp",
            ),
        }
    }

    /// Whether it is mere waiting for the grid: evenly spread over a period by the way it is measured, so
    /// that two runs cannot differ in it.
    pub fn is_grid(self) -> bool {
        self.name().split('.').nth(1) == Some("grid")
    }
}

/// The three legs of something that waits for a gather.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Way {
    pub(super) whole: Leg,
    pub(super) grid: Leg,
    pub(super) machinery: Leg,
}

impl Way {
    pub(super) const REFERENCE: Self = Self {
        whole: Leg::ReferenceCommand,
        grid: Leg::ReferenceGrid,
        machinery: Leg::ReferenceMachinery,
    };
    pub(super) const OBSTACLE: Self = Self {
        whole: Leg::ObstacleCommand,
        grid: Leg::ObstacleGrid,
        machinery: Leg::ObstacleMachinery,
    };
    pub(super) const MEASUREMENT: Self = Self {
        whole: Leg::MeasurementCommand,
        grid: Leg::MeasurementGrid,
        machinery: Leg::MeasurementMachinery,
    };
    pub(super) const LEASE: Self = Self {
        whole: Leg::LeaseAnswer,
        grid: Leg::LeaseGrid,
        machinery: Leg::LeaseMachinery,
    };
    pub(super) const TRACK: Self = Self {
        whole: Leg::TrackAnswer,
        grid: Leg::TrackGrid,
        machinery: Leg::TrackMachinery,
    };
    pub(super) const STOP: Self = Self {
        whole: Leg::StopCommand,
        grid: Leg::StopGrid,
        machinery: Leg::StopMachinery,
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_leg_has_its_place_and_a_name_of_its_own() {
        for (index, leg) in Leg::ALL.iter().enumerate() {
            assert_eq!(*leg as usize, index);
            let same = Leg::ALL.iter().filter(|other| other.name() == leg.name());
            assert_eq!(same.count(), 1, "{}", leg.name());
        }
    }
}
