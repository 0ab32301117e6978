//! Requests of clients to a cycle, and their precedence after a stop.

use cdcr_controller::safety::{Mode, Observation, Refusal, Request};

use super::Cycle;
use crate::handover::{
    CycleAnswer, CycleInputs, CycleRequest, REQUESTS_PER_CYCLE, REQUESTS_WAITING,
};
use crate::rt::schedule::Release;

impl Cycle {
    /// Notes the time at which a stop or a fault latched the robot.
    pub(super) fn note_latch(&mut self, before: Mode, release: &Release) {
        let now = self.modes.mode();
        if now.is_latched() && now != before {
            self.latched_ns = release.start_ns;
        }
    }

    /// Carries out the waiting requests. A request from before a stop or a fault is not carried out after it.
    pub(super) fn answer(
        &mut self,
        mut next_request: impl FnMut() -> Option<CycleRequest>,
        inputs: &CycleInputs,
        seen: &Observation,
        release: &Release,
    ) -> [Option<CycleAnswer>; REQUESTS_WAITING] {
        let is_stopped = core::mem::take(&mut self.stop_signalled) || inputs.stops > self.stops;
        // A counted stop answers all waiting requests.
        let most = if is_stopped {
            REQUESTS_WAITING
        } else {
            REQUESTS_PER_CYCLE
        };
        let mut asked = [None; REQUESTS_WAITING];
        asked[..most].fill_with(&mut next_request);
        let of_requests = asked.iter().flatten();
        let of_requests = of_requests.filter(|asked| asked.request == Request::Stop);
        let newest = of_requests.map(|stop| stop.stops).max();
        let stops = is_stopped || newest.is_some();
        self.stops = self.stops.max(inputs.stops).max(newest.unwrap_or(0));
        if stops {
            self.latched_ns = release.start_ns;
        }
        let latched_ns = self.latched_ns;
        let is_in_time =
            |asked: &CycleRequest| asked.request == Request::Stop || asked.asked_ns >= latched_ns;
        let requests = asked
            .map(|asked: Option<CycleRequest>| asked.filter(is_in_time).map(|asked| asked.request));
        let outcomes = self.modes.requests(&requests, stops, seen);
        let mut answers = [None; REQUESTS_WAITING];
        for (answer, (asked, outcome)) in answers.iter_mut().zip(asked.iter().zip(outcomes)) {
            *answer = asked.map(|CycleRequest { ticket, .. }| CycleAnswer {
                ticket,
                outcome: outcome.unwrap_or(Err(Refusal::Overruled)),
            });
        }
        answers
    }
}
