use std::fmt::{self, Formatter};

use serde::de::{self, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{CONTROL_BLOCKS_MAX, HORIZON_STEPS_MAX, SWARM_MAX};
use crate::optimizer::{GaussNewtonSettings, KpsoSettings, VelocityRule};

/// How the optimal control problem is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SolverKind {
    /// Knowledge-based particle swarm, as in the paper.
    Kpso,
    /// Damped Gauss-Newton steps from the last plan, and from the best candidate where an error is left.
    GaussNewton,
    /// Gauss-Newton refines, and the swarm chooses the basin where that leaves an error.
    #[default]
    KpsoRefined,
}

impl SolverKind {
    /// Every kind.
    pub const ALL: [Self; 3] = [Self::Kpso, Self::GaussNewton, Self::KpsoRefined];

    /// Name of the kind in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Kpso => "kpso",
            Self::GaussNewton => "gauss-newton",
            Self::KpsoRefined => "kpso-refined",
        }
    }

    pub(super) fn searches(self) -> bool {
        self != Self::GaussNewton
    }

    pub(super) fn refines(self) -> bool {
        self != Self::Kpso
    }
}

/// In which rates the optimal control problem is posed. The command is always bend-vector rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Coordinates {
    /// Rates (u̇, v̇) of each section's bend vector: smooth everywhere.
    #[default]
    BendVector,
    /// The paper's (θ̇, φ̇), with signed θ. A rate φ̇ moves nothing where the section is straight.
    BendAngles,
}

crate::parameters! {
    /// Everything that tunes the optimal control problem and its solver.
    ///
    /// The default is the paper's swarm (6 × 30, c₁ = c₂ = 1.2, N = 2) with the inertia weight that Eq. 6
    /// lacks, refined by Gauss-Newton.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct NmpcSettings {
        /// "kpso-refined": Gauss-Newton, then the swarm where an error remains. "kpso": the paper's swarm alone, from
        /// candidates of ours. "gauss-newton": damped steps from the last plan, and from the best candidate where an error
        /// remains.
        solver: SolverKind = SolverKind::KpsoRefined;
        /// Prediction steps N, {range}.
        horizon_steps: u32 = 2, in ranges::HORIZON_STEPS;
        /// Optimised rates: "bend-vector" (smooth everywhere), or "bend-angles", the paper's theta and phi.
        coordinates: Coordinates = Coordinates::BendVector;
        /// Control blocks M, {range}, and at most N; 0: one per step. A plan has at most 300 numbers: 50 blocks with three
        /// sections, 25 with six; at most 20 blocks where rate changes have a weight.
        control_blocks: u32 = 0, in ranges::CONTROL_BLOCKS, "at most controller.horizon_steps";
        /// Particles of the swarm, {range}.
        swarm_size: u32 = 6, in ranges::SWARM_SIZE;
        /// Iterations of the swarm, {range}.
        swarm_iterations: u32 = 30, in ranges::ITERATIONS;
        /// Iterations without improvement before the swarm is regenerated, {range}; 0: never.
        regenerate_after: u32 = 10, in ranges::ITERATIONS;
        /// "inertia", "constriction" (Clerc & Kennedy), or "verbatim" (Eq. 6 as printed; it does not converge).
        velocity_rule: VelocityRule = VelocityRule::Inertia;
        /// Inertia weight w, {range}.
        inertia: f64 = 0.5, in ranges::INERTIA;
        /// Coefficient c1 of Eq. 6, the weight of a particle's own best, {range}.
        cognitive: f64 = 1.2, in ranges::COEFFICIENT;
        /// Coefficient c2 of Eq. 6, the weight of the swarm's best, {range}.
        social: f64 = 1.2, in ranges::COEFFICIENT;
        /// Gauss-Newton steps, {range}; "gauss-newton" takes one more for a long plan from rest.
        refinement_steps: u32 = 3, in ranges::REFINEMENT_STEPS;
        /// Damping of the Gauss-Newton steps, {range}.
        damping: f64 = 1e-14, in ranges::DAMPING;
        /// Weight of the squared position error in the cost (Eq. 5), per m², {range}.
        position_weight: f64 = 1.0, in ranges::POSITION_WEIGHT, usual 1e-3..=1e6;
        /// Weight of the squared orientation error, per rad², {range}, where the reference asks for an orientation.
        orientation_weight: f64 = 0.1, in ranges::WEIGHT, usual 0.0..=1e3;
        /// Orientation error without cost, {range}.
        orientation_tolerance_rad: f64 = 0.0, in ranges::ORIENTATION_TOLERANCE_RAD;
        /// Weight of the squared rates, per (rad/s)², {range}, or "auto": 0, as in the paper, for the ideal simulated robot, and
        /// 1e-10 for all others. With 0, sensor noise makes a robot of several sections drift around its tip.
        rate_weight: RateWeight = RateWeight::Auto, in ranges::WEIGHT, usual 0.0..=0.01;
        /// Weight of the squared changes of rates, per (rad/s)², {range}.
        rate_change_weight: f64 = 0.0, in ranges::WEIGHT, usual 0.0..=0.01;
        /// Gain by which bends that the tip does not need return towards straight while it travels, {range}: by the factor exp(-gain) where the
        /// reference travels the length of the robot, and by exp(-1) in a second at most. 0: they drift, and on a repeated path the body does not repeat its motion
        /// (docs/tuning.md). Without a weight of the rates, or with a horizon of one step, it has no effect.
        posture_gain: f64 = 0.0, in ranges::POSTURE_GAIN;
        /// Factor on the error cost of the last step, {range}.
        terminal_weight: f64 = 1.0, in ranges::WEIGHT, usual 0.0..=1e4, "above 0 where controller.horizon_steps is 1";
        /// Safe distance between body and obstacles, {range}: the clearance guard lets no command bring the body nearer. A
        /// tracking robot that is nearer leaves its reference and moves away, at up to its rate limits, also where a client sets a value above the
        /// clearance at run time. In all other modes it does not move away; it just does not get closer. Clients cannot set a smaller value than this.
        safe_distance_m: f64 = 0.01, in ranges::SAFE_DISTANCE_M;
        /// Penalty in the solver's cost for each step inside the safe distance, {range}. Rejected without a slope or
        /// square penalty, because it does not prevent collisions alone.
        obstacle_step_penalty: f64 = 1e3, in ranges::WEIGHT, "slope and square together at least a millionth of the step at a depth of 1 mm";
        /// Penalty in the solver's cost per m of depth inside the safe distance, {range}.
        obstacle_slope_penalty: f64 = 1e4, in ranges::WEIGHT, "slope and square together at least a millionth of the step at a depth of 1 mm";
        /// Penalty in the solver's cost per m² of squared depth inside the safe distance, {range}.
        obstacle_square_penalty: f64 = 0.0, in ranges::WEIGHT;
        /// Seed of the swarm, a whole number. The same seed gives bit-identical results.
        seed: u64 = 1;
    }
}

/// Weight of the squared rates.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum RateWeight {
    /// Chosen for the robot by the caller with [`RateWeight::auto`]. The solver treats it as 0, the weight of
    /// the ideal robot.
    #[default]
    Auto,
    /// This weight, per (rad/s)².
    Of(f64),
}

impl RateWeight {
    /// Weight for a measured robot: too small to affect the tip, and large enough that sensor noise does not
    /// move the robot around its tip (docs/robustness.md).
    pub const MEASURED: Self = Self::Of(1e-10);

    const WORD: &str = "auto";

    /// Weight for an ideal robot, which equals its model, or for a measured one.
    pub fn auto(is_ideal: bool) -> Self {
        if is_ideal {
            Self::Of(0.0)
        } else {
            Self::MEASURED
        }
    }
}

impl From<f64> for RateWeight {
    fn from(weight: f64) -> Self {
        Self::Of(weight)
    }
}

impl From<RateWeight> for f64 {
    fn from(weight: RateWeight) -> Self {
        match weight {
            RateWeight::Auto => 0.0,
            RateWeight::Of(weight) => weight,
        }
    }
}

impl Serialize for RateWeight {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str(Self::WORD),
            Self::Of(weight) => serializer.serialize_f64(*weight),
        }
    }
}

impl<'de> Deserialize<'de> for RateWeight {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct WordOrNumber;

        impl Visitor<'_> for WordOrNumber {
            type Value = RateWeight;

            fn expecting(&self, text: &mut Formatter<'_>) -> fmt::Result {
                write!(text, "a number or {:?}", RateWeight::WORD)
            }

            fn visit_f64<E>(self, weight: f64) -> Result<RateWeight, E> {
                Ok(weight.into())
            }

            fn visit_i64<E>(self, weight: i64) -> Result<RateWeight, E> {
                Ok((weight as f64).into())
            }

            fn visit_u64<E>(self, weight: u64) -> Result<RateWeight, E> {
                Ok((weight as f64).into())
            }

            fn visit_str<E: de::Error>(self, word: &str) -> Result<RateWeight, E> {
                if word == RateWeight::WORD {
                    return Ok(RateWeight::Auto);
                }
                Err(E::invalid_value(Unexpected::Str(word), &self))
            }
        }

        deserializer.deserialize_any(WordOrNumber)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for RateWeight {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "RateWeight".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "anyOf": [{ "type": "number" }, { "const": Self::WORD }] })
    }
}

/// A setting that is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {value} is out of range: allowed is {low} to {high}")]
pub struct SettingsError {
    /// Name of the setting.
    pub key: &'static str,
    /// The value found.
    pub value: f64,
    /// Smallest allowed value.
    pub low: f64,
    /// Largest allowed value.
    pub high: f64,
}

/// Allowed ranges of the settings.
pub mod ranges {
    use super::{CONTROL_BLOCKS_MAX, HORIZON_STEPS_MAX, SWARM_MAX};
    use std::ops::RangeInclusive;

    /// Prediction steps.
    pub const HORIZON_STEPS: RangeInclusive<f64> = 1.0..=HORIZON_STEPS_MAX as f64;
    /// Control blocks.
    pub const CONTROL_BLOCKS: RangeInclusive<f64> = 0.0..=CONTROL_BLOCKS_MAX as f64;
    /// Particles of the swarm.
    pub const SWARM_SIZE: RangeInclusive<f64> = 1.0..=SWARM_MAX as f64;
    /// Swarm iterations, and iterations before a regeneration.
    pub const ITERATIONS: RangeInclusive<f64> = 0.0..=1000.0;
    /// Inertia of a particle: the share of its velocity that it keeps.
    pub const INERTIA: RangeInclusive<f64> = 0.0..=1.0;
    /// Swarm coefficients.
    pub const COEFFICIENT: RangeInclusive<f64> = 0.0..=4.0;
    /// Gauss-Newton steps.
    pub const REFINEMENT_STEPS: RangeInclusive<f64> = 0.0..=50.0;
    /// Damping: above zero, because the matrix of a straight robot is singular.
    pub const DAMPING: RangeInclusive<f64> = 1e-20..=1.0;
    /// Weights and penalties in the cost.
    pub const WEIGHT: RangeInclusive<f64> = 0.0..=1e12;
    /// Gain of the posture, per length of the robot.
    pub const POSTURE_GAIN: RangeInclusive<f64> = 0.0..=10.0;
    /// Orientation error that costs nothing \[rad\].
    pub const ORIENTATION_TOLERANCE_RAD: RangeInclusive<f64> = 0.0..=1.0;
    /// Distance kept from obstacles \[m\].
    pub const SAFE_DISTANCE_M: RangeInclusive<f64> = 0.0..=10.0;
    /// Period T \[s\].
    pub const PERIOD_S: RangeInclusive<f64> = 1e-6..=10.0;
    /// Position weight: above zero, or there is nothing to follow.
    pub const POSITION_WEIGHT: RangeInclusive<f64> = 1e-12..=1e12;
}

/// A Gauss-Newton step below this counts as converged: in 5 ms it moves a tip by 1e-15 m.
const STEP_TOLERANCE_RAD_S: f64 = 1e-12;
/// A small position error of the tip \[m\], see [`NmpcSettings::small_cost`].
const SMALL_ERROR_M: f64 = 1e-6;
/// A mean position error below this counts as zero \[m\].
const POSITION_TOLERANCE_M: f64 = 1e-15;

impl NmpcSettings {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// [`SettingsError`] for the first value outside its range, NaN included.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let each = Self::PARAMETERS.iter().zip(self.numbers());
        for (parameter, value) in each {
            if let (Some(range), Some(value)) = (&parameter.range, value) {
                check(parameter.name, value, range.clone())?;
            }
        }
        let steps = f64::from(self.horizon_steps);
        check(
            "control_blocks",
            f64::from(self.control_blocks),
            0.0..=steps,
        )?;
        check(
            "terminal_weight",
            self.terminal_weight,
            self.terminal_range(),
        )?;
        check(
            "obstacle_slope_penalty",
            self.obstacle_slope_penalty,
            self.slope_range(),
        )
    }

    /// Checks the settings, and the period against [`ranges::PERIOD_S`].
    pub(crate) fn validate_with(&self, period_s: f64) -> Result<(), SettingsError> {
        self.validate()?;
        check("period_s", period_s, ranges::PERIOD_S)
    }

    /// With one step, the last step has the only weight, so it must be above zero.
    fn terminal_range(&self) -> std::ops::RangeInclusive<f64> {
        if self.horizon_steps == 1 {
            ranges::POSITION_WEIGHT
        } else {
            ranges::WEIGHT
        }
    }

    /// A constant penalty alone has no gradient and does not prevent collisions. So slope and square together
    /// must reach a millionth of the step penalty at a depth of 1 mm.
    fn slope_range(&self) -> std::ops::RangeInclusive<f64> {
        const DEPTH_M: f64 = 1e-3;
        let square = self.obstacle_square_penalty * DEPTH_M * DEPTH_M;
        let least = (1e-6 * self.obstacle_step_penalty - square).max(0.0) / DEPTH_M;
        least..=*ranges::WEIGHT.end()
    }

    pub(super) fn kpso(&self) -> KpsoSettings {
        KpsoSettings {
            size: self.swarm_size as usize,
            iterations: self.swarm_iterations,
            rule: self.velocity_rule,
            inertia: self.inertia,
            cognitive: self.cognitive,
            social: self.social,
            regenerate_after: self.regenerate_after,
            cost_tolerance: self.cost_tolerance(),
        }
    }

    pub(super) fn gauss_newton(&self) -> GaussNewtonSettings {
        GaussNewtonSettings {
            steps: self.refinement_steps,
            damping: self.damping,
            step_tolerance: STEP_TOLERANCE_RAD_S,
            is_rough: false,
            residuals_max: self.small_cost(),
        }
    }

    /// Cost of a small position error. Below it no search takes place, and the derivatives of the previous
    /// point are accurate enough.
    pub(super) fn small_cost(&self) -> f64 {
        self.position_weight * SMALL_ERROR_M * SMALL_ERROR_M
    }

    /// A cost at or below this is zero to working precision.
    pub(super) fn cost_tolerance(&self) -> f64 {
        let steps = f64::from(self.horizon_steps);
        steps * self.position_weight * POSITION_TOLERANCE_M * POSITION_TOLERANCE_M
    }
}

/// Rejects a value outside its range, NaN included.
fn check(
    key: &'static str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
) -> Result<(), SettingsError> {
    let (low, high) = range.into_inner();
    let error = SettingsError {
        key,
        value,
        low,
        high,
    };
    (low..=high).contains(&value).then_some(()).ok_or(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_settings_are_legal_and_bad_ones_say_what_is_allowed() {
        assert_eq!(NmpcSettings::default().validate(), Ok(()));
        let bad = NmpcSettings {
            swarm_size: 1000,
            ..NmpcSettings::default()
        };
        let error = bad.validate().expect_err("too many particles");
        assert_eq!(
            error.to_string(),
            "swarm_size = 1000 is out of range: allowed is 1 to 512"
        );
        let bad = NmpcSettings {
            inertia: f64::NAN,
            ..NmpcSettings::default()
        };
        assert_eq!(bad.validate().expect_err("NaN").key, "inertia");
        let bad = NmpcSettings {
            control_blocks: 3,
            ..NmpcSettings::default()
        };
        assert_eq!(bad.validate().expect_err("M > N").high, 2.0);
        // With one step, the last step is the only one.
        let weightless = |horizon_steps| NmpcSettings {
            horizon_steps,
            terminal_weight: 0.0,
            ..NmpcSettings::default()
        };
        assert_eq!(weightless(2).validate(), Ok(()));
        let error = weightless(1).validate().expect_err("nothing to follow");
        assert_eq!((error.key, error.low), ("terminal_weight", 1e-12));
    }
}
