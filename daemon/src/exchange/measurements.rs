use cdcr_controller::estimator::Measurement as Measured;
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
    /// Of the bends or cables; of the tip where the driver measures nothing else.
    newest: Option<TimedMeasurement>,
    /// Of the tip, beside the bends or cables.
    newest_tip: Option<TimedMeasurement>,
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
            newest_tip: None,
        }
    }

    /// Nobody listened for `unheard_ns`: that is no silence of the driver.
    pub(super) fn extend(&mut self, unheard_ns: u64) {
        self.driver.extend(unheard_ns);
    }

    /// The newest one of the tip, where the driver measures bends or cables, too.
    pub(super) fn newest_tip(&self) -> Option<TimedMeasurement> {
        self.newest_tip
    }

    /// The newest one of what tells where the robot is.
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
        // What another driver measured does not say what this one does.
        let is_bound = self.driver.is_bound_to(message.header.sender_id);
        let has_bends = is_bound && self.newest.as_ref().is_some_and(|newest| !is_tip(newest));
        let newest = if has_bends && is_tip(&timed) {
            &mut self.newest_tip
        } else {
            &mut self.newest
        };
        if !is_newer || newest.is_some_and(|newest| timed.measured_ns <= newest.measured_ns) {
            return Ok(Outcome::Stale);
        }
        *newest = Some(timed);
        if !is_bound {
            self.newest_tip = None;
        }
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

fn is_tip(timed: &TimedMeasurement) -> bool {
    matches!(timed.measurement, Measured::TipPosition(_))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use std::path::Path;

    use cdcr_shared_types::Header;
    use cdcr_shared_types::codes::{Interface, MeasurementKind};

    use super::*;

    #[test]
    fn the_tip_counts_alone_until_something_tells_the_bends() {
        let text = "[link]\nkind = \"driver\"\n";
        let validated = Config::parse(text, Path::new("measurements")).unwrap();
        let mut desk = Measurements::new(&validated.config);
        let mut now_ns = 1_000_000_000;
        let mut take = |desk: &mut Measurements, sender_id: u64, kind: MeasurementKind| {
            now_ns += 1_000_000;
            let message = Measurement {
                header: Header {
                    sender_id,
                    ..Header::default()
                },
                measured_ns: now_ns,
                kind: kind.code(),
                interface: Interface::Velocity.code(),
                sections: 3,
                tip_position_m: [0.0, 0.0, 0.8],
                ..Measurement::default()
            };
            let arrival = Arrival {
                gather_ns: now_ns,
                now_ns,
                is_faulted: false,
            };
            let taken = desk.take(&message, true, &validated.robot, arrival);
            assert_eq!(
                taken.map_err(|refused| refused.outcome),
                Ok(Outcome::Accepted)
            );
            now_ns
        };
        let stamp = |timed: Option<TimedMeasurement>| timed.map(|timed| timed.measured_ns);
        let tip = take(&mut desk, 1, MeasurementKind::TipPose);
        assert_eq!(
            (stamp(desk.newest()), stamp(desk.newest_tip())),
            (Some(tip), None)
        );
        let bends = take(&mut desk, 1, MeasurementKind::Configuration);
        assert_eq!(stamp(desk.newest()), Some(bends));
        let tip = take(&mut desk, 1, MeasurementKind::TipPose);
        assert_eq!(
            (stamp(desk.newest()), stamp(desk.newest_tip())),
            (Some(bends), Some(tip))
        );
        // The encoders of a driver that is gone say nothing of one that has none.
        desk.driver = BoundDriver::new(0);
        let tip = take(&mut desk, 2, MeasurementKind::TipPose);
        assert_eq!(
            (stamp(desk.newest()), stamp(desk.newest_tip())),
            (Some(tip), None)
        );
    }
}
