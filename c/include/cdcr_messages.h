/* The messages of cdcrd: structs, codes and limits, as they lie in shared memory and as the functions of cdcr.h take them.
 *
 * Made from the declarations in shared-types/src by `CDCR_GENERATE=1 cargo test -p cdcr-c messages`; do not edit it. What
 * each message is for: docs/wire-protocol.md. A comment begins with the offset in bytes.
 *
 * SI units. Times are nanoseconds of CLOCK_MONOTONIC. Little-endian, without padding. Set a struct to zeros before you fill it in. A text is
 * UTF-8 padded with zeros, and has none when it is full: print it with "%.*s" and CDCR_TEXT_BYTES. */
#ifndef CDCR_MESSAGES_H
#define CDCR_MESSAGES_H

#include <stddef.h>
#include <stdint.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "cdcrd runs on little-endian machines"
#endif

#ifdef __cplusplus
#define CDCR_ASSERT_SIZE(type, bytes) static_assert(sizeof(type) == (bytes), "the compiler pads " #type)
#elif __STDC_VERSION__ >= 201112L
#define CDCR_ASSERT_SIZE(type, bytes) _Static_assert(sizeof(type) == (bytes), "the compiler pads " #type)
#else
#define CDCR_ASSERT_SIZE(type, bytes) typedef char cdcr_size_of_##type[sizeof(type) == (bytes) ? 1 : -1]
#endif

/* What cdcr_connect and cdcr_driver_connect ask for: of which version this header is. */
#define CDCR_LAYOUT UINT64_C(0x96fbc992825fa1a7)

/* Bending sections of one robot. The longest published cable-driven arm has five. */
#define CDCR_SECTIONS_MAX 6

/* Scalars of a configuration: two bend-vector components for each section. */
#define CDCR_COORDINATES_MAX 12

/* Cables of one robot: three for each section. */
#define CDCR_CABLES_MAX 18

/* Points in one reference chunk: 0.64 s of a reference sampled at 5 ms, 9 kB. */
#define CDCR_CHUNK_POINTS_MAX 128

/* Points that the daemon buffers ahead: 32 full chunks, 20 s of a reference sampled at 5 ms. */
#define CDCR_REFERENCE_POINTS_MAX 4096

/* Largest time from the arrival of a reference point to the point [s], and longest reference: a day. */
#define CDCR_REFERENCE_AHEAD_S_MAX 86400

/* Obstacles known to the daemon at one time, and obstacles in one message. */
#define CDCR_OBSTACLES_MAX 64

/* Age of an obstacle that moves, at its arrival [ms]. Its place is predicted from its stamp on, so an old or
 * unset one would place it elsewhere. */
#define CDCR_OBSTACLE_AGE_MS_MAX 1000

/* Speed of an obstacle [m/s]: faster than anything beside a robot. */
#define CDCR_OBSTACLE_SPEED_M_S_MAX 100

/* Longest period of a daemon [ms], and so the longest time of one solve. */
#define CDCR_PERIOD_MS_MAX 100

/* Age of a request at its arrival [ms]: an older one waited while the daemon or its client was stopped. A client
 * waits as long for the answer. */
#define CDCR_REQUEST_AGE_MS_MAX 1000

/* Prediction steps N of the optimal control problem. */
#define CDCR_HORIZON_STEPS_MAX 50

/* Control blocks M ≤ N that the daemon optimises, limited by the plan size. */
#define CDCR_CONTROL_BLOCKS_MAX 50

/* Scalars of a plan: the rates of every section in every control block, 50 blocks of three sections, 25 of six.
 * It bounds the size of a telemetry record; longer horizons hold each block for several steps. */
#define CDCR_PLAN_MAX 300

/* Particles of the swarm. */
#define CDCR_SWARM_MAX 512

/* Iterations of the swarm in one cycle. */
#define CDCR_ITERATIONS_MAX 1000

/* Input events reported in one telemetry record: as many as one gather and its cycle can bring. */
#define CDCR_EVENTS_MAX 24

/* Bad cycles kept in full for clients that ask: 1 MB. */
#define CDCR_INCIDENTS_MAX 64

/* Time for which a first tip of a driver awaits bends or cables [ms]. After it, the driver measures the tip
 * alone. */
#define CDCR_BENDS_LATE_MS 100

/* A tip sensor beside bends or cables that has measured nothing for this long is silent [ms]: some frames of a
 * slow camera. */
#define CDCR_TIP_SENSOR_SILENT_MS 1000

/* A robot that was held by its motors is not measured farther from where its last command left it: a bend of a
 * section [rad]. Beyond, its encoders may have lost their zero, and a reset has to accept the pose. */
#define CDCR_POSE_DIFFERS_RAD 0.2

/* Bends this far beyond their limit are held, not a fault: the daemon commands the position where the robot is
 * measured, and its driver accepts it. The same tolerance applies between a first position and the measurement
 * [rad]. */
#define CDCR_BEND_TOLERANCE_RAD 0.05

/* Bytes of a text in a message (robot name, build), UTF-8, padded with zeros. */
#define CDCR_TEXT_BYTES 48

typedef enum CdcrChunkMode {
    CDCR_CHUNK_MODE_REPLACE = 0, /* replace */
    CDCR_CHUNK_MODE_APPEND = 1 /* append */
} CdcrChunkMode;

typedef enum CdcrConstraint {
    CDCR_CONSTRAINT_NONE = 0, /* none */
    CDCR_CONSTRAINT_CLEARANCE = 1, /* clearance */
    CDCR_CONSTRAINT_LIMIT = 2 /* limit */
} CdcrConstraint;

typedef enum CdcrCoordinates {
    CDCR_COORDINATES_BEND_VECTOR = 0, /* bend-vector */
    CDCR_COORDINATES_BEND_ANGLES = 1 /* bend-angles */
} CdcrCoordinates;

typedef enum CdcrEventKind {
    CDCR_EVENT_KIND_REFERENCE = 0, /* reference */
    CDCR_EVENT_KIND_OBSTACLES = 1, /* obstacles */
    CDCR_EVENT_KIND_MEASUREMENT = 2, /* measurement */
    CDCR_EVENT_KIND_REQUEST = 3 /* request */
} CdcrEventKind;

typedef enum CdcrInterface {
    CDCR_INTERFACE_NONE = 0, /* none */
    CDCR_INTERFACE_VELOCITY = 1, /* velocity */
    CDCR_INTERFACE_POSITION = 2 /* position */
} CdcrInterface;

typedef enum CdcrInterpolation {
    CDCR_INTERPOLATION_LINEAR = 0, /* linear */
    CDCR_INTERPOLATION_CUBIC = 1 /* cubic */
} CdcrInterpolation;

typedef enum CdcrLateCause {
    CDCR_LATE_CAUSE_NONE = 0, /* in time */
    CDCR_LATE_CAUSE_PLATFORM = 1, /* platform */
    CDCR_LATE_CAUSE_LOAD = 2, /* another task had the core */
    CDCR_LATE_CAUSE_PAGE_FAULT = 3, /* page fault */
    CDCR_LATE_CAUSE_STALL = 4, /* stall of the processor */
    CDCR_LATE_CAUSE_COMPUTE = 5 /* compute */
} CdcrLateCause;

typedef enum CdcrLeaseState {
    CDCR_LEASE_STATE_FREE = 0, /* free */
    CDCR_LEASE_STATE_HELD = 1, /* held */
    CDCR_LEASE_STATE_EXPIRED = 2 /* expired */
} CdcrLeaseState;

typedef enum CdcrMeasurementKind {
    CDCR_MEASUREMENT_KIND_NONE = 0, /* none */
    CDCR_MEASUREMENT_KIND_CONFIGURATION = 1, /* configuration */
    CDCR_MEASUREMENT_KIND_TIP_POSE = 2, /* tip pose */
    CDCR_MEASUREMENT_KIND_CABLE_LENGTHS = 3 /* cable lengths */
} CdcrMeasurementKind;

typedef enum CdcrMeasurementState {
    CDCR_MEASUREMENT_STATE_NONE = 0, /* none */
    CDCR_MEASUREMENT_STATE_USED = 1, /* used */
    CDCR_MEASUREMENT_STATE_REPEATED = 2, /* repeated */
    CDCR_MEASUREMENT_STATE_IMPLAUSIBLE = 3 /* implausible */
} CdcrMeasurementState;

typedef enum CdcrMode {
    CDCR_MODE_STARTING = 0, /* starting */
    CDCR_MODE_HOLDING = 1, /* holding */
    CDCR_MODE_TRACKING = 2, /* tracking */
    CDCR_MODE_HOMING = 3, /* homing */
    CDCR_MODE_STOPPED = 4, /* stopped */
    CDCR_MODE_FAULTED = 5 /* faulted */
} CdcrMode;

typedef enum CdcrObstacleAction {
    CDCR_OBSTACLE_ACTION_UPSERT = 0, /* upsert */
    CDCR_OBSTACLE_ACTION_REMOVE = 1, /* remove */
    CDCR_OBSTACLE_ACTION_CLEAR = 2 /* clear */
} CdcrObstacleAction;

typedef enum CdcrObstacleShape {
    CDCR_OBSTACLE_SHAPE_SPHERE = 0, /* sphere */
    CDCR_OBSTACLE_SHAPE_CAPSULE = 1 /* capsule */
} CdcrObstacleShape;

typedef enum CdcrOrientationKind {
    CDCR_ORIENTATION_KIND_NONE = 0, /* none */
    CDCR_ORIENTATION_KIND_AXIS = 1, /* tip axis */
    CDCR_ORIENTATION_KIND_FULL = 2, /* full orientation */
    CDCR_ORIENTATION_KIND_PREFERRED = 3 /* preferred tip axis */
} CdcrOrientationKind;

typedef enum CdcrOutcome {
    CDCR_OUTCOME_ACCEPTED = 0, /* accepted */
    CDCR_OUTCOME_NOT_FINITE = 1, /* a value is not a finite number */
    CDCR_OUTCOME_IN_THE_PAST = 2, /* a time is in the past */
    CDCR_OUTCOME_OUT_OF_REACH = 3, /* a position is outside the reachable ball */
    CDCR_OUTCOME_TIME_NOT_INCREASING = 4, /* times do not increase */
    CDCR_OUTCOME_NO_LEASE = 5, /* the sender does not hold the reference lease */
    CDCR_OUTCOME_SEQUENCE_GAP = 6, /* an earlier chunk is missing */
    CDCR_OUTCOME_BUFFER_FULL = 7, /* the buffer is full */
    CDCR_OUTCOME_COUNT_OUT_OF_RANGE = 8, /* a count is out of range */
    CDCR_OUTCOME_UNKNOWN_CODE = 9, /* a code is unknown */
    CDCR_OUTCOME_NOT_UNIT = 10, /* an orientation is not of unit length */
    CDCR_OUTCOME_UNSUPPORTED = 11, /* this daemon does not support it */
    CDCR_OUTCOME_LEASE_HELD = 12, /* another client holds the reference lease */
    CDCR_OUTCOME_NO_REFERENCE = 13, /* there is no reference ahead */
    CDCR_OUTCOME_WRONG_MODE = 14, /* the mode does not allow it */
    CDCR_OUTCOME_CAUSE_STANDS = 15, /* the cause of the fault persists */
    CDCR_OUTCOME_OUT_OF_RANGE = 16, /* a value is out of range */
    CDCR_OUTCOME_BUSY = 17, /* too many requests at once */
    CDCR_OUTCOME_STALE = 18, /* the message is older than one already seen */
    CDCR_OUTCOME_WRONG_ROBOT = 19, /* the message belongs to another robot */
    CDCR_OUTCOME_OVERRULED = 20, /* the robot was stopped after this request */
    CDCR_OUTCOME_ENDING = 21, /* the daemon is shutting down */
    CDCR_OUTCOME_WRONG_INTERFACE = 22, /* the driver's interface differs from the configuration (link.interface) */
    CDCR_OUTCOME_OTHER_DRIVER = 23, /* another driver controls the robot */
    CDCR_OUTCOME_WAITS = 24, /* the robot waits: the inputs are stale, a source of obstacles is silent (obstacles.source_timeout_ms), or the commanded position moves to the robot after a reset */
    CDCR_OUTCOME_TOO_FAR = 25, /* the reference is farther from the tip than motion.approach_distance_m */
    CDCR_OUTCOME_CABLE_MEAN = 26, /* the mean length of a section's cables is not that of its backbone */
    CDCR_OUTCOME_IN_THE_FUTURE = 27, /* a time is in the future */
    CDCR_OUTCOME_POSE_DIFFERS = 28, /* the robot is measured far from where its last command left it */
    CDCR_OUTCOME_BEYOND_TURN = 29, /* a bend is larger than a full turn */
    CDCR_OUTCOME_TIP_ELSEWHERE = 30 /* the tip is measured far from where the bends place it */
} CdcrOutcome;

typedef enum CdcrReason {
    CDCR_REASON_START = 0, /* started */
    CDCR_REASON_REQUEST = 1, /* requested */
    CDCR_REASON_REFERENCE_ENDED = 2, /* the reference ended */
    CDCR_REASON_LEASE_EXPIRED = 3, /* the reference lease expired */
    CDCR_REASON_HOME_REACHED = 4, /* home is reached */
    CDCR_REASON_DEADLINE_MISSES = 5, /* too many deadline misses (cycle.miss_limit) */
    CDCR_REASON_MEASUREMENT_LOST = 6, /* the measurement is lost */
    CDCR_REASON_NON_FINITE = 7, /* a value was not finite */
    CDCR_REASON_LIMIT_BROKEN = 8, /* a limit is exceeded */
    CDCR_REASON_CLEARANCE_BROKEN = 9, /* the clearance is too small (safety.clearance_fault_m) */
    CDCR_REASON_SHUTDOWN = 10, /* the daemon is shutting down */
    CDCR_REASON_LEASE_RELEASED = 11, /* the reference lease was released */
    CDCR_REASON_MEASUREMENT_JUMP = 12, /* the measurement jumps */
    CDCR_REASON_MEASUREMENT_FROZEN = 13, /* the measurement is frozen */
    CDCR_REASON_FOLLOWING_ERROR = 14, /* the following error is too large (safety.following_fault_rad) */
    CDCR_REASON_INPUTS_STALE = 15, /* the inputs are stale */
    CDCR_REASON_SUSPENDED = 16, /* the machine was suspended */
    CDCR_REASON_OBSTACLE_SOURCE_SILENT = 17, /* the source of the obstacles is silent (obstacles.source_timeout_ms) */
    CDCR_REASON_REFERENCE_TOO_FAR = 18, /* the reference was replaced by one farther from the tip than motion.approach_distance_m */
    CDCR_REASON_COMMON_MODE = 19, /* the cables of a section went slack, or one broke (safety.cable_common_m) */
    CDCR_REASON_STOPPED_BEFORE = 20, /* it was stopped or faulted before the daemon started; use cdcrctl reset */
    CDCR_REASON_POSE_DIFFERS = 21, /* the robot is measured far from where its last command left it */
    CDCR_REASON_OBSTACLES_LOST = 22, /* the obstacles of the previous daemon are lost; add them again, then use cdcrctl reset */
    CDCR_REASON_TIP_ELSEWHERE = 23 /* the tip is measured far from where the bends place it */
} CdcrReason;

typedef enum CdcrReferenceState {
    CDCR_REFERENCE_STATE_NONE = 0, /* no reference */
    CDCR_REFERENCE_STATE_BEFORE = 1, /* before the start */
    CDCR_REFERENCE_STATE_INSIDE = 2, /* inside */
    CDCR_REFERENCE_STATE_ENDED = 3 /* ended */
} CdcrReferenceState;

typedef enum CdcrRequestKind {
    CDCR_REQUEST_KIND_TRACK = 1, /* track */
    CDCR_REQUEST_KIND_HOLD = 2, /* hold */
    CDCR_REQUEST_KIND_STOP = 3, /* stop */
    CDCR_REQUEST_KIND_RESET = 4, /* reset */
    CDCR_REQUEST_KIND_HOME = 5, /* home */
    CDCR_REQUEST_KIND_ACQUIRE_LEASE = 6, /* acquire the lease */
    CDCR_REQUEST_KIND_RELEASE_LEASE = 7, /* release the lease */
    CDCR_REQUEST_KIND_SETTINGS = 8, /* change settings */
    CDCR_REQUEST_KIND_RESET_STATISTICS = 9, /* reset the statistics */
    CDCR_REQUEST_KIND_RESET_ACCEPTING_POSE = 10 /* reset, accepting the measured pose */
} CdcrRequestKind;

typedef enum CdcrRobotLink {
    CDCR_ROBOT_LINK_SIMULATED = 0, /* simulated */
    CDCR_ROBOT_LINK_DRIVER = 1 /* driver */
} CdcrRobotLink;

typedef enum CdcrSolverKind {
    CDCR_SOLVER_KIND_KPSO = 0, /* kpso */
    CDCR_SOLVER_KIND_GAUSS_NEWTON = 1, /* gauss-newton */
    CDCR_SOLVER_KIND_KPSO_REFINED = 2 /* kpso-refined */
} CdcrSolverKind;

typedef enum CdcrSolverStatus {
    CDCR_SOLVER_STATUS_IDLE = 0, /* idle */
    CDCR_SOLVER_STATUS_CONVERGED = 1, /* converged */
    CDCR_SOLVER_STATUS_BUDGET_SPENT = 2, /* budget spent */
    CDCR_SOLVER_STATUS_ITERATIONS_SPENT = 3, /* iterations spent */
    CDCR_SOLVER_STATUS_CONSTRAINT_VIOLATED = 4, /* constraint violated */
    CDCR_SOLVER_STATUS_NON_FINITE = 5 /* not finite */
} CdcrSolverStatus;

typedef enum CdcrTipCause {
    CDCR_TIP_CAUSE_NONE = 0, /* none */
    CDCR_TIP_CAUSE_FAR = 1, /* it is too far from where the bends place it */
    CDCR_TIP_CAUSE_WAS_FAR = 2, /* it was too far from where the bends place it, a short time ago */
    CDCR_TIP_CAUSE_JUMPS = 3, /* it moved faster than the robot can */
    CDCR_TIP_CAUSE_JUMPED = 4, /* it moved faster than the robot can many times in a row */
    CDCR_TIP_CAUSE_FROZEN = 5 /* it had the same bits while the robot moved */
} CdcrTipCause;

typedef enum CdcrVelocityRule {
    CDCR_VELOCITY_RULE_INERTIA = 0, /* inertia */
    CDCR_VELOCITY_RULE_CONSTRICTION = 1, /* constriction */
    CDCR_VELOCITY_RULE_VERBATIM = 2 /* verbatim */
} CdcrVelocityRule;

typedef enum CdcrWinner {
    CDCR_WINNER_WARM_START = 0, /* warm start */
    CDCR_WINNER_PREVIOUS = 1, /* previous plan */
    CDCR_WINNER_ZERO = 2, /* zero */
    CDCR_WINNER_LEAST_SQUARES = 3, /* least squares */
    CDCR_WINNER_SWARM = 4, /* swarm */
    CDCR_WINNER_EIGENVECTOR = 5 /* eigenvector */
} CdcrWinner;

/* Bits of guard_flags. */
#define CDCR_GUARD_FLAGS_RATE UINT32_C(1)
#define CDCR_GUARD_FLAGS_BEND UINT32_C(2)
#define CDCR_GUARD_FLAGS_CABLE_SPEED UINT32_C(4)
#define CDCR_GUARD_FLAGS_NOT_FINITE UINT32_C(8)
#define CDCR_GUARD_FLAGS_CLEARANCE UINT32_C(16)
#define CDCR_GUARD_FLAGS_CABLE_STROKE UINT32_C(32)
#define CDCR_GUARD_FLAGS_ACCELERATION UINT32_C(64)
#define CDCR_GUARD_FLAGS_TIP_SPEED UINT32_C(128)
#define CDCR_GUARD_FLAGS_SELF_CONTACT UINT32_C(256)

/* Bits of realtime_missing. */
#define CDCR_REALTIME_MISSING_SCHED_FIFO UINT32_C(1)
#define CDCR_REALTIME_MISSING_CORE_PINNING UINT32_C(2)
#define CDCR_REALTIME_MISSING_LOCKED_MEMORY UINT32_C(4)
#define CDCR_REALTIME_MISSING_REAL_TIME UINT32_C(8)

/* Bits of timing_flags. */
#define CDCR_TIMING_FLAGS_LATE_START UINT32_C(1)
#define CDCR_TIMING_FLAGS_DEADLINE_MISS UINT32_C(2)
#define CDCR_TIMING_FLAGS_STALE_INPUTS UINT32_C(4)

/* cdcr.Header.v1, 24 bytes. */
typedef struct CdcrHeader {
    /* 0: Identity of the sender: drawn at random when a process connects, never 0. */
    uint64_t sender_id;
    /* 8: Number of this message among those of the sender on this service: 1, 2, 3, … */
    uint64_t sequence;
    /* 16: Time of sending [ns, CLOCK_MONOTONIC]. */
    uint64_t sent_ns;
} CdcrHeader;
CDCR_ASSERT_SIZE(CdcrHeader, 24);

/* cdcr.ReferencePoint.v1, 72 bytes. */
typedef struct CdcrReferencePoint {
    /* 0: When the tip shall be there [ns, CLOCK_MONOTONIC]. */
    uint64_t time_ns;
    /* 8: Tip position in the base frame [m]. */
    double position_m[3];
    /* 32: Meaning by orientation_kind: unused; tip axis, or preferred one, as unit vector (x, y, z, 0); or unit
     * quaternion (x, y, z, w) base → tip. */
    double orientation[4];
    /* 64: CdcrOrientationKind. */
    uint32_t orientation_kind;
    /* 68: Zero. */
    uint32_t reserved;
} CdcrReferencePoint;
CDCR_ASSERT_SIZE(CdcrReferencePoint, 72);

/* cdcr.ReferenceChunk.v1, 9256 bytes. */
typedef struct CdcrReferenceChunk {
    /* 0: Sender (it must hold the reference lease), sequence, time. */
    CdcrHeader header;
    /* 24: CdcrChunkMode: append to the trajectory, or begin a new one. */
    uint32_t mode;
    /* 28: CdcrInterpolation between the points of this chunk. */
    uint32_t interpolation;
    /* 32: Points used, 1 ..= CHUNK_POINTS_MAX. */
    uint32_t count;
    /* 36: Zero. */
    uint32_t reserved;
    /* 40: used: 1 * count. The points; only the first count are read. */
    CdcrReferencePoint points[128];
} CdcrReferenceChunk;
CDCR_ASSERT_SIZE(CdcrReferenceChunk, 9256);

/* cdcr.Obstacle.v1, 104 bytes. */
typedef struct CdcrObstacle {
    /* 0: Identity chosen by the sender, unique among all senders; an upsert with a known id replaces. */
    uint32_t id;
    /* 4: CdcrObstacleShape. */
    uint32_t shape;
    /* 8: Centre of the sphere, or first end of the capsule's axis, in the base frame [m]. */
    double start_m[3];
    /* 32: Second end of the capsule's axis [m]; unused for a sphere. */
    double end_m[3];
    /* 56: Radius [m], ≥ 0. */
    double radius_m;
    /* 64: Velocity of the whole shape [m/s]: it is predicted to each release, and over the horizon, at constant
     * velocity. At most 100 m/s (OBSTACLE_SPEED_M_S_MAX). */
    double velocity_m_s[3];
    /* 88: When start_m and end_m held [ns, CLOCK_MONOTONIC]; at most 1 ms ahead of the daemon. An obstacle that
     * moves is refused as in the past if it is older than 1 s when it arrives (OBSTACLE_AGE_MS_MAX), as with 0. */
    uint64_t measured_ns;
    /* 96: How long it stays known after measured_ns [ns]; 0: until removed. An obstacle whose lifetime is over when
     * it arrives is refused as in the past, one that has left the range of positions by then as out of range. Where
     * the daemon watches the senders of obstacles (obstacles.source_timeout_ms), one does not expire before its
     * sender has sent something after that (header.sent_ns); in a telemetry record this is then 0. */
    uint64_t lifetime_ns;
} CdcrObstacle;
CDCR_ASSERT_SIZE(CdcrObstacle, 104);

/* cdcr.ObstacleUpdate.v1, 6688 bytes. */
typedef struct CdcrObstacleUpdate {
    /* 0: Sender, sequence, time. */
    CdcrHeader header;
    /* 24: CdcrObstacleAction: upsert, remove by id, clear all. */
    uint32_t action;
    /* 28: Obstacles used, 0 ..= OBSTACLES_MAX. */
    uint32_t count;
    /* 32: used: 1 * count. The obstacles; only the first count are read, and of a removal only their ids. */
    CdcrObstacle obstacles[64];
} CdcrObstacleUpdate;
CDCR_ASSERT_SIZE(CdcrObstacleUpdate, 6688);

/* cdcr.Measurement.v3, 360 bytes. */
typedef struct CdcrMeasurement {
    /* 0: Sender, sequence, time of sending. */
    CdcrHeader header;
    /* 24: When it was measured [ns, CLOCK_MONOTONIC]. */
    uint64_t measured_ns;
    /* 32: CdcrMeasurementKind: which of the fields below is meant. */
    uint32_t kind;
    /* 36: Sections of the robot it belongs to; must be the daemon's. */
    uint32_t sections;
    /* 40: CdcrInterface that the driver of the robot obeys; must be the daemon's link.interface. */
    uint32_t interface;
    /* 44: Zero. */
    uint32_t reserved;
    /* 48: Begin of the newest time in which velocity-controlled motors rested because their command had run out [ns,
     * CLOCK_MONOTONIC], along the commands: where the driver took the last one 2 ms after its release, 2 ms before
     * the time of its clock. The daemon compares it with the measured bends. */
    uint64_t rested_from_ns;
    /* 56: End of that time, or when this is sent if the motors still rest, likewise. 0: the driver does not state
     * it, or the motors have not rested since the first command. Ignored where the driver obeys positions, whose
     * motors make up for a rest. */
    uint64_t rested_until_ns;
    /* 64: used: 2 * sections; where kind is 1. Bend vector (u₁, v₁, u₂, v₂, …) [rad]. */
    double bend_rad[12];
    /* 160: where kind is 2. Tip position in the base frame [m]. */
    double tip_position_m[3];
    /* 184: where kind is 2. Tip orientation, quaternion (x, y, z, w) base → tip: finite. For recordings and
     * calibration: the daemon controls by the position alone. */
    double tip_orientation[4];
    /* 216: used: 3 * sections; where kind is 3. Cable lengths, section by section, three each [m]. */
    double cable_length_m[18];
} CdcrMeasurement;
CDCR_ASSERT_SIZE(CdcrMeasurement, 360);

/* cdcr.Command.v3, 560 bytes. */
typedef struct CdcrCommand {
    /* 0: The daemon, sequence, time of sending. */
    CdcrHeader header;
    /* 24: Sender of the measurements on which the commands act. 0: none has been accepted yet, or the robot is
     * simulated. A driver that sends measurements follows no command that acts on those of another one. */
    uint64_t driver_id;
    /* 32: Number of the cycle: its release was at cycle periods after the daemon's origin. */
    uint64_t cycle;
    /* 40: Release time of that cycle [ns, CLOCK_MONOTONIC]; the rates hold from here. */
    uint64_t release_ns;
    /* 48: When the move to bend_target_rad ends: one period after the release [ns, CLOCK_MONOTONIC]. */
    uint64_t target_ns;
    /* 56: Until when the speeds may be followed without a newer command [ns, CLOCK_MONOTONIC]. Then the driver stops
     * at once, or shrinks all speeds together by one factor, the fastest bend component by
     * motion.deceleration_rad_s2 or faster, and holds: the clearance guard has checked this way at its ends, and
     * within 1 mm between. A stop that is over earlier is not checked in time beside a moving obstacle. Cables that
     * stop one by one leave it. It counts from the release, so a command that is delayed on its way is not valid for
     * longer. */
    uint64_t valid_until_ns;
    /* 64: CdcrMode of the daemon. */
    uint32_t mode;
    /* 68: Sections of the robot. */
    uint32_t sections;
    /* 72: CdcrInterface: what the driver obeys, cable_length_m or cable_speed_m_s (or the bend vector and its rates,
     * where the driver computes its own cables). */
    uint32_t interface;
    /* 76: Zero. */
    uint32_t reserved;
    /* 80: used: 2 * sections. Bend-vector rates (u̇₁, v̇₁, …) [rad/s]. */
    double bend_rate_rad_s[12];
    /* 176: used: 2 * sections. Commanded bend vector at target_ns [rad]: that of the command before, moved on by the
     * rates. It begins at the measured one when control begins, and after a reset. */
    double bend_target_rad[12];
    /* 272: used: 3 * sections. Cable lengths at bend_target_rad, section by section, three each [m]. */
    double cable_length_m[18];
    /* 416: used: 3 * sections. Cable speeds that belong to bend_rate_rad_s [m/s]. */
    double cable_speed_m_s[18];
} CdcrCommand;
CDCR_ASSERT_SIZE(CdcrCommand, 560);

/* cdcr.SolverSettings.v2, 176 bytes. */
typedef struct CdcrSolverSettings {
    /* 0: CdcrSolverKind. */
    uint32_t solver;
    /* 4: CdcrCoordinates of the controls. */
    uint32_t coordinates;
    /* 8: Prediction steps N. */
    uint32_t horizon_steps;
    /* 12: Control blocks M, and at most N; 0: one per step. */
    uint32_t control_blocks;
    /* 16: Particles of the swarm. */
    uint32_t swarm_size;
    /* 20: Iterations of the swarm. */
    uint32_t swarm_iterations;
    /* 24: Iterations without improvement before the swarm is regenerated; 0: never. */
    uint32_t regenerate_after;
    /* 28: CdcrVelocityRule. */
    uint32_t velocity_rule;
    /* 32: Gauss-Newton steps. */
    uint32_t refinement_steps;
    /* 36: Zero. */
    uint32_t reserved;
    /* 40: Inertia weight w. */
    double inertia;
    /* 48: Coefficient c1 of Eq. 6, the weight of a particle's own best. */
    double cognitive;
    /* 56: Coefficient c2 of Eq. 6, the weight of the swarm's best. */
    double social;
    /* 64: Damping of the Gauss-Newton steps [m²]. */
    double damping;
    /* 72: 1/m². Weight of the squared position error in the cost (Eq. 5), per m². */
    double position_weight;
    /* 80: 1/rad². Weight of the squared orientation error, per rad². */
    double orientation_weight;
    /* 88: Orientation error without cost [rad]. */
    double orientation_tolerance_rad;
    /* 96: s²/rad². Weight of the squared rates, per (rad/s)². */
    double rate_weight;
    /* 104: s²/rad². Weight of the squared changes of rates, per (rad/s)². */
    double rate_change_weight;
    /* 112: Gain by which bends that the tip does not need return towards straight while it travels. */
    double posture_gain;
    /* 120: Factor on the error cost of the last step. */
    double terminal_weight;
    /* 128: Safe distance between body and obstacles [m]. */
    double safe_distance_m;
    /* 136: Penalty in the solver's cost for each step inside the safe distance. */
    double obstacle_step_penalty;
    /* 144: 1/m. Penalty in the solver's cost per m of depth inside the safe distance. */
    double obstacle_slope_penalty;
    /* 152: 1/m². Penalty in the solver's cost per m² of squared depth inside the safe distance. */
    double obstacle_square_penalty;
    /* 160: Time that a solve may take [ns]; 0: what is left of the period less the margin. */
    uint64_t budget_ns;
    /* 168: Seed of the swarm. */
    uint64_t seed;
} CdcrSolverSettings;
CDCR_ASSERT_SIZE(CdcrSolverSettings, 176);

/* cdcr.Request.v3, 208 bytes. */
typedef struct CdcrRequest {
    /* 0: Sender, sequence, time. A lease is bound to the sender's identity. */
    CdcrHeader header;
    /* 24: CdcrRequestKind. */
    uint32_t kind;
    /* 28: 1: yes, 0: no. With a reset: it is also granted where the robot is measured far from where its last
     * command left it; control begins where it is measured. 0 with every other request. */
    uint32_t accepts_pose;
    /* 32: Read by a settings request only. */
    CdcrSolverSettings settings;
} CdcrRequest;
CDCR_ASSERT_SIZE(CdcrRequest, 208);

/* cdcr.Response.v2, 80 bytes. */
typedef struct CdcrResponse {
    /* 0: The daemon, sequence, time. */
    CdcrHeader header;
    /* 24: header.sequence of the request. */
    uint64_t request_sequence;
    /* 32: Newest cycle when it was answered: the one that carried it out, or, for a lease or settings, the one
     * before it takes effect. */
    uint64_t cycle;
    /* 40: CdcrOutcome. */
    uint32_t outcome;
    /* 44: CdcrMode after the request. */
    uint32_t mode;
    /* 48: Holder of the reference lease after the request; 0: none. */
    uint64_t lease_holder;
    /* 56: How long the lease still runs [ns]. */
    uint64_t lease_left_ns;
    /* 64: With the outcome PoseDiffers: how far this section is measured from where the last command left it [rad].
     * Otherwise 0. */
    double pose_difference_rad;
    /* 72: Section with the largest such difference, 1 next to the base; otherwise 0. */
    uint32_t pose_section;
    /* 76: Zero. */
    uint32_t reserved;
} CdcrResponse;
CDCR_ASSERT_SIZE(CdcrResponse, 80);

/* cdcr.SectionDescription.v1, 48 bytes. */
typedef struct CdcrSectionDescription {
    /* 0: Length of the backbone [m]. */
    double length_m;
    /* 8: Distance of the cables from the backbone [m]. */
    double cable_radius_m;
    /* 16: Angle of the first cable [rad]. */
    double cable_offset_rad;
    /* 24: Largest bend [rad]. */
    double bend_max_rad;
    /* 32: Largest rate of each bend-vector component [rad/s]. */
    double rate_max_rad_s;
    /* 40: Radius of the body [m]. */
    double body_radius_m;
} CdcrSectionDescription;
CDCR_ASSERT_SIZE(CdcrSectionDescription, 48);

/* cdcr.RobotDescription.v3, 336 bytes. */
typedef struct CdcrRobotDescription {
    /* 0: Sections used, 1 ..= SECTIONS_MAX. */
    uint32_t sections;
    /* 4: Zero. */
    uint32_t reserved;
    /* 8: Fingerprint of all parameters, equal to that of the telemetry. */
    uint64_t fingerprint;
    /* 16: Largest speed of a cable [m/s]. */
    double cable_speed_max_m_s;
    /* 24: How far a cable can be pulled or paid out from its length at the straight robot [m]. */
    double cable_stroke_max_m;
    /* 32: Largest commanded speed of the end of any section, seen from the base [m/s]; 0: no limit. */
    double tip_speed_max_m_s;
    /* 40: Overlap of two parts of the body, by their body_radius_m, that a command may lead to; as much as the body
     * is thick: no check [m]. */
    double self_overlap_max_m;
    /* 48: used: 1 * sections. The sections, base first. */
    CdcrSectionDescription section[6];
} CdcrRobotDescription;
CDCR_ASSERT_SIZE(CdcrRobotDescription, 336);

/* cdcr.LatencySummary.v1, 48 bytes. */
typedef struct CdcrLatencySummary {
    /* 0: Values counted. */
    uint64_t count;
    /* 8: ns. Smallest of the values. */
    uint64_t min_ns;
    /* 16: ns. Median. */
    uint64_t p50_ns;
    /* 24: ns. 99th percentile. */
    uint64_t p99_ns;
    /* 32: ns. 99.9th percentile. */
    uint64_t p999_ns;
    /* 40: ns. Largest of the values. */
    uint64_t max_ns;
} CdcrLatencySummary;
CDCR_ASSERT_SIZE(CdcrLatencySummary, 48);

/* cdcr.Statistics.v5, 456 bytes. */
typedef struct CdcrStatistics {
    /* 0: Cycles that ran. */
    uint64_t cycles;
    /* 8: Cycles that started later than the late-start limit. */
    uint64_t late_starts;
    /* 16: Cycles whose command was handed over after the deadline. */
    uint64_t deadline_misses;
    /* 24: Releases that passed without a cycle. */
    uint64_t skipped_periods;
    /* 32: Most releases in a row that were missed or skipped. */
    uint64_t longest_streak;
    /* 40: Solves that the time budget ended. */
    uint64_t budget_hits;
    /* 48: Cycles that used the inputs of the cycle before again, because no gather came between. */
    uint64_t stale_inputs;
    /* 56: Cycles that solved and whose command limits or guard changed. */
    uint64_t limited_cycles;
    /* 64: Cycles that followed a reference. */
    uint64_t tracked_cycles;
    /* 72: Distances of tip and reference in them, as estimated, added up [nm]. */
    uint64_t tip_error_sum_nm;
    /* 80: The largest of them [nm]. */
    uint64_t tip_error_max_nm;
    /* 88: Cycles of a robot behind a driver that saw no newer measurement than the cycle before. */
    uint64_t stale_measurements;
    /* 96: Tips that were not used: refused at their arrival, or measured beside bends or cables and implausible:
     * they jumped, were frozen or were more than a ninth of the robot's length, or 0.1 m, from where the bends place
     * them. */
    uint64_t tips_not_used;
    /* 104: Records, with their part of the statistics, and events that were lost inside the daemon because a queue
     * was full. */
    uint64_t dropped_records;
    /* 112: Longest time between two clock reads in a cycle [ns], from its start to the end of the solve, work
     * included. Far longer than a quantum of work: the processor stood still, though no deadline was missed. */
    uint64_t longest_gap_ns;
    /* 120: one for each CdcrLateCause from 1 on. Cycles that started late, missed their deadline or skipped periods,
     * by their LateCause; index = code, so the first is 0. A punctual cycle whose skipped releases the late cycle
     * before it took is not counted again. */
    uint64_t causes[6];
    /* 168: Release to start. */
    CdcrLatencySummary wake;
    /* 216: Taking in what clients and driver sent, shortly before the release. */
    CdcrLatencySummary gather;
    /* 264: Start to hand-over of the command. */
    CdcrLatencySummary compute;
    /* 312: The solver, part of compute. */
    CdcrLatencySummary solve;
    /* 360: Release to hand-over of the command. */
    CdcrLatencySummary response;
    /* 408: Hand-over of the command to its being in the readers' queues. */
    CdcrLatencySummary publish;
} CdcrStatistics;
CDCR_ASSERT_SIZE(CdcrStatistics, 456);

/* cdcr.Status.v18, 2328 bytes. */
typedef struct CdcrStatus {
    /* 0: The daemon, sequence, time. */
    CdcrHeader header;
    /* 24: text. Name of the robot, as in the service names. */
    char robot_name[48];
    /* 72: text. Version of the daemon. */
    char build[48];
    /* 120: Process id. */
    uint32_t process_id;
    /* 124: CdcrMode. */
    uint32_t mode;
    /* 128: CdcrReason why this mode. */
    uint32_t reason;
    /* 132: bits CDCR_REALTIME_MISSING_…. Cdcrrealtime bits that are **missing**; 0: real time. */
    uint32_t realtime_missing;
    /* 136: CdcrRobotLink: simulated or driver. */
    uint32_t link;
    /* 140: largest value: none. Core that the real-time threads are pinned to; u32::MAX: none. */
    uint32_t core;
    /* 144: Origin of the time grid [ns, CLOCK_MONOTONIC]: cycle k is released at origin + k · period. */
    uint64_t origin_ns;
    /* 152: Period T [ns]. */
    uint64_t period_ns;
    /* 160: Deadline D [ns] after the release. */
    uint64_t deadline_ns;
    /* 168: Cycles run since the start, whatever was reset. The cycle numbers of answers and telemetry count the
     * skipped releases, too: at t, they are at (t - origin_ns) / period_ns. */
    uint64_t cycles;
    /* 176: Cycles that started later than the late-start limit. */
    uint64_t late_starts;
    /* 184: Cycles whose command was handed over after the deadline. */
    uint64_t deadline_misses;
    /* 192: Releases that passed before the cycle could start. */
    uint64_t skipped_periods;
    /* 200: Solves that the time budget ended. */
    uint64_t budget_hits;
    /* 208: Records, with their part of the statistics, and events that were lost inside the daemon because a queue
     * was full. */
    uint64_t dropped_records;
    /* 216: Faults since the start. */
    uint64_t faults;
    /* 224: Cycles in which the clearance guard changed the command. */
    uint64_t clearance_guarded;
    /* 232: Obstacle updates that were refused, for any reason. */
    uint64_t obstacles_refused;
    /* 240: one for each CdcrOutcome from 0 on. Input messages by their Outcome, index = code; 0 counts the accepted
     * ones. */
    uint64_t outcomes[31];
    /* 488: When since_reset began [ns, CLOCK_MONOTONIC]: the start, or the last reset. */
    uint64_t statistics_since_ns;
    /* 496: Statistics since the start, or since a client reset them. */
    CdcrStatistics since_reset;
    /* 952: Statistics of the last minute, in steps of ten seconds: 50 to 60 s. */
    CdcrStatistics last_minute;
    /* 1408: Holder of the reference lease; 0: nobody. */
    uint64_t lease_holder;
    /* 1416: Last time of the buffered reference [ns, CLOCK_MONOTONIC]; 0: none. */
    uint64_t reference_end_ns;
    /* 1424: Points of the buffered reference that are still ahead. */
    uint32_t reference_points;
    /* 1428: Obstacles of the newest cycle. */
    uint32_t obstacle_count;
    /* 1432: Smallest clearance in the newest cycle [m]: the smaller of that by the estimate, as in Telemetry, and
     * that by the measured bends. Infinite without obstacles. */
    double clearance_m;
    /* 1440: How far the tip may be from where the bends place it [m], as in Telemetry: in clearance_m the body is
     * thicker by this distance. */
    double tip_margin_m;
    /* 1448: The robot of the daemon's configuration. */
    CdcrRobotDescription robot;
    /* 1784: The solver's settings. */
    CdcrSolverSettings settings;
    /* 1960: How often the leaky bucket of deadline misses became full and the robot went on: it is simulated, and
     * the configuration sets no cycle.miss_limit. */
    uint64_t misses_tolerated;
    /* 1968: Position of the tip in the newest cycle [m], as in Telemetry. */
    double tip_position_m[3];
    /* 1992: Distance of tip and reference in the newest cycle [m]; NaN without a reference. */
    double position_error_m;
    /* 2000: Position of the reference in the newest cycle [m]; NaN without one. */
    double reference_position_m[3];
    /* 2024: Distance of tip and reference when a sensor of the tip measured it last [m]: with the noise of the
     * sensor and the error of the model. NaN without a reference or such a sensor. */
    double measured_error_m;
    /* 2032: used: 1 * robot.sections. Following error of each section in the newest cycle [rad], as in Telemetry. */
    double following_error_rad[6];
    /* 2080: used: 3 * robot.sections. Following error of each cable in the newest cycle [m], as in Telemetry. */
    double following_error_m[18];
    /* 2224: Cycles in which the following error was above the warning. */
    uint64_t following_warnings;
    /* 2232: CdcrInterface. */
    uint32_t interface;
    /* 2236: CdcrReason why a reset is refused in the newest cycle, in the modes stopped and faulted; Start: it is
     * not. */
    uint32_t reset_refused_by;
    /* 2240: Smallest safe_distance_m that a client may ask for [m]: that of the configuration. */
    double safe_distance_min_m;
    /* 2248: A sender of obstacles with a lifetime that is not heard for this long is silent [ns]; 0: no sender is
     * watched. */
    uint64_t obstacle_source_timeout_ns;
    /* 2256: The one of them that has been silent for the longest time, by its header.sender_id: its obstacles stay;
     * 0: none is silent. */
    uint64_t silent_obstacle_source;
    /* 2264: Begin of its silence [ns, CLOCK_MONOTONIC]: when its last update was taken, later by the time in which
     * the daemon stood still. */
    uint64_t silent_since_ns;
    /* 2272: s²/rad². SolverSettings has this rate_weight unless a client sets another: it depends on the robot. */
    double rate_weight_auto;
    /* 2280: When the tip was measured last beside bends or cables [ns, CLOCK_MONOTONIC]; 0: it was not. */
    uint64_t tip_measured_ns;
    /* 2288: Measurements of the tip that were refused since the start, for any reason. */
    uint64_t tips_refused;
    /* 2296: Distance of the measured tip from where the newest refused first bends placed it [m], in whole
     * millimetres; after them, from where the measured bends place it, where it is so far that a reset is refused;
     * 0: nothing is refused for it. */
    double tip_contradiction_m;
    /* 2304: CdcrOutcome. Outcome of the newest of them; accepted: none was refused since a tip was accepted. */
    uint32_t tip_refused_by;
    /* 2308: 1: yes, 0: no. A tip sensor beside the driver is configured (link.tip_sensor). */
    uint32_t has_tip_sensor;
    /* 2312: A clearance below this is a fault [m] (safety.clearance_fault_m). */
    double clearance_fault_m;
    /* 2320: CdcrTipCause why the newest tip measured beside bends or cables is not used, as in Telemetry. */
    uint32_t tip_cause;
    /* 2324: 1: yes, 0: no. The driver has measured only the tip: also a tip sensor beside it for which
     * link.tip_sensor is not set. */
    uint32_t driver_measures_tip_only;
} CdcrStatus;
CDCR_ASSERT_SIZE(CdcrStatus, 2328);

/* cdcr.InputEvent.v2, 40 bytes. */
typedef struct CdcrInputEvent {
    /* 0: header.sender_id of the message. */
    uint64_t sender_id;
    /* 8: header.sequence of the message. */
    uint64_t sequence;
    /* 16: The daemon's clock when it evaluated the message; of a request that a cycle decided, that cycle's
     * handed_over_ns [ns, CLOCK_MONOTONIC]. */
    uint64_t evaluated_ns;
    /* 24: CdcrEventKind. */
    uint32_t kind;
    /* 28: CdcrOutcome. */
    uint32_t outcome;
    /* 32: Detail of the outcome: index of the point or obstacle; for a request its CdcrRequestKind, with
     * accepts_pose ResetAcceptingPose; for an accepted obstacle update how many obstacles are known after it; for
     * first bends that a tip contradicts, its distance in mm. */
    uint32_t detail;
    /* 36: It took effect this many gathers before the record's gather: 0, unless more happened at once than one
     * record can report. */
    uint32_t gathers_ago;
} CdcrInputEvent;
CDCR_ASSERT_SIZE(CdcrInputEvent, 40);

/* cdcr.ReferenceSample.v1, 64 bytes. */
typedef struct CdcrReferenceSample {
    /* 0: Position in the base frame [m]. */
    double position_m[3];
    /* 24: As in ReferencePoint. */
    double orientation[4];
    /* 56: CdcrOrientationKind. */
    uint32_t orientation_kind;
    /* 60: CdcrReferenceState. */
    uint32_t state;
} CdcrReferenceSample;
CDCR_ASSERT_SIZE(CdcrReferenceSample, 64);

/* cdcr.Approach.v1, 96 bytes. */
typedef struct CdcrApproach {
    /* 0: Release at which it began [ns]. */
    uint64_t begin_ns;
    /* 8: How long the distance takes [ns]. */
    uint64_t duration_ns;
    /* 16: How long joining the motion takes [ns]. */
    uint64_t joining_ns;
    /* 24: Tip minus reference at the beginning [m]. */
    double offset_m[3];
    /* 48: Velocity of what was followed before, minus that of the reference, at the beginning [m/s]. */
    double velocity_m_s[3];
    /* 72: Rotation from the reference's orientation to the tip's at the beginning, axis times angle [rad]. */
    double turn_rad[3];
} CdcrApproach;
CDCR_ASSERT_SIZE(CdcrApproach, 96);

/* cdcr.SolverReport.v1, 72 bytes. */
typedef struct CdcrSolverReport {
    /* 0: Cost of the solution, in the scale of the weights. */
    double cost;
    /* 8: Cost of the warm start. */
    double warm_cost;
    /* 16: Norm of the projected gradient at the solution. */
    double gradient_norm;
    /* 24: How far the solution breaks its worst constraint: [m] of clearance, or parts of a limit. */
    double violation;
    /* 32: Seed of this cycle's swarm: a function of settings.seed and the cycle. */
    uint64_t seed;
    /* 40: Cost evaluations. */
    uint32_t evaluations;
    /* 44: Budget checks that were passed. A replay with a budget of this many checks does the same work, whatever
     * its clock says. */
    uint32_t quanta;
    /* 48: Swarm iterations. */
    uint32_t iterations;
    /* 52: Gauss-Newton steps that were accepted. */
    uint32_t refinements;
    /* 56: CdcrSolverStatus. */
    uint32_t status;
    /* 60: CdcrWinner: which candidate the solution descends from. */
    uint32_t winner;
    /* 64: CdcrConstraint: which constraint the solution breaks. */
    uint32_t violated;
    /* 68: 1: yes, 0: no. 1 when the budget ended the solve, whatever the status. */
    uint32_t budget_spent;
} CdcrSolverReport;
CDCR_ASSERT_SIZE(CdcrSolverReport, 72);

/* cdcr.SchedulingReport.v1, 40 bytes. */
typedef struct CdcrSchedulingReport {
    /* 0: Time that the thread was ready to run and another had the core [ns]. */
    uint64_t run_delay_ns;
    /* 8: Time that it ran [ns]. */
    uint64_t on_core_ns;
    /* 16: Longest time between two clock reads [ns], from the start of the cycle to the end of the solve, work
     * included. Far longer than a quantum of work (a few µs): the processor stood still. */
    uint64_t longest_gap_ns;
    /* 24: Page faults, minor and major, since they were last read: in each late cycle, while there are some, and in
     * one of 16 others. */
    uint32_t page_faults;
    /* 28: Times that it lost the core other than by its sleep. */
    uint32_t switches;
    /* 32: CdcrLateCause: what made the cycle late. */
    uint32_t late_cause;
    /* 36: 1: yes, 0: no. 1 when the numbers above could be read. */
    uint32_t known;
} CdcrSchedulingReport;
CDCR_ASSERT_SIZE(CdcrSchedulingReport, 40);

/* cdcr.Telemetry.v15, 15632 bytes. */
typedef struct CdcrTelemetry {
    /* 0: The daemon, number of the record, time of publication. */
    CdcrHeader header;
    /* 24: Number of the cycle on the grid: release = origin + cycle · period. */
    uint64_t cycle;
    /* 32: Release time r of this cycle [ns, CLOCK_MONOTONIC]: what was measured, predicted and commanded refers to
     * it. */
    uint64_t release_ns;
    /* 40: The release that the thread slept for [ns]. Earlier than release_ns when it slept through whole periods;
     * lateness counts from here, so a stall cannot hide behind the newest release. */
    uint64_t due_ns;
    /* 48: The cycle started s [ns]. */
    uint64_t start_ns;
    /* 56: The solver began [ns]. */
    uint64_t solve_start_ns;
    /* 64: The solver ended [ns]. */
    uint64_t solve_end_ns;
    /* 72: The command was handed over p [ns]. */
    uint64_t handed_over_ns;
    /* 80: Period T [ns]. */
    uint64_t period_ns;
    /* 88: Time since the release of the previous cycle that ran [ns]: a multiple of the period. */
    uint64_t elapsed_ns;
    /* 96: Periods skipped between the previous cycle and this one. */
    uint32_t skipped_periods;
    /* 100: bits CDCR_TIMING_FLAGS_…. Cdcrtiming bits: late start, deadline miss, stale inputs. */
    uint32_t timing_flags;
    /* 104: Deadline misses since the start. */
    uint64_t deadline_misses_total;
    /* 112: Skipped periods since the start. */
    uint64_t skipped_periods_total;
    /* 120: What the system did to the cycle thread, and what made the cycle late. */
    CdcrSchedulingReport scheduling;
    /* 160: CdcrMode in which the command was made. */
    uint32_t mode;
    /* 164: CdcrReason why this mode. */
    uint32_t reason;
    /* 168: Level of the leaky bucket of deadline misses. */
    uint32_t miss_bucket;
    /* 172: Events of this record, 0 ..= EVENTS_MAX. */
    uint32_t event_count;
    /* 176: Number of the gather whose inputs the cycle used. */
    uint64_t gather;
    /* 184: The clock of that gather [ns, CLOCK_MONOTONIC]. */
    uint64_t gather_ns;
    /* 192: used: 1 * event_count. What the daemon took in since the last record; the first event_count are used. */
    CdcrInputEvent events[24];
    /* 1152: The measurement as used, header zero; kind 0 when there was none. The simulated robot measures its own
     * configuration. */
    CdcrMeasurement measurement;
    /* 1512: used: 2 * command.sections. Estimated bend vector that the commands up to this release lead to [rad]:
     * what the next one is planned from. Of motors without lag and delay it is the one at the release. */
    double bend_rad[12];
    /* 1608: used: 2 * command.sections. Rates of the previous command [rad/s]; zero if the last one sent has run
     * out. */
    double previous_rate_rad_s[12];
    /* 1704: The solver's settings in this cycle. */
    CdcrSolverSettings settings;
    /* 1880: The robot of the daemon's configuration. */
    CdcrRobotDescription robot;
    /* 2216: First cycle of the reference window: the samples reach from its release past the horizon, by up to 60
     * periods (60 at 5 ms). */
    uint64_t window_first_cycle;
    /* 2224: How fast rates shrink when holding or stopping [rad/s²]. */
    double deceleration_rad_s2;
    /* 2232: Rate of the fastest component on the way home [rad/s]. */
    double home_rate_rad_s;
    /* 2240: Deadline after the release [ns]. */
    uint64_t deadline_ns;
    /* 2248: A start later than this after the release it was due at is a late start [ns]. */
    uint64_t late_start_ns;
    /* 2256: A measurement older than this is lost [ns]. */
    uint64_t measurement_timeout_ns;
    /* 2264: A clearance below this is a fault [m]. */
    double clearance_fault_m;
    /* 2272: How far a measurement may jump [rad]. */
    double measurement_jump_rad;
    /* 2280: How far the robot may be commanded while the measurement stands still [rad]. */
    double measurement_frozen_rad;
    /* 2288: This many consecutive jumps are a fault. */
    uint32_t measurement_jump_limit;
    /* 2292: CdcrMeasurementState. */
    uint32_t measurement_state;
    /* 2296: Level at which the leaky bucket stops the robot; 0: it does not. */
    uint32_t miss_limit;
    /* 2300: CdcrLeaseState. */
    uint32_t lease_state;
    /* 2304: Scalars of warm_plan and plan that are used; 0: the solver did not run. */
    uint32_t plan_length;
    /* 2308: Obstacles of this cycle, 0 ..= OBSTACLES_MAX. */
    uint32_t obstacle_count;
    /* 2312: used: 1 * obstacle_count. The obstacles as used, in this order, where they are at the release (plan and
     * guard look at them reference_lead_ns later): measured_ns is the release, lifetime_ns what is left of their
     * lifetime then, 0: until removed. The first obstacle_count are used. */
    CdcrObstacle obstacles[64];
    /* 8968: used: 1 * plan_length. The plan that the solver started from [rad/s], block by block. */
    double warm_plan[300];
    /* 11368: used: 1 * plan_length. The solution [rad/s], block by block. */
    double plan[300];
    /* 13768: What the solver did. */
    CdcrSolverReport report;
    /* 13840: Reference at the release. */
    CdcrReferenceSample reference;
    /* 13904: The way to it that the plan follows. */
    CdcrApproach approach;
    /* 14000: used: 2 * command.sections. Bend vector at the release [rad]: behind bend_rad by the lag of the motors
     * behind their commands. */
    double present_rad[12];
    /* 14096: The tip as it was measured beside bends or cables [m]; zero when it was not. */
    double tip_measured_m[3];
    /* 14120: When the tip of tip_measured_m was measured [ns, CLOCK_MONOTONIC]. */
    uint64_t tip_measured_ns;
    /* 14128: Offset of the measured tip from where the bends place it, smoothed [m]. The plan's reference is moved
     * back by it. */
    double tip_offset_m[3];
    /* 14152: Distance that the tip may have from where the bends place it [m]: the length of tip_offset_m, and three
     * standard deviations of its uncertainty. For plan and guard the body is thicker by this distance. */
    double tip_margin_m;
    /* 14160: Tip position at the release, from present_rad and tip_offset_m [m]. */
    double tip_position_m[3];
    /* 14184: Tip orientation at the release, unit quaternion (x, y, z, w). */
    double tip_orientation[4];
    /* 14216: Distance of tip and reference at the release [m]; NaN without a reference. */
    double position_error_m;
    /* 14224: bits CDCR_GUARD_FLAGS_…. Cdcrguard bits: which limits changed the command that the mode wanted. */
    uint32_t guard_flags;
    /* 14228: CdcrMeasurementState: what became of tip_measured_m. */
    uint32_t tip_state;
    /* 14232: Smallest distance at the release between the surfaces of body and obstacles, from present_rad and
     * obstacles [m]: negative inside one, infinite without obstacles, NaN when present_rad is not finite. The body
     * counts as thicker by tip_margin_m. */
    double clearance_m;
    /* 14240: The command as it left. */
    CdcrCommand command;
    /* 14800: used: 2 * command.sections. Commanded bend vector at the release [rad]: command.bend_target_rad is one
     * period later. */
    double commanded_rad[12];
    /* 14896: used: 1 * command.sections. Following error of each section [rad]: how far the measured bend vector is
     * from every commanded one of the last following_lag_ns, so that a lag of the motors up to that is not an error.
     * Zero while only the tip is measured. */
    double following_error_rad[6];
    /* 14944: used: 3 * command.sections. The same of each cable [m]. Where positions are obeyed and lengths
     * measured, with the difference of the section's mean length from the commanded one, which is not an error of a
     * bend. */
    double following_error_m[18];
    /* 15088: A following error above this is a warning [rad]. */
    double following_warning_rad;
    /* 15096: A following error above this is a fault [rad]. */
    double following_fault_rad;
    /* 15104: How far the motors may lag behind [ns]. */
    uint64_t following_lag_ns;
    /* 15112: Largest acceleration of a component [rad/s²]; infinite: no limit. */
    double acceleration_rad_s2;
    /* 15120: How far ahead of the reference the motors are commanded [ns]: the delay and time constant of [actuator]
     * together. */
    uint64_t reference_lead_ns;
    /* 15128: Time constant of the motors [ns]: reference_lead_ns less their delay. */
    uint64_t motor_time_constant_ns;
    /* 15136: used: 2 * command.sections. Bend vector at the end of the motors' delay [rad], where this cycle's
     * command begins to act. */
    double delayed_rad[12];
    /* 15232: used: 2 * command.sections. Where the commands up to this release lead the motors [rad]: bend_rad
     * differs from that by the play of the cables. */
    double motor_rad[12];
    /* 15328: used: 3 * command.sections. Used part of that play there: each cable minus its motor [m]. */
    double slack_m[18];
    /* 15472: Play of the cables [m]; 0: none. */
    double play_m;
    /* 15480: used: 2 * command.sections. Commanded position minus the place of the robot where control begins after
     * a reset [rad], while moves_to_begin is set: the rates wanted are those of homing from there. */
    double way_rad[12];
    /* 15576: A reference farther from the tip than this is not approached [m]; infinite: it is, from anywhere. */
    double approach_distance_m;
    /* 15584: Largest speed of a tip that is behind its reference and returns to it, in the newest cycle that solved
     * [m/s]; infinite: no limit. */
    double pace_m_s;
    /* 15592: 1: yes, 0: no. 1 where a latched mode was left and control has not begun since: a following error is
     * not a fault then. */
    uint32_t control_begins;
    /* 15596: 1: yes, 0: no. 1 while the commanded position moves to where control begins after a reset. */
    uint32_t moves_to_begin;
    /* 15600: 1: yes, 0: no. 1 where the last command had run out when the solve ended: limits and ramp count from
     * rest, the solve from previous_rate_rad_s. */
    uint32_t ran_out_in_solve;
    /* 15604: Number of the reference lease: counted as leases are acquired. Tracking ends where it changes. */
    uint32_t lease_number;
    /* 15608: 1: yes, 0: no. 1 where a reset has to accept the pose: a section is measured more than 0.2 rad from
     * where the last command left it, or the daemon before this one ended in such a pose. */
    uint32_t pose_differs;
    /* 15612: 1: yes, 0: no. 1 where the newest measurement was rejected as a jump: a reset is refused then. */
    uint32_t measurement_rejected;
    /* 15616: 1: yes, 0: no. 1 where the reference at the release is too far from the tip to be tracked. */
    uint32_t reference_too_far;
    /* 15620: CdcrTipCause: why the newest tip_measured_m was not used, also in the cycles until the next one. */
    uint32_t tip_cause;
    /* 15624: Distance of the measured tip from where the measured bends place it [m], where it is so far that a
     * reset is refused (the reason TipElsewhere); 0: it is not. */
    double tip_contradiction_m;
} CdcrTelemetry;
CDCR_ASSERT_SIZE(CdcrTelemetry, 15632);

/* cdcr.Incident.v14, 15672 bytes. */
typedef struct CdcrIncident {
    /* 0: The daemon, number of the incident, time of publication. */
    CdcrHeader header;
    /* 24: Time that the hypervisor kept our core from the machine within steal_window_ns before the publication
     * [ns], in steps of 10 ms. */
    uint64_t steal_ns;
    /* 32: Length of that window [ns], which ends just before the publication; 0: it could not be read. */
    uint64_t steal_window_ns;
    /* 40: The record of the cycle, as its readers received it, except scheduling.late_cause: where steal of at least
     * a tick and half of the lateness explains it, the daemon puts platform in place of load, stall or compute. The
     * telemetry service keeps the cause as first seen. */
    CdcrTelemetry telemetry;
} CdcrIncident;
CDCR_ASSERT_SIZE(CdcrIncident, 15672);

#endif
