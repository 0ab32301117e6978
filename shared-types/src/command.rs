use core::ops::Range;

use crate::Header;
use crate::limits::{CABLES_MAX, COORDINATES_MAX};
use crate::message::message;

message! {
    /// The command to the robot until the next one.
    ///
    /// A driver follows the **positions or the speeds**, as `interface` states, never a mixture of both. The positions
    /// are the integral of the speeds: bit-exactly constant while the speeds are zero, wherever the robot is measured.
    ///
    /// Cycles and sequences ascend. A command is not sent if a newer one overtakes it while the daemon is delayed. Nor
    /// is it sent if it expires before it can leave, unless it is rest. In a telemetry record, the sequence of such a
    /// command is 0. The last command of a daemon that ends with status 0 is rest.
    ///
    /// The daemon sends no command before it knows the robot's configuration, that is before the first measurement. The
    /// robot comes to rest from `valid_until_ns` on, as described there.
    pub struct Command "cdcr.Command.v3" {
        /// The daemon, sequence, time of sending.
        header: Header,
        /// Sender of the measurements on which the commands act. 0: none has been accepted yet, or the robot is simulated. A driver
        /// that sends measurements follows no command that acts on those of another one.
        driver_id: u64,
        /// Number of the cycle: its release was at `cycle` periods after the daemon's origin.
        cycle: u64,
        /// Release time of that cycle \[ns, `CLOCK_MONOTONIC`\]; the rates hold from here.
        release_ns: u64,
        /// When the move to `bend_target_rad` ends: one period after the release \[ns, `CLOCK_MONOTONIC`\].
        target_ns: u64,
        /// Until when the speeds may be followed without a newer command \[ns, `CLOCK_MONOTONIC`\]. Then the driver stops at once, or shrinks all
        /// speeds together by one factor, the fastest bend component by `motion.deceleration_rad_s2` or faster, and holds: the clearance guard has checked
        /// this way at its ends, and within 1 mm between. A stop that is over earlier is not checked in time beside a moving obstacle. Cables that stop one by one leave it.
        /// It counts from the release, so a command that is delayed on its way is not valid for longer.
        valid_until_ns: u64,
        /// [`codes::Mode`](crate::codes::Mode) of the daemon.
        mode: u32 [code Mode],
        /// Sections of the robot.
        sections: u32,
        /// [`codes::Interface`](crate::codes::Interface): what the driver obeys, `cable_length_m` or `cable_speed_m_s`
        /// (or the bend vector and its rates, where the driver computes its own cables).
        interface: u32 [code Interface],
        /// Zero.
        reserved: u32 [reserved],
        /// Bend-vector rates (u̇₁, v̇₁, …) \[rad/s\].
        bend_rate_rad_s: [f64; COORDINATES_MAX] [used 2 sections],
        /// Commanded bend vector at `target_ns` \[rad\]: that of the command before, moved on by the rates. It begins at
        /// the measured one when control begins, and after a reset.
        bend_target_rad: [f64; COORDINATES_MAX] [used 2 sections],
        /// Cable lengths at `bend_target_rad`, section by section, three each \[m\].
        cable_length_m: [f64; CABLES_MAX] [used 3 sections],
        /// Cable speeds that belong to `bend_rate_rad_s` \[m/s\].
        cable_speed_m_s: [f64; CABLES_MAX] [used 3 sections],
    }
}

impl Command {
    /// When motors that took this velocity command at `taken_ns` have rested until `now_ns` without a newer one, for
    /// [`Measurement::rested_from_ns`](crate::Measurement::rested_from_ns): less the time from the release to `taken_ns`.
    pub fn rest_ns(&self, taken_ns: u64, now_ns: u64) -> Option<Range<u64>> {
        let from_ns = self.valid_until_ns.max(taken_ns);
        let late_ns = taken_ns.saturating_sub(self.release_ns);
        (now_ns > from_ns).then(|| from_ns - late_ns..now_ns - late_ns)
    }
}
