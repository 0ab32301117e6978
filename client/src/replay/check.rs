use core::fmt;

/// The first difference of a cycle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Number of the cycle.
    pub cycle: u64,
    /// Field of the record, with an index for an array: `plan[3]`.
    pub what: String,
    /// Recorded value.
    pub recorded: String,
    /// Computed value.
    pub computed: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            cycle,
            what,
            recorded,
            computed,
        } = self;
        write!(
            f,
            "cycle {cycle}: {what} is {recorded} in the recording, but {computed} recomputed"
        )
    }
}

/// Compares computed values with a record, and keeps the first difference.
#[derive(Debug)]
pub(super) struct Check {
    cycle: u64,
    first: Option<Difference>,
}

impl Check {
    pub(super) fn new(cycle: u64) -> Self {
        Self { cycle, first: None }
    }

    pub(super) fn first(self) -> Option<Difference> {
        self.first
    }

    /// Compares numbers bit by bit.
    pub(super) fn numbers(&mut self, what: &str, recorded: &[f64], computed: &[f64]) {
        let mut pairs = recorded.iter().zip(computed);
        let odd = pairs.position(|(recorded, computed)| recorded.to_bits() != computed.to_bits());
        if let Some(i) = odd {
            let texts = (format!("{:?}", recorded[i]), format!("{:?}", computed[i]));
            self.note(format!("{what}[{i}]"), texts);
        } else if recorded.len() != computed.len() {
            let texts = (recorded.len().to_string(), computed.len().to_string());
            self.note(format!("length of {what}"), texts);
        }
    }

    /// Compares one number bit by bit.
    pub(super) fn number(&mut self, what: &str, recorded: f64, computed: f64) {
        if recorded.to_bits() != computed.to_bits() {
            let texts = (format!("{recorded:?}"), format!("{computed:?}"));
            self.note(what.to_owned(), texts);
        }
    }

    /// Compares a word, a count or a flag.
    pub(super) fn same<T: PartialEq + fmt::Display + Copy>(
        &mut self,
        what: &str,
        recorded: T,
        computed: T,
    ) {
        if recorded != computed {
            self.note(
                what.to_owned(),
                (recorded.to_string(), computed.to_string()),
            );
        }
    }

    fn note(&mut self, what: String, (recorded, computed): (String, String)) {
        self.first.get_or_insert(Difference {
            cycle: self.cycle,
            what,
            recorded,
            computed,
        });
    }
}
