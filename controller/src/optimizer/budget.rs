/// How much a solve may still do: a closure that says whether it is spent.
///
/// The solvers announce their work piece by piece ([`Budget::spend`]), and the closure is asked once in
/// each *quantum* of about [`QUANTUM_NS`]. It may read a clock (the daemon), count (a replay:
/// [`Budget::of_quanta`]) or never end ([`Budget::unlimited`]). Once it answered "spent" it is not asked
/// again.
#[derive(Debug)]
pub struct Budget<F> {
    is_spent: F,
    passed: u32,
    over: bool,
    /// Work since the closure was asked \[ns\].
    meter_ns: u32,
}

/// Work between two looks at the budget, in nominal nanoseconds of a processor with vector registers.
/// Others take some times longer, and stay below 5 µs.
pub const QUANTUM_NS: u32 = 1500;

/// A budget whose closure is behind a pointer.
pub type ErasedBudget<'a> = Budget<&'a mut dyn FnMut() -> bool>;

impl Budget<fn() -> bool> {
    /// A budget that never ends; the iteration limits bound the work.
    pub fn unlimited() -> Self {
        Self::new(|| false)
    }
}

impl<F: FnMut() -> bool> Budget<F> {
    /// A budget that is spent when `is_spent` answers true.
    pub fn new(is_spent: F) -> Self {
        Self {
            is_spent,
            passed: 0,
            over: false,
            meter_ns: 0,
        }
    }

    /// The same budget with its closure behind a pointer, for `work`: code that takes it is compiled once,
    /// not once for each closure.
    pub fn erased<R>(&mut self, work: impl FnOnce(&mut ErasedBudget) -> R) -> R {
        let mut erased = Budget {
            is_spent: &mut self.is_spent as &mut dyn FnMut() -> bool,
            passed: self.passed,
            over: self.over,
            meter_ns: self.meter_ns,
        };
        let result = work(&mut erased);
        (self.passed, self.over, self.meter_ns) = (erased.passed, erased.over, erased.meter_ns);
        result
    }

    /// Announces a piece of work of about `work_ns`, at most a quantum, and says whether it may be done.
    #[inline]
    pub fn spend(&mut self, work_ns: u32) -> bool {
        self.meter_ns += work_ns;
        if self.meter_ns < QUANTUM_NS {
            return !self.over;
        }
        self.left()
    }

    /// Asks whether another quantum may begin.
    pub fn left(&mut self) -> bool {
        self.meter_ns = 0;
        if !self.over {
            self.over = (self.is_spent)();
            self.passed += u32::from(!self.over);
        }
        !self.over
    }

    /// Quanta begun so far: the measure of the work done, the same on every machine.
    pub fn passed(&self) -> u32 {
        self.passed
    }

    /// Whether the budget ended the work.
    pub fn is_over(&self) -> bool {
        self.over
    }
}

/// A budget of exactly `quanta` pieces of work: what a replay uses to repeat a recorded solve.
impl Budget<()> {
    /// See the type.
    pub fn of_quanta(quanta: u32) -> Budget<impl FnMut() -> bool> {
        let mut left = quanta;
        Budget::new(move || {
            let spent = left == 0;
            left = left.saturating_sub(1);
            spent
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_work_add_up_to_quanta() {
        let mut budget = Budget::of_quanta(1);
        assert!(
            (0..14).all(|_| budget.spend(100)),
            "the first quantum is free of questions"
        );
        assert_eq!(budget.passed(), 0);
        assert!(budget.spend(100));
        assert_eq!(budget.passed(), 1);
        assert!((0..14).all(|_| budget.spend(100)) && !budget.spend(100) && !budget.spend(0));
    }

    #[test]
    fn counts_what_it_let_pass_and_stays_spent() {
        let mut budget = Budget::of_quanta(2);
        assert!(budget.left() && budget.left() && !budget.left() && !budget.left());
        assert_eq!((budget.passed(), budget.is_over()), (2, true));
        assert!(Budget::unlimited().left());
    }
}
