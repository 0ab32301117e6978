//! The words that arguments take, each declared once: for the argument, its refusal and its type in Python.

use cdcr_controller::closed_loop::Sensor;
use cdcr_controller::plant::RobotPreset;
use cdcr_controller::reference::Interpolation;
use cdcr_shared_types::codes::Interface;
use pyo3::prelude::*;

use crate::errors::Failure;

/// How an orientation is given.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Form {
    Quaternion,
    Matrix,
    Zyx,
}

pub(crate) const FORMS: &[(&str, Form)] = &[
    ("quaternion", Form::Quaternion),
    ("matrix", Form::Matrix),
    ("zyx", Form::Zyx),
];
pub(crate) const SENSORS: &[(&str, Sensor)] = &[
    ("cables", Sensor::Cables),
    ("tip", Sensor::Tip { every: 1 }),
    ("both", Sensor::CablesAndTip { every: 1 }),
    ("nothing", Sensor::Nothing),
];
pub(crate) const INTERFACES: &[(&str, Interface)] = &[
    ("velocity", Interface::Velocity),
    ("position", Interface::Position),
];
pub(crate) const INTERPOLATIONS: &[(&str, Interpolation)] = &[
    ("cubic", Interpolation::Cubic),
    ("linear", Interpolation::Linear),
];

/// The meaning of a word.
pub(crate) fn chosen<T: Copy>(
    argument: &str,
    word: &str,
    words: &[(&str, T)],
) -> Result<T, Failure> {
    let known = words.iter().find(|(known, _)| *known == word);
    known.map(|(_, meaning)| *meaning).ok_or_else(|| {
        let quoted: Vec<_> = words.iter().map(|(word, _)| format!("{word:?}")).collect();
        let (last, others) = quoted.split_last().expect("there are words");
        let remedy = format!("Use {} or {last}.", others.join(", "));
        Failure::argument(format!("{argument} is {word:?}"), remedy)
    })
}

fn names<T>(words: &[(&'static str, T)]) -> Vec<&'static str> {
    words.iter().map(|(word, _)| *word).collect()
}

/// The types of arguments with their words.
#[pyfunction]
pub(crate) fn words() -> Vec<(&'static str, Vec<&'static str>)> {
    vec![
        ("Form", names(FORMS)),
        ("Plant", RobotPreset::ALL.map(RobotPreset::name).to_vec()),
        ("Sensor", names(SENSORS)),
        ("Interface", names(INTERFACES)),
        ("Interpolation", names(INTERPOLATIONS)),
    ]
}
