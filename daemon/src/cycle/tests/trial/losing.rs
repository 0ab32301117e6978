//! A velocity driver that loses commands at any time and goes on measuring, in steps of a millisecond.

use cdcr_controller::robot::Obstacle;
use cdcr_shared_types::Command;

use super::*;

const MS: u64 = 1_000_000;
/// Time between two turns of the driver \[ms\].
const TURN_MS: u64 = 2;

/// From then on commands are lost: the robot has set out before \[ms\].
const BEGINS_MS: u64 = 2000;

/// When commands are lost.
#[allow(clippy::struct_field_names, reason = "the unit ends each name")]
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct Losses {
    /// Time from the end of a loss to that of the next one \[ms\].
    pub(in super::super) every_ms: u64,
    /// By how much they are earlier \[ms\].
    pub(in super::super) phase_ms: u64,
    /// How long they last, in turn \[ms\].
    pub(in super::super) lasts_ms: [u64; 3],
}

impl Losses {
    fn contain(&self, now_ms: u64) -> bool {
        let at_ms = now_ms + self.phase_ms;
        let lasts_ms = self.lasts_ms[(at_ms / self.every_ms % 3) as usize];
        now_ms >= BEGINS_MS && at_ms % self.every_ms + lasts_ms >= self.every_ms
    }
}

/// It states the true rest of its motors.
#[derive(Debug)]
pub(in super::super) struct LosingDriver {
    losses: Losses,
    /// When it stands still as a whole: it neither measures nor takes commands.
    pub(in super::super) stalls: Option<Losses>,
    /// Time from a release until its command arrives \[ms\], less than a period.
    late_ms: u64,
    arrived: Option<Command>,
    /// The command in force, and when it was taken \[ns\].
    taken: Option<(Command, u64)>,
    /// The newest rest that is over \[ns\].
    rested_ns: [u64; 2],
    measured: Option<TimedMeasurement>,
    /// Least true clearance so far \[m\].
    pub(in super::super) least_m: f64,
}

impl LosingDriver {
    pub(in super::super) fn new(losses: Losses, late_ms: u64) -> Self {
        Self {
            losses,
            stalls: None,
            late_ms,
            arrived: None,
            taken: None,
            rested_ns: [0; 2],
            measured: None,
            least_m: f64::INFINITY,
        }
    }

    fn rest_ns(&self, now_ns: u64) -> [u64; 2] {
        let rest_ns =
            (self.taken).and_then(|(command, taken_ns)| command.rest_ns(taken_ns, now_ns));
        rest_ns.map_or(self.rested_ns, |rest_ns| [rest_ns.start, rest_ns.end])
    }

    /// One turn of its loop.
    fn turn(&mut self, plant: &mut MisbehavingRobot, now_ms: u64) {
        let now_ns = BEGIN_NS + now_ms * MS;
        let is_lost = self.losses.contain(now_ms);
        if let Some(command) = self.arrived.take_if(|_| !is_lost) {
            self.rested_ns = self.rest_ns(now_ns);
            self.taken = Some((command, now_ns));
        }
        self.measured = Some(TimedMeasurement {
            measurement: Measurement::CableLengths(plant.measure_cables().unwrap()),
            measured_ns: now_ns,
            rested_ns: self.rest_ns(now_ns),
        });
    }

    fn order(&self, now_ms: u64) -> MotorOrder {
        match self.taken {
            Some((command, _)) if BEGIN_NS + now_ms * MS < command.valid_until_ns => {
                MotorOrder::Speeds(command.cable_speed_m_s)
            }
            _ => MotorOrder::Stop,
        }
    }
}

impl Trial {
    /// One cycle, and the motion of the robot behind this driver until the next one.
    pub(in super::super) fn turn_losing(
        &mut self,
        driver: &mut LosingDriver,
        obstacle: &Obstacle,
    ) -> CycleRecord {
        let release_ms = self.next * PERIOD_NS / MS;
        self.gather(BEGIN_NS + release_ms * MS);
        if driver.measured.is_some() {
            self.inputs.measurement = driver.measured;
        }
        let (record, command) = self.command(0);
        for step_ms in 0..PERIOD_NS / MS {
            let now_ms = release_ms + step_ms;
            if step_ms == driver.late_ms {
                driver.arrived = Some(command);
            }
            let stalls = driver.stalls.is_some_and(|stalls| stalls.contain(now_ms));
            if now_ms.is_multiple_of(TURN_MS) && !stalls {
                driver.turn(&mut self.plant, now_ms);
            }
            self.plant.order(driver.order(now_ms));
            self.plant.advance(1e-3);
            let clearance_m = self.plant.clearance_m([*obstacle].into_iter());
            driver.least_m = driver.least_m.min(clearance_m);
        }
        record
    }
}
