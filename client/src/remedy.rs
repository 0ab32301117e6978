use cdcr_shared_types::codes::{Mode, Outcome, Reason, RequestKind};

const ACCEPT_POSE: &str = "Check where it is. If it was moved by hand, its motors were off or something held it, the measured pose may be right. Otherwise its encoders \
     have lost their zero: bring it to straight and set the zero (docs/drivers.md, Zero). Then accept the measured pose: cdcrctl reset --accept-pose.";

const TIP_ELSEWHERE: &str = "The encoders or the tip sensor are wrong, and --accept-pose does not help. Check where the robot is. If its encoders have lost their zero, bring it to \
     straight and set the zero (docs/drivers.md, Zero). If the bends are right (cdcrctl status), end the tip sensor, or let the driver send no tips, for one second. \
     Then cdcrctl reset, with --accept-pose where cdcrctl status asks for it. Start the sensor again after it was corrected.";

/// Remedy for a refused message or request.
pub fn remedy(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Accepted => "Nothing to do.",
        Outcome::NotFinite => "Remove NaN and infinite numbers from the message.",
        Outcome::InThePast => {
            "The message came too late, or sender or daemon stalled. Send it again with the present time. Reference: start later (--lead) or send further ahead. Measurement: send it \
             within link.measurement_timeout_ms of its time stamp (CLOCK_MONOTONIC, ns), or raise that key above the delay of a slow sensor; for a tip beside bends or cables link.tip_age_max_ms."
        }
        Outcome::InTheFuture => {
            "Stamp messages with CLOCK_MONOTONIC of the daemon's host, in ns, not ahead of now. The wall clock (Python: time.time_ns) is years ahead of it."
        }
        Outcome::CableMean => {
            "Send each cable in m, from the first section on, as long as on the straight robot plus its stroke \
             (docs/drivers.md, Zero); check robot.sections in the configuration."
        }
        Outcome::BeyondTurn => {
            "Send bends in rad, not in degrees: 90 degrees are 1.5708 rad (docs/drivers.md, Frames, angles, signs)."
        }
        Outcome::TipElsewhere => {
            "Check units, signs, order and zero of the driver (bends in rad, cables in m; the scale of the encoders) and the frame of the tip sensor \
             (docs/drivers.md, Frames, angles, signs); the limit is a ninth of the robot's length, 0.1 m at most. To start without the tip sensor, restart cdcrd without link.tip_sensor."
        }
        Outcome::OutOfReach => {
            "Scale or move the reference into the ball whose radius is the robot's length; positions are in m: 150 mm are 0.15."
        }
        Outcome::TimeNotIncreasing => "Increase the time by at least 1 µs from point to point.",
        Outcome::NoLease => "Acquire the lease before sending; cdcrctl ref does both.",
        Outcome::SequenceGap => "Start again with a chunk in mode replace.",
        Outcome::BufferFull => {
            "Send less far ahead, or wait until points have been played; or remove obstacles."
        }
        Outcome::CountOutOfRange | Outcome::OutOfRange => {
            "See the ranges in the documentation of the message. A point of a reference lies a day ahead at most. The time span of a measurement must not end before it begins \
             (rested_from_ns, rested_until_ns)."
        }
        Outcome::UnknownCode => "Use client and daemon of one version.",
        Outcome::NotUnit => "Normalise the axis or quaternion.",
        Outcome::Unsupported => "Do not use this feature, or install a daemon that supports it.",
        Outcome::LeaseHeld => {
            "Stop the other client, or wait: cdcrctl status shows who holds the lease."
        }
        Outcome::NoReference => "Send a reference first: cdcrctl ref spiral --track.",
        Outcome::WrongMode => {
            "See the mode in cdcrctl status: hold ends homing, reset leaves stopped and faulted."
        }
        Outcome::CauseStands => {
            "Correct the cause first: cdcrctl status names it in its line reset (after many deadline misses, wait until the cycles were in time for \
             some seconds); then repeat cdcrctl reset."
        }
        Outcome::PoseDiffers => ACCEPT_POSE,
        Outcome::Waits => {
            "See cdcrctl status. While a source of obstacles is silent, restart that program, with the same ids, or remove its obstacles: cdcrctl obstacle remove ID (clear removes \
             those of every client). After a reset, wait until the robot \
             rests; where it does not move, an obstacle or a limit is in the way: cdcrctl stop, move the obstacle or the robot, cdcrctl reset. Otherwise repeat the request; \
             where inputs are stale again, see cdcrctl incidents."
        }
        Outcome::TooFar => {
            "Bring the tip nearer first, with cdcrctl goto or home, or set motion.approach to \"smooth\"."
        }
        Outcome::Busy => "Wait a moment and try again.",
        Outcome::Stale => "Use one connection for each sender, with increasing sequence numbers.",
        Outcome::WrongRobot => "Use the number of sections that cdcrctl status shows.",
        Outcome::WrongInterface => {
            "Set link.interface to the interface of the driver, \"position\" or \"velocity\"."
        }
        Outcome::OtherDriver => {
            "End the other driver (or tip sensor) first: only one is allowed per robot. A tip sensor in a separate process needs link.tip_sensor = \"separate\"."
        }
        Outcome::Ending => "The daemon is shutting down; restart it first.",
        Outcome::Overruled => {
            "A stop or a fault overruled the request: find the cause (cdcrctl status), then cdcrctl reset, and repeat the request."
        }
    }
}

/// Reason of a refused request.
pub(crate) fn refusal(kind: RequestKind, outcome: Outcome) -> &'static str {
    match (kind, outcome) {
        (RequestKind::Track, Outcome::NoLease) => "no client feeds a reference",
        _ => outcome.text(),
    }
}

/// Like [`remedy`], for a request that a daemon in `mode` refused.
pub fn request_remedy(kind: RequestKind, outcome: Outcome, mode: Mode) -> &'static str {
    if kind == RequestKind::Track && outcome == Outcome::NoLease {
        return "Feed one first, for example: cdcrctl ref spiral --track. A stop ends the feed before it.";
    }
    if kind == RequestKind::Reset && outcome == Outcome::TipElsewhere {
        return TIP_ELSEWHERE;
    }
    if outcome != Outcome::WrongMode {
        return remedy(outcome);
    }
    match mode {
        Mode::Starting => {
            "No measurement of the driver was accepted yet: check that it runs and sends; cdcrctl status counts refused ones by reason."
        }
        Mode::Stopped | Mode::Faulted => "Reset first: cdcrctl reset.",
        Mode::Holding | Mode::Tracking | Mode::Homing if kind == RequestKind::Reset => {
            "Nothing to reset: the daemon is neither stopped nor faulted."
        }
        Mode::Holding | Mode::Tracking | Mode::Homing => "Hold first: cdcrctl hold.",
    }
}

/// Remedy for each reason of a mode, for a user whose reference ended by it or who sees it in the status.
pub fn reason_remedy(reason: Reason) -> &'static str {
    match reason {
        Reason::Start => "The daemon was restarted: feed the reference again.",
        Reason::Request => {
            "A client (cdcrctl hold, stop, ...) or the signal SIGUSR1 asked for it. After a hold, feed the reference again. After a stop, check \
             that nobody is in the robot's way, then cdcrctl reset."
        }
        Reason::ReferenceEnded => {
            "The chunks came too late: give this program more time, or send further ahead."
        }
        Reason::LeaseExpired | Reason::LeaseReleased => {
            "This program was delayed for too long, or another client released its lease. cdcrctl status shows whether another client holds it now: end \
             that one or wait for it, then feed again."
        }
        Reason::HomeReached => "Another client sent it home.",
        Reason::DeadlineMisses => {
            "The machine is too busy: see the causes in cdcrctl status, then cdcrctl reset. The limit is the setting \
             cycle.miss_limit."
        }
        Reason::MeasurementLost => {
            "Check that the driver runs and measures within each link.measurement_timeout_ms, which must be longer than the delay of the measurements, and in cdcrctl status that no messages are \
             refused (cdcrctl echo telemetry shows refused measurements), then cdcrctl reset, with --accept-pose where cdcrctl status asks for it."
        }
        Reason::MeasurementJump => {
            "Check the sensors and the driver (cdcrctl echo telemetry shows each measurement's state), then \
             cdcrctl reset, with --accept-pose where cdcrctl status asks for it."
        }
        Reason::MeasurementFrozen => {
            "Check that the driver still reads the sensors and the robot can move, then cdcrctl reset, with --accept-pose where cdcrctl status asks for it."
        }
        Reason::FollowingError => {
            "Motors that follow positions keep pushing: switch off their torque before you touch the robot. Check that the motors run, reach robot.cable_speed_max_m_s, and nothing holds the robot; with a new driver also the sign, order and unit of its cables, and that \
             it obeys its commands. cdcrctl status shows the following error and, beside it, a cause that the cables show, such as the zero of a section. Then cdcrctl reset, with --accept-pose where cdcrctl status asks for it."
        }
        Reason::InputsStale => {
            "The machine delayed the daemon's exchange thread: see the causes in cdcrctl incidents, then feed the reference, or go home, again."
        }
        Reason::Suspended => "The machine was suspended: check the robot, then cdcrctl reset.",
        Reason::ObstacleSourceSilent => {
            "Check that the program that sends the obstacles runs, or remove its obstacles (cdcrctl obstacle remove ID), then feed the reference, or go home, again."
        }
        Reason::ReferenceTooFar => {
            "Bring the tip nearer first, with cdcrctl goto, or set motion.approach to \"smooth\"."
        }
        Reason::CommonMode => "Check the cables and their spools, then cdcrctl reset.",
        Reason::NonFinite => "See the daemon's log, then cdcrctl reset.",
        Reason::LimitBroken => {
            "Bring the robot inside its limits, or correct the driver's units and zeros (cdcrctl status \
             names the section and its bend while it is beyond its limit), then cdcrctl reset."
        }
        Reason::ClearanceBroken => {
            "Move the obstacle or the robot, then cdcrctl reset. Where cdcrctl status shows a tip margin, check the tip \
             sensor first; where the robot rests clear of the obstacle, its motors lag more than [actuator] states, or its driver stalls."
        }
        Reason::StoppedBefore => {
            "Check the robot and, if its encoders were restarted, their zero (docs/drivers.md, Zero), then cdcrctl reset, with --accept-pose where cdcrctl status asks for it."
        }
        Reason::PoseDiffers => ACCEPT_POSE,
        Reason::TipElsewhere => TIP_ELSEWHERE,
        Reason::ObstaclesLost => {
            "Their file is of another version of cdcrd, or another program wrote it: check the robot and what is in its way, add the obstacles again, then \
             cdcrctl reset."
        }
        Reason::Shutdown => "Restart it with cdcrd run.",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_remedy_is_a_sentence() {
        for &outcome in Outcome::ALL {
            let text = remedy(outcome);
            assert!(text.ends_with('.') && text.len() > 10, "{outcome:?}");
        }
        for &reason in Reason::ALL {
            let text = reason_remedy(reason);
            assert!(text.ends_with('.') && text.len() > 10, "{reason:?}");
        }
        // After these the robot may be elsewhere than its last command.
        for reason in [
            Reason::MeasurementLost,
            Reason::MeasurementJump,
            Reason::MeasurementFrozen,
            Reason::FollowingError,
            Reason::StoppedBefore,
        ] {
            assert!(reason_remedy(reason).contains("--accept-pose"), "{reason}");
        }
        // A reset is also refused while the leaky bucket is full.
        assert!(remedy(Outcome::CauseStands).contains("deadline misses"));
    }
}
