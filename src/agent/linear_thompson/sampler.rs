//! Computes the probabilities of actions from a posterior and a state, and draws an action.

use crate::agent::Actions;
use crate::agent::linear_thompson::normal::win_probabilities;
use crate::agent::linear_thompson::posterior::{Acting, MESSAGES};
use crate::agent::linear_thompson::regression::dot;
use crate::agent::linear_thompson::{BanditDraw, LinearThompson};
use crate::agent::unavailable::certain;
use crate::env::{Action, ActionProbabilities};
use crate::rng::{Purpose, Stream, unit_from_bits};

/// One number per action.
pub type PerAction = ActionProbabilities;

/// Chooses actions from a posterior.
#[derive(Clone, Debug)]
pub struct Sampler {
    draw: BanditDraw,
    is_centred: bool,
    bias: PerAction,
    pi_min: f64,
    smoothing: f64,
    /// Standard normal deviates, the same in every step of a job; empty if no draws are needed.
    deviates: Vec<PerAction>,
    /// Features of the effects in their blocks, and the results of
    /// [`crate::agent::linear_thompson::regression::Factored::whiten`], one row per message.
    row: Vec<f64>,
    whitened: Vec<f64>,
}

impl Sampler {
    /// The sampler of an agent in a job with this seed.
    pub fn new(parameters: &LinearThompson, seed: u64) -> Self {
        let mut bias = [0.0; Action::COUNT];
        bias.iter_mut().zip(&parameters.action_bias).for_each(|(own, bias)| *own = *bias);
        let by_draws = parameters.draw == BanditDraw::Step
            && (parameters.action_centring || parameters.smoothing > 0.0);
        let draws = if by_draws { parameters.probability_draws } else { 0 };
        let mut stream = Stream::new(seed, Purpose::ProbabilityDraws);
        Sampler {
            draw: parameters.draw,
            is_centred: parameters.action_centring,
            bias,
            pi_min: parameters.pi_min,
            smoothing: parameters.smoothing,
            deviates: (0..draws)
                .map(|_| [(); Action::COUNT].map(|()| normal(&mut stream)))
                .collect(),
            row: Vec::new(),
            whitened: Vec::new(),
        }
    }

    /// Chooses in a state with these features: the probabilities of the actions, and the action
    /// that a random word draws from them. `drawn` holds the coefficients of the episode; it is
    /// empty until they are drawn.
    pub fn choose(
        &mut self,
        choice: Actions,
        (acting, drawn): (&mut Acting, &mut Vec<f64>),
        features: &[f64],
        word: u64,
    ) -> (PerAction, Action) {
        let probabilities = match choice {
            Actions::AsTrained => self.probabilities((acting, drawn), features, word),
            Actions::Greedy => {
                let expected = self.expected(acting, features);
                certain(largest(&expected))
            }
        };
        (probabilities, pick(&probabilities, unit_from_bits(word)))
    }

    /// The probabilities of the actions. If coefficients are drawn per episode and `drawn` is
    /// empty, the word seeds their draw.
    pub fn probabilities(
        &mut self,
        (acting, drawn): (&mut Acting, &mut Vec<f64>),
        features: &[f64],
        word: u64,
    ) -> PerAction {
        let free = match self.draw {
            BanditDraw::Episode => {
                if drawn.is_empty() {
                    let mut stream = Stream::new(word, Purpose::EpisodeDraws);
                    acting.draw(drawn, || normal(&mut stream));
                }
                let utilities = self.utilities(drawn, features);
                self.of_utilities(&utilities)
            }
            BanditDraw::Step if self.is_centred => self.of_effects(acting, features),
            BanditDraw::Step => self.of_actions(acting, features),
        };
        let rest = 1.0 - Action::COUNT as f64 * self.pi_min;
        free.map(|p| self.pi_min + rest * p)
    }

    /// The posterior mean of the utility of each action.
    fn expected(&mut self, acting: &mut Acting, features: &[f64]) -> PerAction {
        if self.is_centred {
            return self.utilities(acting.factored()[0].mean(), features);
        }
        let mut expected = self.bias;
        let factored = acting.factored().iter();
        expected.iter_mut().zip(factored).for_each(|(sum, one)| *sum += one.predict(features));
        expected
    }

    /// The utility of each action, given coefficients of all regressions. Actions are compared by
    /// their utilities.
    fn utilities(&self, coefficients: &[f64], features: &[f64]) -> PerAction {
        let mut utilities = self.bias;
        let width = features.len();
        if self.is_centred {
            let effects = coefficients[coefficients.len() - MESSAGES * width..].chunks_exact(width);
            let messages = utilities[1..].iter_mut().zip(effects);
            messages.for_each(|(sum, effect)| *sum += dot(effect, features));
        } else {
            let actions = utilities.iter_mut().zip(coefficients.chunks_exact(width));
            actions.for_each(|(sum, coefficients)| *sum += dot(coefficients, features));
        }
        utilities
    }

    /// The probabilities under independent regressions per action.
    fn of_actions(&self, acting: &mut Acting, features: &[f64]) -> PerAction {
        let (mut means, mut sds) = (self.bias, [0.0; Action::COUNT]);
        for (action, factored) in acting.factored().iter_mut().enumerate() {
            means[action] += factored.predict(features);
            let whitened = factored.whiten(features);
            sds[action] = dot(whitened, whitened).sqrt();
        }
        if self.smoothing == 0.0 {
            return win_probabilities(&means, &sds);
        }
        self.by_draws(|deviates| std::array::from_fn(|a| means[a] + sds[a] * deviates[a]))
    }

    /// The probabilities under the shared regression with action centring, whose effects are
    /// correlated.
    fn of_effects(&mut self, acting: &mut Acting, features: &[f64]) -> PerAction {
        let mut means = self.bias;
        let joint = &mut acting.factored()[0];
        let (width, all) = (features.len(), joint.mean().len());
        let first = all - MESSAGES * width;
        self.whitened.clear();
        for message in 0..MESSAGES {
            let block = first + message * width..first + (message + 1) * width;
            means[message + 1] += dot(&joint.mean()[block.clone()], features);
            self.row.clear();
            self.row.resize(all, 0.0);
            self.row[block].copy_from_slice(features);
            self.whitened.extend_from_slice(joint.whiten(&self.row));
        }
        let root = root_of_products(&self.whitened, all);
        self.by_draws(|deviates| {
            let mut utilities = means;
            for (utility, row) in utilities[1..].iter_mut().zip(&root) {
                *utility += row[0] * deviates[1] + row[1] * deviates[2] + row[2] * deviates[3];
            }
            utilities
        })
    }

    /// The mean, over the job's deviates, of the action probabilities given the utilities of one
    /// draw.
    fn by_draws(&self, utilities: impl Fn(&PerAction) -> PerAction) -> PerAction {
        let mut sums = [0.0; Action::COUNT];
        for deviates in &self.deviates {
            let drawn = self.of_utilities(&utilities(deviates));
            sums.iter_mut().zip(drawn).for_each(|(sum, p)| *sum += p);
        }
        sums.map(|sum| sum / self.deviates.len() as f64)
    }

    /// The probabilities of actions given their utilities: 1 for the largest, or the softmax.
    fn of_utilities(&self, utilities: &PerAction) -> PerAction {
        let best = largest(utilities);
        if self.smoothing == 0.0 {
            return certain(best);
        }
        let highest = utilities[best.index()];
        let weights = utilities.map(|utility| libm::exp(self.smoothing * (utility - highest)));
        let total: f64 = weights.iter().sum();
        weights.map(|weight| weight / total)
    }
}

/// The lower triangular Cholesky factor of the Gram matrix of rows of this width.
fn root_of_products(rows: &[f64], width: usize) -> [[f64; MESSAGES]; MESSAGES] {
    let row = |index: usize| &rows[index * width..(index + 1) * width];
    let mut root = [[0.0; MESSAGES]; MESSAGES];
    for one in 0..MESSAGES {
        for other in 0..=one {
            let known: f64 = (0..other).map(|k| root[one][k] * root[other][k]).sum();
            let rest = dot(row(one), row(other)) - known;
            root[one][other] = match one == other {
                true => rest.max(0.0).sqrt(),
                // A variable without variance has no covariances.
                false if root[other][other] == 0.0 => 0.0,
                false => rest / root[other][other],
            };
        }
    }
    root
}

/// The action of the largest number; ties go to the first.
fn largest(numbers: &PerAction) -> Action {
    let mut best = 0;
    for index in 1..numbers.len() {
        if numbers[index] > numbers[best] {
            best = index;
        }
    }
    Action::from_index(best).expect("a number per action")
}

/// The action at which the cumulative probabilities exceed a number in [0, 1).
pub fn pick(probabilities: &PerAction, unit: f64) -> Action {
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
