//! The measured legs, each from one time stamp to another.

use crate::named::named;

const GATHER: &str = "start of the gather that takes it";
const STOPPED: &str = "first command of mode stopped in the client's hands";
const SENT: &str = "sent_ns of the message, read before it is sent";
const MEASURED: &str = "measured_ns, read before it is sent";
const HANDS: &str = "command in the client's hands";
const FIRST: &str = "first command that uses it in the client's hands";
const ANSWER: &str = "answer in the client's hands";

/// Each leg: name, start stamp, end stamp.
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

// `bare` is iceoryx2 alone between two processes. `grid` is the wait for the grid, `machinery` the rest. The
// exchange answers a renewal of the lease, the cycle a request to track.
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

    /// A whole leg and the two that follow it in the list: its wait for the grid, and the machinery.
    pub(super) fn with_parts(self) -> [Self; 3] {
        [0, 1, 2].map(|part| Self::ALL[self as usize + part])
    }
}
