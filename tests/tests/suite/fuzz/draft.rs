//! Messages of clients and drivers: arbitrary bits, or nearly valid messages with up to three wrong numbers.

use cdcr_daemon::config::Config;
use cdcr_daemon::convert::settings_to_wire;
use cdcr_daemon::handover::RuntimeSettings;
use cdcr_shared_types::codes::{Interface, RequestKind};
use cdcr_shared_types::{
    Measurement, Obstacle, ObstacleUpdate, ReferenceChunk, ReferencePoint, Request, SolverSettings,
};
use proptest::array::{uniform3, uniform4};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;

use crate::fuzz::fields::Fields;
use crate::fuzz::script::{BEGIN_NS, PERIOD_NS, Robot, Run, Script, Step};

/// Length of a section of the paper's robot \[m\].
const SECTION_M: f64 = 0.3;
/// Numbers at the limits of validity.
const CORNERS: [f64; 26] = [
    -0.0,
    1.0,
    -1.0,
    5e-324,
    1e-310,
    1e-308,
    1e-160,
    3.2,
    -3.2,
    1e3,
    1e6,
    1.000_001e6,
    -1e9,
    1e15,
    1e100,
    1e153,
    1e155,
    -1e200,
    1e300,
    1e308,
    f64::MAX,
    f64::MIN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::NAN,
    -f64::NAN,
];
/// Integers at the limits of counts, codes and times.
const WHOLE: [u64; 12] = [
    63,
    64,
    65,
    127,
    128,
    129,
    u32::MAX as u64,
    1 << 31,
    1 << 53,
    i64::MAX as u64,
    1 << 63,
    u64::MAX,
];

/// The bits of a number: any value, limit values with a higher probability.
pub(crate) fn word() -> impl Strategy<Value = u64> {
    prop_oneof![
        3 => any::<u64>(),
        4 => select(CORNERS.as_slice()).prop_map(f64::to_bits),
        3 => 0..8_u64,
        2 => select(WHOLE.as_slice()),
        3 => (-4.0..4.0).prop_map(f64::to_bits),
        // A NaN of any sign and payload, the infinities, and subnormal numbers.
        1 => any::<u64>().prop_map(|bits| bits | 0x7ff0 << 48),
        1 => any::<u64>().prop_map(|bits| bits & !(0x7ff0 << 48)),
    ]
}

/// The bytes of a message of `size` bytes, or fewer.
pub(crate) fn bytes(size: usize) -> impl Strategy<Value = Vec<u8>> {
    vec(word(), 0..=size / 8)
        .prop_map(|words| words.into_iter().flat_map(u64::to_le_bytes).collect())
}

/// A change of one number of a message.
#[derive(Debug, Clone, Copy)]
enum Change {
    Set(u64),
    Flip(u8),
}

/// Index of a number of a message, and its change.
type Changes = Vec<(u16, Change)>;

fn changes() -> impl Strategy<Value = Changes> {
    let change = prop_oneof![
        3 => word().prop_map(Change::Set),
        1 => (0..64_u8).prop_map(Change::Flip),
    ];
    prop_oneof![
        2 => Just(Changes::new()),
        3 => vec((any::<u16>(), change), 1..=3),
    ]
}

/// Changes some of the first `used` numbers, which are the ones that are read.
fn spoil<T: Fields>(message: &mut T, changes: &[(u16, Change)], used: usize) {
    for (index, change) in changes {
        message.change(usize::from(*index) % used, |bits| match change {
            Change::Set(bits) => *bits,
            Change::Flip(bit) => bits ^ (1 << bit),
        });
    }
}

/// A message with times relative to now and lengths relative to the robot, and its changes.
#[derive(Debug, Clone)]
pub(crate) struct Draft {
    step: Step,
    changes: Changes,
}

impl std::fmt::Debug for Step {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", Script(vec![self.clone()]))
    }
}

fn draft(message: impl Strategy<Value = Step>) -> impl Strategy<Value = Draft> {
    (message, changes()).prop_map(|(step, changes)| Draft { step, changes })
}

fn point() -> impl Strategy<Value = ReferencePoint> {
    let gap_ns = prop_oneof![
        20 => 1_000_000..50_000_000_u64,
        1 => Just(1),
        1 => 1..1_u64 << 60,
    ];
    let parts = (gap_ns, uniform3(-0.55..0.55), 0..3_u32, uniform4(-1.0..1.0));
    parts.prop_map(
        |(time_ns, position_m, orientation_kind, direction)| ReferencePoint {
            time_ns,
            position_m,
            orientation: unit(direction, orientation_kind),
            orientation_kind,
            reserved: 0,
        },
    )
}

/// A valid direction for a point with this kind of orientation.
fn unit(direction: [f64; 4], kind: u32) -> [f64; 4] {
    let count = [0, 3, 4][kind as usize];
    let used = &direction[..count];
    let length = used.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
    core::array::from_fn(|i| {
        if i < count {
            direction[i] / length
        } else {
            0.0
        }
    })
}

pub(crate) fn chunk() -> impl Strategy<Value = Draft> {
    let points = prop_oneof![8 => vec(point(), 1..12), 1 => vec(point(), 128)];
    draft(
        (0..2_u32, 0..2_u32, points).prop_map(|(mode, interpolation, points)| {
            let mut chunk = ReferenceChunk {
                mode,
                interpolation,
                count: points.len() as u32,
                ..ReferenceChunk::default()
            };
            chunk.points[..points.len()].copy_from_slice(&points);
            Step::Chunk(chunk)
        }),
    )
}

fn obstacle() -> impl Strategy<Value = Obstacle> {
    let id = prop_oneof![0..6_u32, 0..100_u32];
    let age_ns = prop_oneof![4 => 0..100_000_000_u64, 1 => Just(BEGIN_NS)];
    let lifetime_ns = prop_oneof![Just(0), 50_000_000..500_000_000_u64, Just(u64::MAX)];
    let velocity_m_s = prop_oneof![Just([0.0; 3]), uniform3(-1.0..1.0), uniform3(-60.0..60.0)];
    // Anywhere, or beside the straight robot.
    let place = || {
        let beside = (-0.15..0.15, -0.15..0.15, 0.3..1.1).prop_map(|(x, y, z)| [x, y, z]);
        prop_oneof![1 => uniform3(-1.0..1.0), 2 => beside]
    };
    let ends = [place(), place()];
    (
        id,
        0..2_u32,
        ends,
        0.0..0.2,
        velocity_m_s,
        age_ns,
        lifetime_ns,
    )
        .prop_map(
            |(id, shape, [start_m, end_m], radius_m, velocity_m_s, measured_ns, lifetime_ns)| {
                Obstacle {
                    id,
                    shape,
                    start_m,
                    end_m,
                    radius_m,
                    velocity_m_s,
                    measured_ns,
                    lifetime_ns,
                }
            },
        )
}

pub(crate) fn update() -> impl Strategy<Value = Draft> {
    let action = prop_oneof![8 => Just(0_u32), 1 => Just(1), 1 => Just(2)];
    let obstacles = prop_oneof![8 => vec(obstacle(), 0..6), 1 => vec(obstacle(), 64)];
    draft((action, obstacles).prop_map(|(action, obstacles)| {
        let mut update = ObstacleUpdate {
            action,
            count: obstacles.len() as u32,
            ..ObstacleUpdate::default()
        };
        update.obstacles[..obstacles.len()].copy_from_slice(&obstacles);
        Step::Update(update)
    }))
}

pub(crate) fn measurement() -> impl Strategy<Value = Draft> {
    let bends = prop_oneof![
        4 => vec(-0.3..0.3, 12),
        1 => vec(-2.5..2.5, 12),
    ];
    // Sometimes everything is too large.
    let scale = prop_oneof![10 => Just(1.0), 1 => select(vec![1e3, 1e100, 1e154, 1e300, 1e308])];
    let parts = (
        1..4_u32,
        0..20_000_000_u64,
        scale,
        bends,
        uniform3(-0.6..0.6),
        vec(-0.02..0.02, 18),
        // Mostly false.
        (0..20_000_000_u64, 0..20_000_000_u64),
    );
    draft(
        parts.prop_map(|(kind, measured_ns, scale, bends, tip_m, pulls, rest_ns)| {
            let backbone_m = |cable: usize| (cable / 3 + 1) as f64 * SECTION_M;
            Step::Measurement(Measurement {
                measured_ns,
                kind,
                interface: Interface::Velocity.code(),
                rested_from_ns: rest_ns.0.min(rest_ns.1),
                rested_until_ns: rest_ns.1,
                bend_rad: core::array::from_fn(|i| scale * bends[i]),
                tip_position_m: tip_m.map(|x: f64| scale * x),
                cable_length_m: core::array::from_fn(|i| backbone_m(i) + scale * pulls[i]),
                ..Measurement::default()
            })
        }),
    )
}

/// Settings that are consistent, with a swarm small enough for a test.
fn settings() -> impl Strategy<Value = SolverSettings> {
    let horizon = prop_oneof![6 => 1..8_u32, 1 => Just(50)];
    let codes = (0..3_u32, 0..2_u32, 0..3_u32);
    let counts = (horizon, 0..2_u32, 1..20_u32, 0..30_u32, 0..12_u32, 0..6_u32);
    let weight = || prop_oneof![Just(0.0), 0.0..10.0, Just(1e12)];
    let weights = (weight(), weight(), weight(), weight(), 0.0..0.2);
    (codes, counts, weights, any::<u64>()).prop_map(|(codes, counts, weights, seed)| {
        SolverSettings {
            solver: codes.0,
            coordinates: codes.1,
            velocity_rule: codes.2,
            horizon_steps: counts.0,
            control_blocks: counts.1,
            swarm_size: counts.2,
            swarm_iterations: counts.3,
            regenerate_after: counts.4,
            refinement_steps: counts.5,
            orientation_weight: weights.0,
            rate_weight: weights.1,
            rate_change_weight: weights.2,
            terminal_weight: weights.3,
            safe_distance_m: weights.4,
            seed,
            ..settings_to_wire(&RuntimeSettings::new(&Config::default()))
        }
    })
}

pub(crate) fn request() -> impl Strategy<Value = Draft> {
    let settings = settings().prop_map(|settings| Request {
        kind: RequestKind::Settings.code(),
        settings,
        ..Request::default()
    });
    let kinds = [
        RequestKind::Track,
        RequestKind::Track,
        RequestKind::Hold,
        RequestKind::Home,
        RequestKind::Stop,
        RequestKind::Reset,
        RequestKind::Reset,
    ];
    let mode = (select(kinds.to_vec()), 0..2_u32).prop_map(|(kind, accepts_pose)| Request {
        kind: kind.code(),
        accepts_pose: if kind == RequestKind::Reset {
            accepts_pose
        } else {
            0
        },
        ..Request::default()
    });
    draft(prop_oneof![settings, mode].prop_map(Step::Request))
}

fn run() -> impl Strategy<Value = Draft> {
    let skipped = prop_oneof![6 => Just(0_u32), 1 => 1..30_u32];
    let measured = prop_oneof![4 => Just(1_u32), 1 => Just(0)];
    let lease = prop_oneof![6 => Just(1_u32), 1 => 0..3_u32];
    (1..8_u32, skipped, measured, lease).prop_map(|(cycles, skipped, measured, lease)| Draft {
        step: Step::Run(Run {
            cycles,
            skipped,
            measured,
            lease,
        }),
        changes: Changes::new(),
    })
}

/// Messages of all kinds with cycles between them; half of the scripts first make the robot follow a
/// reference.
pub(crate) fn script() -> impl Strategy<Value = Script> {
    let robot = (select(vec![1_u32, 3, 3, 6]), 0..2_u32)
        .prop_map(|(sections, driver)| Robot { sections, driver });
    let step = prop_oneof![
        3 => run(),
        2 => chunk(),
        2 => update(),
        2 => measurement(),
        2 => request(),
    ];
    (robot, any::<bool>(), chunk(), vec(step, 1..14)).prop_map(|(robot, follows, first, steps)| {
        let mut drafts = if follows {
            beginning(first)
        } else {
            Vec::new()
        };
        drafts.extend(steps);
        lay_out(BEGIN_NS, robot, drafts)
    })
}

/// A measurement, a reference and a request to follow it.
fn beginning(mut reference: Draft) -> Vec<Draft> {
    reference.changes.clear();
    let clean = |step| Draft {
        step,
        changes: Changes::new(),
    };
    let run = Run {
        cycles: 2,
        measured: 1,
        lease: 1,
        ..Run::default()
    };
    let track = Request {
        kind: RequestKind::Track.code(),
        ..Request::default()
    };
    vec![
        clean(Step::Run(run)),
        reference,
        clean(Step::Request(track)),
        clean(Step::Run(run)),
    ]
}

/// Gives each draft its time from `begin_ns` on and the robot's size, then applies its changes.
pub(crate) fn lay_out(begin_ns: u64, robot: Robot, drafts: Vec<Draft>) -> Script {
    let mut now_ns = begin_ns;
    let mut end_ns = 0;
    let mut steps = vec![Step::Robot(robot)];
    for Draft { mut step, changes } in drafts {
        match &mut step {
            Step::Robot(_) => {}
            Step::Run(run) => now_ns += u64::from(run.cycles + run.skipped) * PERIOD_NS,
            Step::Chunk(chunk) => {
                let mut time_ns = if chunk.mode == 1 {
                    now_ns.max(end_ns)
                } else {
                    now_ns
                };
                for point in &mut chunk.points[..chunk.count as usize] {
                    time_ns += point.time_ns;
                    point.time_ns = time_ns;
                    point.position_m = scaled(point.position_m, robot);
                }
                end_ns = time_ns;
                spoil(chunk, &changes, 7 + 10 * chunk.count as usize);
            }
            Step::Update(update) => {
                for obstacle in &mut update.obstacles[..update.count as usize] {
                    obstacle.measured_ns = now_ns.saturating_sub(obstacle.measured_ns);
                    obstacle.start_m = scaled(obstacle.start_m, robot);
                    obstacle.end_m = scaled(obstacle.end_m, robot);
                }
                spoil(update, &changes, 5 + 15 * update.count as usize);
            }
            Step::Measurement(measurement) => {
                measurement.measured_ns = now_ns - measurement.measured_ns;
                measurement.sections = robot.sections;
                measurement.tip_position_m = scaled(measurement.tip_position_m, robot);
                spoil(measurement, &changes, 6 + 2 * robot.sections as usize);
                if measurement.kind > 1 {
                    spoil(measurement, &changes, 43);
                }
            }
            Step::Request(request) => spoil(request, &changes, 31),
        }
        steps.push(step);
    }
    Script(steps)
}

fn scaled(position_m: [f64; 3], robot: Robot) -> [f64; 3] {
    position_m.map(|x| x * SECTION_M * f64::from(robot.sections))
}
