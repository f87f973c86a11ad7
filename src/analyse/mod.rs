//! Statistics and findings from records: pure functions without database or output.
//!
//! The unit of analysis is the trained policy (a seed), never the test episode. Statistics take
//! [`Sample`]s, with one value per seed, or the values of samples. An undefined statistic is an
//! [`Undefined`] with the reason that a table prints, never a NaN. `docs/statistics.md` lists all
//! statistics with their sources.

mod agreement;
mod beyond_chance;
mod bootstrap;
mod contrast;
pub mod declared;
mod effect_size;
mod grouped;
mod improvement;
mod interval;
mod moments;
mod monte_carlo;
mod multiplicity;
mod noncentral;
mod operating;
mod permutation;
mod power;
mod quantile;
mod recovery;
mod sample;
mod smooth;
mod t_test;
mod undefined;

#[cfg(test)]
mod invariance_tests;
#[cfg(test)]
mod reference_tests;

pub use agreement::{Agreement, Likeness, UncertainNumber, Verdict, agreement};
pub use beyond_chance::{ALPHA as CHANCE, BeyondChance, beyond_chance};
pub use bootstrap::{Aggregate, RESAMPLES, interquartile_mean};
pub use contrast::{Contrast, SeedPairing, t_test};
pub use effect_size::{HedgesG, hedges_g, paired_hedges_g};
pub use grouped::grouped;
pub use improvement::{Improvement, improvement, paired_improvement};
pub use interval::{Interval, LEVEL, mean_interval, share_interval};
pub use moments::{Moments, mean_and_sd};
pub use monte_carlo::{jackknife, monte_carlo_p};
pub use multiplicity::{Corrected, correct};
pub use operating::{Along, Crossing, Formula, MonteCarloMean, Operating, TrialEstimate, crossing};
pub use permutation::{MOST_ARRANGEMENTS, paired_permutation_p, permutation_p};
pub use power::{Detectable, FEW_SEEDS, POWER, detectable};
pub use quantile::{lower_quartile, quantile};
pub use recovery::{Recovered, recovered};
pub use sample::{DuplicateSeed, Lost, Sample};
pub use smooth::moving_mean;
pub use t_test::{TTest, paired_t_test, student_t_test, unpaired_t_test};
pub use undefined::Undefined;
