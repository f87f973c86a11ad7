//! Policies made of networks: how observations become actions.

use burn::tensor::{Device, Tensor, TensorData};

use crate::agent::{Actions, DuelingQNetwork, PolicyNetwork};
use crate::env::Action;
use crate::rng::Stream;

/// A way to choose actions.
pub trait Policy {
    /// Chooses an action for every observation.
    ///
    /// **Shapes**: `observations` is \[rows, width\], row by row; `actions` is \[rows\]. The stream
    /// is drawn from once a row where chance plays a part, and not at all otherwise.
    fn act(&self, observations: &[f32], actions: &mut [Action], stream: &mut Stream);
}

/// The best action by its value, and now and then any action.
#[derive(Debug)]
pub struct EpsilonGreedy {
    network: DuelingQNetwork,
    epsilon: f64,
}

impl EpsilonGreedy {
    /// A policy that explores at the rate `epsilon`, in [0, 1].
    pub fn new(network: DuelingQNetwork, epsilon: f64) -> Self {
        EpsilonGreedy { network, epsilon }
    }
}

impl Policy for EpsilonGreedy {
    fn act(&self, observations: &[f32], actions: &mut [Action], stream: &mut Stream) {
        let explored: Vec<Option<Action>> =
            actions.iter().map(|_| explore(self.epsilon, stream)).collect();
        if let Some(every) = explored.iter().copied().collect::<Option<Vec<Action>>>() {
            // Nobody asks for the values.
            return actions.copy_from_slice(&every);
        }
        let values = rows(observations, actions.len(), |x| self.network.forward(x));
        for ((action, explored), values) in
            actions.iter_mut().zip(explored).zip(values.chunks_exact(Action::COUNT))
        {
            *action = explored.unwrap_or_else(|| best(values));
        }
    }
}

/// An action at random with probability `epsilon`. One draw decides both, by different bits of it.
fn explore(epsilon: f64, stream: &mut Stream) -> Option<Action> {
    if epsilon == 0.0 {
        return None;
    }
    let bits = stream.bits();
    (crate::rng::unit_from_bits(bits) < epsilon).then(|| Action::from_low_bits(bits))
}

/// Actions with the softmax probabilities of a policy network's logits.
#[derive(Debug)]
pub struct SoftmaxPolicy {
    network: PolicyNetwork,
    actions: Actions,
}

impl SoftmaxPolicy {
    /// A policy that samples ([`Actions::AsTrained`]) or takes the most likely action.
    pub fn new(network: PolicyNetwork, actions: Actions) -> Self {
        SoftmaxPolicy { network, actions }
    }
}

impl Policy for SoftmaxPolicy {
    fn act(&self, observations: &[f32], actions: &mut [Action], stream: &mut Stream) {
        let logits = rows(observations, actions.len(), |x| self.network.forward(x));
        for (action, logits) in actions.iter_mut().zip(logits.chunks_exact(Action::COUNT)) {
            *action = match self.actions {
                Actions::AsTrained => sample_softmax(logits, stream.unit()),
                Actions::Greedy => best(logits),
            };
        }
    }
}

/// Runs a network on observations: \[rows, width\] to \[rows, actions\], row by row.
fn rows(
    observations: &[f32],
    rows: usize,
    forward: impl FnOnce(Tensor<2>) -> Tensor<2>,
) -> Vec<f32> {
    let input = matrix(observations.to_vec(), rows, &super::device::inference());
    forward(input).into_data().try_to_vec().expect("networks compute in f32")
}

/// A matrix of so many rows.
pub(super) fn matrix(values: Vec<f32>, rows: usize, device: &Device) -> Tensor<2> {
    let columns = values.len() / rows;
    Tensor::from_data(TensorData::new(values, [rows, columns]), device)
}

/// The action of the highest value; the lowest numbered of equals.
fn best(values: &[f32]) -> Action {
    let mut best = 0;
    for (index, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = index;
        }
    }
    Action::from_index(best).expect("one value an action")
}

/// The action at which the cumulated softmax probabilities pass `unit`, a number in [0, 1).
fn sample_softmax(logits: &[f32], unit: f64) -> Action {
    let highest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut cumulated = [0.0; Action::COUNT];
    let mut total = 0.0;
    for (sum, logit) in cumulated.iter_mut().zip(logits) {
        total += libm::exp(f64::from(*logit) - f64::from(highest));
        *sum = total;
    }
    let threshold = unit * total;
    let index = cumulated.iter().position(|&sum| threshold < sum).unwrap_or(Action::COUNT - 1);
    Action::from_index(index).expect("one logit an action")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    #[test]
    fn softmax_samples_have_the_probabilities_by_hand() {
        // Logits ln 1, ln 2, ln 3, ln 4: probabilities 0.1, 0.2, 0.3, 0.4.
        let logits: Vec<f32> = [1.0f32, 2.0, 3.0, 4.0].iter().map(|v| v.ln() + 50.0).collect();
        for (unit, index) in [(0.0, 0), (0.099, 0), (0.101, 1), (0.31, 2), (0.59, 2), (0.61, 3)] {
            assert_eq!(sample_softmax(&logits, unit).index(), index, "{unit}");
        }
        assert_eq!(sample_softmax(&[f32::MIN, 0.0, f32::MIN, f32::MIN], 0.999).index(), 1);
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
