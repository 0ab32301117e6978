use core::fmt;

/// Limit on the work of a solve.
///
/// The solvers announce each piece of work ([`Budget::spend`]). Once in each *quantum* of about
/// [`QUANTUM_NS`] the budget checks its end condition. This is a closure that may read a clock
/// ([`Budget::new`], the daemon), a count ([`Budget::from_quanta`], a replay) or none ([`Budget::unlimited`]).
/// Once the budget is spent, the condition is not checked again.
#[derive(Debug)]
pub struct Budget<'a> {
    end: End<'a>,
    quanta: u32,
    spent: bool,
    /// Work since the last check \[ns\].
    meter_ns: u32,
}

/// End condition of a budget.
enum End<'a> {
    Never,
    AfterQuanta(u32),
    When(&'a mut dyn FnMut() -> bool),
}

impl fmt::Debug for End<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Never => write!(f, "Never"),
            Self::AfterQuanta(quanta) => write!(f, "AfterQuanta({quanta})"),
            Self::When(_) => write!(f, "When(..)"),
        }
    }
}

/// Work between two checks of the budget, in nominal nanoseconds of a processor with vector registers. Other
/// processors take a few times longer, but less than 5 µs.
pub const QUANTUM_NS: u32 = 1500;

impl<'a> Budget<'a> {
    /// A budget that is spent when `is_spent` returns true.
    pub fn new(is_spent: &'a mut dyn FnMut() -> bool) -> Self {
        Self::from_end(End::When(is_spent))
    }

    /// A budget that never ends; the iteration limits bound the work.
    pub fn unlimited() -> Self {
        Self::from_end(End::Never)
    }

    /// A budget of exactly `quanta` quanta, with which a replay repeats a recorded solve.
    pub fn from_quanta(quanta: u32) -> Self {
        Self::from_end(End::AfterQuanta(quanta))
    }

    fn from_end(end: End<'a>) -> Self {
        Self {
            end,
            quanta: 0,
            spent: false,
            meter_ns: 0,
        }
    }

    /// Announces a piece of work of about `work_ns`, at most a quantum. Returns whether it may be done.
    #[inline]
    pub fn spend(&mut self, work_ns: u32) -> bool {
        self.meter_ns += work_ns;
        if self.meter_ns < QUANTUM_NS {
            return !self.spent;
        }
        self.begin_quantum()
    }

    /// Begins a new quantum if the budget is not spent. Returns whether it did.
    pub fn begin_quantum(&mut self) -> bool {
        self.meter_ns = 0;
        if !self.spent {
            self.spent = match &mut self.end {
                End::Never => false,
                End::AfterQuanta(quanta) => self.quanta == *quanta,
                End::When(is_spent) => is_spent(),
            };
            self.quanta += u32::from(!self.spent);
        }
        !self.spent
    }

    /// Quanta begun so far: a measure of the work that is the same on every machine.
    pub fn quanta(&self) -> u32 {
        self.quanta
    }

    /// Whether the budget ended the work.
    pub fn is_spent(&self) -> bool {
        self.spent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_work_add_up_to_quanta() {
        let mut budget = Budget::from_quanta(1);
        assert!(
            (0..14).all(|_| budget.spend(100)),
            "the first quantum is free of questions"
        );
        assert_eq!(budget.quanta(), 0);
        assert!(budget.spend(100));
        assert_eq!(budget.quanta(), 1);
        assert!((0..14).all(|_| budget.spend(100)) && !budget.spend(100) && !budget.spend(0));
    }

    #[test]
    fn counts_what_it_let_pass_and_stays_spent() {
        let mut budget = Budget::from_quanta(2);
        assert!(
            budget.begin_quantum()
                && budget.begin_quantum()
                && !budget.begin_quantum()
                && !budget.begin_quantum()
        );
        assert_eq!((budget.quanta(), budget.is_spent()), (2, true));
        assert!(Budget::unlimited().begin_quantum());
    }
}
