//! Activations with gradients, on values that [`crate::kernel`] computes.
//!
//! Burn's own tanh on ndarray computes every value in f64, and a second time for the gradient. In a PPO
//! job, that would be more than half of the time.

use burn::tensor::{Tensor, activation};

use crate::agent::Activation;
use crate::agent::burn::{linearized, matrix, values};
use crate::kernel::{self, Isa};

/// The activation of every element.
pub(super) fn apply(activation: Activation, x: Tensor<2>) -> Tensor<2> {
    match activation {
        Activation::Relu => activation::relu(x),
        Activation::Tanh => tanh(x),
    }
}

/// tanh x, with the derivative 1 - tanh² x.
fn tanh(x: Tensor<2>) -> Tensor<2> {
    let (rows, device) = (x.dims()[0], x.clone().inner().device());
    let inputs = values(&x);
    let mut outputs = inputs.clone();
    kernel::Activation::Tanh.apply(Isa::chosen(), &mut outputs);
    if !x.is_autodiff() {
        return matrix(outputs, rows, &device);
    }
    let slopes = outputs.iter().map(|output| 1.0 - output * output).collect();
    linearized(x, inputs, slopes) + Tensor::from_inner(matrix(outputs, rows, &device))
}

#[cfg(test)]
mod tests {
    use burn::tensor::TensorData;

    use super::*;
    use crate::agent::burn::{device, numbers};

    /// Values and derivatives of `f` at -9, -8.75 … 9.
    fn values_and_derivatives(f: impl Fn(Tensor<2>) -> Tensor<2>) -> (Vec<f32>, Vec<f32>) {
        let x: Vec<f32> = (-36..=36).map(|x| x as f32 / 4.0).collect();
        let data = TensorData::new(x.clone(), [1, x.len()]);
        let x: Tensor<2> = Tensor::from_data(data, &device::training()).require_grad();
        let y = f(x.clone());
        let gradients = y.clone().sum().backward();
        (numbers(y), numbers(x.grad(&gradients).unwrap()))
    }

    #[test]
    fn values_and_derivatives_are_burns() {
        let (ours, theirs) =
            (values_and_derivatives(tanh), values_and_derivatives(activation::tanh));
        for (ours, theirs) in [(ours.0, theirs.0), (ours.1, theirs.1)] {
            assert_eq!(ours.len(), 73);
            for (ours, theirs) in ours.iter().zip(theirs) {
                assert!((ours - theirs).abs() < 2e-6, "{ours} is not {theirs}");
            }
        }
    }

    #[test]
    fn values_without_gradients_are_those_with_gradients() {
        let data = || TensorData::new(vec![-0.3_f32, 0.0, 2.0, 40.0], [2, 2]);
        let tracked = tanh(Tensor::from_data(data(), &device::training()).require_grad());
        let plain = tanh(Tensor::from_data(data(), &device::inference()));
        assert!(!plain.is_autodiff());
        assert_eq!(numbers(tracked), numbers(plain));
    }
}
