use core::fmt;

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::Mode;

use crate::value;

/// Trigger of a recording: it fires in the first cycle that meets its condition after one that does not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Trigger {
    /// The daemon reports an incident.
    Incident,
    /// The robot is faulted.
    Fault,
    /// The mode changes.
    Mode,
    /// The distance of tip and reference exceeds this \[m\].
    Error(f64),
    /// The clearance is below this \[m\].
    Clearance(f64),
    /// The response time exceeds this \[ns\].
    Response(u64),
}

impl Trigger {
    /// Parses the command-line form: `error>5mm`.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let words = text.split_once(['>', '<']);
        let unknown =
            || "use incident, fault, mode, error>5mm, clearance<5mm or response>800us".to_owned();
        let Some((name, limit)) = words else {
            return match text.trim() {
                "incident" => Ok(Self::Incident),
                "fault" => Ok(Self::Fault),
                "mode" => Ok(Self::Mode),
                _ => Err(unknown()),
            };
        };
        match (name.trim(), text.contains('>')) {
            ("error", true) => Ok(Self::Error(value::length_m(limit.trim())?)),
            ("clearance", false) => Ok(Self::Clearance(value::length_m(limit.trim())?)),
            ("response", true) => {
                let time = value::duration(limit)?;
                Ok(Self::Response(time.as_nanos() as u64))
            }
            _ => Err(unknown()),
        }
    }

    /// Whether it fires with a record, given the previous one.
    pub(crate) fn fires(self, before: &Telemetry, record: &Telemetry) -> bool {
        match self {
            // Incidents have a service of their own.
            Self::Incident => false,
            Self::Mode => before.mode != record.mode,
            Self::Fault | Self::Error(_) | Self::Clearance(_) | Self::Response(_) => {
                self.holds(record) && !self.holds(before)
            }
        }
    }

    fn holds(self, record: &Telemetry) -> bool {
        match self {
            Self::Incident | Self::Mode => false,
            Self::Fault => record.mode == Mode::Faulted.code(),
            Self::Error(limit_m) => record.position_error_m > limit_m,
            Self::Clearance(limit_m) => record.clearance_m < limit_m,
            Self::Response(limit_ns) => {
                record.handed_over_ns.saturating_sub(record.due_ns) > limit_ns
            }
        }
    }
}

impl fmt::Display for Trigger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Incident => write!(f, "incident"),
            Self::Fault => write!(f, "fault"),
            Self::Mode => write!(f, "mode"),
            Self::Error(limit_m) => write!(f, "error>{}mm", 1e3 * limit_m),
            Self::Clearance(limit_m) => write!(f, "clearance<{}mm", 1e3 * limit_m),
            Self::Response(limit_ns) => write!(f, "response>{}us", *limit_ns as f64 * 1e-3),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triggers_are_typed_with_their_units() {
        for (text, expected) in [
            ("incident", Trigger::Incident),
            ("error>5mm", Trigger::Error(5.0 * 1e-3)),
            ("clearance < 0.01m", Trigger::Clearance(0.01)),
            ("response>800us", Trigger::Response(800_000)),
        ] {
            assert_eq!(Trigger::parse(text), Ok(expected), "{text}");
        }
        for bad in [
            "",
            "errors",
            "error<5mm",
            "clearance>5mm",
            "error>5",
            "error>mm",
            "response>5",
            "mode>1m",
        ] {
            assert!(Trigger::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_trigger_fires_where_it_begins_to_hold() {
        let of = |error_m| Telemetry {
            position_error_m: error_m,
            ..Telemetry::default()
        };
        let error = Trigger::Error(0.005);
        let fires = |before, after| error.fires(&of(before), &of(after));
        assert!(fires(0.004, 0.006) && fires(f64::NAN, 0.006));
        assert!(!fires(0.006, 0.007) && !fires(0.006, f64::NAN) && !fires(0.004, 0.005));
        let in_mode = |mode: Mode| Telemetry {
            mode: mode.code(),
            ..Telemetry::default()
        };
        let (holding, faulted) = (in_mode(Mode::Holding), in_mode(Mode::Faulted));
        for (trigger, fires) in [
            (Trigger::Fault, true),
            (Trigger::Mode, true),
            (Trigger::Incident, false),
        ] {
            assert_eq!(trigger.fires(&holding, &faulted), fires);
        }
        assert!(!Trigger::Fault.fires(&faulted, &holding));
    }
}
