//! Settings of the solver, in both directions.

use cdcr_controller::nmpc::{Coordinates, NmpcSettings, SolverKind};
use cdcr_controller::optimizer::VelocityRule;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{self, Outcome};

use crate::handover::{ChangedSettings, RuntimeSettings};

/// Generates both conversions, and the changes of a configuration, from the list of the settings. A missing field does
/// not compile.
macro_rules! both_ways {
    ({ $($choice:ident: $type:ident { $($variant:ident),+ },)+ } $($number:ident),+ $(,)?) => {
        pub fn settings_to_wire(settings: &RuntimeSettings) -> wire::SolverSettings {
            let RuntimeSettings { nmpc, budget_ns } = settings;
            let NmpcSettings { $($choice,)+ $($number),+ } = *nmpc;
            wire::SolverSettings {
                $($choice: match $choice { $($type::$variant => codes::$type::$variant,)+ }.code(),)+
                $($number: $number.into(),)+
                budget_ns: *budget_ns,
                reserved: 0,
            }
        }

        fn nmpc_from_wire(message: &wire::SolverSettings) -> Result<NmpcSettings, Outcome> {
            let wire::SolverSettings { $($choice,)+ $($number,)+ budget_ns: _, reserved: _ } = *message;
            let unknown = |_| Outcome::UnknownCode;
            Ok(NmpcSettings {
                $($choice: match codes::$type::try_from($choice).map_err(unknown)? {
                    $(codes::$type::$variant => $type::$variant,)+
                },)+
                $($number: $number.into(),)+
            })
        }

        /// The settings in force with the changes of the configuration. The combination is not validated.
        pub fn with_changes(in_force: &RuntimeSettings, changed: &ChangedSettings) -> RuntimeSettings {
            let ChangedSettings { before, after } = changed;
            let changed_or = |is_changed, [new, old]: [&RuntimeSettings; 2]| if is_changed { *new } else { *old };
            let newer = [after, in_force];
            RuntimeSettings {
                nmpc: NmpcSettings {
                    $($choice: changed_or(after.nmpc.$choice != before.nmpc.$choice, newer).nmpc.$choice,)+
                    $($number: changed_or(after.nmpc.$number != before.nmpc.$number, newer).nmpc.$number,)+
                },
                budget_ns: changed_or(after.budget_ns != before.budget_ns, newer).budget_ns,
            }
        }
    };
}

wire::solver_settings!(both_ways);

/// Settings from the wire, validated for a daemon with this period.
pub fn settings_from_wire(
    message: &wire::SolverSettings,
    period_ns: u64,
) -> Result<RuntimeSettings, Outcome> {
    if message.reserved != 0 {
        return Err(Outcome::UnknownCode);
    }
    let budget_ns = message.budget_ns;
    if budget_ns > period_ns {
        return Err(Outcome::OutOfRange);
    }
    let nmpc = nmpc_from_wire(message)?;
    nmpc.validate().map_err(|_| Outcome::OutOfRange)?;
    Ok(RuntimeSettings { nmpc, budget_ns })
}

#[cfg(test)]
mod tests {
    use cdcr_controller::nmpc::{Coordinates, NmpcSettings, SolverKind};
    use cdcr_controller::optimizer::VelocityRule;
    use cdcr_controller::parameters::UserParameter;
    use cdcr_shared_types::{SolverSettings, codes};

    /// Every choice as in a configuration and as in a message.
    macro_rules! choices {
        ({ $($choice:ident: $type:ident { $($variant:ident),+ },)+ } $($number:ident),+ $(,)?) => {
            [$($((serde_json::json!($type::$variant), codes::$type::$variant.text()),)+)+]
        };
    }

    #[test]
    fn choices_and_units_are_the_same_in_configuration_and_messages() {
        for (in_configuration, in_messages) in cdcr_shared_types::solver_settings!(choices) {
            assert_eq!(in_configuration, in_messages);
        }
        for kind in SolverKind::ALL {
            assert_eq!(serde_json::json!(kind), kind.name());
        }
        for field in SolverSettings::LAYOUT.fields {
            let mut parameters = NmpcSettings::PARAMETERS.iter();
            let parameter = parameters.find(|parameter| parameter.name == field.name);
            let unit = parameter.map_or("", UserParameter::unit);
            let has_unit_elsewhere = parameter.is_none() && !field.unit.is_empty();
            assert!(
                !has_unit_elsewhere || field.name == "budget_ns",
                "{}",
                field.name
            );
            assert!(unit.is_empty() || unit == field.unit, "{}", field.name);
        }
    }
}
