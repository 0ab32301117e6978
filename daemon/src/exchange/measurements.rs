use std::f64::consts::TAU;

use cdcr_controller::estimator::{Measurement as Measured, tip_offset_max_m};
use cdcr_controller::robot::Robot;
use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::{MeasurementKind, Outcome};
use cdcr_shared_types::limits::{BENDS_LATE_MS, TIP_SENSOR_SILENT_MS};

use super::bound_sender::BoundSender;
use crate::config::{Config, Interface, LinkKind, TipSensor, ns};
use crate::convert::{self, Refused};
use crate::handover::{RefusedTips, TimedMeasurement};

/// The newest measurements of driver and tip sensor, and the processes bound to send them.
#[derive(Debug)]
pub(super) struct Measurements {
    has_driver: bool,
    interface: Interface,
    /// A measurement older than this at its arrival is refused \[ns\].
    timeout_ns: u64,
    /// The same for a tip beside bends or cables \[ns\].
    tip_age_max_ns: u64,
    driver: BoundSender,
    /// Number of drivers so far.
    drivers: u64,
    /// First measurement of that driver \[ns\]; time without a gather does not count.
    driver_since_ns: u64,
    /// That driver has sent bends or cables.
    has_bends: bool,
    /// The process that measures only the tip, if the configuration has one.
    tip_sensor: Option<BoundSender>,
    /// Of the bends or cables, or of the tip if the driver measures nothing else.
    newest: Option<TimedMeasurement>,
    /// Of the tip, in addition to bends or cables.
    newest_tip: Option<TimedMeasurement>,
    /// Number of processes that measured the tip so far.
    tip_sensors: u64,
    refused_tips: RefusedTips,
    agreement: Agreement,
}

/// Tips in a row that agree with the first bends of a sender, after one that contradicted some.
#[derive(Debug, Clone, Copy, Default)]
struct Agreement {
    sender_id: u64,
    tips: u32,
    /// Time of the newest of them \[ns\].
    newest_ns: u64,
}

/// So many tips have to agree: one may be a stray one. A camera that measures once a second delays the start by 3 s.
const AGREEING_TIPS: u32 = 3;
/// A silent tip sensor may be replaced by another one \[ns\].
const TIP_SENSOR_LOST_NS: u64 = 1_000_000 * TIP_SENSOR_SILENT_MS as u64;
/// A driver that has sent no bends or cables for this long since its first tip measures the tip alone \[ns\].
const BENDS_LATE_NS: u64 = 1_000_000 * BENDS_LATE_MS as u64;

/// Circumstances of a measurement's arrival.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrival {
    /// Start of the gather \[ns\].
    pub(super) gather_ns: u64,
    /// Present time \[ns\]: the gather may have stalled since its start.
    pub(super) now_ns: u64,
    /// The cycle has faulted. It must detect the loss of a driver, and bring the robot to rest, before
    /// another driver is accepted.
    pub(super) is_faulted: bool,
}

impl Measurements {
    pub(super) fn new(config: &Config) -> Self {
        let timeout_ns = ns(config.link.measurement_timeout_ms);
        Self {
            has_driver: config.link.kind == LinkKind::Driver,
            interface: config.link.interface,
            timeout_ns,
            tip_age_max_ns: match ns(config.link.tip_age_max_ms) {
                0 => timeout_ns,
                age_ns => age_ns,
            },
            driver: BoundSender::new(timeout_ns),
            drivers: 0,
            driver_since_ns: 0,
            has_bends: false,
            tip_sensor: (config.link.tip_sensor == TipSensor::Separate)
                .then(|| BoundSender::new(TIP_SENSOR_LOST_NS.max(timeout_ns))),
            newest: None,
            newest_tip: None,
            tip_sensors: 0,
            refused_tips: RefusedTips::default(),
            agreement: Agreement::default(),
        }
    }

    /// Excludes the `paused_ns` without a gather from the silence of driver and tip sensor.
    pub(super) fn extend(&mut self, paused_ns: u64) {
        self.driver.extend(paused_ns);
        self.driver_since_ns += paused_ns;
        if let Some(tip_sensor) = &mut self.tip_sensor {
            tip_sensor.extend(paused_ns);
        }
    }

    /// The newest measurement of the tip in addition to bends or cables.
    pub(super) fn newest_tip(&self) -> Option<TimedMeasurement> {
        self.newest_tip
    }

    /// Sender id of the driver, once one has been accepted.
    pub(super) fn driver_id(&self) -> Option<u64> {
        self.driver.id()
    }

    /// The driver has sent tips, and neither bends nor cables.
    pub(super) fn driver_measures_tip_only(&self) -> bool {
        self.driver.id().is_some() && !self.has_bends
    }

    /// Number of drivers so far.
    pub(super) fn drivers(&self) -> u64 {
        self.drivers
    }

    /// Number of separate tip sensors so far.
    pub(super) fn tip_sensors(&self) -> u64 {
        self.tip_sensors
    }

    /// Measurements of the tip that were refused so far.
    pub(super) fn refused_tips(&self) -> RefusedTips {
        self.refused_tips
    }

    /// The newest measurement that determines the robot's configuration.
    pub(super) fn newest(&self) -> Option<TimedMeasurement> {
        self.newest
    }

    /// Keeps the newest measurement. A valid one that is not newer is stale, which is not an error of its
    /// sender.
    pub(super) fn take(
        &mut self,
        message: &Measurement,
        is_newer: bool,
        robot: &Robot,
        arrival: Arrival,
    ) -> Result<Outcome, Refused> {
        let taken = self.keep(message, is_newer, robot, arrival);
        if let Err(refused) = &taken
            && refused.outcome == Outcome::TipElsewhere
        {
            self.refused_tips.contradiction_m = 1e-3 * f64::from(refused.detail);
        } else if self.has_bends {
            self.refused_tips.contradiction_m = 0.0;
        }
        if message.kind == MeasurementKind::TipPose.code() {
            match &taken {
                Err(refused) => {
                    self.refused_tips.count += 1;
                    self.refused_tips.newest = refused.outcome;
                    self.refused_tips.is_over = false;
                }
                Ok(outcome) => {
                    let is_accepted = *outcome == Outcome::Accepted;
                    self.refused_tips.is_over |= is_accepted && self.refused_tips.count > 0;
                }
            }
        }
        taken
    }

    fn keep(
        &mut self,
        message: &Measurement,
        is_newer: bool,
        robot: &Robot,
        arrival: Arrival,
    ) -> Result<Outcome, Refused> {
        if !self.has_driver {
            return Err(Refused::whole(Outcome::Unsupported));
        }
        let sender = message.header.sender_id;
        let is_tip = message.kind == MeasurementKind::TipPose.code();
        if is_tip && let Some(mut tip_sensor) = self.tip_sensor {
            // The robot continues without a tip sensor: its successor needs no preceding fault.
            let timed = self.checked(message, tip_sensor, true, robot, arrival)?;
            let outcome = replace_newest(&mut self.newest_tip, timed, is_newer);
            if outcome == Outcome::Accepted {
                self.tip_sensors += u64::from(!tip_sensor.is_bound_to(sender));
                tip_sensor.bind(sender, arrival.gather_ns);
                self.tip_sensor = Some(tip_sensor);
            }
            return Ok(outcome);
        }
        let timed = self.checked(message, self.driver, arrival.is_faulted, robot, arrival)?;
        // Measurements of another driver do not show what this one measures.
        let is_bound = self.driver.is_bound_to(sender);
        let has_bends = is_bound && self.has_bends;
        let since_ns = if is_bound {
            self.driver_since_ns
        } else {
            arrival.gather_ns
        };
        let waits = arrival.gather_ns.saturating_sub(since_ns) < BENDS_LATE_NS;
        let mut unused = None;
        let newest = match (is_tip, has_bends) {
            (true, true) => &mut self.newest_tip,
            (true, false) if waits => &mut unused,
            _ => &mut self.newest,
        };
        // Bends determine the configuration, a tip does not: they replace it, also with the same time stamp.
        newest.take_if(|newest| is_newer && !is_tip && is_a_tip(newest));
        let outcome = replace_newest(newest, timed, is_newer);
        if outcome == Outcome::Accepted {
            if !is_bound && self.tip_sensor.is_none() {
                self.newest_tip = None;
            }
            self.drivers += u64::from(!is_bound);
            self.driver.bind(sender, arrival.gather_ns);
            self.driver_since_ns = since_ns;
            self.has_bends = has_bends || !is_tip;
        }
        Ok(outcome)
    }

    /// Refuses an invalid measurement, or one too old at its arrival: it does not show where the robot is,
    /// even if its sender works.
    fn checked(
        &mut self,
        message: &Measurement,
        bound: BoundSender,
        may_change: bool,
        robot: &Robot,
        arrival: Arrival,
    ) -> Result<TimedMeasurement, Refused> {
        if !bound.is(message.header.sender_id, arrival.gather_ns, may_change) {
            return Err(Refused::whole(Outcome::OtherDriver));
        }
        let interface = self.interface.into();
        let timed = convert::measurement(message, robot, interface, arrival.now_ns)?;
        let has_bends = self.has_bends && self.driver.is_bound_to(message.header.sender_id);
        let is_beside = self.tip_sensor.is_some() || has_bends;
        let age_max_ns = match timed.measurement {
            Measured::TipPosition(_) if is_beside => self.tip_age_max_ns,
            _ => self.timeout_ns,
        };
        if arrival.now_ns.saturating_sub(timed.measured_ns) > age_max_ns {
            return Err(Refused::whole(Outcome::InThePast));
        }
        // Later, cables that run free are a fault of their own (`safety::CommonModeWatch`).
        let is_first = !has_bends;
        if let Measured::CableLengths(lengths_m) = &timed.measurement
            && is_first
            && let Some(section) = robot.section_of_foreign_cables(lengths_m)
        {
            return Err(Refused::at_index(Outcome::CableMean, 3 * section));
        }
        // Later, a bend beyond its limit is a fault that names it.
        if let Measured::Configuration(bends) = &timed.measurement
            && is_first
            && let Some(index) = bends.as_slice().iter().position(|bend| bend.abs() > TAU)
        {
            return Err(Refused::at_index(Outcome::BeyondTurn, index));
        }
        // A later driver of a robot that was measured is compared with where its last command left it.
        if is_first
            && !self.has_bends
            && self.drivers <= 1
            && let Some(away_m) = self.contradiction_m(
                message.header.sender_id,
                &timed.measurement,
                robot,
                arrival.now_ns,
            )
        {
            return Err(Refused::at_index(
                Outcome::TipElsewhere,
                (1e3 * away_m) as usize,
            ));
        }
        Ok(timed)
    }

    /// How far the tip is measured from where first bends place it \[m\], if a tip sensor measures and that is too far.
    /// Motors that follow positions would jump with their first command. Later, the body counts as that much thicker.
    /// A sensor that measures no more, for example because a person stands before it, takes nothing back, and no single tip does.
    fn contradiction_m(
        &mut self,
        sender_id: u64,
        bends: &Measured,
        robot: &Robot,
        now_ns: u64,
    ) -> Option<f64> {
        self.tip_sensor?;
        let tip = self.newest_tip?;
        let bends = bends.configuration(robot)?;
        let Measured::TipPosition(tip_m) = tip.measurement else {
            return None;
        };
        let measures = now_ns.saturating_sub(tip.measured_ns) <= TIP_SENSOR_LOST_NS;
        // No body reaches half as far again as its model: there the sensor is wrong.
        let is_place = tip_m.norm() < 1.5 * robot.reach_m();
        let away_m = (tip_m - robot.tip_position(&bends)).norm();
        let is_far = away_m > tip_offset_max_m(robot.reach_m());
        let before_m = self.refused_tips.contradiction_m;
        if measures && is_place && is_far {
            if self.agreement.sender_id == sender_id {
                self.agreement.tips = 0;
            }
            return Some(away_m);
        }
        let agrees = measures && is_place && self.has_agreed(sender_id, tip.measured_ns);
        (before_m > 0.0 && !agrees).then_some(before_m)
    }

    /// A tip agrees with the first bends of a sender: whether enough have done so in a row.
    fn has_agreed(&mut self, sender_id: u64, measured_ns: u64) -> bool {
        if self.agreement.sender_id != sender_id {
            self.agreement = Agreement {
                sender_id,
                ..Agreement::default()
            };
        }
        if self.agreement.newest_ns != measured_ns {
            self.agreement.newest_ns = measured_ns;
            self.agreement.tips += 1;
        }
        self.agreement.tips >= AGREEING_TIPS
    }
}

fn replace_newest(
    newest: &mut Option<TimedMeasurement>,
    timed: TimedMeasurement,
    is_newer: bool,
) -> Outcome {
    if !is_newer || newest.is_some_and(|newest| timed.measured_ns <= newest.measured_ns) {
        return Outcome::Stale;
    }
    *newest = Some(timed);
    Outcome::Accepted
}

fn is_a_tip(timed: &TimedMeasurement) -> bool {
    matches!(timed.measurement, Measured::TipPosition(_))
}

#[cfg(test)]
mod tests;
