//! Instruction sets and their selection.

use std::env;
use std::sync::OnceLock;

use pulp::{Scalar, WithSimd};

/// The environment variable that forces an instruction set.
const VARIABLE: &str = "JITAI_SIMD";

/// An instruction set that this processor has.
#[derive(Clone, Copy, Debug)]
pub enum Isa {
    /// 16 lanes of f32.
    #[cfg(target_arch = "x86_64")]
    Avx512(pulp::x86::V4),
    /// 8 lanes of f32.
    #[cfg(target_arch = "x86_64")]
    Avx2(pulp::x86::V3),
    /// 4 lanes of f32.
    #[cfg(target_arch = "aarch64")]
    Neon(pulp::aarch64::Neon),
    /// One number at a time; fused multiply-adds are emulated in software where the processor has none.
    Portable(Scalar),
}

/// A forced instruction set that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{VARIABLE} is `{wanted}`; expected one of the instruction sets of this machine: {}",
    Isa::names()
)]
pub struct IsaError {
    wanted: String,
}

fn wanted() -> Result<Isa, IsaError> {
    Isa::by_name(env::var(VARIABLE).ok().as_deref())
}

impl Isa {
    /// The instruction sets of this processor, fastest first.
    pub fn available() -> Vec<Isa> {
        let mut available = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            available.extend(pulp::x86::V4::try_new().map(Isa::Avx512));
            available.extend(pulp::x86::V3::try_new().map(Isa::Avx2));
        }
        #[cfg(target_arch = "aarch64")]
        available.extend(pulp::aarch64::Neon::try_new().map(Isa::Neon));
        available.push(Isa::Portable(Scalar::new()));
        available
    }

    /// The instruction set to use: the set that `JITAI_SIMD` names, or else the fastest. Falls back to the
    /// portable set if the processor lacks the named set; [`Isa::check_choice`] reports that case.
    pub fn chosen() -> Isa {
        static CHOSEN: OnceLock<Isa> = OnceLock::new();
        *CHOSEN.get_or_init(|| wanted().unwrap_or(Isa::Portable(Scalar::new())))
    }

    /// Checks that this processor has the instruction set that `JITAI_SIMD` names.
    ///
    /// **Errors**: `JITAI_SIMD` names an instruction set that this processor does not have.
    pub fn check_choice() -> Result<(), IsaError> {
        wanted().map(|_| ())
    }

    fn by_name(wanted: Option<&str>) -> Result<Isa, IsaError> {
        let mut available = Isa::available().into_iter();
        match wanted {
            None | Some("") => available.next(),
            Some(wanted) => available.find(|isa| isa.name() == wanted),
        }
        .ok_or_else(|| IsaError { wanted: wanted.unwrap_or_default().to_owned() })
    }

    /// The name of the set, as in `JITAI_SIMD`.
    pub fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512(_) => "avx512",
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2(_) => "avx2",
            #[cfg(target_arch = "aarch64")]
            Isa::Neon(_) => "neon",
            Isa::Portable(_) => "portable",
        }
    }

    fn names() -> String {
        Isa::available().into_iter().map(Isa::name).collect::<Vec<_>>().join(", ")
    }

    /// Runs an operation compiled for this instruction set.
    #[inline]
    pub fn run<Op: WithSimd>(self, operation: Op) -> Op::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512(simd) => pulp::Simd::vectorize(simd, operation),
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2(simd) => pulp::Simd::vectorize(simd, operation),
            #[cfg(target_arch = "aarch64")]
            Isa::Neon(simd) => pulp::Simd::vectorize(simd, operation),
            Isa::Portable(simd) => pulp::Simd::vectorize(simd, operation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_available_set_can_be_asked_for_and_no_other() {
        for isa in Isa::available() {
            assert_eq!(Isa::by_name(Some(isa.name())).unwrap().name(), isa.name());
        }
        let fastest = Isa::available()[0].name();
        assert_eq!(Isa::by_name(None).unwrap().name(), fastest);
        let error = Isa::by_name(Some("mmx")).unwrap_err().to_string();
        assert!(error.starts_with("JITAI_SIMD is `mmx`; expected one of "), "{error}");
        assert!(error.ends_with("portable"), "{error}");
    }
}
