//! Cases measured in turn, round by round: a disturbance of the machine affects only one round.

use std::collections::BTreeMap;

use anyhow::Result;
use serde_json::Value;

use crate::interrupt;
use crate::progress::Progress;

pub(crate) struct StudyCase<'a> {
    pub(crate) table: &'static str,
    pub(crate) what: String,
    pub(crate) expected_s: f64,
    pub(crate) measure: Box<dyn Fn(u32) -> Result<Vec<Value>> + 'a>,
}

#[derive(Default)]
pub(crate) struct Rounds(BTreeMap<&'static str, Vec<Vec<Value>>>);

impl Rounds {
    /// Empty if nothing of that table was measured.
    pub(crate) fn get(&self, table: &str) -> &[Vec<Value>] {
        self.0.get(table).map_or(&[], Vec::as_slice)
    }
}

pub(crate) fn expected_s(rounds: u32, cases: &[StudyCase<'_>]) -> f64 {
    f64::from(rounds) * cases.iter().map(|case| case.expected_s).sum::<f64>()
}

pub(crate) fn run(rounds: u32, cases: &[StudyCase<'_>], progress: &mut Progress) -> Result<Rounds> {
    let mut found = Rounds::default();
    for round in 1..=rounds {
        for case in cases {
            interrupt::check()?;
            progress.begin(&format!("round {round} of {rounds}: {}", case.what));
            let of_table = found.0.entry(case.table).or_default();
            of_table.resize(round as usize, Vec::new());
            of_table[round as usize - 1].extend((case.measure)(round)?);
            progress.advance(case.expected_s);
        }
    }
    Ok(found)
}
