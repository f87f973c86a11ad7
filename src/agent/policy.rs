//! Policies made of networks: how observations become actions.

use crate::agent::Actions;
use crate::env::{Action, Observations};
use crate::kernel::{Isa, math};
use crate::rng::{Stream, unit_from_bits};

/// A way to choose actions.
pub trait Policy {
    /// Chooses an action for every observation.
    ///
    /// **Shapes**: `actions` is \[rows\]. The stream is drawn from once a row where chance plays a
    /// part, and not at all otherwise.
    fn act(&mut self, observations: &Observations, actions: &mut [Action], stream: &mut Stream);

    /// The probability with which each observation leads to each of these actions.
    ///
    /// **Shapes**: `actions` and what is returned are \[rows\].
    fn probabilities(&mut self, observations: &Observations, actions: &[Action]) -> Vec<f64>;
}

/// A network that gives a number for every action: its value, or its logit.
pub trait ActionNetwork {
    /// Replaces `out` by the numbers for every observation, \[rows, actions\], row by row.
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>);
}

/// The best action by its value, and now and then any action.
pub struct EpsilonGreedy<N> {
    network: N,
    epsilon: f64,
    values: Vec<f32>,
    explored: Vec<Option<Action>>,
}

impl<N: ActionNetwork> EpsilonGreedy<N> {
    /// A policy that explores at the rate `epsilon`, in [0, 1].
    pub fn new(network: N, epsilon: f64) -> Self {
        EpsilonGreedy { network, epsilon, values: Vec::new(), explored: Vec::new() }
    }
}

impl<N: ActionNetwork> Policy for EpsilonGreedy<N> {
    fn act(&mut self, observations: &Observations, actions: &mut [Action], stream: &mut Stream) {
        self.explored.clear();
        self.explored.extend(actions.iter().map(|_| explore(self.epsilon, stream)));
        self.network.evaluate(observations, &mut self.values);
        let values = self.values.chunks_exact(Action::COUNT);
        for ((action, explored), values) in actions.iter_mut().zip(&self.explored).zip(values) {
            *action = explored.unwrap_or_else(|| best(values));
        }
    }

    fn probabilities(&mut self, observations: &Observations, actions: &[Action]) -> Vec<f64> {
        self.network.evaluate(observations, &mut self.values);
        let any = self.epsilon / Action::COUNT as f64;
        let of = |(action, values): (&Action, &[f32])| {
            if *action == best(values) { 1.0 - self.epsilon + any } else { any }
        };
        actions.iter().zip(self.values.chunks_exact(Action::COUNT)).map(of).collect()
    }
}

/// An action at random with probability `epsilon`. One draw decides both, by different bits of it.
pub(super) fn explore(epsilon: f64, stream: &mut Stream) -> Option<Action> {
    if epsilon == 0.0 {
        return None;
    }
    let bits = stream.bits();
    (unit_from_bits(bits) < epsilon).then(|| Action::from_low_bits(bits))
}

/// Actions with the softmax probabilities of a policy network's logits.
pub struct SoftmaxPolicy<N> {
    network: N,
    actions: Actions,
    logits: Vec<f32>,
}

impl<N: ActionNetwork> SoftmaxPolicy<N> {
    /// A policy that samples ([`Actions::AsTrained`]) or takes the most likely action.
    pub fn new(network: N, actions: Actions) -> Self {
        SoftmaxPolicy { network, actions, logits: Vec::new() }
    }
}

impl<N: ActionNetwork> Policy for SoftmaxPolicy<N> {
    fn act(&mut self, observations: &Observations, actions: &mut [Action], stream: &mut Stream) {
        self.network.evaluate(observations, &mut self.logits);
        match self.actions {
            Actions::AsTrained => sample(Isa::chosen(), &mut self.logits, actions, stream),
            Actions::Greedy => {
                for (action, logits) in actions.iter_mut().zip(self.logits.chunks(Action::COUNT)) {
                    *action = best(logits);
                }
            }
        }
    }

    fn probabilities(&mut self, observations: &Observations, actions: &[Action]) -> Vec<f64> {
        self.network.evaluate(observations, &mut self.logits);
        if let Actions::AsTrained = self.actions {
            exponentials(Isa::chosen(), &mut self.logits);
        }
        let of = |(action, row): (&Action, &[f32])| match self.actions {
            Actions::Greedy => f64::from(u8::from(*action == best(row))),
            Actions::AsTrained => {
                let total: f64 = row.iter().copied().map(f64::from).sum();
                f64::from(row[action.index()]) / total
            }
        };
        actions.iter().zip(self.logits.chunks_exact(Action::COUNT)).map(of).collect()
    }
}

/// The action of the highest value; the lowest numbered of equals.
pub(super) fn best(values: &[f32]) -> Action {
    let mut best = 0;
    for (index, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = index;
        }
    }
    Action::from_index(best).expect("one value an action")
}

/// Samples an action for every row of logits by their softmax; the logits become their
/// exponentials relative to the highest of the row.
pub(super) fn sample(isa: Isa, logits: &mut [f32], actions: &mut [Action], stream: &mut Stream) {
    exponentials(isa, logits);
    for (action, row) in actions.iter_mut().zip(logits.chunks_exact(Action::COUNT)) {
        *action = pick(row, stream.unit());
    }
}

/// Puts exp(logit - highest of its row) in the place of every logit.
pub(super) fn exponentials(isa: Isa, logits: &mut [f32]) {
    for row in logits.chunks_exact_mut(Action::COUNT) {
        let highest = row.iter().copied().fold(f32::NEG_INFINITY, |a, b| if b > a { b } else { a });
        row.iter_mut().for_each(|logit| *logit -= highest);
    }
    math::exp_each(isa, logits);
}

/// The action at which the cumulated weights pass `unit`, a number in [0, 1), times their sum.
fn pick(weights: &[f32], unit: f64) -> Action {
    let mut total = 0.0;
    let cumulated: [f64; Action::COUNT] = std::array::from_fn(|action| {
        total += f64::from(weights[action]);
        total
    });
    let threshold = unit * total;
    // Without a branch: where it would go is what cannot be foreseen.
    let passed = cumulated[..Action::COUNT - 1].iter().map(|&sum| usize::from(sum <= threshold));
    Action::from_index(passed.sum()).expect("at most all but the last are passed")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    #[test]
    fn softmax_samples_have_the_probabilities_by_hand() {
        // Logits ln 1, ln 2, ln 3, ln 4: probabilities 0.1, 0.2, 0.3, 0.4.
        let mut weights: Vec<f32> = [1.0f32, 2.0, 3.0, 4.0].iter().map(|v| v.ln() + 50.0).collect();
        exponentials(Isa::chosen(), &mut weights);
        for (unit, index) in [(0.0, 0), (0.099, 0), (0.101, 1), (0.31, 2), (0.59, 2), (0.61, 3)] {
            assert_eq!(pick(&weights, unit).index(), index, "{unit}");
        }
        let mut certain = [-1e30, 0.0, -1e30, -1e30];
        exponentials(Isa::chosen(), &mut certain);
        assert_eq!(pick(&certain, 0.999).index(), 1);
        assert_eq!(pick(&[1.0; 4], 1.0).index(), 3);
    }

    #[test]
    fn the_best_action_is_the_lowest_numbered_of_equals() {
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0]).index(), 1);
        assert_eq!(best(&[-1.0; 4]).index(), 0);
    }

    #[test]
    fn exploration_happens_at_its_rate_and_spreads_evenly() {
        let mut stream = Stream::new(8, Purpose::Exploration);
        let mut counts = [0u32; 4];
        for _ in 0..200_000 {
            if let Some(action) = explore(0.2, &mut stream) {
                counts[action.index()] += 1;
            }
        }
        for count in counts {
            // 10,000 expected, standard deviation 97.
            assert!((f64::from(count) - 10_000.0).abs() < 400.0, "{counts:?}");
        }
        assert_eq!(explore(0.0, &mut stream), None);
        assert!(explore(1.0, &mut stream).is_some());
    }
}
