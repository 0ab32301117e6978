//! Every limit of the wire contract, with its reason. Nothing is unbounded.

/// Declares the limits, and the list of them.
macro_rules! limits {
    ($($(#[doc = $doc:literal])+ $name:ident: $type:ty = $value:expr;)+) => {
        $($(#[doc = $doc])+ pub const $name: $type = $value;)+

        /// Name, value and meaning of each.
        pub const ALL: &[(&str, f64, &str)] = &[$((stringify!($name), $name as f64, concat!($($doc),+)),)+];
    };
}

limits! {
    /// Bending sections of one robot. The longest published cable-driven arm has five.
    SECTIONS_MAX: usize = 6;

    /// Scalars of a configuration: two bend-vector components for each section.
    COORDINATES_MAX: usize = 2 * SECTIONS_MAX;

    /// Cables of one robot: three for each section.
    CABLES_MAX: usize = 3 * SECTIONS_MAX;

    /// Points in one reference chunk: 0.64 s of a reference sampled at 5 ms, 9 kB.
    CHUNK_POINTS_MAX: usize = 128;

    /// Points that the daemon buffers ahead: 32 full chunks, 20 s of a reference sampled at 5 ms.
    REFERENCE_POINTS_MAX: usize = 4096;

    /// Largest time from the arrival of a reference point to the point \[s\], and longest reference: a day.
    REFERENCE_AHEAD_S_MAX: usize = 86_400;

    /// Obstacles known to the daemon at one time, and obstacles in one message.
    OBSTACLES_MAX: usize = 64;

    /// Age of an obstacle that moves, at its arrival \[ms\]. Its place is predicted from its stamp on, so an old or unset one
    /// would place it elsewhere.
    OBSTACLE_AGE_MS_MAX: usize = 1000;

    /// Speed of an obstacle \[m/s\]: faster than anything beside a robot.
    OBSTACLE_SPEED_M_S_MAX: usize = 100;

    /// Longest period of a daemon \[ms\], and so the longest time of one solve.
    PERIOD_MS_MAX: usize = 100;

    /// Age of a request at its arrival \[ms\]: an older one waited while the daemon or its client was stopped. A client
    /// waits as long for the answer.
    REQUEST_AGE_MS_MAX: usize = 1000;

    /// Prediction steps N of the optimal control problem.
    HORIZON_STEPS_MAX: usize = 50;

    /// Control blocks M ≤ N that the daemon optimises, limited by the plan size.
    CONTROL_BLOCKS_MAX: usize = 50;

    /// Scalars of a plan: the rates of every section in every control block, 50 blocks of three sections, 25 of six. It
    /// bounds the size of a telemetry record; longer horizons hold each block for several steps.
    PLAN_MAX: usize = 300;

    /// Particles of the swarm.
    SWARM_MAX: usize = 512;

    /// Iterations of the swarm in one cycle.
    ITERATIONS_MAX: usize = 1000;

    /// Input events reported in one telemetry record: as many as one gather and its cycle can bring.
    EVENTS_MAX: usize = 24;

    /// Bad cycles kept in full for clients that ask: 1 MB.
    INCIDENTS_MAX: usize = 64;

    /// Time for which a first tip of a driver awaits bends or cables \[ms\]. After it, the driver measures the tip alone.
    BENDS_LATE_MS: usize = 100;

    /// A tip sensor beside bends or cables that has measured nothing for this long is silent \[ms\]: some frames of a slow camera.
    TIP_SENSOR_SILENT_MS: usize = 1000;

    /// A robot that was held by its motors is not measured farther from where its last command left it: a bend of a section
    /// \[rad\]. Beyond, its encoders may have lost their zero, and a reset has to accept the pose.
    POSE_DIFFERS_RAD: f64 = 0.2;

    /// Bends this far beyond their limit are held, not a fault: the daemon commands the position where the robot is measured,
    /// and its driver accepts it. The same tolerance applies between a first position and the measurement \[rad\].
    BEND_TOLERANCE_RAD: f64 = 0.05;

    /// Bytes of a text in a message (robot name, build), UTF-8, padded with zeros.
    TEXT_BYTES: usize = 48;
}
