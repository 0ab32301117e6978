use pulp::{NullaryFnOnce, WithSimd};

/// Instruction sets for the swarm and the smoother of long plans. With the same work, all give the same bits at
/// different speeds. Under a limited budget, `Scalar` gives other bits, because its quanta contain one particle instead of eight. Each
/// variant takes seconds to compile, so a release contains only those it can use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Simd {
    /// One particle at a time: the reference for tests and benchmarks. Only with the feature `scalar`.
    #[cfg(any(test, feature = "scalar"))]
    Scalar,
    /// Eight particles at once, with the base instructions of the target.
    Portable,
    /// Eight particles at once in two 256-bit registers (x86-64 with AVX2).
    Avx2,
    /// Eight particles at once in one 512-bit register (x86-64 with AVX-512).
    Avx512,
}

impl Simd {
    /// Instruction sets of this processor, slowest first.
    pub fn available() -> impl Iterator<Item = Self> {
        [
            #[cfg(any(test, feature = "scalar"))]
            Self::Scalar,
            Self::Portable,
            Self::Avx2,
            Self::Avx512,
        ]
        .into_iter()
        .filter(|simd| simd.is_available())
    }

    /// The fastest instruction set of this processor.
    pub fn best() -> Self {
        Self::available().last().unwrap_or(Self::Portable)
    }

    #[cfg(target_arch = "x86_64")]
    fn is_available(self) -> bool {
        match self {
            #[cfg(any(test, feature = "scalar"))]
            Self::Scalar => true,
            Self::Portable => true,
            Self::Avx2 => pulp::x86::V3::try_new().is_some(),
            Self::Avx512 => pulp::x86::V4::try_new().is_some(),
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn is_available(self) -> bool {
        !matches!(self, Self::Avx2 | Self::Avx512)
    }

    /// Runs `work` compiled for this instruction set, or for the portable one if the processor does not
    /// support it.
    ///
    /// `work` is large and fully inlined. Each type of it, one for the swarm, is compiled once for each instruction set,
    /// which takes time.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn run<R>(self, work: impl WithSimd<Output = R>) -> R {
        if self == Self::Avx512
            && let Some(processor) = pulp::x86::V4::try_new()
        {
            return avx512::run(processor, work);
        }
        self.run_narrow(work)
    }

    /// As [`Self::run`], with AVX2 in the place of AVX-512: for the smoother, whose short rows take longer with AVX-512.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn run_narrow<R>(self, work: impl WithSimd<Output = R>) -> R {
        if matches!(self, Self::Avx2 | Self::Avx512)
            && let Some(processor) = pulp::x86::V3::try_new()
        {
            return avx2::run(processor, work);
        }
        portable::run(work)
    }

    #[cfg(not(target_arch = "x86_64"))]
    pub(super) fn run<R>(self, work: impl WithSimd<Output = R>) -> R {
        portable::run(work)
    }

    #[cfg(not(target_arch = "x86_64"))]
    pub(super) fn run_narrow<R>(self, work: impl WithSimd<Output = R>) -> R {
        self.run(work)
    }
}

/// Runs `work` in a separate function, compiled for `instructions`. Code shared by several callers is
/// compiled once for each instruction set, and the callers stay small. The result does not depend on the
/// caller.
#[inline(never)]
pub(crate) fn run_outlined<W: NullaryFnOnce>(instructions: impl pulp::Simd, work: W) -> W::Output {
    instructions.vectorize(work)
}

// One module for each instruction set: a module is a code generation unit, so the compiler works on them in
// parallel.

mod portable {
    #[inline(never)]
    pub(super) fn run<W: pulp::WithSimd>(work: W) -> W::Output {
        work.with_simd(pulp::Scalar)
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    #[inline(never)]
    pub(super) fn run<W: pulp::WithSimd>(processor: pulp::x86::V3, work: W) -> W::Output {
        pulp::Simd::vectorize(processor, work)
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    #[inline(never)]
    pub(super) fn run<W: pulp::WithSimd>(processor: pulp::x86::V4, work: W) -> W::Output {
        pulp::Simd::vectorize(processor, work)
    }
}
