//! The log-likelihood of one value by the parameters of its draw, with first and second derivatives.

use crate::env::declared::FitLaw;
use crate::kernel::math;

/// Adds the derivatives of a value's log-likelihood by the parameters, and returns the log-likelihood without what does not
/// depend on them. `first` has one number per parameter, and `second` a square of them; both are overwritten.
///
/// Normal densities are without 1 / √(2π), and lognormal ones are those of the logarithm.
pub(super) fn row(law: FitLaw, y: f64, at: &[f64], first: &mut [f64], second: &mut [f64]) -> f64 {
    match law {
        FitLaw::Normal | FitLaw::Lognormal => normal(y, [at[0], at[1]], first, second),
        FitLaw::Bernoulli => {
            let p = sigmoid(at[0]);
            first[0] = y - p;
            second[0] = -p * sigmoid(-at[0]);
            y * at[0] - softplus(at[0])
        }
        FitLaw::Poisson => {
            let mean = math::exp(at[0]);
            first[0] = y - mean;
            second[0] = -mean;
            y * at[0] - mean
        }
        FitLaw::ZeroInflatedPoisson => zero_inflated(y, [at[0], at[1]], first, second),
        FitLaw::Categorical => categorical(y as usize, at, first, second),
    }
}

/// -ln s - (y - m)² / 2s²; negative infinity where s is not above 0.
fn normal(y: f64, [mean, sd]: [f64; 2], first: &mut [f64], second: &mut [f64]) -> f64 {
    if sd <= 0.0 {
        return f64::NEG_INFINITY;
    }
    let rest = (y - mean) / sd;
    first[0] = rest / sd;
    first[1] = (rest * rest - 1.0) / sd;
    let precision = 1.0 / (sd * sd);
    second[0] = -precision;
    second[1] = -2.0 * rest * precision;
    second[2] = second[1];
    second[3] = (1.0 - 3.0 * rest * rest) * precision;
    -libm::log(sd) - 0.5 * rest * rest
}

/// The value is 0 for certain with probability σ(z), and otherwise Poisson with mean λ = e^l.
///
/// A 0 has the probability (e^z + e^-λ) / (1 + e^z), and was certain with probability a = σ(z + λ).
fn zero_inflated(y: f64, [zero, log]: [f64; 2], first: &mut [f64], second: &mut [f64]) -> f64 {
    let mean = math::exp(log);
    let (p, of_p) = (sigmoid(zero), sigmoid(zero) * sigmoid(-zero));
    if y > 0.0 {
        first.copy_from_slice(&[-p, y - mean]);
        second.copy_from_slice(&[-of_p, 0.0, 0.0, -mean]);
        return y * log - mean - softplus(zero);
    }
    let certain = sigmoid(zero + mean);
    let drawn = sigmoid(-zero - mean);
    let both = certain * drawn;
    first.copy_from_slice(&[certain - p, -drawn * mean]);
    let mixed = both * mean;
    second.copy_from_slice(&[both - of_p, mixed, mixed, mixed * mean - drawn * mean]);
    // ln(e^z + e^-λ).
    let (most, least) = if zero > -mean { (zero, -mean) } else { (-mean, zero) };
    most + softplus(least - most) - softplus(zero)
}

fn categorical(y: usize, at: &[f64], first: &mut [f64], second: &mut [f64]) -> f64 {
    let most = at.iter().fold(f64::NEG_INFINITY, |most, x| most.max(*x));
    let sum: f64 = at.iter().map(|x| math::exp(x - most)).sum();
    let count = at.len();
    for (i, x) in at.iter().enumerate() {
        let p = math::exp(x - most) / sum;
        first[i] = f64::from(u8::from(i == y)) - p;
        for (j, other) in at.iter().enumerate() {
            let q = math::exp(other - most) / sum;
            second[i * count + j] = if i == j { -p * (1.0 - p) } else { p * q };
        }
    }
    at[y] - most - libm::log(sum)
}

/// The part of a value's log-likelihood that does not depend on the parameters.
pub(super) fn constant(law: FitLaw, y: f64) -> f64 {
    match law {
        FitLaw::Poisson | FitLaw::ZeroInflatedPoisson => -libm::lgamma(y + 1.0),
        FitLaw::Normal | FitLaw::Lognormal | FitLaw::Bernoulli | FitLaw::Categorical => 0.0,
    }
}

/// The mean of a draw by its parameters; of a categorical draw the mean index, and of a lognormal one that of logarithms.
pub(super) fn mean(law: FitLaw, at: &[f64]) -> f64 {
    match law {
        FitLaw::Normal | FitLaw::Lognormal => at[0],
        FitLaw::Bernoulli => sigmoid(at[0]),
        FitLaw::Poisson => math::exp(at[0]),
        FitLaw::ZeroInflatedPoisson => sigmoid(-at[0]) * math::exp(at[1]),
        FitLaw::Categorical => {
            let most = at.iter().fold(f64::NEG_INFINITY, |most, x| most.max(*x));
            let weights = at.iter().map(|x| math::exp(x - most));
            let sum: f64 = weights.clone().sum();
            weights.enumerate().map(|(index, weight)| index as f64 * weight / sum).sum()
        }
    }
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + math::exp(-x))
}

/// ln(1 + e^x).
fn softplus(x: f64) -> f64 {
    x.max(0.0) + libm::log1p(math::exp(-x.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_the_log_likelihood() {
        let cases: [(FitLaw, &[f64], &[f64]); 6] = [
            (FitLaw::Normal, &[0.3, 1.7], &[2.5]),
            (FitLaw::Lognormal, &[0.3, 0.4], &[-0.2]),
            (FitLaw::Bernoulli, &[0.7], &[0.0, 1.0]),
            (FitLaw::Poisson, &[1.3], &[0.0, 4.0]),
            (FitLaw::ZeroInflatedPoisson, &[-0.4, 0.8], &[0.0, 3.0]),
            (FitLaw::Categorical, &[0.2, -0.3, 0.9], &[0.0, 2.0]),
        ];
        for (law, at, values) in cases {
            let count = at.len();
            let of = |at: &[f64], y: f64| {
                let (mut first, mut second) = (vec![0.0; count], vec![0.0; count * count]);
                let value = row(law, y, at, &mut first, &mut second);
                (value, first, second)
            };
            for y in values {
                let (_, first, second) = of(at, *y);
                for i in 0..count {
                    const STEP: f64 = 1e-5;
                    let moved = |step: f64| {
                        let mut at = at.to_vec();
                        at[i] += step;
                        of(&at, *y)
                    };
                    let (up, down) = (moved(STEP), moved(-STEP));
                    let near = |exact: f64, numeric: f64| {
                        let off = (exact - numeric).abs() / exact.abs().max(1.0);
                        assert!(off < 1e-8, "{law:?} {i}: {exact} {numeric}");
                    };
                    near(first[i], (up.0 - down.0) / (2.0 * STEP));
                    for j in 0..count {
                        near(second[i * count + j], (up.1[j] - down.1[j]) / (2.0 * STEP));
                    }
                }
            }
        }
    }

    #[test]
    fn likelihoods_are_those_of_scipy() {
        // scipy.stats: bernoulli.logpmf(1, expit(0.7)), poisson.logpmf(4, exp(1.3)), and the mixture by hand.
        let of = |law, y: f64, at: &[f64]| {
            let count = at.len();
            row(law, y, at, &mut vec![0.0; count], &mut vec![0.0; count * count]) + constant(law, y)
        };
        assert!((of(FitLaw::Bernoulli, 1.0, &[0.7]) + 0.403_186_049).abs() < 1e-8);
        assert!((of(FitLaw::Poisson, 4.0, &[1.3]) + 1.647_350_498).abs() < 1e-8);
        let zero = (0.401_312_339_9 + 0.598_687_660_1 * (-(0.8f64.exp())).exp()).ln();
        assert!((of(FitLaw::ZeroInflatedPoisson, 0.0, &[-0.4, 0.8]) - zero).abs() < 1e-8);
    }
}
