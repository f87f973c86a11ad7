//! Simulated episodes that correct the value at the start for the error of the grid.

use crate::env::{ContextDraw, FirstContext, apply_action};
use crate::rng::{Purpose, Stream};

use super::solution::Solution;

/// The mean return of a policy.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeanReturn {
    /// In steps walked.
    pub mean: f64,
    /// The standard error of the mean.
    pub standard_error: f64,
}

/// The mean return of a solution's policy, over at least two `episodes`. Every call uses the same contexts.
pub(super) fn mean_return(solution: &Solution, episodes: u64) -> MeanReturn {
    let errors: Vec<f64> = (1..=episodes).map(|seed| sum_of_errors(solution, seed)).collect();
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let variance = errors.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0);
    let standard_error = (variance / n).sqrt();
    MeanReturn { mean: solution.value_of_start() + mean, standard_error }
}

/// The sum of value errors along an episode: for each state after the first, the mean of the best action
/// value minus the value of the state.
fn sum_of_errors(solution: &Solution, seed: u64) -> f64 {
    let e = solution.environment();
    let mut stream = Stream::new(seed, Purpose::Optimum);
    let (mut h, mut d) = (e.initial_habituation, e.initial_disengagement);
    let mut sum = 0.0;
    for time in 0..e.horizon {
        let left = e.horizon - 1 - time;
        let values = solution.action_values(left, h, d);
        if time > 0 {
            sum += solution.mean_of_best(&values) - solution.value(left + 1, h, d);
        }
        let (draw, believed) = if time == 0 && e.first_context == FirstContext::Fixed {
            (ContextDraw::FIXED_FIRST, 1.0)
        } else {
            let draw = ContextDraw::draw(e.sigma, &mut stream);
            (draw, solution.belief().probability_of_zero(&draw))
        };
        let effect = apply_action(e, draw.context, values.best(believed), h, d);
        (h, d) = (effect.habituation, effect.disengagement);
        if d >= e.disengagement_threshold {
            break;
        }
    }
    sum
}
