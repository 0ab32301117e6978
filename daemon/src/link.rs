//! The robots of a cycle: an ideal and a misbehaving one, simulated inside the daemon, and one behind a
//! driver.

use cdcr_controller::estimator::Measurement;
use cdcr_controller::plant::{KinematicPlant, MisbehavingRobot, MotorOrder};
use cdcr_controller::robot::{BendRates, CABLES_MAX, Configuration, Robot, RobotError};

use crate::config::{Interface, LinkKind, Validated, ns};
use crate::handover::{CycleInputs, Policy, TimedMeasurement};

/// The robot of a cycle, simulated or real. Nothing here allocates, locks or makes a system call.
#[derive(Debug)]
pub enum CycleRobot {
    /// Simulated, equal to its model.
    Ideal(Box<IdealRobot>),
    /// Simulated, different from its model.
    Misbehaving(Box<MisbehavingLink>),
    /// A driver process: measurements come with the inputs, and the exchange publishes the commands from the
    /// records.
    Driver,
}

impl CycleRobot {
    /// The robot of a configuration. An ideal one moves while its newest command is valid.
    pub fn new(validated: &Validated) -> Result<Self, RobotError> {
        let Validated {
            config,
            robot,
            initial,
            ..
        } = validated;
        Ok(match config.link.kind {
            LinkKind::Driver => Self::Driver,
            LinkKind::Simulated if config.link.is_ideal() => {
                let moving_ns = Policy::new(config).moving_ns(u64::MAX, ns(config.cycle.period_ms));
                let plant = KinematicPlant::new(robot, *initial);
                Self::ideal(plant.with_extrapolate_max_s(moving_ns as f64 * 1e-9))
            }
            LinkKind::Simulated => Self::Misbehaving(Box::new(MisbehavingLink::new(validated)?)),
        })
    }

    pub fn ideal(plant: KinematicPlant) -> Self {
        let now_ns = None;
        Self::Ideal(Box::new(IdealRobot { plant, now_ns }))
    }

    /// The newest measurement for the release at `release_ns`; `None` before the first. Called once in each
    /// cycle.
    pub fn measure(&mut self, release_ns: u64, inputs: &CycleInputs) -> Option<TimedMeasurement> {
        match self {
            Self::Ideal(robot) => Some(TimedMeasurement {
                measurement: robot.measure(release_ns),
                measured_ns: release_ns,
                rested_ns: [0; 2],
            }),
            Self::Misbehaving(robot) => robot.measure(release_ns),
            Self::Driver => inputs.measurement,
        }
    }

    /// The newest measurement of the tip in addition to bends or cables. Called once in each cycle, after
    /// [`Self::measure`].
    pub fn measure_tip(
        &mut self,
        release_ns: u64,
        inputs: &CycleInputs,
    ) -> Option<TimedMeasurement> {
        match self {
            Self::Misbehaving(robot) => {
                if robot.measures_both
                    && let Some(position_m) = robot.plant.measure_tip()
                {
                    robot.last_tip = Some(TimedMeasurement {
                        measurement: Measurement::TipPosition(position_m),
                        measured_ns: release_ns,
                        rested_ns: [0; 2],
                    });
                }
                robot.last_tip
            }
            Self::Ideal(_) | Self::Driver => inputs.tip,
        }
    }

    /// Sets the rates from the release at `release_ns` on, for a simulated robot. `commanded` is the
    /// commanded position at that release; `begins`: it is on its way to the robot, after a reset.
    pub fn command(
        &mut self,
        release_ns: u64,
        rates: &BendRates,
        commanded: &Configuration,
        begins: bool,
    ) {
        match self {
            Self::Ideal(robot) => robot.plant.command(rates),
            Self::Misbehaving(robot) => robot.command(release_ns, rates, commanded, begins),
            Self::Driver => {}
        }
    }
}

/// The ideal kinematic robot. Commands take effect at the release of their cycle, and its state is known
/// exactly at each release.
#[derive(Debug)]
pub struct IdealRobot {
    plant: KinematicPlant,
    now_ns: Option<u64>,
}

impl IdealRobot {
    fn measure(&mut self, release_ns: u64) -> Measurement {
        let before_ns = self.now_ns.replace(release_ns).unwrap_or(release_ns);
        self.plant.advance((release_ns - before_ns) as f64 * 1e-9);
        Measurement::Configuration(*self.plant.configuration())
    }
}

/// A robot that differs from its model, with its driver. Its sensors are read at each release. Its motors
/// execute the command of the configured interface while it is valid.
#[derive(Debug)]
pub struct MisbehavingLink {
    plant: MisbehavingRobot,
    model: Robot,
    interface: Interface,
    measures_tip: bool,
    /// Tip and cables are measured.
    measures_both: bool,
    /// Last measurement of its sensors, which may be silent at a release.
    last: Option<TimedMeasurement>,
    last_tip: Option<TimedMeasurement>,
    valid_ns: u64,
    rates: BendRates,
    /// Target of position motors \[m\].
    target_m: [f64; CABLES_MAX],
    /// By how much these targets differ from the commanded lengths \[m\]. A load keeps the robot beside its targets, so motors stay while the
    /// commanded position moves to the robot, as those of `cdcr_client::Driver` do.
    beside_m: [f64; CABLES_MAX],
    /// The commanded position was on its way to the robot.
    begins: bool,
    /// End of the validity of the rates \[ns\].
    until_ns: u64,
    now_ns: Option<u64>,
}

/// Step of the motors' simulation \[ns\]; longer if there would be more than [`STEPS_MAX`] steps.
const STEP_NS: u64 = 1_000_000;
const STEPS_MAX: u64 = 50;

impl MisbehavingLink {
    fn new(validated: &Validated) -> Result<Self, RobotError> {
        let Validated {
            config,
            robot,
            truth,
            flaws,
            initial,
            ..
        } = validated;
        let (preset, seed) = (config.link.simulated, u64::from(config.link.simulated_seed));
        let plant = MisbehavingRobot::new(robot, initial, *flaws, seed)?;
        Ok(Self {
            plant: match truth {
                Some(truth) => plant.with_truth(truth.clone()),
                None => plant,
            },
            measures_both: config.link.simulated_tip && !preset.measures_tip(),
            model: robot.clone(),
            interface: config.link.interface,
            measures_tip: preset.measures_tip(),
            last: None,
            last_tip: None,
            valid_ns: Policy::new(config).moving_ns(u64::MAX, ns(config.cycle.period_ms)),
            rates: BendRates::zero(robot.section_count()),
            target_m: robot.cable_lengths(initial),
            beside_m: [0.0; CABLES_MAX],
            begins: false,
            until_ns: 0,
            now_ns: None,
        })
    }

    fn move_to(&mut self, release_ns: u64) {
        let mut now_ns = self.now_ns.replace(release_ns).unwrap_or(release_ns);
        let even_ns = (release_ns - now_ns).div_ceil(STEPS_MAX);
        let speeds_m_s = self.model.cable_speeds(&self.rates);
        while now_ns < release_ns {
            let step_ns = STEP_NS.max(even_ns).min(release_ns - now_ns);
            let step_s = step_ns as f64 * 1e-9;
            let is_valid = now_ns < self.until_ns;
            self.plant.order(match self.interface {
                Interface::Velocity if is_valid => MotorOrder::Speeds(speeds_m_s),
                Interface::Velocity => MotorOrder::Stop,
                Interface::Position => {
                    if is_valid {
                        for (target_m, speed_m_s) in self.target_m.iter_mut().zip(&speeds_m_s) {
                            *target_m += speed_m_s * step_s;
                        }
                    }
                    MotorOrder::Lengths(self.target_m)
                }
            });
            self.plant.advance(step_s);
            now_ns += step_ns;
        }
    }

    fn measure(&mut self, release_ns: u64) -> Option<TimedMeasurement> {
        self.move_to(release_ns);
        let measurement = if self.measures_tip {
            self.plant.measure_tip().map(Measurement::TipPosition)
        } else {
            self.plant.measure_cables().map(Measurement::CableLengths)
        };
        let timed = measurement.map(|measurement| TimedMeasurement {
            measurement,
            measured_ns: release_ns,
            rested_ns: [0; 2],
        });
        self.last = timed.or(self.last);
        self.last
    }

    fn command(
        &mut self,
        release_ns: u64,
        rates: &BendRates,
        commanded: &Configuration,
        begins: bool,
    ) {
        let commanded_m = self.model.cable_lengths(commanded);
        // The last part of the way, too.
        if begins | core::mem::replace(&mut self.begins, begins) {
            self.beside_m = core::array::from_fn(|cable| self.target_m[cable] - commanded_m[cable]);
            self.rates = BendRates::zero(self.model.section_count());
        } else {
            self.target_m = core::array::from_fn(|cable| commanded_m[cable] + self.beside_m[cable]);
            self.rates = *rates;
        }
        self.until_ns = release_ns + self.valid_ns;
    }
}
