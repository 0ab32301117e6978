use core::fmt::Display;

use cdcr_client::{CommandRefusal, ConnectError, LinkError, RequestError, StopError};
use cdcr_shared_types::Response;
use cdcr_shared_types::codes::{Interface, UnknownCode};

use crate::code::Code;

/// Error of a call: its return code, and the text for `cdcr_last_error`.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) code: Code,
    pub(crate) text: String,
    /// The answer of the daemon, if it refused a request.
    pub(crate) refusal: Option<Response>,
}

impl Failure {
    pub(crate) fn new(code: Code, text: impl Display) -> Self {
        Self {
            code,
            text: text.to_string(),
            refusal: None,
        }
    }

    pub(crate) fn argument(text: impl Display) -> Self {
        Self::new(Code::Argument, text)
    }
}

/// Refuses the argument `name` where no `T` can be.
pub(crate) fn check_pointer<T>(pointer: *const T, name: &str) -> Result<(), Failure> {
    if pointer.is_null() {
        return Err(Failure::argument(format!("{name} is NULL")));
    }
    if !pointer.is_aligned() {
        let why = format!("{name} is not aligned as its type is");
        return Err(Failure::argument(why));
    }
    Ok(())
}

/// Converts the argument `name` from C to a code of the wire.
pub(crate) fn read_code<T: TryFrom<u32, Error = UnknownCode>>(
    value: u32,
    name: &str,
) -> Result<T, Failure> {
    T::try_from(value).map_err(|unknown| Failure::argument(format!("{name}: {unknown}")))
}

/// Converts the argument `interface` of a driver.
pub(crate) fn read_interface(value: u32) -> Result<Interface, Failure> {
    match read_code(value, "interface")? {
        Interface::None => Err(Failure::argument(
            "interface: a driver obeys CDCR_INTERFACE_VELOCITY or CDCR_INTERFACE_POSITION",
        )),
        interface => Ok(interface),
    }
}

impl From<ConnectError> for Failure {
    fn from(error: ConnectError) -> Self {
        let code = match &error {
            ConnectError::DaemonNotRunning { .. } => Code::NoDaemon,
            ConnectError::Silent { .. } => Code::Silent,
            ConnectError::VersionMismatch { .. } => Code::Layout,
            ConnectError::OtherUser { .. }
            | ConnectError::OtherClock { .. }
            | ConnectError::ReadOnly { .. } => Code::Access,
            ConnectError::Full { .. } => Code::Full,
            ConnectError::Robot(_) | ConnectError::Location(_) => Code::Argument,
            ConnectError::Memory { .. } => Code::Link,
            ConnectError::Port(cause) => code_of(cause),
        };
        Self::new(code, error)
    }
}

impl From<LinkError> for Failure {
    fn from(error: LinkError) -> Self {
        Self::new(code_of(&error), error)
    }
}

fn code_of(error: &LinkError) -> Code {
    match error {
        LinkError::Port { .. } | LinkError::Askers { .. } => Code::Full,
        LinkError::Silent { .. } | LinkError::Replaced { .. } => Code::Silent,
        LinkError::ChunkPoints { .. }
        | LinkError::Obstacles { .. }
        | LinkError::Misplaced { .. } => Code::Argument,
        LinkError::Memory { .. } | LinkError::Send { .. } | LinkError::Receive { .. } => Code::Link,
    }
}

// Of a stated place: a refused command is not an error.
impl From<CommandRefusal> for Failure {
    fn from(refusal: CommandRefusal) -> Self {
        Self::argument(refusal)
    }
}

impl From<RequestError> for Failure {
    fn from(error: RequestError) -> Self {
        let refusal = match &error {
            RequestError::Refused {
                outcome,
                mode,
                pose,
                ..
            } => Some(Response {
                outcome: outcome.code(),
                mode: mode.code(),
                pose_section: pose.section,
                pose_difference_rad: pose.rad,
                ..Response::default()
            }),
            _ => None,
        };
        let code = match &error {
            RequestError::Refused { .. } => Code::Refused,
            RequestError::Timeout { .. } => Code::Silent,
            RequestError::Restarted => Code::NoDaemon,
            RequestError::Link { .. } => Code::Link,
            RequestError::Answer { .. } => Code::Layout,
        };
        Self {
            refusal,
            ..Self::new(code, error)
        }
    }
}

impl From<StopError> for Failure {
    fn from(error: StopError) -> Self {
        match error {
            StopError::NoDaemon(_) => Self::new(Code::NoDaemon, error),
            StopError::Connect(error) => error.into(),
            StopError::Request(error) => error.into(),
            StopError::Unconfirmed { .. } => Self::new(Code::Unconfirmed, error),
        }
    }
}
