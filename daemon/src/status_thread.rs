//! Publishes the status and incidents, so that the supervisor never waits for files.
//!
//! For each reader that joins or leaves, iceoryx2 creates and removes files in the root folder, under a lock
//! shared with clients. The supervisor feeds watchdogs and receives signals. So it passes its results through
//! a bounded hand-over to this thread.

use std::sync::Arc;
use std::sync::mpsc::channel;
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use cdcr_shared_types::{Incident, Service, Status, ipc};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::Node;

use crate::config::Validated;
use crate::handover::{Shared, StatusThreadEnds};
use crate::services::{ServiceError, incidents, node, publisher};

/// Time between checks for new readers of the incidents, unless woken: they receive earlier incidents.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);
/// Time limit for the creation of its ports.
const START_MAX: Duration = Duration::from_secs(10);
/// Longest wait for the thread at the end.
const END_MAX: Duration = Duration::from_secs(1);
/// iceoryx2 has large arrays on the stack.
const STACK_BYTES: usize = 1024 * 1024;

/// Handle of the thread; dropping it ends the thread.
#[derive(Debug)]
pub struct StatusThread {
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

impl StatusThread {
    /// Starts the thread with the priority and the cores of the calling thread, and waits until its services
    /// exist.
    pub(crate) fn start(
        validated: &Validated,
        ends: StatusThreadEnds,
        shared: &Arc<Shared>,
    ) -> Result<Self> {
        let (ready, is_ready) = channel();
        let (validated, theirs) = (validated.clone(), Arc::clone(shared));
        let thread = Builder::new()
            .name("cdcr-status".to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || match Desk::new(&validated, ends) {
                // If nobody receives the answer, the start was abandoned.
                Ok(mut desk) => drop(ready.send(Ok(())).map(|()| desk.run(&theirs))),
                Err(error) => drop(ready.send(Err(error))),
            })
            .context("the thread cdcr-status")?;
        let answer = is_ready.recv_timeout(START_MAX);
        answer.context("the thread cdcr-status did not start")??;
        Ok(Self {
            shared: Arc::clone(shared),
            thread,
        })
    }

    /// Wakes the thread to publish.
    pub(crate) fn wake(&self) {
        self.thread.thread().unpark();
    }

    pub(crate) fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }
}

impl Drop for StatusThread {
    fn drop(&mut self) {
        self.shared.supervisor_ended.set(true);
        self.wake();
        let begin = Instant::now();
        while !self.thread.is_finished() && begin.elapsed() < END_MAX {
            std::thread::sleep(Duration::from_millis(1));
        }
        if !self.thread.is_finished() {
            tracing::warn!("thread cdcr-status does not respond: the process ends without it");
        }
    }
}

/// The publishers of both services.
#[derive(Debug)]
struct Desk {
    statuses: Publisher<ipc::Variant, Status, ()>,
    incidents: Publisher<ipc::Variant, Incident, ()>,
    ends: StatusThreadEnds,
    /// Number of status messages sent.
    sent: u64,
    _node: Node<ipc::Variant>,
}

impl Desk {
    fn new(validated: &Validated, ends: StatusThreadEnds) -> Result<Self, ServiceError> {
        let (node, robot) = (node(&validated.location)?, &validated.config.robot.name);
        Ok(Self {
            statuses: publisher(&node, Service::Status, robot)?,
            incidents: incidents(&node, robot)?,
            ends,
            sent: 0,
            _node: node,
        })
    }

    /// Runs until the supervisor's last status is published.
    fn run(&mut self, shared: &Shared) {
        loop {
            // Checked before the hand-over is emptied: after the end nothing more can come.
            let is_last = shared.supervisor_ended.is_set();
            shared.status_beats.add(1);
            self.publish();
            if is_last {
                break;
            }
            std::thread::park_timeout(CHECK_INTERVAL);
        }
    }

    fn publish(&mut self) {
        while let Ok(incident) = self.ends.incidents.pop() {
            if let Err(error) = self.incidents.send_copy(incident) {
                tracing::warn!(%error, "cannot publish an incident");
            }
        }
        // Late joiners receive earlier incidents.
        if let Err(error) = self.incidents.update_connections() {
            tracing::warn!(%error, "cannot connect an incident subscriber");
        }
        if self.ends.status.update() {
            let mut status = *self.ends.status.read();
            // A status replaced before it was sent leaves no gap in the sequence.
            self.sent += 1;
            status.header.sequence = self.sent;
            if let Err(error) = self.statuses.send_copy(status) {
                tracing::warn!(%error, "cannot publish the status");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;
    use crate::config::Config;
    use crate::handover::{RuntimeSettings, channels};

    #[test]
    fn a_snapshot_that_another_one_replaced_leaves_no_gap() {
        let folder = Scratch::in_memory().unwrap();
        let root = folder.path().join("root");
        let text = format!("[transport]\nroot = \"{}\"\n", root.display());
        let validated = Config::parse(&text, &folder.path().join("robot.toml")).unwrap();
        let ends = channels(RuntimeSettings::new(&validated.config));
        let mut supervisor = ends.supervisor;
        let mut desk = Desk::new(&validated, ends.status_thread).unwrap();
        let name = Service::Status.name(&validated.config.robot.name).unwrap();
        let service = node(&validated.location).unwrap().service_builder(&name);
        let service = service.publish_subscribe::<Status>().open().unwrap();
        let reader = service.subscriber_builder().create().unwrap();
        let mut status = Status::default();
        for (cycles, is_sent) in [(1, true), (2, false), (3, false), (4, true)] {
            status.cycles = cycles;
            supervisor.status.write(status);
            if is_sent {
                desk.publish();
            }
        }
        let seen: Vec<_> = std::iter::from_fn(|| reader.receive().unwrap())
            .map(|status| (status.header.sequence, status.cycles))
            .collect();
        assert_eq!(seen, [(1, 1), (2, 4)]);
    }
}
