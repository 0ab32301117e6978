use core::fmt;

use super::fit::{Square, scaled};
use super::geometry::{PARAMETERS_MAX, Parameter};

/// A combination of parameters is determined if the data know it this many times better than its plausible errors.
const DETERMINED_MIN: f64 = 5.0;
/// Parameters with at least this share of the largest component belong to a combination.
const COMPONENT_SHARE: f64 = 0.3;

/// A parameter that was not estimated, and the reason.
#[derive(Debug, Clone, PartialEq)]
pub struct Held {
    /// The parameter that keeps its configured value.
    pub parameter: Parameter,
    /// Why the data do not determine it.
    pub why: HeldReason,
}

/// Reason why a parameter was not estimated.
#[derive(Debug, Clone, PartialEq)]
pub enum HeldReason {
    /// By request.
    Requested,
    /// The data cannot distinguish it from these parameters; if empty, the data do not depend on it.
    Undetermined(Vec<Parameter>),
}

impl fmt::Display for HeldReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Requested => write!(f, "held on request"),
            Self::Undetermined(others) if others.is_empty() => {
                write!(f, "the data do not depend on it")
            }
            Self::Undetermined(others) => {
                let names: Vec<_> = others.iter().map(ToString::to_string).collect();
                write!(f, "the data do not separate it from: {}", names.join(", "))
            }
        }
    }
}

/// Removes parameters from `active` until the data determine every combination of the others. From an undetermined
/// combination, the parameter most likely to be right as configured is held: base and sensor first, lengths last.
pub(super) fn hold_undetermined(
    square: &Square,
    scale: &[f64; PARAMETERS_MAX],
    active: &mut Vec<usize>,
    held: &mut Vec<Held>,
) {
    while !active.is_empty() {
        let eigen = scaled(square, active, scale).symmetric_eigen();
        // Eigenvectors of held parameters have the eigenvalue 1 and no component of an active one.
        let is_active = |vector: usize| {
            let shares = active
                .iter()
                .map(|&i| eigen.eigenvectors[(i, vector)].powi(2));
            shares.sum::<f64>() > 0.5
        };
        let weakest = (0..PARAMETERS_MAX)
            .filter(|&vector| is_active(vector))
            .min_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let Some(weakest) =
            weakest.filter(|&at| eigen.eigenvalues[at] < DETERMINED_MIN * DETERMINED_MIN)
        else {
            return;
        };
        let share = |index: usize| eigen.eigenvectors[(index, weakest)].abs();
        let largest = active.iter().map(|&i| share(i)).fold(0.0, f64::max);
        let mut combined = active.clone();
        combined.retain(|&index| share(index) >= COMPONENT_SHARE * largest);
        let first = combined.iter().copied().min_by(|&a, &b| {
            let group = |index: usize| Parameter::from_index(index).group();
            group(a).cmp(&group(b)).then(share(b).total_cmp(&share(a)))
        });
        let Some(first) = first else {
            return;
        };
        active.retain(|&index| index != first);
        combined.retain(|&index| index != first);
        held.push(Held {
            parameter: Parameter::from_index(first),
            why: HeldReason::Undetermined(
                combined.into_iter().map(Parameter::from_index).collect(),
            ),
        });
    }
}

/// Indices of parameters that are held for lack of data, and so as uncertain as is plausible. The turn of the base about
/// z and the distance of the sensor along the tip are not among them: no path determines those from positions, and
/// the user measures or chooses them.
pub(super) fn uncertain(held: &[Held]) -> impl Iterator<Item = usize> {
    let is_uncertain = |held: &&Held| {
        let is_chosen = matches!(
            held.parameter,
            Parameter::BaseRotation(2) | Parameter::SensorPosition(2)
        );
        held.why != HeldReason::Requested && !is_chosen
    };
    held.iter()
        .filter(is_uncertain)
        .map(|held| held.parameter.index())
}

/// Covariance of the estimates in units of the plausible errors. The parameters held for lack of data count as far as the rows leave them
/// uncertain, with their plausible errors as prior knowledge; that one is held at a wrong value is not part of it.
pub(super) fn covariance(
    square: &Square,
    scale: &[f64; PARAMETERS_MAX],
    active: &[usize],
    held: &[Held],
) -> Option<Square> {
    let all: Vec<_> = active.iter().copied().chain(uncertain(held)).collect();
    let mut square = scaled(square, &all, scale);
    for index in uncertain(held) {
        square[(index, index)] += 1.0;
    }
    square.try_inverse()
}

/// Removes the parameters from `active` that plausible errors of the held ones change too much to be determined.
pub(super) fn hold_uncertain(
    square: &Square,
    scale: &[f64; PARAMETERS_MAX],
    active: &mut Vec<usize>,
    held: &mut Vec<Held>,
) -> Option<()> {
    let covariance = covariance(square, scale, active, held)?;
    let deviation = |index: usize| covariance[(index, index)].sqrt();
    let (kept, lost): (Vec<_>, Vec<_>) = active
        .iter()
        .partition(|&&index| DETERMINED_MIN * deviation(index) < 1.0);
    let others: Vec<_> = uncertain(held).collect();
    for index in lost {
        let share = |other: &usize| covariance[(index, *other)].abs() / deviation(*other);
        let largest = others.iter().map(share).fold(0.0, f64::max);
        let combined = others
            .iter()
            .filter(|&other| share(other) >= COMPONENT_SHARE * largest);
        held.push(Held {
            parameter: Parameter::from_index(index),
            why: HeldReason::Undetermined(
                combined
                    .map(|&other| Parameter::from_index(other))
                    .collect(),
            ),
        });
    }
    *active = kept;
    Some(())
}
