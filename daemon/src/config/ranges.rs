//! What is allowed for each number, whatever the other keys say: the ranges that are declared.

use cdcr_controller::parameters::number_text;

use super::{Config, ConfigError, Origins, keys};

/// Refuses the first number outside its range, NaN included.
pub(super) fn check(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    let sections = config.robot.sections.iter().enumerate();
    let sections = sections.map(|(index, section)| {
        let numbers = section.numbers().to_vec();
        (format!("robot.sections[{index}]"), numbers)
    });
    for (table, numbers) in config.numbers_by_table().into_iter().chain(sections) {
        let parameters = keys::below(&keys::without_indices(&table)).iter();
        for (parameter, number) in parameters.zip(numbers) {
            let (Some(range), Some(value)) = (&parameter.range, number) else {
                continue;
            };
            if !range.contains(&value) {
                let [low, high] = [range.start(), range.end()].map(|limit| number_text(*limit));
                let message = format!("{value} is out of range: allowed is {low} to {high}");
                let key = format!("{table}.{}", parameter.name);
                return Err(origins.error(&[&key], &message));
            }
        }
    }
    Ok(())
}
