//! A robot that is not its model: how far its tip is from the reference in truth, with all that the controller does about it and
//! with each part of that switched off.
//!
//! A closed loop offline; each seed gives the same bits again.

use anyhow::{Context, Result};
use cdcr_controller::closed_loop::{ClosedLoop, Driven, Sensor};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
use cdcr_controller::plant::{Flaws, Preset};
use cdcr_controller::reference::{Orientation, ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;
use serde::Serialize;

use crate::chart::{BLUE, Curve, GREEN, GREY, ORANGE, PURPLE, Panel, Scale, sheet};
use crate::dataset::{Column, Dataset, Plot, Sheet, fixed, plain, word};
use crate::interrupt;
use crate::progress::Progress;
use crate::scene::PERIOD_S;

const EXPLANATION: &str = "\
<p>Three sections follow a figure eight of 160 mm by 80 mm at up to 52 mm/s. The robot is not its model: its motors lag, its \
sensors have noise, its sections have other lengths, a load bends it. The error is that of the tip in truth, without the first \
second; every row is the mean of the seeds, the largest error is that of all of them. The controller is the one of \
a daemon with its default settings and its motors configured (<em>full</em>), and the same with a part switched off.</p>\n";

const COLUMNS: [Column; 11] = [
    word("robot", "name"),
    word("controller", "controller"),
    word("interface", "interface"),
    plain("seeds", "seeds"),
    fixed("mean mm", "mean_error_mm", 3),
    fixed("settled mm", "settled_error_mm", 3),
    fixed("max mm", "max_error_mm", 3),
    fixed("rate change rms rad/s", "rate_change_rms", 4),
    fixed("clearance mm", "min_clearance_mm", 2),
    fixed("target mm", "target_mm", 2),
    word("reached", "reached"),
];

/// Cycles of a run: once round the figure eight, and a little more.
const CYCLES: u32 = 3000;
/// Of these nothing is counted: the robot comes from its start.
const BEGIN_CYCLES: u32 = 200;
/// What a run takes, about \[s\].
const RUN_S: f64 = 0.12;
/// Time constant of a daemon's estimate, by default \[s\].
const TIME_CONSTANT_S: f64 = 0.1;
/// Largest acceleration of a robot behind a driver, by default \[rad/s²\].
const ACCELERATION_RAD_S2: f64 = 40.0;

#[derive(Debug, Clone, Copy)]
pub struct RobustnessOptions {
    /// Runs of each robot with each controller, each with other noise.
    pub rounds: u32,
}

impl RobustnessOptions {
    pub fn full() -> Self {
        Self { rounds: 20 }
    }

    pub fn quick() -> Self {
        Self { rounds: 1 }
    }
}

pub fn expected_s(options: &RobustnessOptions) -> f64 {
    let runs = cases().count() as f64 * 2.0;
    f64::from(options.rounds) * runs * RUN_S
}

/// Runs every robot with every controller and interface. The same seeds give the same numbers.
pub fn run(options: &RobustnessOptions, progress: &mut Progress) -> Result<Dataset> {
    let scene = Scene::new()?;
    let mut dataset = Dataset {
        name: "robustness",
        heading: "Robots that are not their model",
        explanation: EXPLANATION,
        ..Dataset::default()
    };
    let (mut rows, mut panels) = (Vec::new(), Vec::<Panel>::new());
    for (scenario, control) in cases() {
        for obeys_positions in [true, false] {
            let mut runs = Vec::new();
            for seed in 1..=u64::from(options.rounds) {
                interrupt::check()?;
                progress.begin(&format!("{}, {}", scenario.name, control.name()));
                runs.push(scene.run(&scenario, control, obeys_positions, seed)?);
                progress.advance(RUN_S);
            }
            if obeys_positions {
                draw(&mut panels, &scenario, control, &runs[0]);
            }
            let row = Row::of(&scenario, control, obeys_positions, &runs);
            // Without noise every run is the same.
            if control == Control::Full && scenario.flaws.noise_m + scenario.flaws.tip_noise_m > 0.0
            {
                let path = format!("robustness/{}/{}", row.name, row.interface);
                let means = runs.iter().map(Run::mean_mm);
                dataset.lower(format!("{path}/mean_error"), "mm", means);
            }
            rows.push(row);
        }
    }
    dataset.plots.push(Plot {
        name: "robustness-error",
        caption: "Error of the tip in truth, position interface, the first seed.",
        svg: sheet(&panels, 2, 420)?,
    });
    dataset.sheets.push(
        Sheet::new(&rows)?
            .key("scenarios")
            .file("robustness")
            .table(
                "Robots that are not their model, on a figure eight",
                &COLUMNS,
            ),
    );
    Ok(dataset)
}

/// What is done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Control {
    /// All that a daemon does.
    Full,
    /// The motors are taken for ideal.
    NoActuator,
    /// What is measured is believed at once, and the motors are taken for ideal.
    NoEstimator,
    /// The sensor of the tip is not used.
    NoTip,
    /// Nothing is measured.
    OpenLoop,
}

impl Control {
    fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::NoActuator => "no actuator model",
            Self::NoEstimator => "no estimator",
            Self::NoTip => "no tip",
            Self::OpenLoop => "open loop",
        }
    }
}

/// A robot, and what is known of it.
#[derive(Debug, Clone)]
struct Scenario {
    name: &'static str,
    flaws: Flaws,
    /// What its motors are taken for.
    actuator: Actuator,
    sensor: Sensor,
    /// A ball stands at the way.
    has_ball: bool,
    /// The mean error that is wanted \[mm\].
    target_mm: Option<f64>,
}

fn motors(delay_s: f64, time_constant_s: f64) -> Actuator {
    Actuator {
        delay_s,
        time_constant_s,
    }
}

fn scenarios() -> Vec<Scenario> {
    let known = motors(0.015, 0.03);
    let base = Scenario {
        name: "ideal",
        flaws: Flaws::default(),
        actuator: Actuator::IDEAL,
        sensor: Sensor::Cables,
        has_ball: false,
        target_mm: None,
    };
    let lagging = |name, actuator| Scenario {
        name,
        flaws: Flaws {
            actuator,
            ..Flaws::default()
        },
        actuator: known,
        target_mm: Some(0.5),
        ..base.clone()
    };
    let of_preset = |name, preset: Preset| Scenario {
        name,
        flaws: preset.flaws(),
        actuator: preset.flaws().actuator,
        ..base.clone()
    };
    let tip_alone = |name, tip_noise_m, target_mm| Scenario {
        name,
        flaws: Flaws {
            tip_noise_m,
            ..Flaws::default()
        },
        sensor: Sensor::Tip { every: 1 },
        target_mm: Some(target_mm),
        ..base.clone()
    };
    vec![
        base.clone(),
        Scenario {
            name: "30 µm of noise",
            flaws: Flaws {
                noise_m: 3e-5,
                ..Flaws::default()
            },
            target_mm: Some(0.15),
            ..base.clone()
        },
        lagging("lag 30 ms, delay 15 ms", known),
        lagging("lag 21 ms, delay 10 ms", motors(0.01, 0.021)),
        lagging("lag 39 ms, delay 20 ms", motors(0.02, 0.039)),
        Scenario {
            name: "wrong model",
            flaws: Flaws {
                length_error: 0.05,
                payload_rad: [0.015, 0.0],
                tip_noise_m: 3e-4,
                ..Flaws::default()
            },
            sensor: Sensor::CablesAndTip { every: 2 },
            target_mm: Some(0.2),
            ..base.clone()
        },
        Scenario {
            name: "play of 0.5 mm",
            flaws: Flaws {
                backlash_m: 5e-4,
                tip_noise_m: 3e-4,
                ..Flaws::default()
            },
            sensor: Sensor::CablesAndTip { every: 1 },
            target_mm: Some(0.3),
            ..base.clone()
        },
        tip_alone("tip alone, 0.1 mm", 1e-4, 0.1),
        tip_alone("tip alone, 0.5 mm", 5e-4, 0.25),
        of_preset("laboratory", Preset::Laboratory),
        Scenario {
            has_ball: true,
            ..of_preset("laboratory, ball", Preset::Laboratory)
        },
        Scenario {
            sensor: Sensor::CablesAndTip { every: 2 },
            ..of_preset("sloppy, with tip", Preset::Sloppy)
        },
        of_preset("slow", Preset::Slow),
        Scenario {
            sensor: Sensor::Tip { every: 1 },
            ..of_preset("blind", Preset::Blind)
        },
    ]
}

/// Each scenario with the controllers that differ on it.
fn cases() -> impl Iterator<Item = (Scenario, Control)> {
    scenarios().into_iter().flat_map(|scenario| {
        let has_tip = matches!(scenario.sensor, Sensor::CablesAndTip { .. });
        let controls = [
            (Control::Full, true),
            (Control::NoActuator, scenario.actuator != Actuator::IDEAL),
            (Control::NoEstimator, !has_tip),
            (Control::NoTip, has_tip),
            (Control::OpenLoop, true),
        ];
        let differing = controls.into_iter().filter(|(_, differs)| *differs);
        differing.map(move |(control, _)| (scenario.clone(), control))
    })
}

/// The model, and the shape that it has at the beginning of the reference.
struct Scene {
    robot: Robot,
    settings: NmpcSettings,
    start: Configuration,
    ball: Obstacle,
}

impl Scene {
    fn new() -> Result<Self> {
        let robot = Robot::new(&RobotParameters::paper(3))?;
        let settings = NmpcSettings::default();
        let bent = Configuration::from_bend_angles(&[[0.4, 0.0]; 3]);
        let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings)?;
        let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, bent, &[], |_| eight(0.0));
        for _ in 0..600 {
            closed.step(&mut nmpc);
        }
        // 5 mm nearer to the tip than the safe distance where that turns.
        let centre_m = Vector3::new(0.37, 0.0, 0.7);
        Ok(Self {
            start: *closed.configuration(),
            ball: Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros())
                .context("the ball")?,
            robot,
            settings,
        })
    }

    fn run(
        &self,
        scenario: &Scenario,
        control: Control,
        obeys_positions: bool,
        seed: u64,
    ) -> Result<Run> {
        let driven = scenario.driven(control, obeys_positions, seed);
        let obstacles = if scenario.has_ball {
            core::slice::from_ref(&self.ball)
        } else {
            &[]
        };
        let mut nmpc = Nmpc::new(self.robot.clone(), PERIOD_S, self.settings)?;
        let (robot, settings) = (&self.robot, self.settings);
        let mut closed = ClosedLoop::new(robot, PERIOD_S, settings, self.start, obstacles, eight)
            .with_acceleration(ACCELERATION_RAD_S2)
            .with_driven(driven)?;
        let mut run = Run::default();
        let mut before = BendRates::zero(robot.section_count());
        for cycle in 0..CYCLES {
            closed.step(&mut nmpc);
            let rates = closed.command().rates;
            run.errors_mm.push(1e3 * closed.error_m());
            let clearance_mm = 1e3 * closed.clearance_m();
            run.min_clearance_mm = run.min_clearance_mm.min(clearance_mm);
            if cycle >= BEGIN_CYCLES {
                let pairs = rates.as_slice().iter().zip(before.as_slice());
                run.changes += pairs.map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
            }
            before = rates;
        }
        Ok(run)
    }
}

impl Scenario {
    fn driven(&self, control: Control, obeys_positions: bool, seed: u64) -> Driven {
        let full = Driven {
            flaws: self.flaws,
            actuator: self.actuator,
            time_constant_s: TIME_CONSTANT_S,
            obeys_positions,
            sensor: self.sensor,
            seed,
        };
        match control {
            Control::Full => full,
            Control::NoActuator => Driven {
                actuator: Actuator::IDEAL,
                ..full
            },
            Control::NoEstimator => Driven {
                actuator: Actuator::IDEAL,
                time_constant_s: 0.0,
                ..full
            },
            Control::NoTip => Driven {
                sensor: Sensor::Cables,
                ..full
            },
            Control::OpenLoop => Driven {
                sensor: Sensor::Nothing,
                ..full
            },
        }
    }
}

/// A figure eight across the robot's axis, at up to 52 mm/s.
fn eight(time_s: f64) -> ReferenceSample {
    let (turn, size_m) = (0.46 * time_s, 0.08);
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m: Vector3::new(
            0.25 + size_m * turn.sin(),
            0.5 * size_m * (2.0 * turn).sin(),
            0.7,
        ),
        orientation: Orientation::Free,
    }
}

/// One run, cycle by cycle.
#[derive(Debug)]
struct Run {
    errors_mm: Vec<f64>,
    /// Sum of the squares of what the rates changed by \[rad²/s²\].
    changes: f64,
    min_clearance_mm: f64,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            errors_mm: Vec::with_capacity(CYCLES as usize),
            changes: 0.0,
            min_clearance_mm: f64::INFINITY,
        }
    }
}

impl Run {
    fn counted(&self) -> &[f64] {
        &self.errors_mm[BEGIN_CYCLES as usize..]
    }

    fn mean_mm(&self) -> f64 {
        mean(self.counted())
    }

    /// Of the second half.
    fn settled_mm(&self) -> f64 {
        mean(&self.counted()[self.counted().len() / 2..])
    }

    fn max_mm(&self) -> f64 {
        self.counted().iter().copied().fold(0.0, f64::max)
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// One line: a robot with a controller, over all seeds.
#[derive(Debug, Serialize)]
struct Row {
    name: &'static str,
    controller: &'static str,
    interface: &'static str,
    seeds: usize,
    mean_error_mm: f64,
    settled_error_mm: f64,
    max_error_mm: f64,
    /// Root mean square of what the rates change by from cycle to cycle \[rad/s\].
    rate_change_rms: f64,
    /// Of the true body; none without an obstacle.
    min_clearance_mm: Option<f64>,
    safe_distance_mm: f64,
    target_mm: Option<f64>,
    /// Whether the mean error is what is wanted.
    reached: Option<&'static str>,
}

impl Row {
    fn of(scenario: &Scenario, control: Control, obeys_positions: bool, runs: &[Run]) -> Self {
        let count = runs.len() as f64;
        let average = |of: fn(&Run) -> f64| runs.iter().map(of).sum::<f64>() / count;
        let clearances = runs.iter().map(|run| run.min_clearance_mm);
        let counted = f64::from(CYCLES - BEGIN_CYCLES);
        let mean_error_mm = average(Run::mean_mm);
        let target_mm = scenario.target_mm.filter(|_| control == Control::Full);
        Self {
            name: scenario.name,
            controller: control.name(),
            interface: if obeys_positions {
                "position"
            } else {
                "velocity"
            },
            seeds: runs.len(),
            mean_error_mm,
            settled_error_mm: average(Run::settled_mm),
            max_error_mm: runs.iter().map(Run::max_mm).fold(0.0, f64::max),
            rate_change_rms: (average(|run| run.changes) / counted).sqrt(),
            min_clearance_mm: clearances.reduce(f64::min).filter(|mm| mm.is_finite()),
            safe_distance_mm: 1e3 * NmpcSettings::default().safe_distance_m,
            target_mm,
            reached: target_mm.map(|mm| if mean_error_mm <= mm { "yes" } else { "no" }),
        }
    }
}

/// The error over time of a first run, a panel for each robot.
fn draw(panels: &mut Vec<Panel>, scenario: &Scenario, control: Control, run: &Run) {
    let colour = match control {
        Control::Full => BLUE,
        Control::NoActuator => GREEN,
        Control::NoTip => PURPLE,
        Control::NoEstimator => ORANGE,
        Control::OpenLoop => GREY,
    };
    let points = run.errors_mm.iter().enumerate();
    let points = points.map(|(cycle, error_mm)| (cycle as f64 * PERIOD_S, *error_mm));
    let curve = Curve::line(control.name(), points.collect(), colour);
    if control == Control::Full {
        panels.push(Panel {
            title: scenario.name.to_owned(),
            x: "time [s]",
            y: "error of the tip [mm]",
            scale: Scale::Log { floor: 1e-3 },
            curves: Vec::new(),
        });
    }
    if let Some(panel) = panels.last_mut() {
        panel.curves.push(curve);
    }
}
