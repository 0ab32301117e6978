use cdcr_controller::robot::Robot;
use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::Outcome;

use super::bound_driver::BoundDriver;
use crate::config::{Config, Interface, LinkKind, ns};
use crate::convert::{self, Refused};
use crate::handover::TimedMeasurement;

/// The driver's newest measurement, and whose measurements count.
#[derive(Debug)]
pub(super) struct Measurements {
    has_driver: bool,
    interface: Interface,
    /// A measurement that is older than this when it arrives is refused \[ns\].
    timeout_ns: u64,
    driver: BoundDriver,
    newest: Option<TimedMeasurement>,
}

/// When a measurement arrives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrival {
    /// When the gather began \[ns\].
    pub(super) gather_ns: u64,
    /// Now: the gather may have stood still since it began \[ns\].
    pub(super) now_ns: u64,
    /// Whether the cycle has noticed a fault: it sees first that a driver is lost, and the robot rests before another one has it.
    pub(super) is_faulted: bool,
}

impl Measurements {
    /// No measurement yet.
    pub(super) fn new(config: &Config) -> Self {
        let timeout_ns = ns(config.link.measurement_timeout_ms);
        Self {
            has_driver: config.link.kind == LinkKind::Driver,
            interface: config.link.interface,
            timeout_ns,
            driver: BoundDriver::new(timeout_ns),
            newest: None,
        }
    }

    /// Nobody listened for `unheard_ns`: that is no silence of the driver.
    pub(super) fn extend(&mut self, unheard_ns: u64) {
        self.driver.extend(unheard_ns);
    }

    /// The newest one.
    pub(super) fn newest(&self) -> Option<TimedMeasurement> {
        self.newest
    }

    /// Keeps the newest measurement. One that is good and not newer than the newest is stale, and nobody's mistake.
    pub(super) fn take(
        &mut self,
        message: &Measurement,
        is_newer: bool,
        robot: &Robot,
        arrival: Arrival,
    ) -> Result<Outcome, Refused> {
        let timed = self.checked(message, robot, arrival)?;
        let newest = self.newest;
        if !is_newer || newest.is_some_and(|newest| timed.measured_ns <= newest.measured_ns) {
            return Ok(Outcome::Stale);
        }
        self.newest = Some(timed);
        self.driver
            .hear(message.header.sender_id, arrival.gather_ns);
        Ok(Outcome::Accepted)
    }

    /// One that is old at its arrival does not tell where the robot is, though its driver may be well: it is never
    /// believed, and a first one least of all.
    fn checked(
        &self,
        message: &Measurement,
        robot: &Robot,
        arrival: Arrival,
    ) -> Result<TimedMeasurement, Refused> {
        if !self.has_driver {
            return Err(Refused::whole(Outcome::Unsupported));
        }
        let sender = message.header.sender_id;
        if !self
            .driver
            .is(sender, arrival.gather_ns, arrival.is_faulted)
        {
            return Err(Refused::whole(Outcome::OtherDriver));
        }
        let interface = convert::interface(self.interface);
        let timed = convert::measurement(message, robot, interface, arrival.now_ns)?;
        if arrival.now_ns.saturating_sub(timed.measured_ns) > self.timeout_ns {
            return Err(Refused::whole(Outcome::InThePast));
        }
        Ok(timed)
    }
}
