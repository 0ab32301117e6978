use core::fmt::{Debug, Display};
use std::time::Duration;

use cdcr_shared_types::limits::{CHUNK_POINTS_MAX, OBSTACLES_MAX};
use cdcr_shared_types::{Service, ipc};

/// Why a port of an open connection failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// A publisher or subscriber could not be created.
    #[error(
        "cannot open a port on the {service} service: {cause}. \
         At most {writers} writers and {readers} readers are allowed; close one of them"
    )]
    Port {
        /// Last part of the service's name.
        service: &'static str,
        /// Error text of iceoryx2.
        cause: String,
        /// Writers that the service allows.
        writers: usize,
        /// Readers that the service allows.
        readers: usize,
    },
    /// The port for requests could not be created.
    #[error(
        "cannot send requests to the daemon: {cause}. At most {} clients are allowed; close one of them",
        Service::CONTROL_CLIENTS - Service::CONTROL_KEPT
    )]
    Askers {
        /// Error text of iceoryx2, or that all places are taken.
        cause: String,
    },
    /// Shared memory has no space for a port.
    #[error("cannot open a port on the {service} service: {cause}")]
    Memory {
        /// Last part of the service's name.
        service: &'static str,
        /// Needed and free space, and the remedy.
        cause: String,
    },
    /// A message could not be sent.
    #[error("cannot send on the {service} service: {cause}")]
    Send {
        /// Last part of the service's name.
        service: &'static str,
        /// Error text of iceoryx2.
        cause: String,
    },
    /// Messages could not be received.
    #[error("cannot receive from the {service} service: {cause}")]
    Receive {
        /// Last part of the service's name.
        service: &'static str,
        /// Error text of iceoryx2.
        cause: String,
    },
    /// The daemon has stopped sending.
    #[error(
        "the daemon has sent nothing on the {service} service for {} ms: {liveness}",
        waited.as_millis()
    )]
    Silent {
        /// Last part of the service's name.
        service: &'static str,
        /// Time waited.
        waited: Duration,
        /// Whether the daemon still runs.
        liveness: Liveness,
    },
    /// The root folder was emptied or replaced: the port lies in a deleted file, and no daemon receives.
    #[error(
        "nobody receives on the {service} service: the daemon's root folder was emptied or replaced since this program connected. \
         Connect again, or start this program again"
    )]
    Replaced {
        /// Last part of the service's name.
        service: &'static str,
    },
    /// A reference chunk without points or with too many.
    #[error("a reference chunk holds 1 to {CHUNK_POINTS_MAX} points, not {count}")]
    ChunkPoints {
        /// Number of points.
        count: usize,
    },
    /// An obstacle message with too many obstacles.
    #[error("an obstacle message holds at most {OBSTACLES_MAX} obstacles, not {count}")]
    Obstacles {
        /// Number of obstacles.
        count: usize,
    },
    /// An obstacle that is probably in millimetres.
    #[error("{cause}: are these millimetres? Positions and radius are in m: 150 mm are 0.15")]
    Misplaced {
        /// The obstacle and its place.
        cause: String,
    },
}

/// State of a daemon that does not answer or sends nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Liveness {
    /// Not checked.
    Unknown,
    /// The process runs: it is stopped, or one of its threads is blocked.
    Runs {
        /// Process id, where it could be determined.
        process_id: Option<u32>,
    },
    /// No process holds the daemon's lock or name.
    Ended,
    /// The root folder was emptied or replaced since this client connected: it reaches neither the daemon of then nor a later one.
    Replaced,
}

impl Display for Liveness {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Unknown => f.write_str("it has ended, or is stopped or delayed"),
            Self::Runs { process_id } => {
                let process = process_text(*process_id);
                write!(f, "it runs ({process}), but is stopped or delayed")
            }
            Self::Ended => f.write_str("it has ended (start one with `cdcrd run`)"),
            Self::Replaced => f.write_str(
                "its root folder was emptied or replaced since this program connected: connect again, or start this program again",
            ),
        }
    }
}

/// Text for a process id.
pub(crate) fn process_text(process_id: Option<u32>) -> String {
    process_id.map_or_else(
        || "process unknown".to_owned(),
        |id| format!("process {id}"),
    )
}

impl LinkError {
    pub(crate) fn port(service: Service, cause: String) -> Self {
        let queues = service.queues();
        Self::Port {
            service: service.key(),
            cause,
            writers: queues.publishers,
            readers: queues.watchers(),
        }
    }

    pub(crate) fn askers(cause: String) -> Self {
        Self::Askers { cause }
    }

    pub(crate) fn memory(service: Service, lack: impl Display) -> Self {
        Self::Memory {
            service: service.key(),
            cause: lack.to_string(),
        }
    }

    pub(crate) fn send(service: Service, cause: impl Debug) -> Self {
        Self::Send {
            service: service.key(),
            cause: ipc::words(&cause),
        }
    }

    pub(crate) fn receive(service: Service, cause: impl Debug) -> Self {
        Self::Receive {
            service: service.key(),
            cause: ipc::words(&cause),
        }
    }

    pub(crate) fn replaced(service: Service) -> Self {
        Self::Replaced {
            service: service.key(),
        }
    }

    pub(crate) fn silent(service: Service, waited: Duration, liveness: Liveness) -> Self {
        Self::Silent {
            service: service.key(),
            waited,
            liveness,
        }
    }
}
