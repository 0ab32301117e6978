use std::cell::OnceCell;
use std::fmt;
use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::codes::{Mode, Outcome, RequestKind, UnknownCode};
use cdcr_shared_types::limits::POSE_DIFFERS_RAD;
use cdcr_shared_types::{Request, Response, Service, ipc};
use iceoryx2::port::client::Client;
use iceoryx2::prelude::BackpressureStrategy;
use iceoryx2::service::port_factory::PortFactory;

use crate::connect_error::Place;
use crate::link_error::{LinkError, Liveness};
use crate::remedy::{refusal, request_remedy};
use crate::sender::MessageSender;
use crate::services::ControlChannel;

/// Interval at which a waiting client checks for the answer.
pub(crate) const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Name of what a client requested, in errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RequestName {
    /// A request of this kind.
    Request(RequestKind),
    /// The renewal of the lease, which is a request to acquire it.
    Renewal,
}

impl fmt::Display for RequestName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Request(kind) => kind.fmt(f),
            Self::Renewal => f.write_str("renew the lease"),
        }
    }
}

impl RequestName {
    /// The kind of the request.
    pub fn kind(self) -> RequestKind {
        match self {
            Self::Request(kind) => kind,
            Self::Renewal => RequestKind::AcquireLease,
        }
    }
}

/// How far a section is measured from where its last command left it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseDifference {
    /// Section with the largest difference, 1 next to the base; 0: the refusal is not for this reason.
    pub section: u32,
    /// Distance of that section from its commanded position \[rad\].
    pub rad: f64,
}

impl PoseDifference {
    /// Of the following errors of the sections \[rad\]: the largest, where a reset has to accept it.
    pub fn of_errors(errors_rad: &[f64]) -> Self {
        let sections = (1..).zip(errors_rad);
        sections
            .map(|(section, &rad)| Self { section, rad })
            .filter(|pose| pose.rad > POSE_DIFFERS_RAD)
            .max_by(|one, other| one.rad.total_cmp(&other.rad))
            .unwrap_or_default()
    }
}

impl fmt::Display for PoseDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.section {
            0 => Ok(()),
            section => write!(f, ": section {section} by {:.2} rad", self.rad),
        }
    }
}

/// Why a request failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RequestError {
    /// The daemon refused the request.
    #[error("cannot {asked}: {}{pose} (the daemon is {mode}). {}", refusal(asked.kind(), *outcome), request_remedy(asked.kind(), *outcome, *mode))]
    Refused {
        /// What was requested.
        asked: RequestName,
        /// Reason of the refusal.
        outcome: Outcome,
        /// Mode of the daemon after the request.
        mode: Mode,
        /// With [`Outcome::PoseDiffers`].
        pose: PoseDifference,
    },
    /// No answer arrived.
    #[error(
        "cannot {asked}: the daemon did not answer within {} ms: {liveness}",
        waited.as_millis()
    )]
    Timeout {
        /// What was requested.
        asked: RequestName,
        /// Time waited.
        waited: Duration,
        /// Whether the daemon still runs.
        liveness: Liveness,
    },
    /// The answer came from another daemon than the one that granted the lease.
    #[error(
        "cannot renew the lease: the daemon was restarted and the lease is lost. Acquire a new one"
    )]
    Restarted,
    /// The request or its answer could not be transferred.
    #[error("cannot {asked}: {cause}")]
    Link {
        /// What was requested.
        asked: RequestName,
        /// Error text of the port.
        cause: String,
    },
    /// The answer has a code that is unknown in this version.
    #[error("the outcome of {asked} is unknown: the daemon answered with {code}")]
    Answer {
        /// What was requested.
        asked: RequestName,
        /// The unknown code.
        code: UnknownCode,
    },
}

impl RequestError {
    /// The same error of a renewal.
    pub(crate) fn of_renewal(mut self) -> Self {
        match &mut self {
            Self::Refused { asked, .. }
            | Self::Timeout { asked, .. }
            | Self::Link { asked, .. }
            | Self::Answer { asked, .. } => *asked = RequestName::Renewal,
            Self::Restarted => {}
        }
        self
    }
}

type Port = Client<ipc::Variant, Request, (), Response, ()>;

/// The client end of the control service. Its port is created on first use: for every client that joins or
/// leaves a service, the daemon creates or removes files. A client that only reads must not cost the control
/// loop anything.
#[derive(Debug)]
pub(crate) struct Control {
    channel: ControlChannel,
    port: OnceCell<Port>,
    sender: MessageSender,
    place: Place,
    /// Maximum number of requesting clients, this one included.
    clients_max: usize,
}

impl Control {
    /// For all requests but a stop: leaves the ports free that are reserved for stops.
    pub(crate) fn new(channel: ControlChannel, sender: MessageSender, place: Place) -> Self {
        Self {
            channel,
            port: OnceCell::new(),
            sender,
            place,
            clients_max: Service::CONTROL_CLIENTS - Service::CONTROL_KEPT,
        }
    }

    /// May use the ports that are reserved for stops.
    pub(crate) fn with_reserved_places(self) -> Self {
        Self {
            clients_max: Service::CONTROL_CLIENTS,
            ..self
        }
    }

    /// The port, created on first use.
    pub(crate) fn port(&self) -> Result<&Port, LinkError> {
        if let Some(port) = self.port.get() {
            return Ok(port);
        }
        if self.channel.dynamic_config().number_of_clients() >= self.clients_max {
            return Err(LinkError::askers("all places are taken".to_owned()));
        }
        let port = self.channel.make_port(
            Service::Control,
            0,
            |service| {
                service
                    .client_builder()
                    .backpressure_strategy(BackpressureStrategy::DiscardData)
                    .create()
            },
            LinkError::askers,
        )?;
        Ok(self.port.get_or_init(|| port))
    }

    /// Liveness of the daemon, as far as this client can reach one.
    pub(crate) fn liveness(&self) -> Liveness {
        if self.channel.file.is_replaced() {
            return Liveness::Replaced;
        }
        self.place.liveness()
    }

    /// Sends a request and returns the answer if it is accepted. When the daemon ends without an answer, or
    /// none is running, the next daemon gets the request as soon as it knows the robot's configuration. So no
    /// request is lost within `timeout`. Of the `content`, header and kind are ignored.
    pub(crate) fn request(
        &self,
        kind: RequestKind,
        content: Request,
        timeout: Duration,
    ) -> Result<Response, RequestError> {
        let deadline = Instant::now() + timeout;
        let mut was_unanswered = false;
        loop {
            let request = Request {
                header: self.sender.next_header(Service::Control),
                kind: kind.code(),
                ..content
            };
            let answer = self.request_once(kind, request, deadline)?;
            let is_over = Instant::now() >= deadline;
            if let Some(response) = answer
                && (is_over || !can_be_retried(kind, &response, was_unanswered))
            {
                return evaluate(kind, response);
            }
            was_unanswered |= answer.is_none();
            if is_over {
                return Err(RequestError::Timeout {
                    asked: RequestName::Request(kind),
                    waited: timeout,
                    liveness: self.liveness(),
                });
            }
            thread::sleep(POLL_INTERVAL);
        }
    }

    /// Sends a reset.
    pub(crate) fn reset(
        &self,
        accept_pose: bool,
        timeout: Duration,
    ) -> Result<Response, RequestError> {
        let content = Request {
            accepts_pose: u32::from(accept_pose),
            ..Request::default()
        };
        self.request(RequestKind::Reset, content, timeout)
    }

    /// Sends `request` to the present daemon. `None` when it will not answer, or has not answered by
    /// `deadline`.
    fn request_once(
        &self,
        kind: RequestKind,
        request: Request,
        deadline: Instant,
    ) -> Result<Option<Response>, RequestError> {
        let asked = RequestName::Request(kind);
        let link = |cause: String| RequestError::Link { asked, cause };
        let port = self.port().map_err(|cause| link(cause.to_string()))?;
        let pending = port
            .send_copy(request)
            .map_err(|cause| link(ipc::words(&cause)))?;
        loop {
            // Read before the answer: a daemon answers first and then drops the request.
            let is_open = pending.is_connected();
            let answer = pending
                .receive()
                .map_err(|cause| link(ipc::words(&cause)))?;
            match answer {
                Some(answer) if answer.payload().request_sequence == request.header.sequence => {
                    return Ok(Some(*answer.payload()));
                }
                Some(_) => {}
                None if !is_open || Instant::now() >= deadline => return Ok(None),
                None => thread::sleep(POLL_INTERVAL),
            }
        }
    }
}

/// Whether the same request may be granted a moment later. A restarted daemon refuses requests for a mode
/// until it has measured its robot. A daemon that was suspended refuses old requests, because it cannot know
/// that the client still waits. A reset is not repeated, because a stop may have been requested in the
/// meantime.
fn can_be_retried(kind: RequestKind, response: &Response, was_unanswered: bool) -> bool {
    let is = |outcome: Outcome| response.outcome == outcome.code();
    let is_starting = response.mode == Mode::Starting.code();
    (kind != RequestKind::Reset && is(Outcome::Stale))
        || (was_unanswered && is_starting && is(Outcome::WrongMode))
}

fn evaluate(kind: RequestKind, response: Response) -> Result<Response, RequestError> {
    let asked = RequestName::Request(kind);
    match Outcome::try_from(response.outcome) {
        Ok(Outcome::Accepted) => Ok(response),
        Ok(outcome) => Err(match Mode::try_from(response.mode) {
            Ok(mode) => RequestError::Refused {
                asked,
                outcome,
                mode,
                pose: PoseDifference {
                    section: response.pose_section,
                    rad: response.pose_difference_rad,
                },
            },
            Err(code) => RequestError::Answer { asked, code },
        }),
        Err(code) => Err(RequestError::Answer { asked, code }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_has_request_reason_and_remedy() {
        let response = Response {
            outcome: Outcome::LeaseHeld.code(),
            mode: Mode::Tracking.code(),
            ..Response::default()
        };
        let refused = evaluate(RequestKind::AcquireLease, response).expect_err("refused");
        let renewal = refused.clone().of_renewal().to_string();
        let text = refused.to_string();
        assert!(text.contains("cannot acquire the lease:"), "{text}");
        let expected = text.replace("acquire", "renew");
        assert_eq!(renewal, expected);
        assert!(
            text.contains("another client holds the reference lease"),
            "{text}"
        );
        assert!(text.contains("tracking"), "{text}");
        assert!(text.contains("cdcrctl status"), "{text}");
    }

    #[test]
    fn a_refused_pose_names_its_section_and_the_ways_out() {
        let response = Response {
            outcome: Outcome::PoseDiffers.code(),
            mode: Mode::Faulted.code(),
            pose_section: 2,
            pose_difference_rad: 0.834,
            ..Response::default()
        };
        let text = evaluate(RequestKind::Reset, response)
            .expect_err("refused")
            .to_string();
        for part in [
            "left it: section 2 by 0.83 rad (the daemon is faulted). ",
            "--accept-pose",
            "zero",
        ] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn a_reset_that_the_daemon_found_too_old_is_not_asked_again() {
        let stale = Response {
            outcome: Outcome::Stale.code(),
            mode: Mode::Stopped.code(),
            ..Response::default()
        };
        assert!(can_be_retried(RequestKind::Home, &stale, true));
        assert!(!can_be_retried(RequestKind::Reset, &stale, true));
    }

    #[test]
    fn the_remedy_for_a_wrong_mode_fits_the_mode() {
        for (kind, mode, remedy) in [
            (RequestKind::Track, Mode::Homing, "cdcrctl hold"),
            (RequestKind::Home, Mode::Tracking, "cdcrctl hold"),
            (
                RequestKind::Hold,
                Mode::Starting,
                "No measurement of the driver",
            ),
            (RequestKind::Track, Mode::Stopped, "cdcrctl reset"),
            (RequestKind::Home, Mode::Faulted, "cdcrctl reset"),
            (RequestKind::Reset, Mode::Tracking, "Nothing to reset"),
        ] {
            let response = Response {
                outcome: Outcome::WrongMode.code(),
                mode: mode.code(),
                ..Response::default()
            };
            let error = evaluate(kind, response).expect_err("refused");
            assert!(error.to_string().contains(remedy), "{error}");
        }
    }

    #[test]
    fn only_what_can_be_granted_in_a_moment_is_asked_again() {
        let response = |outcome: Outcome, mode: Mode| Response {
            outcome: outcome.code(),
            mode: mode.code(),
            ..Response::default()
        };
        for (outcome, mode, was_unanswered, again) in [
            (Outcome::WrongMode, Mode::Starting, true, true),
            (Outcome::WrongMode, Mode::Starting, false, false),
            (Outcome::WrongMode, Mode::Faulted, true, false),
            (Outcome::Ending, Mode::Stopped, true, false),
            (Outcome::Stale, Mode::Holding, false, true),
            (Outcome::Accepted, Mode::Starting, true, false),
        ] {
            let response = response(outcome, mode);
            assert_eq!(
                can_be_retried(RequestKind::Home, &response, was_unanswered),
                again,
                "{outcome} {mode}"
            );
        }
    }

    #[test]
    fn an_unknown_outcome_is_no_success() {
        let response = Response {
            outcome: 999,
            ..Response::default()
        };
        assert!(matches!(
            evaluate(RequestKind::Hold, response),
            Err(RequestError::Answer { .. })
        ));
    }
}
