//! `--shard 3/40`: one of n disjoint parts of the jobs of manifests.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};
use std::fmt;
use std::num::NonZeroU32;
use std::str::FromStr;

use crate::job::JobKey;

/// Maximum number of shards; more than any cluster has cores.
const MOST_SHARDS: u32 = 1_000_000;

/// One of several disjoint parts, counted from 1.
///
/// The jobs of a shard depend only on the set of all jobs. They are the same on every machine, for any
/// earlier runs and any order of the jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    number: NonZeroU32,
    of: NonZeroU32,
}

/// Why a text is not a shard.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ShardError {
    /// Not two whole numbers with a slash between them.
    #[error("expected a number, a slash and the number of shards, such as 3/40")]
    Form,
    /// The number of shards is 0 or too large.
    #[error("expected 1 to {MOST_SHARDS} shards, found {0}")]
    Of(u64),
    /// The number of the shard is out of range.
    #[error("shards are counted from 1 to {of}, found {number}")]
    Number {
        /// The number.
        number: u64,
        /// The number of shards.
        of: u32,
    },
}

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        let whole = |text: &str| -> Result<u64, ShardError> {
            let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
            let number = digits.then(|| text.parse().unwrap_or(u64::MAX));
            number.ok_or(ShardError::Form)
        };
        let (number, of) = text.split_once('/').ok_or(ShardError::Form)?;
        let (number, of) = (whole(number)?, whole(of)?);
        let shards = u32::try_from(of).ok().filter(|of| *of <= MOST_SHARDS);
        let shards = shards.and_then(NonZeroU32::new).ok_or(ShardError::Of(of))?;
        let inside = u32::try_from(number).ok().and_then(NonZeroU32::new);
        let inside = inside.filter(|inside| *inside <= shards);
        let number = inside.ok_or(ShardError::Number { number, of: shards.get() })?;
        Ok(Shard { number, of: shards })
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl Shard {
    /// The keys of the jobs in this shard, given all jobs with their work. Repeated jobs count once.
    ///
    /// Jobs are assigned in descending order of work, each to the shard with the least work so far. The
    /// work of two shards then differs by at most the work of one job.
    pub fn keys(self, jobs: impl IntoIterator<Item = (JobKey, u64)>) -> HashSet<JobKey> {
        let jobs: HashMap<JobKey, u64> = jobs.into_iter().collect();
        let mut jobs: Vec<(Reverse<u64>, JobKey)> =
            jobs.into_iter().map(|(key, work)| (Reverse(work), key)).collect();
        jobs.sort_unstable();
        let parts = (1..=self.of.get()).map(|number| Reverse((0_u128, 0_usize, number)));
        let mut parts: BinaryHeap<_> = parts.collect();
        let mut keys = HashSet::new();
        for (Reverse(work), key) in jobs {
            let Some(mut least) = parts.peek_mut() else { break };
            let Reverse((sum, count, number)) = &mut *least;
            if *number == self.number.get() {
                keys.insert(key);
            }
            *sum += u128::from(work);
            *count += 1;
        }
        keys
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Stream};

    /// The parts into which `of` shards divide the jobs.
    fn parts(jobs: &[(JobKey, u64)], of: u32) -> Vec<HashSet<JobKey>> {
        let shard = |number: u32| format!("{number}/{of}").parse::<Shard>().unwrap();
        (1..=of).map(|number| shard(number).keys(jobs.iter().copied())).collect()
    }

    /// Jobs with keys from a stream and with work spread over `powers` powers of two.
    fn jobs(stream: &mut Stream, count: usize, powers: u32) -> Vec<(JobKey, u64)> {
        let mut number = |below: f64| (stream.unit() * below) as u64;
        let mut one = || {
            let key = u128::from(number(1e18)) << 64 | u128::from(number(1e18));
            let power = number(f64::from(powers)) as i32;
            (JobKey(key.to_be_bytes()), 1 + number(2_f64.powi(power)))
        };
        (0..count).map(|_| one()).collect()
    }

    #[test]
    fn shards_are_disjoint_complete_and_alike() {
        let mut stream = Stream::new(35, Purpose::Environment);
        for round in 0..200 {
            let of = 1 + (stream.unit() * 40.0) as u32;
            let count = (stream.unit() * 60.0 * f64::from(of)) as usize;
            let jobs = jobs(&mut stream, count, 1 + round % 30);
            let found = parts(&jobs, of);
            let all: HashSet<JobKey> = jobs.iter().map(|(key, _)| *key).collect();
            assert_eq!(found.iter().map(HashSet::len).sum::<usize>(), all.len());
            assert_eq!(found.iter().flatten().copied().collect::<HashSet<_>>(), all);

            let works: HashMap<JobKey, u64> = jobs.iter().copied().collect();
            let work = |part: &HashSet<JobKey>| part.iter().map(|key| works[key]).sum::<u64>();
            let (least, most) = found
                .iter()
                .map(work)
                .fold((u64::MAX, 0), |(least, most), work| (least.min(work), most.max(work)));
            let largest = works.values().max().copied().unwrap_or(0);
            assert!(most - least <= largest, "{least} {most} {largest}");
        }
    }

    #[test]
    fn shards_depend_on_nothing_but_the_jobs() {
        let mut stream = Stream::new(1, Purpose::Environment);
        let mut jobs = jobs(&mut stream, 500, 3);
        let before = parts(&jobs, 7);
        jobs.reverse();
        jobs.extend_from_within(..50);
        assert_eq!(parts(&jobs, 7), before);
    }

    #[test]
    fn more_shards_than_jobs_leave_some_empty() {
        let jobs = [(JobKey([1; 16]), 5), (JobKey([2; 16]), 0)];
        let sizes: Vec<usize> = parts(&jobs, 4).iter().map(HashSet::len).collect();
        assert_eq!(sizes, [1, 1, 0, 0]);
    }

    #[test]
    fn shards_are_read_and_faulty_ones_refused() {
        assert_eq!("3/40".parse::<Shard>().unwrap().to_string(), "3/40");
        for (text, expected) in [
            ("0/4", ShardError::Number { number: 0, of: 4 }),
            ("5/4", ShardError::Number { number: 5, of: 4 }),
            ("1/0", ShardError::Of(0)),
            ("1/9999999999999999999999", ShardError::Of(u64::MAX)),
            ("a/b", ShardError::Form),
            ("3", ShardError::Form),
            ("-1/4", ShardError::Form),
            ("1/4/4", ShardError::Form),
            (" 1/4", ShardError::Form),
            ("/", ShardError::Form),
        ] {
            assert_eq!(text.parse::<Shard>(), Err(expected), "{text}");
        }
    }
}
