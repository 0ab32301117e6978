use std::cell::OnceCell;
use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::codes::{Mode, Outcome, RequestKind, UnknownCode};
use cdcr_shared_types::{Request, Response, Service, SolverSettings, ipc};
use iceoryx2::port::client::Client;
use iceoryx2::prelude::BackpressureStrategy;
use iceoryx2::service::port_factory::PortFactory;

use crate::connect_error::Place;
use crate::link_error::{LinkError, Liveness};
use crate::remedy::{refusal, request_remedy};
use crate::sender::Sender;
use crate::services::ControlChannel;

/// How often a waiting client looks for the answer.
pub(crate) const LOOK_AGAIN: Duration = Duration::from_millis(1);

/// Why a request had no effect.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// The daemon refused it.
    #[error("cannot {kind}: {} (the daemon is {mode}). {}", refusal(*kind, *outcome), request_remedy(*kind, *outcome, *mode))]
    Refused {
        /// What was asked for.
        kind: RequestKind,
        /// Why not.
        outcome: Outcome,
        /// Mode of the daemon after the request.
        mode: Mode,
    },
    /// No answer came.
    #[error(
        "cannot {kind}: the daemon did not answer within {} ms: {liveness}",
        waited.as_millis()
    )]
    Timeout {
        /// What was asked for.
        kind: RequestKind,
        /// How long it was waited for.
        waited: Duration,
        /// Whether it still runs.
        liveness: Liveness,
    },
    /// Another daemon answered than the one that gave the lease.
    #[error(
        "cannot {kind} again: the daemon was restarted and the lease is lost. Acquire a new one"
    )]
    Restarted {
        /// What was asked for.
        kind: RequestKind,
    },
    /// The request or its answer could not be carried.
    #[error("cannot {kind}: {cause}")]
    Link {
        /// What was asked for.
        kind: RequestKind,
        /// What iceoryx2 says.
        cause: String,
    },
    /// The answer holds a code that this version does not know.
    #[error("the outcome of {kind} is unknown: the daemon answered with {code}")]
    Answer {
        /// What was asked for.
        kind: RequestKind,
        /// The code.
        code: UnknownCode,
    },
}

type Port = Client<ipc::Service, Request, (), Response, ()>;

/// The asking end of the control service. Its port is made when it is first used: with every client that joins or
/// leaves a service the daemon makes or removes files, and who only reads must not cost the control loop anything.
#[derive(Debug)]
pub(crate) struct Control {
    channel: ControlChannel,
    port: OnceCell<Port>,
    sender: Sender,
    place: Place,
    /// How many clients may ask, this one included, for it to be one of them.
    clients_max: usize,
}

impl Control {
    /// For everything but a stop: leaves the places free that are kept for one.
    pub(crate) fn new(channel: ControlChannel, sender: Sender, place: Place) -> Self {
        Self {
            channel,
            port: OnceCell::new(),
            sender,
            place,
            clients_max: Service::CONTROL_CLIENTS - Service::CONTROL_KEPT,
        }
    }

    /// May take the places that are kept for a stop.
    pub(crate) fn with_kept_places(self) -> Self {
        Self {
            clients_max: Service::CONTROL_CLIENTS,
            ..self
        }
    }

    /// The port, made if it is not there.
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

    /// Asks, waits for the answer, and returns it when it says accepted. When the daemon that has the
    /// request ends without an answer, or there is none at the moment, the next one gets it, as soon as it knows
    /// where its robot is: within `timeout` a request is never lost.
    pub(crate) fn ask(
        &self,
        kind: RequestKind,
        settings: SolverSettings,
        timeout: Duration,
    ) -> Result<Response, RequestError> {
        let deadline = Instant::now() + timeout;
        let mut was_unanswered = false;
        loop {
            let request = Request {
                header: self.sender.next_header(Service::Control),
                kind: kind.code(),
                reserved: 0,
                settings,
            };
            let answer = self.ask_once(kind, request, deadline)?;
            let is_over = Instant::now() >= deadline;
            if let Some(response) = answer
                && (is_over || !comes_too_early(kind, &response, was_unanswered))
            {
                return evaluate(kind, response);
            }
            was_unanswered |= answer.is_none();
            if is_over {
                return Err(RequestError::Timeout {
                    kind,
                    waited: timeout,
                    liveness: self.place.liveness(),
                });
            }
            thread::sleep(LOOK_AGAIN);
        }
    }

    /// Sends `request` to the daemon of this moment. `None` when no answer will come from it, or none came
    /// until `deadline`.
    fn ask_once(
        &self,
        kind: RequestKind,
        request: Request,
        deadline: Instant,
    ) -> Result<Option<Response>, RequestError> {
        let link = |cause: String| RequestError::Link { kind, cause };
        let port = self.port().map_err(|cause| link(cause.to_string()))?;
        let pending = port
            .send_copy(request)
            .map_err(|cause| link(ipc::words(&cause)))?;
        loop {
            // Before the look for the answer: a daemon answers first and then lets the request go.
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
                None => thread::sleep(LOOK_AGAIN),
            }
        }
    }
}

/// Whether the same request can be granted a moment later. A daemon that was started again refuses every request about
/// the mode until it has heard of its robot; and one that stood still refuses what waited for it for long, because it
/// does not know that the client still waits. But a stop may have come meanwhile: a reset that is from before it is not asked again.
fn comes_too_early(kind: RequestKind, response: &Response, was_unanswered: bool) -> bool {
    let is = |outcome: Outcome| response.outcome == outcome.code();
    let is_starting = response.mode == Mode::Starting.code();
    (kind != RequestKind::Reset && is(Outcome::Stale))
        || (was_unanswered && is_starting && is(Outcome::WrongMode))
}

fn evaluate(kind: RequestKind, response: Response) -> Result<Response, RequestError> {
    match Outcome::try_from(response.outcome) {
        Ok(Outcome::Accepted) => Ok(response),
        Ok(outcome) => Err(match Mode::try_from(response.mode) {
            Ok(mode) => RequestError::Refused {
                kind,
                outcome,
                mode,
            },
            Err(code) => RequestError::Answer { kind, code },
        }),
        Err(code) => Err(RequestError::Answer { kind, code }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_says_what_why_and_what_to_do() {
        let response = Response {
            outcome: Outcome::LeaseHeld.code(),
            mode: Mode::Tracking.code(),
            ..Response::default()
        };
        let text = evaluate(RequestKind::AcquireLease, response)
            .expect_err("refused")
            .to_string();
        assert!(text.contains("acquire the lease"), "{text}");
        assert!(
            text.contains("another client holds the reference lease"),
            "{text}"
        );
        assert!(text.contains("tracking"), "{text}");
        assert!(text.contains("cdcrctl status"), "{text}");
    }

    #[test]
    fn a_reset_that_the_daemon_found_too_old_is_not_asked_again() {
        let stale = Response {
            outcome: Outcome::Stale.code(),
            mode: Mode::Stopped.code(),
            ..Response::default()
        };
        assert!(comes_too_early(RequestKind::Home, &stale, true));
        assert!(!comes_too_early(RequestKind::Reset, &stale, true));
    }

    #[test]
    fn the_remedy_for_a_wrong_mode_fits_the_mode() {
        for (kind, mode, remedy) in [
            (RequestKind::Track, Mode::Homing, "cdcrctl hold"),
            (RequestKind::Home, Mode::Tracking, "cdcrctl hold"),
            (RequestKind::Hold, Mode::Starting, "not sent a measurement"),
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
                comes_too_early(RequestKind::Home, &response, was_unanswered),
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
