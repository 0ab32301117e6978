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
    /// Number of quanta at which the present part of the work ends.
    part_end: u32,
    /// Whether only the part is spent.
    is_part_spent: bool,
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
            part_end: u32::MAX,
            is_part_spent: false,
        }
    }

    /// Does a part of the work, which ends when the whole has `quanta` quanta. The rest of the budget is left to what
    /// follows.
    pub fn until<R>(&mut self, quanta: u32, part: impl FnOnce(&mut Self) -> R) -> R {
        let whole_end = self.part_end;
        self.part_end = whole_end.min(quanta);
        let result = part(self);
        self.part_end = whole_end;
        if self.is_part_spent {
            (self.spent, self.is_part_spent) = (false, false);
        }
        result
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

    /// Announces pieces of work as if by [`Self::spend`], one after another. Returns whether all may be done.
    #[inline]
    pub(super) fn spend_each(&mut self, mut pieces_ns: impl Iterator<Item = u32> + Clone) -> bool {
        let sum_ns: u32 = pieces_ns.clone().sum();
        if !self.spent && self.meter_ns + sum_ns < QUANTUM_NS {
            self.meter_ns += sum_ns;
            return true;
        }
        pieces_ns.all(|work_ns| self.spend(work_ns))
    }

    /// Begins a new quantum if the budget is not spent. Returns whether it did.
    pub fn begin_quantum(&mut self) -> bool {
        self.meter_ns = 0;
        if !self.spent && self.quanta >= self.part_end {
            (self.spent, self.is_part_spent) = (true, true);
        }
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

    /// Whether no more work may be done, in the whole or in the present part ([`Self::until`]).
    pub fn is_spent(&self) -> bool {
        self.spent
    }

    /// Whether the whole budget is spent.
    pub fn is_whole_spent(&self) -> bool {
        self.spent && !self.is_part_spent
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
    fn pieces_announced_together_count_as_one_by_one() {
        let (mut together, mut single) = (Budget::from_quanta(9), Budget::from_quanta(9));
        for pieces in (0..90).map(|length| (0..length).map(|piece| 7 * piece)) {
            let mut each = pieces.clone();
            let is_left = each.all(|work_ns| single.spend(work_ns));
            assert_eq!(together.spend_each(pieces), is_left);
            assert_eq!(
                (together.quanta(), together.meter_ns),
                (single.quanta(), single.meter_ns)
            );
        }
        assert!(together.is_spent());
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
    #[test]
    fn a_part_ends_before_the_whole_and_leaves_the_rest() {
        let mut budget = Budget::from_quanta(3);
        let ends = |budget: &mut Budget<'_>| {
            while budget.begin_quantum() {}
            (budget.quanta(), budget.is_spent(), budget.is_whole_spent())
        };
        assert_eq!(budget.until(2, ends), (2, true, false));
        assert!(!budget.is_spent());
        assert_eq!(budget.until(9, ends), (3, true, true));
        assert!(budget.is_whole_spent() && !budget.until(9, Budget::begin_quantum));
    }
}
