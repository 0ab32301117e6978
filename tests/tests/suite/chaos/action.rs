//! The actions of a run, and their frequencies.

use cdcr_shared_types::codes::RequestKind;

/// One action on a daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Action {
    /// A `cdcrctl ref` begins.
    FeedByProcess,
    /// A client sends a request.
    Request(RequestKind),
    /// A client takes the lease and returns it, or lets it expire.
    TakeLease,
    /// A client is killed.
    KillClient,
    /// A client is stopped for a while.
    FreezeClient,
    /// A client without the lease sends a reference.
    FeedWithoutLease,
    /// Points in the past.
    LatePoints,
    /// Points that are not finite, out of reach, unordered or invalid.
    BadPoints,
    /// References or obstacles as fast as possible.
    Flood,
    /// An obstacle beside the robot, outside the safe distance.
    ObstacleNear,
    /// An obstacle inside the safe distance.
    ObstacleInside,
    /// An obstacle that approaches.
    ObstacleTowards,
    /// All obstacles are removed.
    ObstaclesCleared,
    /// More obstacles than allowed.
    TooManyObstacles,
    /// An invalid obstacle.
    BadObstacle,
    /// Other settings of the solver.
    Settings,
    /// Settings out of range.
    BadSettings,
    /// The whole daemon is stopped for a while.
    FreezeDaemon,
    /// Every core is kept busy.
    HogProcessors,
    /// A second daemon is started at the same place.
    SecondDaemon,
    /// A reader connects, reads a little and leaves.
    ReaderComesAndGoes,
    /// A reader connects and never reads.
    ReaderNeverReads,
    /// The driver is silent, late or frozen, jumps or measures NaN.
    FaultyDriver,
    /// The driver is stopped like a frozen process.
    FreezeDriver,
    /// The driver is killed, and another one started.
    KillDriver,
}

impl Action {
    /// Whether the action needs a robot behind a driver.
    pub(crate) fn needs_driver(self) -> bool {
        matches!(
            self,
            Self::FaultyDriver | Self::FreezeDriver | Self::KillDriver
        )
    }
}

/// Every action with its frequency in one round. A round is shuffled and executed completely, so that each
/// action occurs even in a short run.
pub(crate) const ROUND: &[(Action, usize)] = &[
    (Action::FeedByProcess, 4),
    (Action::Request(RequestKind::Track), 6),
    (Action::Request(RequestKind::Hold), 2),
    (Action::Request(RequestKind::Home), 4),
    (Action::Request(RequestKind::Stop), 2),
    (Action::Request(RequestKind::Reset), 12),
    (Action::Request(RequestKind::ResetStatistics), 1),
    (Action::TakeLease, 1),
    (Action::KillClient, 2),
    (Action::FreezeClient, 2),
    (Action::FeedWithoutLease, 2),
    (Action::LatePoints, 1),
    (Action::BadPoints, 2),
    (Action::Flood, 2),
    (Action::ObstacleNear, 4),
    (Action::ObstacleInside, 2),
    (Action::ObstacleTowards, 3),
    (Action::ObstaclesCleared, 4),
    (Action::TooManyObstacles, 1),
    (Action::BadObstacle, 3),
    (Action::Settings, 4),
    (Action::BadSettings, 1),
    (Action::FreezeDaemon, 2),
    (Action::HogProcessors, 1),
    (Action::SecondDaemon, 1),
    (Action::ReaderComesAndGoes, 2),
    (Action::ReaderNeverReads, 1),
    (Action::FaultyDriver, 5),
    (Action::FreezeDriver, 1),
    (Action::KillDriver, 2),
];
