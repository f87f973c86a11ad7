//! Equal failures, listed once with their number.

use crate::job::counted;
use crate::key::printable;
use crate::store::FailedJob;

/// The failed jobs of an experiment with the same kind of failure and the same message up to its numbers.
pub struct SameFailure<'f> {
    /// The first of these jobs.
    pub first: &'f FailedJob,
    /// The number of these jobs.
    pub jobs: usize,
}

impl SameFailure<'_> {
    /// The failure in words, after the name of its first job: `and 2 more jobs: diverged (…)`.
    pub fn described(&self, name: &str) -> String {
        let failure = &self.first.failure;
        let others = match self.jobs {
            1 => String::new(),
            jobs => format!(" and {}", more(jobs - 1)),
        };
        format!("{name}{others}: {} ({})", failure.kind, printable(&failure.message))
    }
}

/// A message without its numbers, which differ between jobs that failed in the same way.
pub fn without_numbers(message: &str) -> String {
    let mut plain = message.replace(|c: char| c.is_ascii_digit(), "#");
    while plain.contains("##") {
        plain = plain.replace("##", "#");
    }
    plain
}

/// `1 more job`, `2 more jobs`.
pub fn more(jobs: usize) -> String {
    counted(jobs, "more job")
}

/// The different failures, in the order in which each occurs first.
pub fn different<'f>(failed: impl IntoIterator<Item = &'f FailedJob>) -> Vec<SameFailure<'f>> {
    let mut indices = std::collections::HashMap::new();
    let mut different: Vec<SameFailure<'f>> = Vec::new();
    for job in failed {
        let message = without_numbers(&job.failure.message);
        let failure = (&job.experiment, job.failure.kind.word(), message);
        let index = *indices.entry(failure).or_insert(different.len());
        match different.get_mut(index) {
            Some(same) => same.jobs += 1,
            None => different.push(SameFailure { first: job, jobs: 1 }),
        }
    }
    different
}

#[cfg(test)]
mod tests {
    use super::without_numbers;

    #[test]
    fn messages_that_differ_in_numbers_are_the_same() {
        let message = |update, loss| format!("the loss of update {update} is {loss}");
        assert_eq!(without_numbers(&message(7, "NaN")), without_numbers(&message(123, "NaN")));
        assert_ne!(without_numbers(&message(7, "NaN")), without_numbers(&message(7, "infinite")));
        assert_ne!(without_numbers("1"), without_numbers(""));
    }
}
