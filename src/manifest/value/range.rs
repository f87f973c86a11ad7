//! The arithmetic of ranges: `{ from, to, step }` and `{ from, to, count, scale }` become lists.
//!
//! A job is identified by its content, so a range must give the numbers that an author would type: 0.1 + 2
//! × 0.1 must be 0.3. Values between the ends are therefore rounded to 12 significant decimal digits. If
//! the rounded values do not rise strictly from one end to the other, the range is rejected: a value would
//! be repeated or lie outside the ends.

/// Maximum number of values of one range.
pub(in crate::manifest) const MOST_VALUES: u64 = 1_000_000;

/// Maximum number of values of all lists and ranges of a manifest.
pub(in crate::manifest) const MOST_VALUES_IN_ALL: u64 = 2_000_000;

/// How the values of a range are spaced; counts are from 2 to [`MOST_VALUES`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::manifest) enum Spacing<N> {
    /// A constant difference.
    Step(N),
    /// A number of equally spaced values.
    Linear(u64),
    /// A number of values with a constant ratio.
    Log(u64),
}

/// Why a range has no list of values.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(in crate::manifest) enum RangeError {
    /// The ends are equal or in the wrong order.
    #[error("`from` must be below `to`")]
    Ends,
    /// The steps miss the upper end.
    #[error(
        "steps of {step} from {from} do not reach {to} exactly: the last value below it is {last}"
    )]
    Misses { from: String, to: String, step: String, last: String },
    /// There are too many values.
    #[error("a range has at most {MOST_VALUES} values; choose a larger step")]
    TooLong,
    /// There are more values than the rest of the manifest leaves.
    #[error("the lists and ranges of a manifest have at most {MOST_VALUES_IN_ALL} values in all")]
    TooManyInAll,
    /// The lower end of a logarithmic range is not above 0.
    #[error("a logarithmic range must be above 0 at both ends")]
    LogOfZero,
    /// The whole numbers would not be equally spaced.
    #[error("{count} whole numbers cannot be equally spaced from {from} to {to}")]
    Uneven { from: u64, to: u64, count: u64 },
    /// Rounding to decimal digits made two values equal, or put one outside the ends.
    #[error(
        "the step is too small for the values: rounded to 12 significant digits, {before} is \
         followed by {after}"
    )]
    TooFine { before: String, after: String },
    /// Rounding to whole numbers made two values equal.
    #[error("two of the {count} values from {from} to {to} round to the same whole number")]
    Repeats { from: u64, to: u64, count: u64 },
}

/// The numbers of a range, both ends included, if there are at most `most`.
pub(in crate::manifest) fn reals(
    from: f64,
    to: f64,
    spacing: Spacing<f64>,
    most: u64,
) -> Result<Vec<f64>, RangeError> {
    if from >= to {
        return Err(RangeError::Ends);
    }
    let decimals = decimals(from.abs().max(to.abs()));
    let part = |i: u64, count: u64| i as f64 / (count - 1) as f64;
    let values = match spacing {
        Spacing::Step(step) => {
            let count = steps(from, to, step, decimals)? + 1;
            fit(count, most)?;
            list(from, to, count, |i| round_at(from + (to - from) * part(i, count), decimals))
        }
        Spacing::Linear(count) => {
            fit(count, most)?;
            list(from, to, count, |i| round_at(from + (to - from) * part(i, count), decimals))
        }
        Spacing::Log(_) if from <= 0.0 => return Err(RangeError::LogOfZero),
        Spacing::Log(count) => {
            fit(count, most)?;
            list(from, to, count, |i| round(log_point(from, to, part(i, count))))
        }
    };
    match values.windows(2).find(|pair| pair[0] >= pair[1]) {
        None => Ok(values),
        Some(pair) => {
            let [before, after] = [pair[0], pair[1]].map(|x| format!("{x:?}"));
            Err(RangeError::TooFine { before, after })
        }
    }
}

/// The number of steps from one end to the other.
fn steps(from: f64, to: f64, step: f64, decimals: usize) -> Result<u64, RangeError> {
    let steps = ((to - from) / step).round();
    if steps >= MOST_VALUES as f64 {
        return Err(RangeError::TooLong);
    }
    if steps < 1.0 || (from + steps * step - to).abs() > 1e-9 * (to - from) {
        let last = round_at(from + ((to - from) / step).floor() * step, decimals);
        let [from, to, step, last] = [from, to, step, last].map(|x| format!("{x:?}"));
        return Err(RangeError::Misses { from, to, step, last });
    }
    Ok(steps as u64)
}

/// Rejects more values than a range, or the rest of the manifest, may have.
fn fit(count: u64, most: u64) -> Result<(), RangeError> {
    match count {
        _ if count > MOST_VALUES => Err(RangeError::TooLong),
        _ if count > most => Err(RangeError::TooManyInAll),
        _ => Ok(()),
    }
}

/// The whole numbers of a range, both ends included, if there are at most `most`.
pub(in crate::manifest) fn integers(
    from: u64,
    to: u64,
    spacing: Spacing<u64>,
    most: u64,
) -> Result<Vec<u64>, RangeError> {
    if from >= to {
        return Err(RangeError::Ends);
    }
    let width = to - from;
    let stepping = |step: u64| {
        fit(width / step + 1, most)?;
        Ok((0..=width / step).map(|i| from + i * step).collect())
    };
    match spacing {
        Spacing::Step(step) if width / step >= MOST_VALUES => Err(RangeError::TooLong),
        Spacing::Step(step) if !width.is_multiple_of(step) => {
            let last = from + width / step * step;
            let [from, to, step, last] = [from, to, step, last].map(|n| n.to_string());
            Err(RangeError::Misses { from, to, step, last })
        }
        Spacing::Step(step) => stepping(step),
        Spacing::Linear(count) if !width.is_multiple_of(count - 1) => {
            Err(RangeError::Uneven { from, to, count })
        }
        Spacing::Linear(count) => stepping(width / (count - 1)),
        Spacing::Log(_) if from == 0 => Err(RangeError::LogOfZero),
        Spacing::Log(count) => {
            fit(count, most)?;
            let part = |i: u64| i as f64 / (count - 1) as f64;
            let point = |i| log_point(from as f64, to as f64, part(i)).round() as u64;
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

/// The point at a fraction `part` of the distance between the ends, on a logarithmic scale.
fn log_point(from: f64, to: f64, part: f64) -> f64 {
    from * libm::pow(to / from, part)
}

/// The number of decimals that gives numbers of this size 12 significant digits.
fn decimals(size: f64) -> usize {
    (11.0 - libm::log10(size).floor()).clamp(0.0, 300.0) as usize
}

fn round_at(x: f64, decimals: usize) -> f64 {
    let rounded = round_by_arithmetic(x, decimals).unwrap_or_else(|| {
        format!("{x:.decimals$}").parse().expect("formatted from a finite number")
    });
    // Cancellation can give -0, which would make another job than 0.
    if rounded == 0.0 { 0.0 } else { rounded }
}

/// The number rounded to `decimals` decimals without formatting; `None` if the bits could differ from
/// formatting, which takes a third of a second for a range of a million values.
fn round_by_arithmetic(x: f64, decimals: usize) -> Option<f64> {
    /// Powers of ten up to this exponent are exact.
    const LAST_EXACT_POWER: usize = 22;
    /// Below this value, the rounding error of a product is below 0.001.
    const LARGEST: f64 = 4e12;
    if decimals > LAST_EXACT_POWER {
        return None;
    }
    let power = (0..decimals).fold(1.0, |power, _| power * 10.0);
    let scaled = x * power;
    let near_half = ((scaled - scaled.floor()) - 0.5).abs() < 1e-3;
    // IEEE division rounds correctly, as parsing a decimal number does: both give the nearest number.
    (scaled.abs() < LARGEST && !near_half).then(|| scaled.round() / power)
}

fn round(x: f64) -> f64 {
    format!("{x:.11e}").parse().expect("formatted from a finite number")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reals(from: f64, to: f64, spacing: Spacing<f64>) -> Result<Vec<f64>, RangeError> {
        super::reals(from, to, spacing, MOST_VALUES)
    }

    fn integers(from: u64, to: u64, spacing: Spacing<u64>) -> Result<Vec<u64>, RangeError> {
        super::integers(from, to, spacing, MOST_VALUES)
    }

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
    fn rounding_by_arithmetic_gives_the_bits_of_rounding_in_writing() {
        let mut by_arithmetic = 0;
        for i in 0..200_000_u32 {
            let x = f64::from(i).mul_add(0.000_123_456_789_1, -11.0);
            for decimals in [decimals(x.abs().max(0.5)), 3, 10, 22, 25] {
                let Some(rounded) = round_by_arithmetic(x, decimals) else { continue };
                let written: f64 = format!("{x:.decimals$}").parse().unwrap();
                assert_eq!(rounded.to_bits(), written.to_bits(), "{x} {decimals}");
                by_arithmetic += 1;
            }
        }
        assert!(by_arithmetic > 500_000, "{by_arithmetic}");
        for halfway in [0.5, 1.5, 2.5, 1e300, f64::MAX] {
            assert_eq!(round_by_arithmetic(halfway, 0), None, "{halfway}");
        }
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
            "steps of 0.3 from 0.0 do not reach 1.0 exactly: the last value below it is 0.9"
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

    #[test]
    fn values_that_rounding_makes_equal_or_puts_outside_the_ends_are_refused() {
        let too_fine = |from, to, spacing| {
            let refused = reals(from, to, spacing);
            assert!(matches!(refused, Err(RangeError::TooFine { .. })), "{from} {to}: {refused:?}");
        };
        // Two values round to the same number.
        too_fine(1.0, 1.000_000_000_001, Spacing::Linear(10));
        too_fine(1.0, 1.000_000_000_001, Spacing::Log(10));
        too_fine(999_999.999_999, 1e6, Spacing::Step(1e-8));
        // Below the lower end, or above the upper one.
        too_fine(0.123_456_789_012_9, 0.123_456_789_013_4, Spacing::Linear(4));
        too_fine(0.999_999_999_999_1, 0.999_999_999_999_4, Spacing::Linear(4));
        // A value rounds to zero, below the lower end.
        too_fine(1e-310, 3e-310, Spacing::Linear(3));
        // The ratio of the ends overflows.
        too_fine(5e-324, 1.0, Spacing::Log(3));
    }

    #[test]
    fn a_range_has_no_more_values_than_the_manifest_leaves() {
        assert_eq!(super::reals(0.0, 1.0, Spacing::Step(0.5), 3).map(|list| list.len()), Ok(3));
        for most in [0, 2] {
            let too_many = Err(RangeError::TooManyInAll);
            assert_eq!(super::reals(0.0, 1.0, Spacing::Step(0.5), most), too_many);
            assert_eq!(super::reals(1.0, 2.0, Spacing::Log(3), most), too_many);
            let too_many = Err(RangeError::TooManyInAll);
            assert_eq!(super::integers(1, 3, Spacing::Step(1), most), too_many);
            assert_eq!(super::integers(1, 4, Spacing::Log(3), most), too_many);
        }
    }
}
