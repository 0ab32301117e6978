//! The system calls allowed in a cycle, enforced by the kernel.

use std::collections::BTreeMap;

use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter,
    SeccompRule, apply_filter,
};

/// `FUTEX_WAKE | FUTEX_PRIVATE_FLAG` (`futex(2)`): a wake-up inside one process.
const WAKE: u64 = 1 | 128;
/// `MADV_DONTNEED` (`madvise(2)`).
const DONT_NEED: u64 = 4;

/// From now on, the calling thread and its process die of SIGSYS at any system call except
///
/// - its sleep (`clock_nanosleep`), its wake-up of the exchange (`futex`, wake only), and clock reads, which
///   are not system calls where the clock is read without the kernel;
/// - the end of a thread (`exit`, and the release of its stacks: `munmap`, `madvise` to free pages,
///   `sigaltstack`, `rt_sigprocmask`), because a filter cannot be removed. In a cycle only the heap could
///   make one of these, and the heap is forbidden, too.
///
/// Allocates, so call it before the heap is forbidden.
pub fn forbid_system_calls() {
    let always = Vec::new;
    let with = |argument, value| {
        let is = SeccompCondition::new(argument, SeccompCmpArgLen::Dword, SeccompCmpOp::Eq, value);
        vec![SeccompRule::new(vec![is.expect("a legal filter")]).expect("a legal filter")]
    };
    let allowed: BTreeMap<i64, Vec<SeccompRule>> = [
        (libc::SYS_clock_nanosleep, always()),
        (libc::SYS_clock_gettime, always()),
        (libc::SYS_futex, with(1, WAKE)),
        (libc::SYS_madvise, with(2, DONT_NEED)),
        (libc::SYS_munmap, always()),
        (libc::SYS_sigaltstack, always()),
        (libc::SYS_rt_sigprocmask, always()),
        (libc::SYS_exit, always()),
    ]
    .into();
    let architecture = std::env::consts::ARCH.try_into().expect("a legal filter");
    let filter = SeccompFilter::new(
        allowed,
        SeccompAction::Trap,
        SeccompAction::Allow,
        architecture,
    );
    let program: BpfProgram = filter
        .expect("a legal filter")
        .try_into()
        .expect("a legal filter");
    apply_filter(&program).expect("a legal filter");
}
