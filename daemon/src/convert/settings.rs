//! Settings of the solver, in both directions.

use cdcr_controller::nmpc::NmpcSettings;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::Outcome;
use cdcr_shared_types::model;

use crate::handover::{ChangedSettings, RuntimeSettings};

pub fn settings_to_wire(settings: &RuntimeSettings) -> wire::SolverSettings {
    model::settings_to_wire(&settings.nmpc, settings.budget_ns)
}

/// Generates the changes of a configuration from the list of the settings. A missing field does not compile.
macro_rules! changes {
    ({ $($choice:ident: $type:ident,)+ } $($number:ident),+ $(,)?) => {
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

wire::solver_settings!(changes);

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
    let nmpc = model::settings_of(message).map_err(|_| Outcome::UnknownCode)?;
    nmpc.validate().map_err(|_| Outcome::OutOfRange)?;
    Ok(RuntimeSettings { nmpc, budget_ns })
}

#[cfg(test)]
mod tests {
    use cdcr_controller::nmpc::{Coordinates, NmpcSettings, SolverKind};
    use cdcr_controller::optimizer::VelocityRule;
    use cdcr_controller::parameters::UserParameter;
    use cdcr_shared_types::message::Meaning;
    use cdcr_shared_types::{SolverSettings, codes, declared};

    /// Every choice as in a configuration and as in a message.
    macro_rules! choices {
        ({ $($choice:ident: $type:ident,)+ } $($number:ident),+ $(,)?) => {
            $(for code in codes::$type::ALL {
                assert_eq!(serde_json::json!($type::from(*code)), code.text());
            })+
        };
    }

    #[test]
    fn choices_units_and_texts_are_the_same_in_configuration_and_messages() {
        cdcr_shared_types::solver_settings!(choices);
        for kind in SolverKind::ALL {
            assert_eq!(serde_json::json!(kind), kind.name());
        }
        for field in SolverSettings::LAYOUT.fields {
            let mut parameters = NmpcSettings::PARAMETERS.iter();
            let parameter = parameters.find(|parameter| parameter.name == field.name);
            let unit = parameter.map_or("", UserParameter::unit);
            // A code has a text for each value.
            if let Some(parameter) = parameter
                && !matches!(field.meaning, Meaning::Code(_))
            {
                let text = parameter.doc.concat().replace(", {range}", "");
                let words = declared::words(field.doc);
                let words = words.split(" [").next().unwrap_or_default();
                let words = words.trim_end_matches('.');
                assert!(text.trim().starts_with(words), "{text}: {words}");
            }
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
