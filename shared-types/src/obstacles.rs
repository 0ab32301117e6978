use crate::Header;
use crate::limits::OBSTACLES_MAX;
use crate::message::message;

message! {
    /// A sphere or a capsule with which the robot's body must not collide.
    ///
    /// Numbers are finite, components of positions (m) within ±10⁶, the radius within 0 to 10⁶ m.
    /// A telemetry record holds the obstacle as used by the cycle, moved to the release.
    pub struct Obstacle "cdcr.Obstacle.v1" {
        /// Identity chosen by the sender, unique among all senders; an upsert with a known id replaces.
        id: u32,
        /// [`codes::ObstacleShape`](crate::codes::ObstacleShape).
        shape: u32 [code ObstacleShape],
        /// Centre of the sphere, or first end of the capsule's axis, in the base frame \[m\].
        start_m: [f64; 3],
        /// Second end of the capsule's axis \[m\]; unused for a sphere.
        end_m: [f64; 3],
        /// Radius \[m\], ≥ 0.
        radius_m: f64,
        /// Velocity of the whole shape \[m/s\]: it is predicted to each release, and over the horizon, at
        /// constant velocity. At most 100 m/s (`OBSTACLE_SPEED_M_S_MAX`).
        velocity_m_s: [f64; 3],
        /// When `start_m` and `end_m` held \[ns, `CLOCK_MONOTONIC`\]; at most 1 ms ahead of the daemon. An obstacle
        /// that moves is refused as in the past if it is older than 1 s when it arrives (`OBSTACLE_AGE_MS_MAX`), as with 0.
        measured_ns: u64,
        /// How long it stays known after `measured_ns` \[ns\]; 0: until removed. An obstacle whose lifetime
        /// is over when it arrives is refused as in the past, one that has left the range of positions by then as out of range. Where the daemon watches the senders of obstacles (`obstacles.source_timeout_ms`), one does not expire before its sender has sent something after that
        /// (`header.sent_ns`); in a telemetry record this is then 0.
        lifetime_ns: u64,
    }

    /// A change to the set of obstacles; up to [`OBSTACLES_MAX`] at a time, accepted or rejected as a whole.
    ///
    /// Any client may send updates, and all clients share the ids. Within one message the last obstacle of an id takes
    /// effect. Removing an unknown id removes nothing. An upsert that would exceed [`OBSTACLES_MAX`] obstacles is
    /// rejected. In the event of an accepted update, `detail` is the number of obstacles after it. An update without
    /// obstacles changes nothing and serves as a sign of life.
    pub struct ObstacleUpdate "cdcr.ObstacleUpdate.v1" {
        /// Sender, sequence, time.
        header: Header,
        /// [`codes::ObstacleAction`](crate::codes::ObstacleAction): upsert, remove by id, clear all.
        action: u32 [code ObstacleAction],
        /// Obstacles used, 0 ..= [`OBSTACLES_MAX`].
        count: u32 [length],
        /// The obstacles; only the first `count` are read, and of a removal only their ids.
        obstacles: [Obstacle; OBSTACLES_MAX] [used 1 count],
    }
}
