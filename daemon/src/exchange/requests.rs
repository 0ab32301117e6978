//! Requests of clients: answered at once (lease, settings, statistics), or after the cycle that carries them
//! out.

use cdcr_controller::safety::Request as ModeRequest;
use cdcr_shared_types::codes::{EventKind, Mode, Outcome, RequestKind};
use cdcr_shared_types::limits::{POSE_DIFFERS_RAD, REQUEST_AGE_MS_MAX};
use cdcr_shared_types::{Header, Request, Response, Service, ipc};
use iceoryx2::active_request::ActiveRequest;

use super::Exchange;
use crate::convert::{Refused, mode_request};
use crate::handover::{CycleAnswer, CycleRecord, CycleRequest, Shared};
use crate::rt::clock::Clock;

/// A request whose client waits for an answer.
type Asked = ActiveRequest<ipc::Variant, Request, (), Response, ()>;

/// Requests carried out by one gather; others are refused as busy, except stops.
pub(super) const REQUESTS_PER_GATHER: usize = 4;
/// Requests read by one gather, so that a stop is found behind a flood of others.
const REQUESTS_SEEN_PER_GATHER: usize = Service::CONTROL_CLIENTS * Service::CONTROL_REQUESTS;
/// Largest age of a request at its arrival \[ns\].
const REQUEST_AGE_MAX_NS: u64 = 1_000_000 * REQUEST_AGE_MS_MAX as u64;
/// Requests that can wait for their cycle.
const WAITING_MAX: usize = 16;

/// The requests that wait for a cycle, and the counts of a gather.
#[derive(Debug)]
pub(super) struct RequestDesk {
    waiting: Vec<(u64, Asked)>,
    next_ticket: u64,
    answers_sent: u64,
    /// Requests carried out since the newest gather began.
    taken: usize,
    stops: u64,
}

impl RequestDesk {
    pub(super) fn new() -> Self {
        Self {
            waiting: Vec::with_capacity(WAITING_MAX),
            next_ticket: 1,
            answers_sent: 0,
            taken: 0,
            stops: 0,
        }
    }

    /// Lets a new gather carry out requests again.
    pub(super) fn begin_gather(&mut self) {
        self.taken = 0;
    }

    /// Stops requested so far.
    pub(super) fn stops(&self) -> u64 {
        self.stops
    }

    fn has_space(&self) -> bool {
        self.waiting.len() < WAITING_MAX
    }

    /// Removes the request with `ticket`.
    fn remove(&mut self, ticket: u64) -> Option<Asked> {
        let mut waiting = self.waiting.iter();
        let at = waiting.position(|(waiting, _)| *waiting == ticket)?;
        Some(self.waiting.swap_remove(at).1)
    }
}

impl Exchange {
    pub(super) fn take_requests(&mut self, now_ns: u64, clock: &impl Clock, shared: &Shared) {
        for _ in 0..REQUESTS_SEEN_PER_GATHER {
            let Ok(Some(asked)) = self.ports.control.receive() else {
                return;
            };
            let is_stop = asked.payload().kind == RequestKind::Stop.code();
            if is_stop {
                self.forward_stop(asked, now_ns, shared);
            } else if self.requests.taken < REQUESTS_PER_GATHER {
                self.requests.taken += 1;
                if asked.payload().header.sent_ns > clock.now_ns() {
                    // By such a time a stop would never be newer than the request.
                    self.answer_now(&asked, Outcome::InTheFuture, now_ns);
                    continue;
                }
                self.take_request(asked, now_ns, shared);
            } else {
                self.answer_now(&asked, Outcome::Busy, now_ns);
            }
        }
    }

    /// A stop is never refused and never waits: the inputs of the next cycle count it. If the ring has no
    /// space for the cycle's answer, it is answered now.
    fn forward_stop(&mut self, asked: Asked, now_ns: u64, shared: &Shared) {
        shared.latch.stop_asked();
        self.requests.stops += 1;
        let ring_has_room = self.ends.requests.slots() > 0 && self.requests.has_space();
        if ring_has_room {
            self.forward_to_cycle(asked, ModeRequest::Stop, now_ns);
            // A reset before the stop may have been carried out meanwhile.
            shared.latch.stop_asked();
        } else {
            shared.latch.stop_asked();
            self.answer_now(&asked, Outcome::Accepted, now_ns);
        }
    }

    fn take_request(&mut self, asked: Asked, now_ns: u64, shared: &Shared) {
        let kind = RequestKind::try_from(asked.payload().kind);
        let (kind, accepts_pose) = match (kind, asked.payload().accepts_pose) {
            (Ok(kind), 0) => (kind, false),
            (Ok(RequestKind::Reset), 1) => (RequestKind::Reset, true),
            _ => return self.answer_now(&asked, Outcome::UnknownCode, now_ns),
        };
        // The client of so old a request has already timed out; only a stop is never too late.
        let age_ns = now_ns.saturating_sub(asked.payload().header.sent_ns);
        if age_ns > REQUEST_AGE_MAX_NS {
            return self.answer_now(&asked, Outcome::Stale, now_ns);
        }
        let lease_number = self.references.lease_number();
        if let Some(request) = mode_request(kind, accepts_pose, lease_number) {
            self.forward_to_cycle(asked, request, now_ns);
        } else {
            let outcome = self.execute(kind, asked.payload(), now_ns, shared);
            self.answer_now(&asked, outcome, now_ns);
        }
    }

    /// Requests about the mode are decided by the cycle.
    fn forward_to_cycle(&mut self, asked: Asked, request: ModeRequest, now_ns: u64) {
        let ticket = self.requests.next_ticket;
        let ring = &mut self.ends.requests;
        let passed_on = CycleRequest {
            ticket,
            request,
            asked_ns: asked.payload().header.sent_ns,
            stops: self.requests.stops,
        };
        if self.requests.has_space() && ring.push(passed_on).is_ok() {
            self.requests.next_ticket += 1;
            self.requests.waiting.push((ticket, asked));
        } else {
            self.answer_now(&asked, Outcome::Busy, now_ns);
        }
    }

    /// Requests about lease, settings and statistics are decided here.
    fn execute(
        &mut self,
        kind: RequestKind,
        request: &Request,
        now_ns: u64,
        shared: &Shared,
    ) -> Outcome {
        let client = request.header.sender_id;
        match kind {
            RequestKind::AcquireLease => self.references.acquire_lease(client, now_ns),
            RequestKind::ReleaseLease => self.references.release_lease(client, now_ns),
            RequestKind::Settings => self.settings.change(&request.settings),
            RequestKind::ResetStatistics => {
                shared.statistics_resets.add(1);
                Outcome::Accepted
            }
            _ => Outcome::UnknownCode,
        }
    }

    fn answer_now(&mut self, asked: &Asked, outcome: Outcome, now_ns: u64) {
        let request = *asked.payload();
        self.note_request(&request, outcome, self.gather.number, now_ns);
        let response = self.response(&request.header, outcome, now_ns);
        // A client that has left gets no answer.
        let _ = asked.send_copy(response);
    }

    /// Answers the requests decided by a cycle.
    pub(super) fn answer_decided(&mut self, record: &CycleRecord, now_ns: u64) {
        for CycleAnswer { ticket, outcome } in record.answers.iter().flatten() {
            let Some(asked) = self.requests.remove(*ticket) else {
                continue;
            };
            let outcome = outcome.map_or_else(Outcome::from, |()| Outcome::Accepted);
            let request = *asked.payload();
            // With several waiting records, only the hand-over time identifies the cycle that decided.
            let decided_ns = record.handed_over_ns;
            self.note_request(&request, outcome, record.gather, decided_ns);
            let largest = match outcome {
                Outcome::PoseDiffers => Some(record.following.largest()),
                _ => None,
            };
            // Smaller where the daemon before this one left the pose uncertain.
            let (pose_section, pose_difference_rad) = largest
                .filter(|(_, rad)| *rad > POSE_DIFFERS_RAD)
                .unwrap_or_default();
            let response = Response {
                cycle: record.release.cycle,
                mode: Mode::from(record.mode).code(),
                pose_section,
                pose_difference_rad,
                ..self.response(&request.header, outcome, now_ns)
            };
            let _ = asked.send_copy(response);
        }
    }

    fn response(&mut self, asked: &Header, outcome: Outcome, now_ns: u64) -> Response {
        self.requests.answers_sent += 1;
        Response {
            header: self.header(self.requests.answers_sent, now_ns),
            request_sequence: asked.sequence,
            cycle: self.newest.cycle,
            outcome: outcome.code(),
            mode: self.newest.mode.code(),
            lease_holder: self.references.holder(now_ns).unwrap_or(0),
            lease_left_ns: self.references.lease_left_ns(now_ns),
            ..Response::default()
        }
    }

    fn note_request(
        &mut self,
        request: &Request,
        outcome: Outcome,
        gather: u64,
        evaluated_ns: u64,
    ) {
        let accepts_pose = request.kind == RequestKind::Reset.code() && request.accepts_pose != 0;
        let kind = if accepts_pose {
            RequestKind::ResetAcceptingPose.code()
        } else {
            request.kind
        };
        let result = match outcome {
            Outcome::Accepted => Ok(kind),
            outcome => Err(Refused {
                outcome,
                detail: kind,
            }),
        };
        self.events.note(
            gather,
            EventKind::Request,
            &request.header,
            evaluated_ns,
            result,
        );
    }
}
