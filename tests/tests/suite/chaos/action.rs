//! What can happen in a run, and how often.

use cdcr_shared_types::codes::RequestKind;

/// One thing that happens to a daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Action {
    /// A `cdcrctl ref` begins.
    FeedByProcess,
    /// Some client asks for something.
    Request(RequestKind),
    /// The lease is taken and given back, or left to expire.
    TakeLease,
    /// A client is killed outright.
    KillClient,
    /// A client is stopped for a while.
    FreezeClient,
    /// Somebody without the lease sends a reference.
    FeedWithoutLease,
    /// Points whose time is over.
    LatePoints,
    /// Points that are not finite, out of reach, not in order, or mean nothing.
    BadPoints,
    /// References, or obstacles, as fast as they can be sent.
    Flood,
    /// An obstacle beside the robot, outside the safe distance.
    ObstacleNear,
    /// An obstacle inside the safe distance.
    ObstacleInside,
    /// An obstacle that comes nearer.
    ObstacleTowards,
    /// Every obstacle is removed.
    ObstaclesCleared,
    /// More obstacles than are allowed.
    TooManyObstacles,
    /// An obstacle that is none.
    BadObstacle,
    /// Other settings of the solver.
    Settings,
    /// Settings that are out of range.
    BadSettings,
    /// The whole daemon stands still.
    FreezeDaemon,
    /// Every core is kept busy.
    HogProcessors,
    /// A second daemon is started at the same place.
    SecondDaemon,
    /// A reader comes, reads a little and goes.
    ReaderComesAndGoes,
    /// A reader comes and never reads.
    ReaderNeverReads,
    /// The driver is silent, late, frozen, jumps or measures what is no number.
    FaultyDriver,
    /// The driver is stopped like a frozen process.
    FreezeDriver,
    /// The driver is killed, and another one started.
    KillDriver,
}

impl Action {
    /// Whether it takes a robot behind a driver.
    pub(crate) fn needs_driver(self) -> bool {
        matches!(
            self,
            Self::FaultyDriver | Self::FreezeDriver | Self::KillDriver
        )
    }
}

/// Every action as often as it comes in one round. A round is shuffled and dealt to its end, so that each action
/// happens however short a run is.
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
