use cdcr_controller::nmpc::RateWeight;
use clap::ValueEnum;

/// Values of a few keys that belong together, chosen by measurement: docs/tuning.md.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum TuningPreset {
    /// Smallest tip error that the sensors allow.
    Precise,
    /// Rate changes reduced to a fifth.
    Smooth,
    /// Deviations from the commands corrected five times as fast.
    Fast,
}

impl TuningPreset {
    /// Keys and values.
    pub(super) fn keys(self) -> [(&'static str, f64); 3] {
        let measured = f64::from(RateWeight::MEASURED);
        let (rate_weight, rate_change_weight, time_constant_ms) = match self {
            Self::Precise => (measured, 0.0, 300.0),
            // The weight of the rates ends those that do not move the tip: in half a second at 5 ms (`rates_last_s`).
            Self::Smooth => (1e-7, 1e-5, 300.0),
            Self::Fast => (measured, 0.0, 60.0),
        };
        [
            ("controller.rate_weight", rate_weight),
            ("controller.rate_change_weight", rate_change_weight),
            ("estimator.time_constant_ms", time_constant_ms),
        ]
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::cli::config::ConfigSource;
    use crate::config::{Config, ConfigDraft};

    #[derive(Debug, Parser)]
    struct CommandLine {
        #[command(flatten)]
        source: ConfigSource,
    }

    fn config(arguments: &[&str]) -> Config {
        settings(arguments).validate().unwrap().config
    }

    fn settings(arguments: &[&str]) -> ConfigDraft {
        let line = CommandLine::parse_from(["cdcrd"].iter().chain(arguments));
        line.source.settings().unwrap()
    }

    #[test]
    fn a_tuning_is_shown_as_the_documents_write_it() {
        let shown = settings(&["--tuning", "smooth"]).changed();
        let of = |key| &shown.iter().find(|(name, ..)| *name == key).unwrap().1;
        assert_eq!(of("controller.rate_weight"), "1e-7");
        assert_eq!(of("controller.rate_change_weight"), "1e-5");
        assert_eq!(of("estimator.time_constant_ms"), "300.0");
    }

    #[test]
    fn a_tuning_sets_its_keys_and_an_option_wins_over_it() {
        let default = config(&[]);
        assert!(f64::from(default.controller.rate_weight) == 0.0);
        for tuning in TuningPreset::value_variants() {
            let name = tuning.to_possible_value().unwrap().get_name().to_owned();
            let set = config(&["--tuning", &name]);
            let values = [
                set.controller.rate_weight.into(),
                set.controller.rate_change_weight,
                set.estimator.time_constant_ms,
            ];
            let expected = tuning.keys().map(|(_, value)| value);
            assert!(values == expected, "{name}: {values:?}");
            let mut others = set.clone();
            others.controller.rate_weight = default.controller.rate_weight;
            others.controller.rate_change_weight = default.controller.rate_change_weight;
            others.estimator.time_constant_ms = default.estimator.time_constant_ms;
            assert!(others == default, "{name} sets nothing else");
            let key = "estimator.time_constant_ms=70";
            let over = config(&["--set", key, "--tuning", &name]);
            assert!(over.estimator.time_constant_ms == 70.0, "{name}");
            // The former name of the option.
            assert!(config(&["--preset", &name]) == set, "{name}");
        }
    }
}
