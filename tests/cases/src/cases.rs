//! Number and choice of the fuzz cases, and the shares of accepted ones.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::sync::Once;

use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngSeed, TestRunner};

/// Runs `test` on a quarter of `cases` values of `strategy`, on all of them with `CDCR_WHOLE`, always the
/// same ones. With `CDCR_FUZZ_CASES` (or `PROPTEST_CASES`), it runs at least that many, different ones each
/// time.
pub fn try_cases<S: Strategy>(cases: u32, strategy: S, test: impl Fn(S::Value)) {
    let asked = cases_asked();
    let least = match std::env::var_os("CDCR_WHOLE") {
        Some(_) => cases,
        None => cases / 4,
    };
    let mut config = Config {
        cases: asked.map_or(least, |asked| asked.max(least)),
        failure_persistence: None,
        max_shrink_iters: 4096,
        max_shrink_time: 60_000,
        ..Config::default()
    };
    if asked.is_none() && config.rng_seed == RngSeed::Random {
        config.rng_seed = RngSeed::Fixed(1);
    }
    let outcome = quietly(|| {
        TestRunner::new(config).run(&strategy, |value| {
            test(value);
            Ok(())
        })
    });
    if let Err(failure) = outcome {
        panic!("{failure}\nkeep the input, see docs/fuzzing.md");
    }
}

/// Runs `work` without the panic messages, of which shrinking produces thousands.
fn quietly<R>(work: impl FnOnce() -> R) -> R {
    thread_local!(static QUIET: Cell<bool> = const { Cell::new(false) });
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let report = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !QUIET.get() {
                report(panic);
            }
        }));
    });
    QUIET.set(true);
    let result = work();
    QUIET.set(false);
    result
}

/// Number of cases in the environment.
pub fn cases_asked() -> Option<u32> {
    let names = ["CDCR_FUZZ_CASES", "PROPTEST_CASES"];
    names.into_iter().find_map(crate::asked)
}

/// Counts accepted and rejected cases, so that a target that rejects everything at the first check fails.
#[derive(Debug, Default)]
pub struct Tally {
    counts: RefCell<BTreeMap<&'static str, [u32; 2]>>,
}

impl Tally {
    pub fn count(&self, kind: &'static str, accepted: bool) {
        self.counts.borrow_mut().entry(kind).or_default()[usize::from(accepted)] += 1;
    }

    /// At least this share of the cases of `kind` was accepted, and at least this share rejected.
    pub fn both_at_least(&self, kind: &'static str, share: f64) {
        let [refused, accepted] = self.counts.borrow().get(kind).copied().unwrap_or_default();
        println!("{kind}: {accepted} accepted, {refused} refused");
        let least = share * f64::from(refused + accepted);
        assert!(
            refused + accepted > 0 && f64::from(accepted) >= least && f64::from(refused) >= least,
            "{kind}: {accepted} accepted and {refused} refused; at least {least} of each are due"
        );
    }

    /// At least one case of `kind` was accepted.
    pub fn happened(&self, kind: &'static str) {
        let [_, accepted] = self.counts.borrow().get(kind).copied().unwrap_or_default();
        println!("{kind}: {accepted} times");
        assert!(accepted > 0, "{kind} never happened");
    }
}
