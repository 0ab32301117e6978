//! A script: the messages for a robot's daemon, and the cycles between them. Its text form is used for
//! failures and for the corpus.

use std::fmt;

use cdcr_shared_types::{Measurement, ObstacleUpdate, ReferenceChunk, Request};

use crate::fuzz::fields::{Fields, fields, name};

/// The clock at the begin of every script \[ns\].
pub(crate) const BEGIN_NS: u64 = 1_000_000_000_000;
/// The period of every script \[ns\].
pub(crate) const PERIOD_NS: u64 = 5_000_000;

#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Robot {
    pub(crate) sections: u32,
    /// 1: behind a driver; 0: simulated.
    pub(crate) driver: u32,
}
fields!(Robot { sections, driver });

/// A number of cycles.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Run {
    pub(crate) cycles: u32,
    /// Skipped periods before the first cycle.
    pub(crate) skipped: u32,
    /// 1: before each cycle a correct driver measures the commanded configuration.
    pub(crate) measured: u32,
    /// 0: free, 1: held, else: expired.
    pub(crate) lease: u32,
}
fields!(Run {
    cycles,
    skipped,
    measured,
    lease
});

#[derive(Clone)]
#[allow(clippy::large_enum_variant, reason = "few of them, short-lived")]
pub(crate) enum Step {
    Robot(Robot),
    Run(Run),
    Chunk(ReferenceChunk),
    Update(ObstacleUpdate),
    Measurement(Measurement),
    Request(Request),
}

impl Step {
    const NAMES: [&str; 6] = [
        "robot",
        "run",
        "reference",
        "obstacles",
        "measurement",
        "request",
    ];

    fn new(name: &str) -> Option<Self> {
        Some(match name {
            "robot" => Self::Robot(Robot::default()),
            "run" => Self::Run(Run::default()),
            "reference" => Self::Chunk(ReferenceChunk::default()),
            "obstacles" => Self::Update(ObstacleUpdate::default()),
            "measurement" => Self::Measurement(Measurement::default()),
            "request" => Self::Request(Request::default()),
            _ => return None,
        })
    }

    fn name(&self) -> &'static str {
        Self::NAMES[match self {
            Self::Robot(_) => 0,
            Self::Run(_) => 1,
            Self::Chunk(_) => 2,
            Self::Update(_) => 3,
            Self::Measurement(_) => 4,
            Self::Request(_) => 5,
        }]
    }

    fn for_each(
        &mut self,
        visit: impl FnMut(&[crate::fuzz::fields::PathStep], crate::fuzz::fields::Number<'_>),
    ) {
        match self {
            Self::Robot(fields) => fields.for_each(visit),
            Self::Run(fields) => fields.for_each(visit),
            Self::Chunk(fields) => fields.for_each(visit),
            Self::Update(fields) => fields.for_each(visit),
            Self::Measurement(fields) => fields.for_each(visit),
            Self::Request(fields) => fields.for_each(visit),
        }
    }
}

/// Steps, beginning with the robot.
#[derive(Clone)]
pub(crate) struct Script(pub(crate) Vec<Step>);

impl Script {
    /// Parses the text form: `[message]`, then a line `field = value` for each nonzero field. A line that
    /// begins with `#` is a comment.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let mut steps: Vec<Step> = Vec::new();
        for (line, text) in (1..).zip(text.lines().map(str::trim)) {
            let wrong =
                || format!("line {line}: {text:?} is no [message] and no field = value of one");
            if text.is_empty() || text.starts_with('#') {
            } else if let Some(kind) = text.strip_prefix('[').and_then(|t| t.strip_suffix(']')) {
                steps.push(Step::new(kind).ok_or_else(wrong)?);
            } else {
                let (field, value) = text.split_once(" = ").ok_or_else(wrong)?;
                let mut found = None;
                steps
                    .last_mut()
                    .ok_or_else(wrong)?
                    .for_each(|path, mut number| {
                        if name(path) == field {
                            found = number.parse(value);
                        }
                    });
                found.ok_or_else(wrong)?;
            }
        }
        Ok(Self(steps))
    }
}

impl fmt::Display for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for step in &self.0 {
            writeln!(f, "[{}]", step.name())?;
            let mut lines = String::new();
            step.clone().for_each(|path, number| {
                if number.bits() != 0 {
                    lines.extend([&name(path), " = ", &number.to_string(), "\n"]);
                }
            });
            f.write_str(&lines)?;
        }
        Ok(())
    }
}

/// A failure shows the text form.
impl fmt::Debug for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\n{self}")
    }
}

#[test]
fn a_script_comes_back_from_its_text() {
    let mut measurement = Measurement {
        measured_ns: u64::MAX,
        ..Measurement::default()
    };
    measurement.bend_rad[..4].copy_from_slice(&[
        -0.0,
        f64::from_bits(0xfff0_0000_0000_0001),
        1e-310,
        0.1,
    ]);
    let script = Script(vec![
        Step::Robot(Robot {
            sections: 3,
            driver: 1,
        }),
        Step::Measurement(measurement),
        Step::Run(Run {
            cycles: 2,
            ..Run::default()
        }),
    ]);
    let text = script.to_string();
    assert_eq!(Script::parse(&text).unwrap().to_string(), text);
    assert!(
        text.contains("\n[measurement]\nmeasured_ns = 18446744073709551615\nbend_rad[0] = -0.0\n")
    );
    assert!(text.contains("\nbend_rad[1] = bits 0xfff0000000000001\n"));
    for wrong in [
        "[robots]",
        "sections = 3",
        "[robot]\nsection = 3",
        "[robot]\nsections = x",
    ] {
        assert!(Script::parse(wrong).is_err(), "{wrong}");
    }
}
