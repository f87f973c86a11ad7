//! Why a statistic has no answer: the reasons that a table prints in its place.

/// Why a statistic is not defined for what it was given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Undefined {
    /// No seed of an arm has a value.
    #[error("no seed completed")]
    NoSeeds,
    /// The statistic needs more seeds.
    #[error("too few seeds: {have}, and {need} are needed")]
    TooFewSeeds {
        /// Seeds there are in the smaller arm, or in common.
        have: usize,
        /// Seeds the statistic needs there.
        need: usize,
    },
    /// The arms have no seed in common that completed in both.
    #[error("no seed in common")]
    NoMatchedSeeds,
    /// The values do not differ between seeds by more than rounding.
    #[error("no variance between seeds")]
    NoVariance,
    /// An exact answer would take too long.
    #[error("too many arrangements to count")]
    Infeasible,
    /// A number on the way is too large, not a number, or outside of where it has a meaning.
    #[error("numbers out of range")]
    OutOfRange,
}

/// The number itself if it is finite.
pub(super) fn finite(number: f64) -> Result<f64, Undefined> {
    if number.is_finite() { Ok(number) } else { Err(Undefined::OutOfRange) }
}

/// Checks that there are enough seeds.
pub(super) fn at_least(need: usize, have: usize) -> Result<(), Undefined> {
    match have {
        0 => Err(Undefined::NoSeeds),
        have if have < need => Err(Undefined::TooFewSeeds { have, need }),
        _ => Ok(()),
    }
}
