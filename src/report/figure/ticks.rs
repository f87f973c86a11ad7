//! Round numbers along an axis, and their labels.

use crate::report::data_table::{exponential, signed};

/// Minimum size of numbers whose labels have an exponent: seven digits.
const LARGE: f64 = 1e6;

/// Maximum number of decimals of a label without an exponent.
const MOST_DECIMALS: i32 = 5;

/// Multiples of a round step from `low` to `high`, about `wanted`, with their labels. The range is finite and
/// not empty.
pub(super) fn linear((low, high): (f64, f64), wanted: usize) -> Vec<(f64, String)> {
    /// Far more than any axis has, for ranges whose ends are equal up to rounding.
    const MOST: i64 = 100;
    let step = round_step((high - low) / wanted.max(1) as f64);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = ((high / step + 1e-9).floor() as i64).min(first.saturating_add(MOST));
    let size = low.abs().max(high.abs());
    let tick = |at: i64| (at as f64 * step, label(at as f64 * step, step, size));
    (first..=last).map(tick).collect()
}

/// Powers of ten from `low` to `high`, above 0, and their triples if there is room for them. A range without
/// two such numbers has the multiples of a round step.
pub(super) fn logarithmic((low, high): (f64, f64), wanted: usize) -> Vec<(f64, String)> {
    let powers = || low.log10().floor() as i32..=high.log10().ceil() as i32;
    let inside = |tick: &f64| (low * 0.999..=high * 1.001).contains(tick);
    let tick = |power: i32, digit: f64| digit * 10_f64.powi(power);
    let halves = powers().flat_map(|power| [tick(power, 1.0), tick(power, 3.0)]);
    let mut ticks: Vec<f64> = halves.filter(inside).collect();
    if ticks.len() < 2 {
        return linear((low, high), wanted);
    }
    if ticks.len() > wanted + 1 {
        let whole: Vec<f64> = powers().map(|power| tick(power, 1.0)).filter(inside).collect();
        let every = whole.len().div_ceil(wanted.max(1)).max(1);
        ticks = whole.into_iter().step_by(every).collect();
    }
    let written = |tick: f64| match tick {
        tick if (1e-3..LARGE).contains(&tick) => (tick, label(tick, tick, tick)),
        tick => (tick, format!("{tick:.0e}")),
    };
    ticks.into_iter().map(written).collect()
}

/// The label of a number, to the digits of its step. `size` is the largest number of the axis: labels of large
/// numbers, and of numbers with many decimals, have an exponent.
fn label(number: f64, step: f64, size: f64) -> String {
    let is_whole = |digits: &i32| {
        let scaled = step * 10_f64.powi(*digits);
        scaled >= 0.5 && (scaled - scaled.round()).abs() < 1e-6 * scaled
    };
    if number == 0.0 {
        return "0".to_owned();
    }
    match (0..MOST_DECIMALS).find(is_whole) {
        Some(decimals) if size < LARGE => signed(&format!("{number:.0$}", decimals as usize)),
        _ => {
            // Steps of 2.5 have one digit more than steps of 1, 2 and 5.
            let digits = number.abs().log10().floor() - step.log10().floor() + 1.0;
            signed(&exponential(number, digits.clamp(0.0, 15.0) as usize))
        }
    }
}

/// The smallest of 1, 2, 2.5, 5 and 10 times a power of ten that is at least `step`, with 1 % tolerance.
pub(super) fn round_step(step: f64) -> f64 {
    let step = step.max(f64::MIN_POSITIVE);
    let power = 10_f64.powf(step.log10().floor());
    let digit = [1.0, 2.0, 2.5, 5.0, 10.0].into_iter().find(|digit| digit * power >= step * 0.99);
    digit.unwrap_or(10.0) * power
}
