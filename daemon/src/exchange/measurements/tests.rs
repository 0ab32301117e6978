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
    /// Of a measurement at its arrival \[ns\].
    age_ns: u64,
    is_faulted: bool,
}

impl Rig {
    fn new(more: &str) -> Self {
        let text = format!("[link]\nkind = \"driver\"\n{more}");
        let validated = Config::parse(&text, Path::new("measurements")).unwrap();
        Self {
            desk: Measurements::new(&validated.config),
            robot: validated.robot,
            now_ns: 1_000_000_000,
            age_ns: 0,
            is_faulted: false,
        }
    }

    fn take(&mut self, sender_id: u64, kind: MeasurementKind) -> Outcome {
        self.take_cables(sender_id, kind, [0.0; CABLES_MAX])
    }

    /// `values`: lengths of cables, or bends.
    fn take_cables(
        &mut self,
        sender_id: u64,
        kind: MeasurementKind,
        values: [f64; CABLES_MAX],
    ) -> Outcome {
        self.now_ns += 1_000_000;
        let message = Measurement {
            header: Header {
                sender_id,
                ..Header::default()
            },
            measured_ns: self.now_ns - self.age_ns,
            kind: kind.code(),
            interface: Interface::Velocity.code(),
            sections: 3,
            tip_position_m: [0.0, 0.0, 0.85],
            cable_length_m: values,
            bend_rad: core::array::from_fn(|i| values[i]),
            ..Measurement::default()
        };
        let arrival = Arrival {
            gather_ns: self.now_ns,
            now_ns: self.now_ns,
            is_faulted: self.is_faulted,
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

/// Degrees in place of radians are seen at once, unless the robot is nearly straight.
#[test]
fn first_bends_beyond_a_full_turn_are_refused() {
    let mut rig = Rig::new("");
    let bent = |bend: f64| core::array::from_fn(|i| if i == 3 { bend } else { 0.1 });
    for bend in [-90.0, 6.3] {
        assert_eq!(rig.take_cables(1, BENDS, bent(bend)), Outcome::BeyondTurn);
    }
    assert_eq!(rig.newest().0, None);
    for bend in [-6.2, 90.0] {
        // The second one is a fault of the cycle, which names its place.
        assert_eq!(rig.take_cables(1, BENDS, bent(bend)), Outcome::Accepted);
    }
}

#[test]
fn the_tip_counts_alone_until_the_bends_are_measured() {
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

/// A camera needs longer than encoders may.
#[test]
fn a_tip_beside_bends_has_a_largest_age_of_its_own() {
    let slow = "tip_age_max_ms = 150.0\n";
    for more in [
        slow.to_owned(),
        format!("tip_sensor = \"separate\"\n{slow}"),
    ] {
        let mut rig = Rig::new(&more);
        let camera = if more == slow { 1 } else { 2 };
        rig.accept(1, BENDS);
        for (age_ms, kind, outcome) in [
            (149, TIP, Outcome::Accepted),
            (151, TIP, Outcome::InThePast),
            (60, BENDS, Outcome::InThePast),
        ] {
            rig.age_ns = 1_000_000 * age_ms;
            let sender = if kind == TIP { camera } else { 1 };
            assert_eq!(rig.take(sender, kind), outcome, "{age_ms} ms");
        }
    }
    // A driver that measures the tip alone has no bends beside it, also where the one before it measured them.
    for has_predecessor in [false, true] {
        let mut rig = Rig::new(slow);
        if has_predecessor {
            rig.accept(2, BENDS);
            rig.now_ns += 1_000_000_000;
            rig.is_faulted = true;
        }
        rig.age_ns = 60_000_000;
        assert_eq!(rig.take(1, TIP), Outcome::InThePast);
    }
}

#[test]
fn refused_tips_are_counted_and_the_newest_names_its_outcome() {
    let mut rig = Rig::new("tip_sensor = \"separate\"\n");
    rig.accept(1, BENDS);
    assert_eq!(rig.desk.refused_tips(), RefusedTips::default());
    rig.accept(2, TIP);
    assert_eq!(rig.take(3, BENDS), Outcome::OtherDriver);
    assert_eq!(rig.desk.refused_tips(), RefusedTips::default());
    for count in 1..=2 {
        assert_eq!(rig.take(3, TIP), Outcome::OtherDriver);
        let newest = Outcome::OtherDriver;
        let contradiction_m = 0.0;
        let expected = RefusedTips {
            count,
            newest,
            contradiction_m,
            is_over: false,
        };
        assert_eq!(rig.desk.refused_tips(), expected);
    }
    // Of a sensor that is silent later, this refusal is not the cause.
    rig.accept(2, TIP);
    assert!(rig.desk.refused_tips().is_over);
}

/// Motors that follow positions would jump as soon as the daemon commands them.
#[test]
fn first_bends_that_a_measuring_tip_sensor_contradicts_are_refused() {
    // The tip is measured 0.05 m below that of the straight robot of 0.9 m.
    for (bend_rad, outcome) in [(0.0, Outcome::Accepted), (1.5, Outcome::TipElsewhere)] {
        let mut bends = [0.0; CABLES_MAX];
        bends[0] = bend_rad;
        let mut rig = Rig::new("tip_sensor = \"separate\"\n");
        rig.accept(2, TIP);
        assert_eq!(rig.take_cables(1, BENDS, bends), outcome);
        let contradiction_m = rig.desk.refused_tips().contradiction_m;
        assert_eq!(contradiction_m > 0.1, bend_rad > 0.0, "{contradiction_m}");
        assert_eq!(rig.desk.driver_id().is_some(), bend_rad == 0.0);
        // A sensor that measures no more takes nothing back; bends that agree do.
        rig.now_ns += TIP_SENSOR_LOST_NS;
        assert_eq!(rig.take_cables(1, BENDS, bends), outcome);
        let straight = [0.0; CABLES_MAX];
        if bend_rad > 0.0 {
            // One tip that agrees may be a stray one, however often it is compared; a contradiction begins again.
            for (bends, tips) in [(straight, 2), (bends, 1), (straight, 2)] {
                for _ in 0..tips {
                    rig.accept(2, TIP);
                    for _ in 0..3 {
                        assert_eq!(rig.take_cables(1, BENDS, bends), outcome);
                    }
                }
            }
        }
        rig.accept(2, TIP);
        assert_eq!(rig.take_cables(1, BENDS, straight), Outcome::Accepted);
        assert_eq!(rig.desk.refused_tips().contradiction_m, 0.0);
        // Later bends may be anywhere.
        bends[0] = 2.0;
        assert_eq!(rig.take_cables(1, BENDS, bends), Outcome::Accepted);
    }
}
