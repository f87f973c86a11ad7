//! Computes the probabilities of actions from a posterior and a state, and draws an action.

use std::f64::consts::FRAC_1_SQRT_2;

use crate::agent::Actions;
use crate::agent::linear_thompson::logistic::mean_of_logistic;
use crate::agent::linear_thompson::normal::Normals;
use crate::agent::linear_thompson::posterior::{Acting, Decision};
use crate::agent::linear_thompson::regression::dot;
use crate::agent::linear_thompson::{BanditAllocation, BanditDraw, LinearThompson};
use crate::agent::unavailable::certain;
use crate::env::Action;
use crate::rng::{Purpose, Stream, unit_from_bits};

/// Chooses actions from a posterior.
#[derive(Clone, Debug)]
pub struct Sampler {
    draw: BanditDraw,
    is_centred: bool,
    /// \[actions\].
    bias: Vec<f64>,
    pi_min: f64,
    smoothing: f64,
    of_effect: OfEffect,
    /// Standard normal deviates, \[draws, actions\], the same in every step of a job; empty if no draws are
    /// needed.
    deviates: Vec<f64>,
    normals: Normals,
    /// Utilities of the actions, and their probabilities given one draw.
    utilities: Vec<f64>,
    given: Vec<f64>,
    /// Features of the effects in their blocks, the results of
    /// [`crate::agent::linear_thompson::regression::Factored::whiten`], one row per message, and the root of their
    /// products.
    row: Vec<f64>,
    whitened: Vec<f64>,
    root: Vec<f64>,
}

/// How the effect of the only message becomes its probability.
#[derive(Clone, Copy, Debug)]
enum OfEffect {
    /// The posterior probability of being the best, by draws or by an integral over all actions.
    Best,
    /// The posterior probability that it is above 0.
    Positive,
    /// The posterior mean of a function of it.
    Logistic(Logistic),
}

impl OfEffect {
    /// The probability of a message with a normal effect; `None` for [`OfEffect::Best`].
    fn probability(self, mean: f64, sd: f64) -> Option<f64> {
        match self {
            OfEffect::Best => None,
            OfEffect::Positive => Some(0.5 * libm::erfc(-mean / sd * FRAC_1_SQRT_2)),
            OfEffect::Logistic(logistic) => Some(logistic.mean(mean, sd)),
        }
    }
}

/// The generalised logistic function L + (U - L) / (1 + C exp(-B z)) of an effect z.
#[derive(Clone, Copy, Debug)]
pub(super) struct Logistic {
    pub(super) lower: f64,
    pub(super) upper: f64,
    pub(super) slope: f64,
    pub(super) log_odds: f64,
}

impl Logistic {
    pub(super) fn of(parameters: &LinearThompson) -> Option<Logistic> {
        let logistic = Logistic {
            lower: parameters.logistic_lower,
            upper: parameters.logistic_upper,
            slope: parameters.logistic_slope,
            log_odds: libm::log(parameters.logistic_odds),
        };
        (parameters.allocation == BanditAllocation::Logistic).then_some(logistic)
    }

    /// Its mean for a normal effect.
    fn mean(self, mean: f64, sd: f64) -> f64 {
        let Logistic { lower, upper, slope, log_odds } = self;
        lower + (upper - lower) * mean_of_logistic(slope * mean - log_odds, slope * sd)
    }
}

impl Sampler {
    /// The sampler of an agent in a job with this seed, for this number of actions.
    pub fn new(parameters: &LinearThompson, actions: usize, seed: u64) -> Self {
        let mut bias = parameters.action_bias.clone();
        bias.resize(actions, 0.0);
        let of_effect = match (parameters.allocation, Logistic::of(parameters)) {
            (_, Some(logistic)) => OfEffect::Logistic(logistic),
            (BanditAllocation::Clipped, None) => OfEffect::Positive,
            (_, None) => OfEffect::Best,
        };
        let by_draws = matches!(of_effect, OfEffect::Best)
            && parameters.draw == BanditDraw::Step
            && (parameters.action_centring || parameters.smoothing > 0.0);
        let draws = if by_draws { parameters.probability_draws as usize } else { 0 };
        let mut stream = Stream::new(seed, Purpose::ProbabilityDraws);
        Sampler {
            draw: parameters.draw,
            is_centred: parameters.action_centring,
            bias,
            pi_min: parameters.pi_min,
            smoothing: parameters.smoothing,
            of_effect,
            deviates: (0..draws * actions).map(|_| normal(&mut stream)).collect(),
            normals: Normals::default(),
            utilities: vec![0.0; actions],
            given: vec![0.0; actions],
            row: Vec::new(),
            whitened: Vec::new(),
            root: Vec::new(),
        }
    }

    /// Number of actions.
    pub fn actions(&self) -> usize {
        self.bias.len()
    }

    /// Chooses in the state of a decision: writes the probabilities of the actions, and the action that a random
    /// word draws from them. The second half of `known` holds the coefficients of the episode; it is empty until
    /// they are drawn.
    pub fn choose(
        &mut self,
        choice: Actions,
        known: (&mut Acting, &mut Vec<f64>),
        decision: &mut Decision,
        word: u64,
    ) {
        let Decision { features, probabilities, action } = decision;
        match choice {
            Actions::AsTrained => self.probabilities(known, features, word, probabilities),
            Actions::Greedy => {
                self.expect(known.0, features);
                certain(largest(&self.utilities), probabilities);
            }
        }
        *action = pick(probabilities, unit_from_bits(word));
    }

    /// Writes the probabilities of the actions. If coefficients are drawn per episode and `drawn` is
    /// empty, the word seeds their draw.
    pub fn probabilities(
        &mut self,
        (acting, drawn): (&mut Acting, &mut Vec<f64>),
        features: &[f64],
        word: u64,
        probabilities: &mut [f64],
    ) {
        match self.draw {
            BanditDraw::Episode => {
                if drawn.is_empty() {
                    let mut stream = Stream::new(word, Purpose::EpisodeDraws);
                    acting.draw(drawn, || normal(&mut stream));
                }
                self.utilities(drawn, features);
                of_utilities(&self.utilities, self.smoothing, probabilities);
            }
            BanditDraw::Step if self.is_centred => self.of_effects(acting, features, probabilities),
            BanditDraw::Step => self.of_actions(acting, features, probabilities),
        }
        if matches!(self.of_effect, OfEffect::Positive) {
            let (least, most) = (self.pi_min, 1.0 - self.pi_min);
            probabilities.iter_mut().for_each(|p| *p = p.clamp(least, most));
            return;
        }
        let rest = 1.0 - self.actions() as f64 * self.pi_min;
        probabilities.iter_mut().for_each(|p| *p = self.pi_min + rest * *p);
    }

    /// The posterior mean of the utility of each action.
    pub fn expect(&mut self, acting: &mut Acting, features: &[f64]) -> &[f64] {
        if self.is_centred {
            self.utilities(acting.factored()[0].mean(), features);
        } else {
            self.utilities.copy_from_slice(&self.bias);
            let each = self.utilities.iter_mut().zip(acting.factored());
            each.for_each(|(sum, one)| *sum += one.predict(features));
        }
        &self.utilities
    }

    /// The deviates of draws, \[draws, actions\]; empty if no draws are needed.
    pub fn deviates(&self) -> &[f64] {
        &self.deviates
    }

    /// Computes the utility of each action, given coefficients of all regressions. Actions are compared by
    /// their utilities.
    fn utilities(&mut self, coefficients: &[f64], features: &[f64]) {
        let utilities = &mut self.utilities;
        utilities.copy_from_slice(&self.bias);
        let width = features.len();
        if self.is_centred {
            let messages = utilities.len() - 1;
            let effects = coefficients[coefficients.len() - messages * width..].chunks_exact(width);
            let messages = utilities[1..].iter_mut().zip(effects);
            messages.for_each(|(sum, effect)| *sum += dot(effect, features));
        } else {
            let actions = utilities.iter_mut().zip(coefficients.chunks_exact(width));
            actions.for_each(|(sum, coefficients)| *sum += dot(coefficients, features));
        }
    }

    /// Writes the probabilities under independent regressions per action.
    fn of_actions(&mut self, acting: &mut Acting, features: &[f64], probabilities: &mut [f64]) {
        let Normals { means, sds, .. } = &mut self.normals;
        means.clone_from(&self.bias);
        sds.clear();
        for (mean, factored) in means.iter_mut().zip(acting.factored()) {
            *mean += factored.predict(features);
            let whitened = factored.whiten(features);
            sds.push(dot(whitened, whitened).sqrt());
        }
        if let [one, other] = sds[..] {
            let sd = (one * one + other * other).sqrt();
            if let Some(second) = self.of_effect.probability(means[1] - means[0], sd) {
                return of_two(second, probabilities);
            }
        }
        if self.smoothing == 0.0 {
            return self.normals.win_probabilities(probabilities);
        }
        self.by_draws(probabilities, |sampler, draw, utilities| {
            let Normals { means, sds, .. } = &sampler.normals;
            for (action, utility) in utilities.iter_mut().enumerate() {
                *utility = means[action] + sds[action] * draw[action];
            }
        });
    }

    /// Writes the probabilities under the shared regression with action centring, whose effects are
    /// correlated.
    fn of_effects(&mut self, acting: &mut Acting, features: &[f64], probabilities: &mut [f64]) {
        let (means, messages) = (&mut self.normals.means, self.bias.len() - 1);
        means.clone_from(&self.bias);
        let joint = &mut acting.factored()[0];
        let (width, all) = (features.len(), joint.mean().len());
        let first = all - messages * width;
        self.whitened.clear();
        for (message, mean) in means[1..].iter_mut().enumerate() {
            let block = first + message * width..first + (message + 1) * width;
            *mean += dot(&joint.mean()[block.clone()], features);
            self.row.clear();
            self.row.extend_from_slice(features);
            self.row.resize(all - block.start, 0.0);
            self.whitened.resize(message * all + block.start, 0.0);
            self.whitened.extend_from_slice(joint.whiten_from(block.start, &self.row));
        }
        if messages == 1 {
            let sd = dot(&self.whitened, &self.whitened).sqrt();
            if let Some(second) = self.of_effect.probability(means[1] - means[0], sd) {
                return of_two(second, probabilities);
            }
        }
        root_of_products(&self.whitened, all, &mut self.root);
        self.by_draws(probabilities, |sampler, draw, utilities| {
            utilities.copy_from_slice(&sampler.normals.means);
            let rows = sampler.root.chunks_exact(utilities.len() - 1);
            for ((message, utility), row) in utilities[1..].iter_mut().enumerate().zip(rows) {
                *utility += dot(&row[..=message], &draw[1..=message + 1]);
            }
        });
    }

    /// Writes the mean, over the job's deviates, of the action probabilities given the utilities of one
    /// draw, which `utilities` writes.
    fn by_draws(
        &mut self,
        probabilities: &mut [f64],
        utilities: impl Fn(&Sampler, &[f64], &mut [f64]),
    ) {
        let (mut of_draw, mut given) =
            (std::mem::take(&mut self.utilities), std::mem::take(&mut self.given));
        probabilities.fill(0.0);
        for draw in self.deviates.chunks_exact(of_draw.len()) {
            utilities(self, draw, &mut of_draw);
            of_utilities(&of_draw, self.smoothing, &mut given);
            probabilities.iter_mut().zip(&given).for_each(|(sum, p)| *sum += p);
        }
        let draws = (self.deviates.len() / of_draw.len()) as f64;
        probabilities.iter_mut().for_each(|sum| *sum /= draws);
        (self.utilities, self.given) = (of_draw, given);
    }
}

/// Writes the probabilities of two actions.
fn of_two(second: f64, probabilities: &mut [f64]) {
    probabilities.copy_from_slice(&[1.0 - second, second]);
}

/// Writes the probabilities of actions given their utilities: 1 for the largest, or the softmax with a slope above 0.
fn of_utilities(utilities: &[f64], smoothing: f64, probabilities: &mut [f64]) {
    let best = largest(utilities);
    if smoothing == 0.0 {
        return certain(best, probabilities);
    }
    let highest = utilities[best.index()];
    for (weight, utility) in probabilities.iter_mut().zip(utilities) {
        *weight = libm::exp(smoothing * (utility - highest));
    }
    let total: f64 = probabilities.iter().sum();
    probabilities.iter_mut().for_each(|weight| *weight /= total);
}

/// Computes the lower triangular Cholesky factor of the Gram matrix of rows of this width, \[rows, rows\].
fn root_of_products(rows: &[f64], width: usize, root: &mut Vec<f64>) {
    let count = rows.len() / width;
    let row = |index: usize| &rows[index * width..(index + 1) * width];
    root.clear();
    root.resize(count * count, 0.0);
    for one in 0..count {
        for other in 0..=one {
            let (ours, theirs) = (&root[one * count..], &root[other * count..]);
            let rest = dot(row(one), row(other)) - dot(&ours[..other], &theirs[..other]);
            root[one * count + other] = match one == other {
                true => rest.max(0.0).sqrt(),
                // A variable without variance has no covariances.
                false if theirs[other] == 0.0 => 0.0,
                false => rest / theirs[other],
            };
        }
    }
}

/// The action of the largest number; ties go to the first.
fn largest(numbers: &[f64]) -> Action {
    let better =
        |best: usize, index: usize| if numbers[index] > numbers[best] { index } else { best };
    Action::from_index((1..numbers.len()).fold(0, better)).expect("a number per action")
}

/// The action at which the cumulative probabilities exceed a number in [0, 1).
pub fn pick(probabilities: &[f64], unit: f64) -> Action {
    let mut cumulated = 0.0;
    let mut picked = 0;
    for (index, probability) in probabilities.iter().enumerate() {
        // Rounding may leave the sum below the number; then the last possible action is taken.
        if *probability > 0.0 {
            picked = index;
            cumulated += probability;
            if unit < cumulated {
                break;
            }
        }
    }
    Action::from_index(picked).expect("a probability per action")
}

/// A standard normal deviate from two words of the stream.
///
/// **Source**: Box and Muller, "A note on the generation of random normal deviates", 1958.
pub fn normal(stream: &mut Stream) -> f64 {
    let (radius, turns) = (1.0 - stream.unit(), stream.unit());
    libm::sqrt(-2.0 * libm::log(radius)) * libm::cos(std::f64::consts::TAU * turns)
}
