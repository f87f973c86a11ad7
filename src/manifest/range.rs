//! The arithmetic of ranges: `{ from, to, step }` and `{ from, to, count, scale }` become lists.
//!
//! A job is identified by its content, so a range has to give the very numbers that an author
//! would have typed: 0.1 + 2 × 0.1 must be 0.3. Values between the ends are therefore rounded to 12
//! significant decimal digits.

/// Most values that one range may have.
pub(super) const MOST_VALUES: u64 = 1_000_000;

/// How the values of a range are spaced; counts are from 2 to [`MOST_VALUES`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Spacing<N> {
    /// This far apart.
    Step(N),
    /// So many values, equally far apart.
    Linear(u64),
    /// So many values, each the same multiple of the one before.
    Log(u64),
}

/// Why a range has no list of values.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(super) enum RangeError {
    /// The ends are equal or the wrong way round.
    #[error("`from` must be below `to`")]
    Ends,
    /// The step does not land on the upper end.
    #[error("steps of {step} from {from} do not arrive at {to}: the last one below it is {last}")]
    Misses { from: String, to: String, step: String, last: String },
    /// There are too many values.
    #[error("a range has at most {MOST_VALUES} values, this step makes more")]
    TooLong,
    /// A logarithmic range touches zero or goes below it.
    #[error("a logarithmic range must be above 0 at both ends")]
    LogOfZero,
    /// Equally spaced whole numbers do not exist.
    #[error("{count} whole numbers cannot be equally spaced from {from} to {to}")]
    Uneven { from: u64, to: u64, count: u64 },
    /// Rounding to whole numbers made two values equal.
    #[error("two of the {count} values from {from} to {to} round to the same whole number")]
    Repeats { from: u64, to: u64, count: u64 },
}

/// The numbers of a range, both ends included.
pub(super) fn reals(from: f64, to: f64, spacing: Spacing<f64>) -> Result<Vec<f64>, RangeError> {
    if from >= to {
        return Err(RangeError::Ends);
    }
    let linear = |count: u64| {
        let decimals = decimals(from.abs().max(to.abs()));
        let part = move |i: u64| i as f64 / (count - 1) as f64;
        list(from, to, count, move |i| round_at(from + (to - from) * part(i), decimals))
    };
    match spacing {
        Spacing::Step(step) => {
            let steps = ((to - from) / step).round();
            if steps >= MOST_VALUES as f64 {
                return Err(RangeError::TooLong);
            }
            if steps < 1.0 || (from + steps * step - to).abs() > 1e-9 * (to - from) {
                let last = from + ((to - from) / step).floor() * step;
                let last = round_at(last, decimals(from.abs().max(to.abs())));
                let [from, to, step, last] = [from, to, step, last].map(|x| format!("{x:?}"));
                return Err(RangeError::Misses { from, to, step, last });
            }
            Ok(linear(steps as u64 + 1))
        }
        Spacing::Linear(count) => Ok(linear(count)),
        Spacing::Log(_) if from <= 0.0 => Err(RangeError::LogOfZero),
        Spacing::Log(count) => Ok(list(from, to, count, |i| round(log_point(from, to, i, count)))),
    }
}

/// The whole numbers of a range, both ends included.
pub(super) fn integers(from: u64, to: u64, spacing: Spacing<u64>) -> Result<Vec<u64>, RangeError> {
    if from >= to {
        return Err(RangeError::Ends);
    }
    let width = to - from;
    let stepping = |step: u64| (0..=width / step).map(|i| from + i * step).collect();
    match spacing {
        Spacing::Step(step) if width / step >= MOST_VALUES => Err(RangeError::TooLong),
        Spacing::Step(step) if !width.is_multiple_of(step) => {
            let last = from + width / step * step;
            let [from, to, step, last] = [from, to, step, last].map(|n| n.to_string());
            Err(RangeError::Misses { from, to, step, last })
        }
        Spacing::Step(step) => Ok(stepping(step)),
        Spacing::Linear(count) if !width.is_multiple_of(count - 1) => {
            Err(RangeError::Uneven { from, to, count })
        }
        Spacing::Linear(count) => Ok(stepping(width / (count - 1))),
        Spacing::Log(_) if from == 0 => Err(RangeError::LogOfZero),
        Spacing::Log(count) => {
            let point = |i| log_point(from as f64, to as f64, i, count).round() as u64;
            let values = list(from, to, count, point);
            let rises = values.windows(2).all(|pair| pair[0] < pair[1]);
            if rises { Ok(values) } else { Err(RangeError::Repeats { from, to, count }) }
        }
    }
}

/// The ends as given, and `inner(i)` between them.
fn list<N>(from: N, to: N, count: u64, inner: impl Fn(u64) -> N) -> Vec<N> {
    let between = (1..count - 1).map(inner);
    std::iter::once(from).chain(between).chain(std::iter::once(to)).collect()
}

fn log_point(from: f64, to: f64, i: u64, count: u64) -> f64 {
    from * (to / from).powf(i as f64 / (count - 1) as f64)
}

/// Decimals that give a number of this size 12 significant digits.
fn decimals(size: f64) -> usize {
    (11.0 - size.log10().floor()).clamp(0.0, 300.0) as usize
}

fn round_at(x: f64, decimals: usize) -> f64 {
    let rounded: f64 = format!("{x:.decimals$}").parse().expect("formatted from a finite number");
    // A sum that cancels may come out as -0, which would be another job than 0.
    if rounded == 0.0 { 0.0 } else { rounded }
}

fn round(x: f64) -> f64 {
    format!("{x:.11e}").parse().expect("formatted from a finite number")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_gives_the_numbers_an_author_would_type() {
        assert_eq!(reals(0.1, 0.4, Spacing::Step(0.1)), Ok(vec![0.1, 0.2, 0.3, 0.4]));
        assert_eq!(reals(0.1, 0.4, Spacing::Linear(4)), Ok(vec![0.1, 0.2, 0.3, 0.4]));
        assert_eq!(reals(-0.3, 0.3, Spacing::Step(0.3)), Ok(vec![-0.3, 0.0, 0.3]));
        assert!(reals(-0.3, 0.3, Spacing::Step(0.1)).unwrap()[3].is_sign_positive());
        assert_eq!(reals(1e-6, 1e-2, Spacing::Log(5)), Ok(vec![1e-6, 1e-5, 1e-4, 1e-3, 1e-2]));
        let hundredths = reals(0.0, 2.0, Spacing::Step(0.01)).unwrap();
        let typed: Vec<f64> = (0..=200).map(|i| format!("{i}e-2").parse().unwrap()).collect();
        assert_eq!(hundredths, typed);
    }

    #[test]
    fn whole_numbers_stay_whole() {
        assert_eq!(integers(32, 256, Spacing::Log(4)), Ok(vec![32, 64, 128, 256]));
        assert_eq!(integers(0, 10, Spacing::Step(5)), Ok(vec![0, 5, 10]));
        assert_eq!(integers(1, 10, Spacing::Linear(4)), Ok(vec![1, 4, 7, 10]));
        assert_eq!(
            integers(1, 10, Spacing::Linear(5)),
            Err(RangeError::Uneven { from: 1, to: 10, count: 5 })
        );
        assert_eq!(
            integers(1, 3, Spacing::Log(9)),
            Err(RangeError::Repeats { from: 1, to: 3, count: 9 })
        );
    }

    #[test]
    fn a_range_that_cannot_include_both_ends_is_refused() {
        let misses = reals(0.0, 1.0, Spacing::Step(0.3)).unwrap_err();
        assert_eq!(
            misses.to_string(),
            "steps of 0.3 from 0.0 do not arrive at 1.0: the last one below it is 0.9"
        );
        assert!(matches!(reals(0.0, 1.0, Spacing::Step(5.0)), Err(RangeError::Misses { .. })));
        assert!(matches!(integers(0, 10, Spacing::Step(3)), Err(RangeError::Misses { .. })));
        assert_eq!(reals(1.0, 1.0, Spacing::Linear(2)), Err(RangeError::Ends));
        assert_eq!(reals(0.0, 1.0, Spacing::Log(3)), Err(RangeError::LogOfZero));
    }

    #[test]
    fn a_tiny_step_is_refused_before_anything_is_built() {
        assert!(matches!(reals(0.0, 1e6, Spacing::Step(5e-324)), Err(RangeError::TooLong)));
        assert!(matches!(integers(0, u64::MAX, Spacing::Step(1)), Err(RangeError::TooLong)));
    }
}
