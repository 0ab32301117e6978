//! Every limit of the wire contract, with its reason. Nothing is unbounded.

/// Bending sections of one robot. The longest published cable-driven arm has five.
pub const SECTIONS_MAX: usize = 6;

/// Scalars of a configuration: two bend-vector components for each section.
pub const COORDINATES_MAX: usize = 2 * SECTIONS_MAX;

/// Cables of one robot: three for each section.
pub const CABLES_MAX: usize = 3 * SECTIONS_MAX;

/// Points in one reference chunk: 0.64 s of a reference sampled at 5 ms, 9 kB.
pub const CHUNK_POINTS_MAX: usize = 128;

/// Points that the daemon buffers ahead: 32 full chunks, 20 s of a reference sampled at 5 ms.
pub const REFERENCE_POINTS_MAX: usize = 4096;

/// Obstacles known to the daemon at one time, and obstacles in one message.
pub const OBSTACLES_MAX: usize = 64;

/// Prediction steps N of the optimal control problem.
pub const HORIZON_STEPS_MAX: usize = 50;

/// Control blocks M ≤ N that the daemon optimises. With six sections this makes 240 unknowns, and
/// bounds the size of a telemetry record; longer horizons hold each block for several steps.
pub const CONTROL_BLOCKS_MAX: usize = 20;

/// Scalars of a plan: the rates of every section in every control block.
pub const PLAN_MAX: usize = COORDINATES_MAX * CONTROL_BLOCKS_MAX;

/// Particles of the swarm.
pub const SWARM_MAX: usize = 512;

/// Iterations of the swarm in one cycle.
pub const ITERATIONS_MAX: usize = 1000;

/// Input events reported in one telemetry record: as many as one gather and its cycle can bring.
pub const EVENTS_MAX: usize = 24;

/// Bad cycles that are kept whole for whoever asks: 0.9 MB.
pub const INCIDENTS_MAX: usize = 64;

/// Bytes of a text in a message (robot name, build), UTF-8, padded with zeros.
pub const TEXT_BYTES: usize = 48;
