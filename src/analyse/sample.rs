//! Samples, the input of every statistic: one value per trained policy.
//!
//! A sample keeps its seeds, so that arms can be matched, and counts the seeds without a value, so
//! that tables can report them. It stores neither its arm nor its metric.

use super::undefined::Undefined;
use super::{Interval, Moments, mean_interval, share_interval};

/// The values of one metric of an arm, by seed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    seeds: Vec<u64>,
    values: Vec<f64>,
    lost: Lost,
    /// All seeds that the arm was given, ascending, where they are known.
    given: Vec<u64>,
    /// Whether the values are shares, from 0 to 1.
    are_shares: bool,
}

/// Numbers of seeds of an arm without a value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// Seeds whose last run failed.
    pub failed: u32,
    /// Seeds whose job has not ended.
    pub open: u32,
    /// Seeds that completed with an infinite, NaN or missing value.
    pub not_finite: u32,
}

impl Lost {
    /// Seeds that ended without a value. Open seeds may still get one.
    pub fn ended(self) -> u32 {
        self.failed + self.not_finite
    }
}

/// A seed with two values, which means that the jobs belong to more than one arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("seed {seed} occurs twice in one arm; distinguish its jobs by the parameter that differs")]
pub struct DuplicateSeed {
    /// The seed.
    pub seed: u64,
}

impl Sample {
    /// The sample of these seeds and values, in any order. Values that are not finite are left out
    /// and counted.
    ///
    /// **Errors**: a seed occurs twice.
    pub fn new(
        values: impl IntoIterator<Item = (u64, f64)>,
        failed: u32,
        open: u32,
    ) -> Result<Sample, DuplicateSeed> {
        let mut pairs: Vec<(u64, f64)> = values.into_iter().collect();
        pairs.sort_by_key(|(seed, _)| *seed);
        if let Some(twice) = pairs.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(DuplicateSeed { seed: twice[0].0 });
        }
        let given: Vec<u64> = pairs.iter().map(|(seed, _)| *seed).collect();
        pairs.retain(|(_, value)| value.is_finite());
        let not_finite = u32::try_from(given.len() - pairs.len()).unwrap_or(u32::MAX);
        let (seeds, values) = pairs.into_iter().unzip();
        let lost = Lost { failed, open, not_finite };
        Ok(Sample { seeds, values, lost, given, are_shares: false })
    }

    /// The sample with all seeds that its arm was given, those without a value included.
    pub fn with_given(self, seeds: impl IntoIterator<Item = u64>) -> Sample {
        let mut given: Vec<u64> = seeds.into_iter().collect();
        given.sort_unstable();
        given.dedup();
        Sample { given, ..self }
    }

    /// All seeds that the arm was given, ascending; those that have a value, if others are not known.
    pub fn given(&self) -> &[u64] {
        &self.given
    }

    /// The sample with the values of the seeds that also have a value in the other sample.
    pub fn shared_with(&self, other: &Sample) -> Sample {
        let is_shared = |seed: &u64| other.seeds.binary_search(seed).is_ok();
        let pairs = self.seeds.iter().copied().zip(self.values.iter().copied());
        let (seeds, values) = pairs.filter(|(seed, _)| is_shared(seed)).unzip();
        Sample { seeds, values, ..self.clone() }
    }

    /// The sample as one of shares, from 0 to 1, whose interval stays between both.
    pub fn of_shares(self) -> Sample {
        Sample { are_shares: true, ..self }
    }

    /// Values in ascending order of seed, all finite.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Seeds that have a value, ascending.
    pub fn seeds(&self) -> &[u64] {
        &self.seeds
    }

    /// Number of values.
    pub fn n(&self) -> usize {
        self.values.len()
    }

    /// Number of seeds, those without a value included.
    pub fn declared(&self) -> usize {
        self.n() + (self.lost.ended() + self.lost.open) as usize
    }

    /// The mean over seeds.
    ///
    /// **Errors**: no seed has a value.
    pub fn mean(&self) -> Result<f64, Undefined> {
        Moments::of(&self.values).map(|moments| moments.mean)
    }

    /// The standard deviation over seeds.
    ///
    /// **Errors**: fewer than two seeds have a value.
    pub fn sd(&self) -> Result<f64, Undefined> {
        Moments::of(&self.values).and_then(|moments| moments.sd)
    }

    /// The interval of the mean over seeds.
    ///
    /// **Errors**: as [`mean_interval`].
    pub fn interval(&self) -> Result<Interval, Undefined> {
        if self.are_shares { share_interval(&self.values) } else { mean_interval(&self.values) }
    }

    /// Seeds without a value.
    pub fn lost(&self) -> Lost {
        self.lost
    }

    /// Pairs of values of the seeds that both samples have, in ascending order of seed.
    ///
    /// **Errors**: a sample is empty, or the samples have no seed in common.
    pub fn matched(&self, other: &Sample) -> Result<Vec<(f64, f64)>, Undefined> {
        let of_other = |seed| other.seeds.binary_search(seed).ok().map(|at| other.values[at]);
        let both = self.seeds.iter().zip(&self.values);
        let pairs: Vec<(f64, f64)> =
            both.filter_map(|(seed, &value)| Some((value, of_other(seed)?))).collect();
        match (self.n().min(other.n()), pairs.len()) {
            (0, _) => Err(Undefined::NoSeeds),
            (_, 0) => Err(Undefined::NoMatchedSeeds),
            _ => Ok(pairs),
        }
    }
}

/// The sample of these values, with the seeds 1, 2 and so on.
#[cfg(test)]
pub(super) fn sample(values: &[f64]) -> Sample {
    Sample::new((1..).zip(values.iter().copied()), 0, 0).unwrap()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stand_by_seed_and_the_lost_are_counted() {
        let sample = Sample::new([(3, 1.0), (1, f64::NAN), (2, 5.0)], 2, 1).unwrap();
        assert_eq!((sample.seeds(), sample.values()), ([2, 3].as_slice(), [5.0, 1.0].as_slice()));
        assert_eq!(sample.lost(), Lost { failed: 2, open: 1, not_finite: 1 });
        assert_eq!(sample.lost().ended(), 3);
    }

    #[test]
    fn a_seed_that_comes_twice_is_no_arm() {
        assert_eq!(Sample::new([(1, 0.0), (1, 2.0)], 0, 0), Err(DuplicateSeed { seed: 1 }));
        assert!(Sample::new([(1, f64::NAN), (1, 2.0)], 0, 0).is_err());
    }

    #[test]
    fn seeds_are_matched_by_their_number_and_not_by_position() {
        let first = Sample::new([(1, 10.0), (2, 20.0), (4, 40.0)], 0, 0).unwrap();
        let second = Sample::new([(4, 4.0), (3, 3.0), (2, 2.0)], 0, 0).unwrap();
        assert_eq!(first.matched(&second).unwrap(), [(20.0, 2.0), (40.0, 4.0)]);
        let apart = Sample::new([(9, 0.0)], 0, 0).unwrap();
        assert_eq!(first.matched(&apart), Err(Undefined::NoMatchedSeeds));
        assert_eq!(first.matched(&Sample::default()), Err(Undefined::NoSeeds));
    }
}
