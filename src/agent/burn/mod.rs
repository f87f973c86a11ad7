//! Training by Burn: modules and automatic differentiation, with Adam from [`crate::kernel`].
//!
//! In: weights and hyper-parameters. Out: engines for the algorithms. A new agent can start with
//! these plain implementations. The engines of [`super::fused`] do the same arithmetic in a
//! fraction of the time and are tested against them, and both against PyTorch.

mod activation;
mod autodiff;
pub(super) mod device;
mod dueling_dqn;
mod gates;
mod network;
mod ppo;
mod recurrent;
mod reinforce;
mod trainer;

use burn::tensor::{Device, Int, Tensor, TensorData};

use crate::agent::policy::ActionNetwork;
use crate::agent::weights::Tensor as WeightTensor;
use crate::env::{Action, Observations};

pub use autodiff::{AutodiffPolicy, PolicyGradient};
#[cfg(test)]
pub use dueling_dqn::BurnQNetwork;
pub use dueling_dqn::{BurnDuelingDqn, BurnRecurrentDqn};
pub use network::{ActorCritic, BurnNetwork, DuelingQNetwork, PolicyNetwork};
pub use ppo::{BurnActorCritic, BurnPpo};
pub use recurrent::{RecurrentActorCritic, RecurrentDuelingQNetwork};
pub use reinforce::BurnReinforce;

impl WeightTensor {
    /// Copies a tensor of Burn.
    pub fn of_burn<const AXES: usize>(tensor: Tensor<AXES>) -> WeightTensor {
        let data = tensor.into_data();
        let shape = data.shape().as_slice().to_vec();
        WeightTensor { shape, values: data.try_to_vec().expect("networks compute in f32") }
    }

    /// The same array as a tensor of Burn.
    ///
    /// # Panics
    /// Panics if the number of axes differs.
    pub fn to_burn<const AXES: usize>(&self, device: &Device) -> Tensor<AXES> {
        Tensor::from_data(TensorData::new(self.values.clone(), self.shape.clone()), device)
    }
}

/// Observations as a matrix with the one-hots expanded: \[rows, inputs\].
pub fn input(observations: &Observations, device: &Device) -> Tensor<2> {
    matrix(observations.written_out(), observations.rows(), device)
}

/// A matrix of `rows` rows from row-major values.
fn matrix(values: Vec<f32>, rows: usize, device: &Device) -> Tensor<2> {
    let columns = values.len() / rows;
    Tensor::from_data(TensorData::new(values, [rows, columns]), device)
}

/// Indices of actions as a column: \[rows, 1\].
pub fn column(actions: &[Action], device: &Device) -> Tensor<2, Int> {
    let indices: Vec<i64> = actions.iter().map(|action| action.index() as i64).collect();
    Tensor::from_data(TensorData::new(indices, [actions.len(), 1]), device)
}

/// The values of a tensor that is still in use, in row-major order. On ndarray, reading a tensor that
/// shares its values takes a hundred times longer than reading a copy, which the product makes.
fn values(tensor: &Tensor<2>) -> Vec<f32> {
    numbers(tensor.clone().inner().mul_scalar(1.0))
}

/// (x - values) slopes, where `values` are those of x: zeros, whose derivative with respect to x is
/// `slopes`. Added to numbers that were computed without Burn, they give them this derivative.
fn linearized(x: Tensor<2>, values: Vec<f32>, slopes: Vec<f32>) -> Tensor<2> {
    let (rows, device) = (x.dims()[0], x.clone().inner().device());
    let constant = |values| Tensor::from_inner(matrix(values, rows, &device));
    (x - constant(values)) * constant(slopes)
}

/// The values of a tensor in row-major order.
fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().expect("networks compute in f32")
}

impl ActionNetwork for DuelingQNetwork {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        *out = numbers(self.forward(input(observations, &device::inference())));
    }
}

impl ActionNetwork for PolicyNetwork {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        *out = numbers(self.forward(input(observations, &device::inference())));
    }
}
