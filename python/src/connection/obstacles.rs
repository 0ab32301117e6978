use std::collections::BTreeSet;
use std::time::Duration;

use cdcr_client::{LinkError, ObstacleSender, obstacles};
use cdcr_shared_types::Header;
use cdcr_shared_types::codes::{EventKind, Outcome};
use pyo3::prelude::*;

use super::Connection;
use crate::errors::{Class, Failure};

/// Time limit for the outcome of a message.
const OUTCOME: Duration = Duration::from_secs(1);

impl Connection {
    pub(super) fn send_obstacles(
        &self,
        py: Python<'_>,
        send: impl FnOnce(&ObstacleSender) -> Result<Header, LinkError> + Send + 'static,
    ) -> PyResult<()> {
        let outcome = self.worker.call_on_thread(py, move |desk| {
            let mut telemetry = desk.connection.telemetry()?;
            let sender = match &mut desk.obstacles {
                Some(sender) => sender,
                none => none.insert(desk.connection.obstacle_sender()?),
            };
            let header = send(sender)?;
            Ok::<_, Failure>(telemetry.outcome_on(EventKind::Obstacles, &header, OUTCOME)?)
        })??;
        if outcome == Outcome::Accepted {
            return Ok(());
        }
        let message = format!("the daemon refused the obstacles: {outcome}");
        Err(Failure::new(Class::Request, message, cdcr_client::remedy(outcome)).into())
    }

    fn ends_wait_for(&self, py: Python<'_>, silent: u64) -> PyResult<bool> {
        let is_over = self.worker.call_on_thread(py, move |desk| {
            desk.connection.ends_wait_for(silent, OUTCOME)
        })?;
        Ok(is_over.map_err(Failure::from)?)
    }

    /// Removes obstacles, and fails for those that were not known, as `cdcrctl obstacle remove` does.
    pub(super) fn remove(&self, py: Python<'_>, ids: Vec<u32>) -> PyResult<()> {
        // The daemon does not report which of them it knew.
        let (known, silent) = self.worker.call_on_thread(py, |desk| {
            let record = desk.connection.telemetry()?.next_within(OUTCOME)?;
            let known = record.map(|record| obstacles(&record).iter().map(|one| one.id).collect());
            let silent = desk.connection.status(OUTCOME)?.silent_obstacle_source;
            Ok::<(Option<BTreeSet<u32>>, u64), Failure>((known, silent))
        })??;
        let wanted: BTreeSet<u32> = ids.iter().copied().collect();
        self.send_obstacles(py, move |sender| sender.remove(&ids))?;
        let known = known.unwrap_or_else(|| wanted.clone());
        let unknown: Vec<_> = wanted.difference(&known).map(u32::to_string).collect();
        if unknown.is_empty() || silent != 0 && self.ends_wait_for(py, silent)? {
            return Ok(());
        }
        let message = format!("no obstacle {} was known to the daemon", unknown.join(", "));
        let remedy =
            "Use the numbers passed to set_obstacles; an obstacle with a lifetime ends by itself.";
        Err(Failure::new(Class::Request, message, remedy).into())
    }
}
