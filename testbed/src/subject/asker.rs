//! A client for requests that polls for the answer without sleeping; the client library polls once a
//! millisecond.

use anyhow::{Context, Result, ensure};
use cdcr_client::monotonic_ns;
use cdcr_shared_types::codes::{Outcome, RequestKind};
use cdcr_shared_types::{Header, Location, Request, Response, Service, ipc};
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client;
use iceoryx2::prelude::{BackpressureStrategy, Node};

/// Long, because machines stall.
const ANSWER_TIMEOUT_NS: u64 = 20_000_000_000;

#[derive(Debug)]
pub struct Asker {
    waiting: Option<Asked>,
    client: Client<ipc::Variant, Request, (), Response, ()>,
    sender_id: u64,
    sequence: u64,
    _node: Node<ipc::Variant>,
}

#[derive(Debug)]
struct Asked {
    pending: PendingResponse<ipc::Variant, Request, (), Response, ()>,
    kind: RequestKind,
    header: Header,
}

#[derive(Debug, Clone, Copy)]
pub struct Answer {
    pub kind: RequestKind,
    pub sequence: u64,
    pub received_ns: u64,
    pub response: Response,
}

impl Answer {
    pub fn accepted(&self) -> Result<()> {
        let (kind, outcome) = (self.kind, Outcome::text_of(self.response.outcome));
        ensure!(
            self.response.outcome == Outcome::Accepted.code(),
            "cannot {kind}: {outcome}"
        );
        Ok(())
    }
}

impl Asker {
    /// Opens the request service of the daemon of `robot`. Requests carry `sender_id`, to which the lease is
    /// bound.
    pub fn open(location: &Location, robot: &str, sender_id: u64) -> Result<Self> {
        let node = location.node_builder()?.create::<ipc::Variant>();
        let node = node.context("a node of iceoryx2")?;
        let service = node
            .service_builder(&Service::Control.name(robot)?)
            .request_response::<Request, Response>()
            .open()
            .context("the control service of the daemon")?;
        let client = service
            .client_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .context("a port for requests")?;
        Ok(Self {
            waiting: None,
            client,
            sender_id,
            sequence: 0,
            _node: node,
        })
    }

    /// Time at which the pending request was sent.
    pub fn waits_since_ns(&self) -> Option<u64> {
        self.waiting.as_ref().map(|asked| asked.header.sent_ns)
    }

    /// Sends a request, one at a time. Returns its sequence number and time stamp.
    pub fn ask(&mut self, kind: RequestKind) -> Result<(u64, u64)> {
        ensure!(
            self.waiting.is_none(),
            "a request was sent before the one before was answered"
        );
        self.sequence += 1;
        let header = Header {
            sender_id: self.sender_id,
            sequence: self.sequence,
            sent_ns: monotonic_ns(),
        };
        let request = Request {
            header,
            kind: kind.code(),
            ..Request::default()
        };
        let pending = self.client.send_copy(request);
        self.waiting = Some(Asked {
            pending: pending.with_context(|| format!("cannot {kind}"))?,
            kind,
            header,
        });
        Ok((header.sequence, header.sent_ns))
    }

    pub fn poll(&mut self) -> Result<Option<Answer>> {
        let Some(asked) = &self.waiting else {
            return Ok(None);
        };
        let received = asked.pending.receive();
        let received = received.with_context(|| format!("cannot {}", asked.kind))?;
        let received_ns = monotonic_ns();
        let Some(response) = received.map(|response| *response.payload()) else {
            let waited_ns = received_ns.saturating_sub(asked.header.sent_ns);
            let (kind, most_s) = (asked.kind, ANSWER_TIMEOUT_NS / 1_000_000_000);
            ensure!(
                waited_ns < ANSWER_TIMEOUT_NS,
                "cannot {kind}: the daemon did not answer within {most_s} s"
            );
            return Ok(None);
        };
        let asked = self.waiting.take().context("a request was waiting")?;
        Ok(Some(Answer {
            kind: asked.kind,
            sequence: asked.header.sequence,
            received_ns,
            response,
        }))
    }
}
