//! Invariant: the commanded position is the integral of the commanded rates, to the bit. The rates before a
//! record are those of the last command, or zero if a command that left has run out.
//!
//! Other changes of it are visible in the records:
//!
//! - Control begins at the present position of the robot: at the first measurement (`measurement_state`), and
//!   after a latched mode (`mode`, `control_begins`). This includes a lost measurement and a change of
//!   drivers, because both lead through Faulted.
//! - When inputs are stale (`timing_flags`) for more than a period, no command has left the daemon meanwhile:
//!   the robot obeyed the last command before.

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{
    Interface, MeasurementKind, MeasurementState, Mode, RobotLink, timing,
};
use cdcr_shared_types::limits::COORDINATES_MAX;
use cdcr_tests::record::{largest, robot_of};

use crate::chaos::ramp::{control_may_begin, is_first_measurement};
use crate::chaos::{CheckResult, ensure};

type Bends = [f64; COORDINATES_MAX];

/// The command that a robot obeys.
#[derive(Debug, Clone, Copy)]
struct Obeyed {
    from_rad: Bends,
    rates_rad_s: Bends,
    /// Time for which it has been the newest \[ns\].
    elapsed_ns: u64,
}

impl Obeyed {
    fn new(record: &Telemetry) -> Self {
        Self {
            from_rad: record.commanded_rad,
            rates_rad_s: record.command.bend_rate_rad_s,
            elapsed_ns: 0,
        }
    }

    /// The position that it leads to, if the motors obey it for at most `most_ns`.
    fn leads_to(&self, most_ns: u64) -> Bends {
        let moving_s = self.elapsed_ns.min(most_ns) as f64 * 1e-9;
        core::array::from_fn(|i| self.from_rad[i] + self.rates_rad_s[i] * moving_s)
    }
}

/// The commanded position over consecutive records.
#[derive(Debug, Clone)]
pub(crate) struct Integral {
    /// Commands pass the exchange to a driver; a simulated robot is measured and commanded in the cycle itself.
    has_driver: bool,
    /// Time for which the inputs have been stale \[ns\]; `None`: records of that time are lost.
    stale_ns: Option<u64>,
    /// The last command that left the daemon.
    sent: Option<Obeyed>,
    /// Whether control began in the previous record.
    has_begun: bool,
}

impl Integral {
    /// Of a daemon with this kind of robot ([`Status::link`](cdcr_shared_types::Status::link)).
    pub(crate) fn new(link: u32) -> Self {
        Self {
            has_driver: link == RobotLink::Driver.code(),
            stale_ns: None,
            sent: None,
            has_begun: false,
        }
    }

    /// Checks the next record. `before`: the previous one, if nothing was lost in between.
    pub(crate) fn check(&mut self, before: Option<&Telemetry>, record: &Telemetry) -> CheckResult {
        let target = Obeyed {
            elapsed_ns: record.period_ns,
            ..Obeyed::new(record)
        };
        let target = target.leads_to(record.period_ns);
        ensure(is_same(&target, &record.command.bend_target_rad), || {
            format!(
                "the command leads to {target:?}, and says {:?}",
                record.command.bend_target_rad
            )
        })?;
        let has_begun = core::mem::take(&mut self.has_begun);
        let Some(led) = self.led(before, record) else {
            return Ok(());
        };
        let Some(before) = before else {
            return Ok(());
        };
        self.check_previous(before, record)?;
        let begins_first = is_first_measurement(before, record);
        if is_same(&led, &record.commanded_rad) && !begins_first {
            return Ok(());
        }
        let moved = || {
            format!(
                "the commands lead to {led:?}, and commanded is {:?}",
                record.commanded_rad
            )
        };
        let rests = largest(&record.previous_rate_rad_s) == 0.0;
        ensure(
            begins_first || rests && control_may_begin(before, record),
            moved,
        )?;
        ensure(!has_begun || record.control_begins == 0, || {
            format!("control begins again: {}", moved())
        })?;
        check_begin(record)?;
        self.has_begun = true;
        self.sent = Some(Obeyed {
            rates_rad_s: [0.0; COORDINATES_MAX],
            ..Obeyed::new(record)
        });
        Ok(())
    }

    /// The position that the commands up to a record lead to; `None` if the necessary records are lost.
    fn led(&mut self, before: Option<&Telemetry>, record: &Telemetry) -> Option<Bends> {
        let is_stale = record.timing_flags & timing::STALE_INPUTS != 0;
        self.stale_ns = match (is_stale, before) {
            (false, _) => Some(0),
            (true, None) => None,
            (true, Some(_)) => self.stale_ns.map(|stale_ns| stale_ns + record.period_ns),
        };
        let (stale_ns, before) = (self.stale_ns?, before?);
        let is_unsent = stale_ns > record.period_ns && self.has_driver;
        if stale_ns == record.period_ns {
            self.sent = Some(Obeyed::new(before));
        }
        if let Some(sent) = &mut self.sent {
            sent.elapsed_ns += record.elapsed_ns;
        }
        let obeyed = if is_unsent {
            self.sent?
        } else {
            Obeyed {
                elapsed_ns: record.elapsed_ns,
                ..Obeyed::new(before)
            }
        };
        let obeys_positions = record.command.interface == Interface::Position.code();
        Some(obeyed.leads_to(if obeys_positions {
            record.period_ns
        } else {
            valid_ns(record)
        }))
    }

    /// Checks the rates that a record counts from, after [`Self::led`].
    fn check_previous(&self, before: &Telemetry, record: &Telemetry) -> CheckResult {
        let Some(stale_ns) = self.stale_ns else {
            return Ok(());
        };
        let has_stalled =
            record.elapsed_ns > record.period_ns && runs_out(record, record.elapsed_ns);
        let is_late = runs_out_in_cycle(record, record.solve_start_ns);
        // Nothing leaves without a gather: by the next release the last command sent will have run out, or the
        // first command after rest may not have left.
        let waits = stale_ns > 0 && self.has_driver;
        let sent_runs_out =
            |sent: Obeyed| sent.elapsed_ns + record.period_ns > rests_after_ns(record);
        let is_first = before.previous_rate_rad_s == [0.0; COORDINATES_MAX]
            || runs_out_in_cycle(before, before.solve_end_ns);
        let rests =
            has_stalled || is_late || waits && (is_first || self.sent.is_some_and(sent_runs_out));
        let from = if rests {
            [0.0; COORDINATES_MAX]
        } else {
            before.command.bend_rate_rad_s
        };
        ensure(record.previous_rate_rad_s == from, || {
            format!("the rates count from others than {from:?}")
        })
    }
}

/// Time for which a command is valid \[ns\].
fn valid_ns(record: &Telemetry) -> u64 {
    record.command.valid_until_ns - record.command.release_ns
}

/// Time since a command after which the robot rests, if no other follows \[ns\].
fn rests_after_ns(record: &Telemetry) -> u64 {
    let obeys_positions = record.command.interface == Interface::Position.code();
    let at_target_ns = if obeys_positions {
        2 * record.period_ns
    } else {
        u64::MAX
    };
    valid_ns(record).min(at_target_ns)
}

/// Whether the robot has come to rest by itself when the next command comes `since_ns` after the last one.
fn runs_out(record: &Telemetry, since_ns: u64) -> bool {
    since_ns >= valid_ns(record) || since_ns > rests_after_ns(record)
}

/// The same at `now_ns`, after a stall inside the cycle of a record.
pub(crate) fn runs_out_in_cycle(record: &Telemetry, now_ns: u64) -> bool {
    let late_ns = now_ns.saturating_sub(record.release_ns);
    late_ns > record.period_ns && runs_out(record, record.elapsed_ns + late_ns)
}

/// Checks that control begins at the known position of the motors: the measured one if the robot holds.
fn check_begin(record: &Telemetry) -> CheckResult {
    let commanded = &record.commanded_rad;
    ensure(is_same(commanded, &record.motor_rad), || {
        format!(
            "control begins at {commanded:?}, and the motors are at {:?}",
            record.motor_rad
        )
    })?;
    let is_used = record.measurement_state == MeasurementState::Used.code();
    let holds = record.mode == Mode::Holding.code();
    let measured = match MeasurementKind::try_from(record.measurement.kind) {
        Ok(MeasurementKind::Configuration) => record.measurement.bend_rad,
        Ok(MeasurementKind::CableLengths) => {
            let lengths_m = &record.measurement.cable_length_m;
            let bends = robot_of(&record.robot).bend_from_cable_lengths(lengths_m);
            let mut measured = [0.0; COORDINATES_MAX];
            measured[..bends.as_slice().len()].copy_from_slice(bends.as_slice());
            measured
        }
        _ => return Ok(()),
    };
    ensure(!(is_used && holds) || is_same(commanded, &measured), || {
        format!("control begins at {commanded:?}, and measured is {measured:?}")
    })
}

fn is_same(a: &Bends, b: &Bends) -> bool {
    a.map(f64::to_bits) == b.map(f64::to_bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    const T_NS: u64 = 5_000_000;

    /// Records of a driver's robot with commands that are valid for three periods.
    struct CommandedRecords {
        integral: Integral,
        last: Telemetry,
    }

    impl CommandedRecords {
        fn new(interface: Interface) -> Self {
            let mut last = Telemetry {
                mode: Mode::Holding.code(),
                period_ns: T_NS,
                elapsed_ns: T_NS,
                measurement_state: MeasurementState::Used.code(),
                ..Telemetry::default()
            };
            last.command.interface = interface.code();
            last.command.valid_until_ns = 3 * T_NS;
            let integral = Integral {
                stale_ns: Some(0),
                ..Integral::new(RobotLink::Driver.code())
            };
            Self { integral, last }
        }

        /// At 0 with 1 rad/s, and not for the first time.
        fn moving(interface: Interface) -> Self {
            let mut line = Self::new(interface);
            line.last.commanded_rad[0] = -(5e6 * 1e-9);
            line.last.command.bend_rate_rad_s[0] = 1.0;
            assert_eq!(line.next(0.0, 1.0, |_| {}), Ok(()));
            line
        }

        /// The next record: commanded position at its release, rates from then on, other changes.
        fn next(
            &mut self,
            commanded_rad: f64,
            rate_rad_s: f64,
            change: impl FnOnce(&mut Telemetry),
        ) -> CheckResult {
            let before = self.last;
            let record = &mut self.last;
            (record.elapsed_ns, record.timing_flags) = (T_NS, 0);
            record.previous_rate_rad_s = record.command.bend_rate_rad_s;
            record.commanded_rad[0] = commanded_rad;
            record.command.bend_rate_rad_s[0] = rate_rad_s;
            record.command.bend_target_rad[0] = commanded_rad + rate_rad_s * 0.005;
            change(record);
            self.integral.check(Some(&before), record)
        }
    }

    fn stale(record: &mut Telemetry) {
        record.timing_flags = timing::STALE_INPUTS;
    }

    fn rests(record: &mut Telemetry) {
        stale(record);
        record.previous_rate_rad_s.fill(0.0);
    }

    #[test]
    fn rates_grow_from_those_of_the_last_command_or_from_rest() {
        let mut line = CommandedRecords::new(Interface::Velocity);
        assert_eq!(line.next(0.0, 1.0, |_| {}), Ok(()));
        let early = |record: &mut Telemetry| record.previous_rate_rad_s.fill(0.0);
        assert!(line.next(0.005, 1.0, early).is_err());
        // Exactly as long as a command is valid.
        let stall = |record: &mut Telemetry| record.elapsed_ns = 3 * T_NS;
        assert!(line.next(0.02, 1.0, stall).is_err());
        let stall = |record: &mut Telemetry| {
            stall(record);
            early(record);
        };
        assert_eq!(line.next(0.02 + 1.0 * (15e6 * 1e-9), 1.0, stall), Ok(()));
    }

    #[test]
    fn what_no_rate_moved_is_found() {
        // Within two periods, a position is reached after one.
        for (interface, there) in [
            (Interface::Position, 0.01 + 2.0 * 0.005),
            (Interface::Velocity, 0.01 + 2.0 * 0.01),
        ] {
            let mut line = CommandedRecords::new(interface);
            assert_eq!(line.next(0.0, 2.0, |_| {}), Ok(()));
            assert_eq!(line.next(0.01, 2.0, |_| {}), Ok(()));
            let two = |record: &mut Telemetry| record.elapsed_ns = 2 * T_NS;
            assert_eq!(line.next(there, 0.0, two), Ok(()));
            assert_eq!(line.next(there, 0.0, |_| {}), Ok(()));
            assert!(line.next(there + 1e-15, 0.0, |_| {}).is_err());
            let beside = |record: &mut Telemetry| record.command.bend_target_rad[0] += 1e-15;
            assert!(line.next(there + 1e-15, 0.0, beside).is_err());
        }
    }

    #[test]
    fn control_begins_where_the_motors_are_and_once() {
        let begins = |record: &mut Telemetry| {
            (record.motor_rad[0], record.control_begins) = (0.3, 1);
            record.measurement.kind = MeasurementKind::Configuration.code();
            record.measurement.bend_rad[0] = 0.3;
        };
        let mut line = CommandedRecords::new(Interface::Position);
        assert!(line.next(0.2, 0.0, begins).is_err(), "not where they are");
        let mut line = CommandedRecords::new(Interface::Position);
        assert_eq!(line.next(0.3, 0.0, begins), Ok(()));
        let again = |record: &mut Telemetry| record.motor_rad[0] = 0.4;
        assert!(line.next(0.4, 0.0, again).is_err(), "twice");
        let mut line = CommandedRecords::new(Interface::Position);
        let unasked = |record: &mut Telemetry| record.motor_rad[0] = 0.3;
        assert!(line.next(0.3, 0.0, unasked).is_err());
        let beside = |record: &mut Telemetry| {
            begins(record);
            record.measurement.bend_rad[0] = 0.31;
        };
        let mut line = CommandedRecords::new(Interface::Position);
        assert!(line.next(0.3, 0.0, beside).is_err(), "not measured there");
        // At the first measurement it does.
        let mut line = CommandedRecords::new(Interface::Position);
        line.last.measurement_state = MeasurementState::None.code();
        let first = |record: &mut Telemetry| {
            begins(record);
            record.control_begins = 0;
            record.measurement_state = MeasurementState::Used.code();
        };
        assert_eq!(line.next(0.3, 0.0, first), Ok(()));
    }

    #[test]
    fn commands_that_did_not_leave_move_it_as_long_as_they_are_valid() {
        // The gather alone is late, then the exchange: the robot obeys the last command that left.
        let obeyed = [
            (Interface::Position, [5e6 * 1e-9; 3]),
            (Interface::Velocity, [5e6, 10e6, 15e6].map(|ns| ns * 1e-9)),
        ];
        let hold_up = |interface, led_rad: [f64; 3]| {
            let mut line = CommandedRecords::moving(interface);
            // By the release after this one the command has run out.
            let last = if interface == Interface::Position {
                1
            } else {
                2
            };
            for (i, led_rad) in led_rad.into_iter().enumerate() {
                let [change, other] = if i < last {
                    [stale, rests]
                } else {
                    [rests, stale]
                };
                let (integral, before) = (line.integral.clone(), line.last);
                assert!(line.next(led_rad, 1.0, other).is_err());
                (line.integral, line.last) = (integral, before);
                assert_eq!(line.next(led_rad, 1.0, change), Ok(()));
            }
            (line, led_rad[2])
        };
        for (interface, led_rad) in obeyed {
            let (mut line, end_rad) = hold_up(interface, led_rad);
            assert_eq!(line.next(end_rad, 0.5, rests), Ok(()));
            assert_eq!(line.next(end_rad, 0.5, rests), Ok(()));
            assert_eq!(line.next(end_rad + 0.5 * 0.005, 0.0, |_| {}), Ok(()));
            let (mut line, end_rad) = hold_up(interface, led_rad);
            assert!(line.next(end_rad + 0.005, 0.5, rests).is_err());
        }
        // A robot that is commanded to rest meanwhile returns there; a simulated one was measured meanwhile.
        let mut line = CommandedRecords::moving(Interface::Position);
        assert_eq!(line.next(0.005, 1.0, stale), Ok(()));
        for _ in 0..3 {
            assert_eq!(line.next(0.005, 0.0, rests), Ok(()));
        }
        // The first command after rest may not have left.
        let mut line = CommandedRecords::new(Interface::Position);
        assert_eq!(line.next(0.0, 1.0, |_| {}), Ok(()));
        assert!(line.next(0.005, 1.0, stale).is_err());
        let (mut line, at_rad) = hold_up(obeyed[0].0, obeyed[0].1);
        line.integral.has_driver = false;
        assert_eq!(line.next(at_rad + 0.005, 1.0, stale), Ok(()));
    }

    #[test]
    fn after_lost_records_it_goes_on_where_the_inputs_are_new() {
        let mut line = CommandedRecords::new(Interface::Position);
        stale(&mut line.last);
        let lost = line.last;
        assert_eq!(line.integral.check(None, &lost), Ok(()));
        assert_eq!(line.next(1.0, 0.0, stale), Ok(()));
        assert_eq!(line.next(1.0, 0.0, |_| {}), Ok(()));
        assert!(line.next(2.0, 0.0, |_| {}).is_err());
    }
}
