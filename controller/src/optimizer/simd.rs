use pulp::{NullaryFnOnce, WithSimd};

/// The instructions that compute the swarm. The same work gives the same bits with all of them; they differ in speed. Under
/// a limited budget that holds for all but the scalar one, whose quanta hold one particle instead of eight.
/// Each is compiled whole, which takes seconds: a release has those that run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Simd {
    /// One particle after the other: the reference for tests and benchmarks. Only with the feature `scalar`.
    #[cfg(any(test, feature = "scalar"))]
    Scalar,
    /// Eight particles side by side, with the instructions that every processor of the target has.
    Portable,
    /// Eight particles in two 256-bit registers (x86-64 with AVX2).
    Avx2,
    /// Eight particles in one 512-bit register (x86-64 with AVX-512).
    Avx512,
}

impl Simd {
    /// Those of this processor, slowest first.
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

    /// The fastest of this processor.
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

    /// Runs `work` compiled for these instructions; those that this processor lacks are replaced by the portable ones.
    ///
    /// `work` is large and inlined whole, so each arm that calls it is paid for by the compiler: there is one
    /// for each set of instructions.
    #[cfg(target_arch = "x86_64")]
    pub(super) fn run<R>(self, work: impl WithSimd<Output = R>) -> R {
        if self == Self::Avx512
            && let Some(processor) = pulp::x86::V4::try_new()
        {
            return avx512::run(processor, work);
        }
        if self == Self::Avx2
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
}

/// Runs `work`, inlined whole, as a function of its own for these instructions. Where it is called from makes no difference: what
/// several callers share is compiled once for each set of instructions, and their own functions stay small.
#[inline(never)]
pub(crate) fn apart<W: NullaryFnOnce>(instructions: impl pulp::Simd, work: W) -> W::Output {
    instructions.vectorize(work)
}

// A module for each set of instructions, because a module is a code generation unit: the compiler works on
// them side by side.

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
