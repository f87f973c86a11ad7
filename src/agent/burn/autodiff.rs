//! A policy gradient with a user-defined network and loss, differentiated by Burn.

use burn::module::Param;
use burn::tensor::{Tensor, activation};

use crate::agent::burn::trainer::Trainer;
use crate::agent::burn::{column, device, input, matrix};
use crate::agent::layers::{self, Shape};
use crate::agent::policy::ActionNetwork;
use crate::agent::reinforce::{ReinforceEngine, Trajectories};
use crate::agent::weights::{Tensor as WeightTensor, Weights, WeightsError};
use crate::env::Observations;
use crate::state::resumable;

/// A policy whose network and loss are written with Burn's operations.
pub trait PolicyGradient: Clone + Send + 'static {
    /// Shapes of the weight matrices of a network. The last matrix has one column per action.
    fn shapes(&self, network: Shape) -> Vec<[usize; 2]>;

    /// The logits of the actions, \[rows, actions\], of observations, \[rows, inputs\].
    fn logits(&self, weights: &[Tensor<2>], observations: Tensor<2>) -> Tensor<2>;

    /// The loss that an update minimises; one number.
    ///
    /// **Shapes**: `log_probabilities` holds the log-probabilities of all actions, \[rows,
    /// actions\]; `taken` holds those of the actions taken and `returns` the discounted rewards to
    /// go, both \[rows, 1\].
    fn loss(&self, log_probabilities: Tensor<2>, taken: Tensor<2>, returns: Tensor<2>)
    -> Tensor<1>;
}

/// A [`PolicyGradient`] with its weights and Adam: an engine of [`crate::agent::ReinforceLearner`].
#[derive(Clone)]
pub struct AutodiffPolicy<P> {
    policy: P,
    matrices: Trainer<Vec<Param<Tensor<2>>>>,
}

impl<P: PolicyGradient> AutodiffPolicy<P> {
    /// A policy before training; its weights are drawn from the seed's own stream.
    pub fn new(policy: P, shape: Shape, learning_rate: f64, seed: u64) -> Self {
        let drawn = layers::draw_matrices(&policy.shapes(shape), seed);
        AutodiffPolicy { matrices: trainer(&drawn, learning_rate), policy }
    }

    /// The policy with trained weights.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn trained(policy: P, shape: Shape, weights: &Weights) -> Result<Self, WeightsError> {
        let shapes = policy.shapes(shape).into_iter().enumerate();
        let matrices = shapes.map(|(index, shape)| weights.tensor(&name(index), &shape).cloned());
        let matrices = matrices.collect::<Result<Vec<WeightTensor>, _>>()?;
        Ok(AutodiffPolicy { matrices: trainer(&matrices, 0.0), policy })
    }
}

fn trainer(matrices: &[WeightTensor], learning_rate: f64) -> Trainer<Vec<Param<Tensor<2>>>> {
    let device = device::training();
    let parameter = |matrix: &WeightTensor| Param::from_tensor(matrix.to_burn(&device));
    Trainer::new(matrices.iter().map(parameter).collect(), learning_rate)
}

fn tensors(matrices: &[Param<Tensor<2>>]) -> Vec<Tensor<2>> {
    matrices.iter().map(Param::val).collect()
}

/// The name of the weight matrix at this index.
fn name(index: usize) -> String {
    format!("matrix.{index}")
}

impl<P: PolicyGradient> ActionNetwork for AutodiffPolicy<P> {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        let observations = input(observations, &device::inference());
        let logits = self.policy.logits(&tensors(self.matrices.evaluated()), observations);
        *out = super::numbers(logits);
    }
}

impl<P: PolicyGradient> ReinforceEngine for AutodiffPolicy<P> {
    type Network = Self;

    /// One step of Adam on the loss of the policy.
    fn update(&mut self, trajectories: &Trajectories) -> f32 {
        let device = device::training();
        let observations = input(&trajectories.observations, &device);
        let logits = self.policy.logits(&tensors(self.matrices.module()), observations);
        let log_probabilities = activation::log_softmax(logits, 1);
        let taken = log_probabilities.clone().gather(1, column(&trajectories.actions, &device));
        let rows = trajectories.actions.len();
        let returns = matrix(trajectories.returns_to_go.clone(), rows, &device);
        let loss = self.policy.loss(log_probabilities, taken, returns);
        let value: f32 = loss.clone().into_scalar();
        if value.is_finite() {
            self.matrices.step(&loss, None);
        }
        value
    }

    fn network(&self) -> Self {
        self.clone()
    }

    fn weights(&self) -> Weights {
        let matrices = tensors(self.matrices.module()).into_iter().enumerate();
        let tensors = matrices.map(|(index, matrix)| (name(index), WeightTensor::of_burn(matrix)));
        Weights { tensors: tensors.collect(), ..Weights::default() }
    }
}

resumable!([P: PolicyGradient] AutodiffPolicy<P> { parts matrices });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Action;
    use crate::state::{Resumable, StateReader, StateWriter};

    /// A policy whose logits are the weights of its single input.
    #[derive(Clone)]
    struct Linear;

    impl PolicyGradient for Linear {
        fn shapes(&self, Shape { inputs, actions }: Shape) -> Vec<[usize; 2]> {
            vec![[inputs, actions]]
        }

        fn logits(&self, weights: &[Tensor<2>], observations: Tensor<2>) -> Tensor<2> {
            observations.matmul(weights[0].clone())
        }

        fn loss(&self, _: Tensor<2>, taken: Tensor<2>, returns: Tensor<2>) -> Tensor<1> {
            -(taken * returns).sum()
        }
    }

    /// A policy with a hidden layer, and a matrix between its two that it does not use.
    #[derive(Clone)]
    struct Hidden;

    impl PolicyGradient for Hidden {
        fn shapes(&self, Shape { inputs, actions }: Shape) -> Vec<[usize; 2]> {
            vec![[inputs, 3], [2, 2], [3, actions]]
        }

        fn logits(&self, weights: &[Tensor<2>], observations: Tensor<2>) -> Tensor<2> {
            observations.matmul(weights[0].clone()).tanh().matmul(weights[2].clone())
        }

        fn loss(&self, _: Tensor<2>, taken: Tensor<2>, returns: Tensor<2>) -> Tensor<1> {
            -(taken * returns).sum()
        }
    }

    fn observation() -> Observations {
        let mut observations = Observations::new(1, 0);
        observations.push(&[1.0], None);
        observations
    }

    fn one_step(action: usize) -> Trajectories {
        Trajectories {
            observations: observation(),
            actions: vec![Action::from_index(action).unwrap()],
            preferences: vec![1.0; 4],
            returns_to_go: vec![3.0],
        }
    }

    #[test]
    fn an_update_makes_a_rewarded_action_likelier_by_hand() {
        let mut policy = AutodiffPolicy::new(Linear, Shape::of_four(1), 0.01, 7);
        let before = policy.weights().tensors["matrix.0"].values.clone();
        let loss = policy.update(&one_step(2));
        // The loss is -G log p. Its gradient is G (p - 1) for the action taken and G p for the
        // others. Adam's first step has the size of the learning rate, against the sign of the
        // gradient.
        let sum: f32 = before.iter().map(|logit| logit.exp()).sum();
        assert!((loss + 3.0 * (before[2].exp() / sum).ln()).abs() < 1e-5, "{loss}");
        let after = &policy.weights().tensors["matrix.0"].values;
        for (index, (after, before)) in after.iter().zip(&before).enumerate() {
            let step = if index == 2 { 0.01 } else { -0.01 };
            assert!((after - before - step).abs() < 1e-5, "{index}: {before} {after}");
        }
    }

    #[test]
    fn only_matrices_of_the_loss_are_trained() {
        let mut policy = AutodiffPolicy::new(Hidden, Shape::of_four(1), 0.01, 7);
        let before = policy.weights();
        policy.update(&one_step(1));
        let after = policy.weights();
        assert_eq!(before.tensors["matrix.1"], after.tensors["matrix.1"]);
        for name in ["matrix.0", "matrix.2"] {
            assert_eq!(before.tensors[name].shape, after.tensors[name].shape);
            let values = after.tensors[name].values.iter().zip(&before.tensors[name].values);
            assert!(values.into_iter().all(|(after, before)| after != before), "{name}");
        }
    }

    #[test]
    fn weights_and_states_read_back_to_the_same_bits() {
        let mut policy = AutodiffPolicy::new(Hidden, Shape::of_four(1), 0.01, 7);
        policy.update(&one_step(0));
        let mut trained =
            AutodiffPolicy::trained(Hidden, Shape::of_four(1), &policy.weights()).unwrap();
        let (mut one, mut other) = (Vec::new(), Vec::new());
        policy.evaluate(&observation(), &mut one);
        trained.evaluate(&observation(), &mut other);
        assert_eq!(one, other);
        assert!(AutodiffPolicy::trained(Hidden, Shape::of_four(2), &policy.weights()).is_err());

        let mut bytes = Vec::new();
        policy.save(&mut StateWriter::new(&mut bytes)).unwrap();
        let mut resumed = AutodiffPolicy::new(Hidden, Shape::of_four(1), 0.01, 8);
        resumed.restore(&mut StateReader::new(&mut &bytes[..])).unwrap();
        for engine in [&mut policy, &mut resumed] {
            engine.update(&one_step(1));
        }
        assert_eq!(policy.weights(), resumed.weights());
    }
}
