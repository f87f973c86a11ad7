//! Activations with gradients, on values that [`crate::kernel`] computes.
//!
//! Burn's own tanh on ndarray computes every value in f64, and a second time for the gradient. In a PPO
//! job, that would be more than half of the time.

use burn::tensor::{Tensor, TensorData, activation};

use crate::agent::Activation;
use crate::agent::burn::values;
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
    let values = |inputs: &mut [f32]| kernel::Activation::Tanh.apply(Isa::chosen(), inputs);
    with_derivative(x, values, |value| 1.0 - value * value)
}

/// The function that `apply` computes in place, with the derivative `slope` as a function of its value.
fn with_derivative(
    x: Tensor<2>,
    apply: impl Fn(&mut [f32]),
    slope: impl Fn(f32) -> f32,
) -> Tensor<2> {
    let (shape, device) = (x.dims(), x.clone().inner().device());
    let inputs = values(&x);
    let mut values = inputs.clone();
    apply(&mut values);
    let constant = |values| Tensor::from_data(TensorData::new(values, shape), &device);
    if !x.is_autodiff() {
        return constant(values);
    }
    // x * slope + rest has the value and the derivative of the function, with two operations of Burn.
    let slopes: Vec<f32> = values.iter().map(|value| slope(*value)).collect();
    let products = inputs.iter().zip(&slopes).map(|(x, slope)| x * slope);
    values.iter_mut().zip(products).for_each(|(value, product)| *value -= product);
    x * Tensor::from_inner(constant(slopes)) + Tensor::from_inner(constant(values))
}

#[cfg(test)]
mod tests {
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
    fn values_without_gradients_are_those_with_gradients_but_for_rounding() {
        let data = || TensorData::new(vec![-0.3_f32, 0.0, 2.0, 40.0], [2, 2]);
        let tracked = tanh(Tensor::from_data(data(), &device::training()).require_grad());
        let plain = tanh(Tensor::from_data(data(), &device::inference()));
        assert!(!plain.is_autodiff());
        for (tracked, plain) in numbers(tracked).iter().zip(numbers(plain)) {
            assert!((tracked - plain).abs() < 1e-7, "{tracked} is not {plain}");
        }
    }
}
