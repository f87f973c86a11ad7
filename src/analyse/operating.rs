//! Operating characteristics: how an estimator behaves over simulated trials, and how many people a trial needs.

use super::interval::{Interval, LEVEL, NORMAL_CRITICAL, critical, mean_interval};
use super::moments::{Moments, mean_and_sd};
use super::noncentral::{noncentral_t, normal};
use super::undefined::{Undefined, at_least, finite};
use crate::estimate::{chi_squared_of_p, root};

/// An estimate of one trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrialEstimate {
    /// The estimate.
    pub value: f64,
    /// Its estimated standard error.
    pub standard_error: f64,
    /// Its interval of level [`LEVEL`].
    pub interval: Interval,
    /// The true effect in this trial, if it was simulated.
    pub truth: Option<f64>,
}

/// A number with its Monte Carlo interval of level [`LEVEL`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MonteCarloMean {
    /// The number.
    pub value: f64,
    /// Its interval over trials.
    pub interval: Result<Interval, Undefined>,
}

/// How an estimator behaves over trials. A statistic that needs the truth is undefined if not every trial has it.
#[derive(Clone, Debug, PartialEq)]
pub struct Operating {
    /// Trials with an estimate.
    pub trials: usize,
    /// The mean estimate.
    pub mean: Result<MonteCarloMean, Undefined>,
    /// The mean true effect.
    pub truth: Result<MonteCarloMean, Undefined>,
    /// The mean difference between the estimate and the true effect of its trial.
    pub bias: Result<MonteCarloMean, Undefined>,
    /// The standard deviation of the estimates over trials.
    pub empirical_error: Result<MonteCarloMean, Undefined>,
    /// The mean estimated standard error.
    pub mean_error: Result<MonteCarloMean, Undefined>,
    /// The share of intervals that contain the mean true effect.
    pub coverage: Result<MonteCarloMean, Undefined>,
    /// The share of intervals that exclude 0.
    pub power: Result<MonteCarloMean, Undefined>,
    /// The root of the mean squared difference between the estimate and the true effect of its trial.
    pub root_mean_square_error: Result<MonteCarloMean, Undefined>,
    /// The share of estimates with the wrong sign, among those whose interval excludes 0.
    pub type_s: Result<MonteCarloMean, Undefined>,
    /// How many times the true effect the mean size of the estimates is, among those whose interval excludes 0.
    pub exaggeration: Result<MonteCarloMean, Undefined>,
    /// The mean length of the intervals.
    pub mean_length: Result<MonteCarloMean, Undefined>,
}

impl Operating {
    /// The operating characteristics over some trials.
    ///
    /// **Source**: Morris, White and Crowther, "Using simulation studies to evaluate statistical methods", Statistics
    /// in Medicine 38, 2019, table 6, for the measures; intervals of shares are Wilson's. Gelman and Carlin, "Beyond
    /// power calculations", Perspectives on Psychological Science 9, 2014, for errors of type S and M.
    pub fn of(trials: &[TrialEstimate]) -> Operating {
        let all =
            |value: fn(&TrialEstimate) -> f64| -> Vec<f64> { trials.iter().map(value).collect() };
        let truths: Option<Vec<f64>> = trials.iter().map(|trial| trial.truth).collect();
        let truths = truths.ok_or(Undefined::NoTruth);
        let truth = truths.as_deref().map_err(|reason| *reason).and_then(mean);
        let errors = truths.as_deref().map_err(|reason| *reason).map(|truths| {
            let pairs = trials.iter().zip(truths);
            pairs.map(|(trial, truth)| trial.value - truth).collect::<Vec<f64>>()
        });
        let bias = errors.as_deref().map_err(|reason| *reason).and_then(mean);
        let coverage =
            truth.and_then(|truth| share(trials, |trial| trial.interval.contains(truth.value)));
        Operating {
            trials: trials.len(),
            mean: mean(&all(|trial| trial.value)),
            truth,
            bias,
            empirical_error: deviation(&all(|trial| trial.value)),
            mean_error: mean(&all(|trial| trial.standard_error)),
            coverage,
            power: share(trials, |trial| !trial.interval.contains(0.0)),
            root_mean_square_error: errors.and_then(|errors| root_mean_square(&errors)),
            type_s: truth.and_then(|truth| wrong_sign(trials, truth.value)),
            exaggeration: truth.and_then(|truth| exaggeration(trials, truth.value)),
            mean_length: mean(&all(|trial| trial.interval.high - trial.interval.low)),
        }
    }

    /// How many times the standard deviation of the estimates their mean standard error is, where that is clearly three
    /// times or more.
    pub fn excess(&self) -> Option<f64> {
        let (error, deviation) = (self.mean_error.ok()?, self.empirical_error.ok()?);
        let is_clear = error.value >= 3.0 * deviation.interval.ok()?.high;
        is_clear.then_some(error.value / deviation.value)
    }
}

fn mean(values: &[f64]) -> Result<MonteCarloMean, Undefined> {
    let value = Moments::of(values)?.mean;
    Ok(MonteCarloMean { value, interval: mean_interval(values) })
}

/// The root of the mean square, with the root of the interval of that mean.
fn root_mean_square(values: &[f64]) -> Result<MonteCarloMean, Undefined> {
    let square = mean(&values.iter().map(|value| value * value).collect::<Vec<_>>())?;
    let root = |ends: Interval| Interval { low: ends.low.max(0.0).sqrt(), high: ends.high.sqrt() };
    Ok(MonteCarloMean { value: square.value.sqrt(), interval: square.interval.map(root) })
}

/// The trials whose interval excludes 0; `truth` is the mean true effect.
fn findings(trials: &[TrialEstimate], truth: f64) -> Result<Vec<f64>, Undefined> {
    let found = trials.iter().filter(|trial| !trial.interval.contains(0.0));
    let found: Vec<f64> = found.map(|trial| trial.value).collect();
    match found.is_empty() {
        _ if truth == 0.0 => Err(Undefined::NoEffect),
        true => Err(Undefined::NoFinding),
        false => Ok(found),
    }
}

fn wrong_sign(trials: &[TrialEstimate], truth: f64) -> Result<MonteCarloMean, Undefined> {
    share(&findings(trials, truth)?, |value| value * truth < 0.0)
}

/// The interval takes the mean true effect as known.
fn exaggeration(trials: &[TrialEstimate], truth: f64) -> Result<MonteCarloMean, Undefined> {
    let found = findings(trials, truth)?;
    mean(&found.iter().map(|value| (value / truth).abs()).collect::<Vec<_>>())
}

/// The standard deviation, with its interval by the chi-squared distribution.
fn deviation(values: &[f64]) -> Result<MonteCarloMean, Undefined> {
    at_least(2, values.len())?;
    let value = finite(mean_and_sd(values).1.unwrap_or(f64::NAN))?;
    let df = values.len() as f64 - 1.0;
    let tail = (1.0 - LEVEL) / 2.0;
    let end = |p: f64| value * (df / chi_squared_of_p(p, df)).sqrt();
    Ok(MonteCarloMean { value, interval: Ok(Interval { low: end(1.0 - tail), high: end(tail) }) })
}

/// The share of trials that count, with Wilson's interval.
pub(super) fn share<T>(
    trials: &[T],
    counts: impl Fn(&T) -> bool,
) -> Result<MonteCarloMean, Undefined> {
    at_least(1, trials.len())?;
    let count = trials.iter().filter(|trial| counts(*trial)).count();
    let interval = Ok(wilson(count, trials.len()));
    Ok(MonteCarloMean { value: count as f64 / trials.len() as f64, interval })
}

/// The interval of a share of at least one trial.
///
/// **Source**: Wilson, "Probable inference, the law of succession, and statistical inference", Journal of the American
/// Statistical Association 22, 1927.
fn wilson(count: usize, trials: usize) -> Interval {
    let (n, square) = (trials as f64, NORMAL_CRITICAL * NORMAL_CRITICAL);
    let p = count as f64 / n;
    let centre = (p + square / (2.0 * n)) / (1.0 + square / n);
    let half = NORMAL_CRITICAL * (p * (1.0 - p) / n + square / (4.0 * n * n)).sqrt();
    let half = half / (1.0 + square / n);
    // Rounding would move the ends of none and of all, which are exactly 0 and 1.
    Interval {
        low: if count == 0 { 0.0 } else { centre - half },
        high: if count == trials { 1.0 } else { centre + half },
    }
}

/// Where a power is reached along a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// The smallest value between the simulated ones.
    pub at: f64,
    /// The ends of its interval; `None` where an end lies beyond the simulated values.
    pub low: Option<f64>,
    /// See [`Crossing::low`].
    pub high: Option<f64>,
}

/// How the power depends on a parameter between two simulated values: its probit is linear in this.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Along {
    /// The square root of a number of people, as for an estimate whose standard error falls with that root.
    People,
    /// The size of an effect, as for an estimate whose standard error does not depend on it.
    Effect,
}

/// The smallest value of a parameter at which the power is at least `power`, by interpolation between simulated values, with
/// their powers in ascending order of values. The ends of the interval are where the upper and the lower ends of the
/// intervals of the powers, interpolated in the same way, reach `power`. `None` if the power is nowhere reached from below.
pub fn crossing(powers: &[(f64, MonteCarloMean)], power: f64, along: Along) -> Option<Crossing> {
    let find_end = |choose: fn(Interval) -> f64| {
        let read = |(at, found): &(f64, MonteCarloMean)| Some((*at, choose(found.interval.ok()?)));
        reached(&powers.iter().filter_map(read).collect::<Vec<_>>(), power, along)
    };
    let values: Vec<(f64, f64)> = powers.iter().map(|(at, found)| (*at, found.value)).collect();
    let at = reached(&values, power, along)?;
    Some(Crossing { at, low: find_end(|end| end.high), high: find_end(|end| end.low) })
}

/// Where an interpolated line first rises to a share.
fn reached(points: &[(f64, f64)], share: f64, along: Along) -> Option<f64> {
    // A share of 0 or 1 has no probit.
    let probit = |share: f64| {
        let within = share.clamp(1e-9, 1.0 - 1e-9);
        root(|z| normal(z) - within, (-10.0, 10.0))
    };
    let goal = probit(share);
    let between = |pair: &[(f64, f64)]| {
        let [(less, low), (more, high)] = pair else { return None };
        let (low, high) = (probit(*low), probit(*high));
        let part = (goal - low) / (high - low);
        (low < goal && goal <= high).then(|| match along {
            Along::People => {
                let root = less.sqrt() + part * (more.sqrt() - less.sqrt());
                root * root
            }
            Along::Effect => less + part * (more - less),
        })
    };
    points.windows(2).find_map(between)
}

/// A micro-randomised trial as the formula of Liao and others sees it, with its mean p (1 - p) in the place of that of a
/// constant probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Formula {
    /// The effect divided by the standard deviation of the outcome given the control variables.
    pub standardised_effect: f64,
    /// The expected number of available decisions of a person.
    pub decisions: f64,
    /// The mean of p (1 - p), with p the probability of treatment.
    pub treatment_variance: f64,
    /// The number of coefficients of the model without treatment, the constant included.
    pub controls: usize,
}

impl Formula {
    /// The smallest number of people with which a constant effect is found with this power, in a test of size 1 -
    /// [`LEVEL`]. `None` if it would be more than a million.
    ///
    /// **Source**: Liao, Klasnja, Tewari and Murphy, "Sample size calculations for micro-randomized trials in mHealth",
    /// Statistics in Medicine 35, 2016, section 3.2, with one coefficient of the effect: the noncentral F distribution
    /// with 1 and N - q - 1 degrees of freedom is that of the square of a noncentral t.
    pub fn people(&self, power: f64) -> Option<u32> {
        let first = self.controls as u32 + 2;
        let (mut few, mut many) = (first, first);
        while self.power(many) < power {
            few = many;
            many = many.checked_mul(2).filter(|many| *many <= 1 << 20)?;
        }
        while many - few > 1 {
            let middle = few + (many - few) / 2;
            if self.power(middle) < power { few = middle } else { many = middle }
        }
        Some(if self.power(few) >= power { few } else { many })
    }

    /// The smallest standardised effect that is found with this power and number of people, of more than the coefficients.
    /// `None` if there are too few people.
    pub fn effect(&self, people: u32, power: f64) -> Option<f64> {
        let df = f64::from(people) - self.controls as f64 - 1.0;
        let information = f64::from(people) * self.decisions * self.treatment_variance;
        let is_defined = df >= 1.0 && information > 0.0;
        let with =
            |standardised_effect: f64| Formula { standardised_effect, ..*self }.power(people);
        is_defined.then(|| {
            let most = (10.0 + 2.0 * critical(df)) / information.sqrt();
            root(|effect| with(effect) - power, (0.0, most))
        })
    }

    /// The power with this number of people.
    fn power(&self, people: u32) -> f64 {
        let df = f64::from(people) - self.controls as f64 - 1.0;
        let information = f64::from(people) * self.decisions * self.treatment_variance;
        let shift = self.standardised_effect.abs() * information.sqrt();
        let bound = critical(df);
        1.0 - noncentral_t(bound, df, shift) + noncentral_t(-bound, df, shift)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(value: f64, truth: f64) -> TrialEstimate {
        let interval = Interval { low: value - 2.0, high: value + 2.0 };
        TrialEstimate { value, standard_error: 1.0 + value, interval, truth: Some(truth) }
    }

    #[test]
    fn characteristics_by_hand() {
        let trials = [trial(1.0, 2.5), trial(3.0, 3.5), trial(5.0, 3.0), trial(7.0, 3.0)];
        let found = Operating::of(&trials);
        let value = |of: &Result<MonteCarloMean, Undefined>| of.unwrap().value;
        assert_eq!(found.trials, 4);
        assert_eq!((value(&found.truth), value(&found.bias)), (3.0, 1.0));
        assert_eq!(value(&found.empirical_error), (20.0_f64 / 3.0).sqrt());
        assert_eq!((value(&found.mean_error), value(&found.power)), (5.0, 0.75));
        // Of -1 to 3, 1 to 5, 3 to 7 and 5 to 9, three contain the mean truth.
        assert_eq!(value(&found.coverage), 0.75);
        // R: t.test(c(-1.5, -0.5, 2, 4))$conf.int, and sqrt(3 * 20 / 3 / qchisq(c(.975, .025), 3)).
        let bias = found.bias.unwrap().interval.unwrap();
        assert!(
            (bias.low - -2.951_449).abs() < 1e-5 && (bias.high - 4.951_449).abs() < 1e-5,
            "{bias:?}"
        );
        // Three times the upper end of the deviation, 9.627068, is 28.88.
        let wide = |half: f64| {
            let trials =
                trials.each_ref().map(|one| TrialEstimate { standard_error: half, ..*one });
            Operating::of(&trials).excess()
        };
        assert_eq!((found.excess(), wide(28.8)), (None, None));
        assert_eq!(wide(29.0), Some(29.0 / (20.0_f64 / 3.0).sqrt()));
        // Of 1.5², 0.5², 2² and 4²: R: sqrt(t.test(c(2.25, .25, 4, 16))$conf.int[2]).
        let off = found.root_mean_square_error.unwrap();
        assert_eq!(off.value, (22.5_f64 / 4.0).sqrt());
        let Interval { low, high } = off.interval.unwrap();
        assert!(low == 0.0 && (high - 4.110_684).abs() < 1e-5, "{low} {high}");
        // 3, 5 and 7 are found: all above 0, as the true effect of 3 is.
        assert_eq!((value(&found.type_s), value(&found.exaggeration)), (0.0, 5.0 / 3.0));
        assert_eq!(value(&found.mean_length), 4.0);
        let error = found.empirical_error.unwrap().interval.unwrap();
        assert!(
            (error.low - 1.462_670).abs() < 1e-5 && (error.high - 9.627_068).abs() < 1e-5,
            "{error:?}"
        );
    }

    #[test]
    fn statistics_without_a_truth_have_a_reason() {
        let trials = [trial(1.0, 2.0), TrialEstimate { truth: None, ..trial(3.0, 3.0) }];
        let found = Operating::of(&trials);
        assert_eq!(
            (found.bias, found.coverage),
            (Err(Undefined::NoTruth), Err(Undefined::NoTruth))
        );
        assert_eq!(found.power.unwrap().value, 0.5);
        assert_eq!(
            (found.type_s, found.exaggeration),
            (Err(Undefined::NoTruth), Err(Undefined::NoTruth))
        );
        let of = |trials: &[TrialEstimate]| Operating::of(trials);
        let wrong = of(&[trial(-5.0, 1.0), trial(9.0, 1.0), trial(1.0, 1.0), trial(3.0, 1.0)]);
        assert_eq!(wrong.type_s.unwrap().value, 1.0 / 3.0);
        assert_eq!(of(&[trial(1.0, 1.0)]).type_s, Err(Undefined::NoFinding));
        assert_eq!(of(&[trial(9.0, 0.0)]).exaggeration, Err(Undefined::NoEffect));
        assert_eq!(Operating::of(&[]).power, Err(Undefined::NoSeeds));
    }

    #[test]
    fn intervals_of_shares_are_those_of_r() {
        // R: prop.test(c(0, 81), c(10, 263), correct = FALSE), each alone.
        let Interval { low, high } = wilson(81, 263);
        assert!((low - 0.255_289).abs() < 1e-5 && (high - 0.366_210).abs() < 1e-5, "{low} {high}");
        let Interval { low, high } = wilson(0, 10);
        assert!(low == 0.0 && (high - 0.277_533).abs() < 1e-5, "{low} {high}");
    }

    #[test]
    fn sample_sizes_are_found_on_the_curve_of_a_normal_estimate() {
        // Phi(0.3 sqrt(N) - 1.96) is 0.8 at ((1.96 + 0.8416) / 0.3)^2.
        let at = |people: f64| {
            let value = normal(0.3 * people.sqrt() - NORMAL_CRITICAL);
            let interval = Ok(Interval { low: value - 0.05, high: value + 0.05 });
            (people, MonteCarloMean { value, interval })
        };
        let sample_size =
            |powers: &[(f64, MonteCarloMean)], power: f64| crossing(powers, power, Along::People);
        let found = sample_size(&[20.0, 40.0, 80.0, 160.0].map(at), 0.8).unwrap();
        let exact = ((NORMAL_CRITICAL + 0.841_621_233_572_914) / 0.3_f64).powi(2);
        assert!((found.at - exact).abs() < 1e-6, "{found:?}");
        assert!(found.low.unwrap() < exact && found.high.unwrap() > exact, "{found:?}");
        assert_eq!(sample_size(&[20.0, 40.0].map(at), 0.8), None);
        assert_eq!(sample_size(&[160.0, 320.0].map(at), 0.8), None);
        // The upper ends reach the power beyond the simulated numbers.
        let ends = sample_size(&[85.0, 90.0].map(at), 0.8).unwrap();
        assert_eq!((ends.low, ends.high), (None, None));
        // Phi(2 d - 1.96) is 0.8 at (1.959964 + 0.841621) / 2.
        let of_effect = |effect: f64| {
            let (_, power) = at((2.0 * effect / 0.3).powi(2));
            (effect, power)
        };
        let found = crossing(&[0.0, 1.0, 3.0].map(of_effect), 0.8, Along::Effect).unwrap();
        assert!((found.at - 1.400_792_609).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn the_formula_gives_the_sample_size_of_the_noncentral_f_distribution() {
        let formula = Formula {
            standardised_effect: 0.1,
            decisions: 210.0,
            treatment_variance: 0.24,
            controls: 3,
        };
        let people = formula.people(0.8).unwrap();
        // SciPy: the first N with 1 - ncf.cdf(f.ppf(0.95, 1, N - 4), 1, N - 4, N * 0.01 * 210 * 0.24) >= 0.8.
        assert_eq!(people, 19);
        assert!(formula.power(people) >= 0.8 && formula.power(people - 1) < 0.8);
        let effect = formula.effect(people, formula.power(people)).unwrap();
        assert!((effect - 0.1).abs() < 1e-9, "{effect}");
        assert_eq!(formula.effect(4, 0.8), None);
        assert_eq!(Formula { standardised_effect: 0.0, ..formula }.people(0.8), None);
    }
}
