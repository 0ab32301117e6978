use cdcr_controller::estimator::Measurement as Measured;
use cdcr_controller::robot::Robot;
use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::{MeasurementKind, Outcome};
use cdcr_shared_types::limits::BENDS_LATE_MS;

use super::bound_sender::BoundSender;
use crate::config::{Config, Interface, LinkKind, TipSensor, ns};
use crate::convert::{self, Refused};
use crate::handover::TimedMeasurement;

/// The newest measurements of driver and tip sensor, and the processes bound to send them.
#[derive(Debug)]
pub(super) struct Measurements {
    has_driver: bool,
    interface: Interface,
    /// A measurement older than this at its arrival is refused \[ns\].
    timeout_ns: u64,
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
}

/// A tip sensor silent for this long may be replaced by another one \[ns\]: some frames of a slow camera.
const TIP_SENSOR_LOST_NS: u64 = 1_000_000_000;
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
            driver: BoundSender::new(timeout_ns),
            drivers: 0,
            driver_since_ns: 0,
            has_bends: false,
            tip_sensor: (config.link.tip_sensor == TipSensor::Separate)
                .then(|| BoundSender::new(TIP_SENSOR_LOST_NS.max(timeout_ns))),
            newest: None,
            newest_tip: None,
            tip_sensors: 0,
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

    /// Number of drivers so far.
    pub(super) fn drivers(&self) -> u64 {
        self.drivers
    }

    /// Number of separate tip sensors so far.
    pub(super) fn tip_sensors(&self) -> u64 {
        self.tip_sensors
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
        &self,
        message: &Measurement,
        bound: BoundSender,
        may_change: bool,
        robot: &Robot,
        arrival: Arrival,
    ) -> Result<TimedMeasurement, Refused> {
        if !bound.is(message.header.sender_id, arrival.gather_ns, may_change) {
            return Err(Refused::whole(Outcome::OtherDriver));
        }
        let interface = convert::interface(self.interface);
        let timed = convert::measurement(message, robot, interface, arrival.now_ns)?;
        if arrival.now_ns.saturating_sub(timed.measured_ns) > self.timeout_ns {
            return Err(Refused::whole(Outcome::InThePast));
        }
        // Later, cables that run free are a fault of their own (`safety::CommonModeWatch`).
        let is_first = !(self.has_bends && self.driver.is_bound_to(message.header.sender_id));
        if let Measured::CableLengths(lengths_m) = &timed.measurement
            && is_first
            && let Some(section) = robot.section_of_foreign_cables(lengths_m)
        {
            return Err(Refused::at(Outcome::CableMean, 3 * section));
        }
        Ok(timed)
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
mod tests {
    use std::path::Path;

    use cdcr_controller::robot::{CABLES_MAX, Configuration};
    use cdcr_shared_types::Header;
    use cdcr_shared_types::codes::Interface;

    use super::*;

    /// A `Measurements` whose time advances by 1 ms with each measurement.
    struct Rig {
        desk: Measurements,
        robot: Robot,
        now_ns: u64,
    }

    impl Rig {
        fn new(more: &str) -> Self {
            let text = format!("[link]\nkind = \"driver\"\n{more}");
            let validated = Config::parse(&text, Path::new("measurements")).unwrap();
            Self {
                desk: Measurements::new(&validated.config),
                robot: validated.robot,
                now_ns: 1_000_000_000,
            }
        }

        fn take(&mut self, sender_id: u64, kind: MeasurementKind) -> Outcome {
            self.take_cables(sender_id, kind, [0.0; CABLES_MAX])
        }

        fn take_cables(
            &mut self,
            sender_id: u64,
            kind: MeasurementKind,
            cable_length_m: [f64; CABLES_MAX],
        ) -> Outcome {
            self.now_ns += 1_000_000;
            let message = Measurement {
                header: Header {
                    sender_id,
                    ..Header::default()
                },
                measured_ns: self.now_ns,
                kind: kind.code(),
                interface: Interface::Velocity.code(),
                sections: 3,
                tip_position_m: [0.0, 0.0, 0.8],
                cable_length_m,
                ..Measurement::default()
            };
            let arrival = Arrival {
                gather_ns: self.now_ns,
                now_ns: self.now_ns,
                is_faulted: false,
            };
            let taken = self.desk.take(&message, true, &self.robot, arrival);
            taken.unwrap_or_else(|refused| refused.outcome)
        }

        /// Takes a measurement that must be accepted; returns its time.
        fn accept(&mut self, sender_id: u64, kind: MeasurementKind) -> u64 {
            assert_eq!(self.take(sender_id, kind), Outcome::Accepted);
            self.now_ns
        }

        /// Time stamps of the newest measurement, and of the newest tip beside it.
        fn newest(&self) -> (Option<u64>, Option<u64>) {
            let stamp = |timed: Option<TimedMeasurement>| timed.map(|timed| timed.measured_ns);
            (stamp(self.desk.newest()), stamp(self.desk.newest_tip()))
        }
    }

    const BENDS: MeasurementKind = MeasurementKind::Configuration;
    const TIP: MeasurementKind = MeasurementKind::TipPose;

    /// A bend and errors of zeros of some millimetres are taken; a cable that runs free later is a fault of its own.
    #[test]
    fn first_cables_of_another_robot_unit_or_order_are_refused() {
        const CABLES: MeasurementKind = MeasurementKind::CableLengths;
        let mut rig = Rig::new("");
        let bent = Configuration::from_slice(&[0.9, -0.4, 0.3, 1.2, -0.7, 0.2]).unwrap();
        let good_m = rig.robot.cable_lengths(&bent);
        let straight_m = rig.robot.cable_lengths(&Configuration::straight(3));
        let mut swapped_m = good_m;
        (3..6).for_each(|i| swapped_m.swap(i, i + 3));
        let mut turned_m = good_m;
        turned_m[..9].rotate_left(3);
        let from_straight_m = core::array::from_fn(|i| good_m[i] - straight_m[i]);
        for foreign_m in [
            good_m.map(|m| 1e3 * m),
            from_straight_m,
            swapped_m,
            turned_m,
        ] {
            assert_eq!(rig.take_cables(1, CABLES, foreign_m), Outcome::CableMean);
        }
        assert_eq!(rig.newest().0, None);
        let mut off_m = good_m;
        off_m[4] += 0.01;
        assert_eq!(rig.take_cables(1, CABLES, off_m), Outcome::Accepted);
        assert_eq!(rig.take_cables(1, CABLES, swapped_m), Outcome::Accepted);
        // The next driver has to prove itself.
        rig.desk.driver = BoundSender::new(0);
        assert_eq!(rig.take_cables(2, CABLES, swapped_m), Outcome::CableMean);
        assert_eq!(rig.take_cables(2, CABLES, good_m), Outcome::Accepted);
    }

    #[test]
    fn the_tip_counts_alone_until_something_tells_the_bends() {
        let mut rig = Rig::new("");
        rig.accept(1, TIP);
        rig.now_ns += BENDS_LATE_NS;
        let tip = rig.accept(1, TIP);
        assert_eq!(rig.newest(), (Some(tip), None));
        let bends = rig.accept(1, BENDS);
        assert_eq!(rig.newest().0, Some(bends));
        let tip = rig.accept(1, TIP);
        assert_eq!(rig.newest(), (Some(bends), Some(tip)));
        // Bends measured by a lost driver do not count for one without encoders.
        rig.desk.driver = BoundSender::new(0);
        rig.accept(2, TIP);
        assert_eq!(rig.newest(), (Some(bends), None));
        rig.now_ns += BENDS_LATE_NS;
        let tip = rig.accept(2, TIP);
        assert_eq!(rig.newest(), (Some(tip), None));
    }

    /// Of a tip alone, control would begin at a guess.
    #[test]
    fn a_tip_waits_for_the_first_bends() {
        let mut rig = Rig::new("");
        rig.accept(1, TIP);
        rig.accept(1, TIP);
        assert_eq!(rig.newest(), (None, None));
        // No time counts in which nothing was gathered.
        rig.now_ns += BENDS_LATE_NS;
        rig.desk.extend(BENDS_LATE_NS);
        rig.accept(1, TIP);
        assert_eq!(rig.newest(), (None, None));
        let bends = rig.accept(1, BENDS);
        let tip = rig.accept(1, TIP);
        assert_eq!(rig.newest(), (Some(bends), Some(tip)));
        // Of the next driver, too.
        rig.desk.driver = BoundSender::new(0);
        rig.accept(2, TIP);
        assert_eq!(rig.newest(), (Some(bends), None));
        let bends = rig.accept(2, BENDS);
        assert_eq!(rig.newest(), (Some(bends), None));
    }

    #[test]
    fn bends_count_though_each_tip_comes_before_them_with_their_time_stamp() {
        let mut rig = Rig::new("");
        rig.accept(1, TIP);
        rig.now_ns += BENDS_LATE_NS;
        for _ in 0..2 {
            let stamp = rig.accept(1, TIP);
            rig.now_ns -= 1_000_000;
            assert_eq!(rig.accept(1, BENDS), stamp);
            assert_eq!(rig.newest().0, Some(stamp));
            assert!(rig.desk.newest().is_some_and(|newest| !is_a_tip(&newest)));
        }
    }

    #[test]
    fn a_sender_of_tips_is_another_driver_unless_the_configuration_has_a_tip_sensor() {
        let mut rig = Rig::new("");
        rig.accept(1, BENDS);
        assert_eq!(rig.take(2, TIP), Outcome::OtherDriver);
    }

    #[test]
    fn a_tip_sensor_and_a_driver_are_bound_each_for_itself() {
        let mut rig = Rig::new("tip_sensor = \"separate\"\n");
        // In any order: the tip alone does not determine the configuration.
        let tip = rig.accept(2, TIP);
        assert_eq!(rig.newest(), (None, Some(tip)));
        let bends = rig.accept(1, BENDS);
        assert_eq!(rig.newest(), (Some(bends), Some(tip)));
        for (sender_id, kind) in [(3, TIP), (1, TIP), (3, BENDS), (2, BENDS)] {
            assert_eq!(rig.take(sender_id, kind), Outcome::OtherDriver);
        }
        let tip = rig.accept(2, TIP);
        assert_eq!(rig.newest(), (Some(bends), Some(tip)));
        // A silent tip sensor is replaced without a fault, a silent driver is not.
        rig.now_ns += TIP_SENSOR_LOST_NS;
        assert_eq!(rig.desk.tip_sensors(), 1);
        let tip = rig.accept(3, TIP);
        assert_eq!(rig.desk.tip_sensors(), 2);
        assert_eq!(rig.take(3, BENDS), Outcome::OtherDriver);
        assert_eq!(rig.newest(), (Some(bends), Some(tip)));
        // Time without gathers does not count as silence.
        rig.now_ns += TIP_SENSOR_LOST_NS;
        rig.desk.extend(TIP_SENSOR_LOST_NS);
        assert_eq!(rig.take(2, TIP), Outcome::OtherDriver);
    }
}
