//! The reasons for undefined statistics, which tables print in place of a number.

/// Why a statistic is undefined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Undefined {
    /// No seed of an arm has a value.
    #[error("no seed completed")]
    NoSeeds,
    /// The statistic needs more seeds.
    #[error("too few seeds: {have} of at least {need}")]
    TooFewSeeds {
        /// Number of seeds in the smaller arm, or in common.
        have: usize,
        /// Number of seeds that the statistic needs.
        need: usize,
    },
    /// A p-value of the level needs more simulated trials without the effect.
    #[error("too few other trials without the effect for p ≤ 0.05: {have} of at least {need}")]
    TooFewReferences {
        /// The smallest number of such trials beside a trial's own twin.
        have: usize,
        /// The number that a p-value of the level needs.
        need: usize,
    },
    /// No seed completed in both arms.
    #[error("no seed in common")]
    NoMatchedSeeds,
    /// The values do not differ between seeds by more than rounding.
    #[error("no variance between seeds")]
    NoVariance,
    /// The optimum of the arms' environment is not known.
    #[error(
        "no optimum known: it needs a completed job of a scenario that shows H and D, in an environment \
         whose optimum can be computed; where messages cost steps, it is that of mean_net_return"
    )]
    NoOptimum,
    /// The loss is not known to be above 0, so that a share of it has no bounds.
    #[error("loss not significantly above 0")]
    NoLoss,
    /// The true effect was not simulated in every trial.
    #[error(
        "no truth known; `truth = true` in [[estimate]] has it simulated, if enough people can be treated and no \
         outside program takes part"
    )]
    NoTruth,
    /// Of the trials whose interval excludes 0 there is none.
    #[error("no interval excludes 0")]
    NoFinding,
    /// The true effect is 0, which has no sign and no size.
    #[error("the true effect is 0")]
    NoEffect,
    /// Every group of trials gives the same number.
    #[error("no Monte Carlo error: the number is the same without each group of trials")]
    NoMonteCarloError,
    /// The largest or the smallest of some trials, which groups of trials give no interval.
    #[error("a maximum or minimum over trials has no Monte Carlo interval")]
    Extreme,
    /// An exact answer would take too long.
    #[error("too many permutations to enumerate")]
    Infeasible,
    /// An intermediate number is infinite, NaN or outside its domain.
    #[error("numbers out of range")]
    OutOfRange,
}

/// Returns the number if it is finite.
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
