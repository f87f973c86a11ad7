//! A subset of the participants of a test: those between two quantiles of a parameter.

use std::fmt;

/// The participants of a job's test whose parameter lies between two of its quantiles.
///
/// The n participants of a job are ranked 0 to n - 1 by the parameter's value, ties by episode. The range
/// has the participants with `from` <= rank / n < `to`. In jobs with equal seeds and populations, the range
/// has the same people.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParticipantRange {
    /// The parameter, as `[population]` calls it.
    pub parameter: &'static str,
    /// Its index among the parameters of participants.
    pub index: u8,
    /// The lower end, in [0, 1).
    pub from: f64,
    /// The upper end, in (0, 1].
    pub to: f64,
}

impl ParticipantRange {
    /// Whether the range has the participant of this rank, among `of` participants.
    pub fn contains(&self, rank: usize, of: usize) -> bool {
        let share = rank as f64 / of as f64;
        share >= self.from && (share < self.to || self.to == 1.0)
    }
}

impl fmt::Display for ParticipantRange {
    /// Writes the participants in words: "the 20 % of participants with the largest delta_d".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ParticipantRange { parameter, from, to, .. } = self;
        // Percent, rounded to one decimal.
        let percent = |share: f64| (share * 1000.0).round() / 10.0;
        if *to == 1.0 {
            let share = percent(1.0 - from);
            write!(f, "the {share} % of participants with the largest {parameter}")
        } else if *from == 0.0 {
            write!(f, "the {} % of participants with the smallest {parameter}", percent(*to))
        } else {
            let (from, to) = (percent(*from), percent(*to));
            write!(f, "participants between the {from} % and the {to} % quantile of {parameter}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(from: f64, to: f64) -> ParticipantRange {
        ParticipantRange { parameter: "delta_d", index: 3, from, to }
    }

    #[test]
    fn fifths_hold_a_fifth_each_and_everybody_once() {
        let fifths = [0.0, 0.2, 0.4, 0.6, 0.8].map(|from| range(from, from + 0.2));
        let fifths = [fifths[0], fifths[1], range(0.4, 0.6), range(0.6, 0.8), range(0.8, 1.0)];
        for count in [5, 1000] {
            for rank in 0..count {
                let held = fifths.iter().filter(|fifth| fifth.contains(rank, count)).count();
                assert_eq!(held, 1, "{rank} of {count}");
            }
            let last = (0..count).filter(|rank| fifths[4].contains(*rank, count)).count();
            assert_eq!(last, count / 5);
        }
        assert!(range(0.0, 1.0).contains(0, 1));
    }

    #[test]
    fn ranges_read_well() {
        let said = |from, to| range(from, to).to_string();
        assert_eq!(said(0.8, 1.0), "the 20 % of participants with the largest delta_d");
        assert_eq!(said(0.0, 0.25), "the 25 % of participants with the smallest delta_d");
        assert_eq!(
            said(0.4, 0.6),
            "participants between the 40 % and the 60 % quantile of delta_d"
        );
    }
}
