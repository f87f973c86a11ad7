//! The gates of a GRU with gradients, on values that [`crate::kernel`] computes.
//!
//! Written with Burn's operations on whole gates, a step would take some twenty of them, and as many
//! for the gradient. For a few rows, the arithmetic takes less time than the start of an operation.

use burn::tensor::Tensor;

use crate::agent::burn::{linearized, matrix, values};
use crate::kernel::{GATES, GruGradient, GruStep, Isa};

/// The states after a step, as in [`GruStep`], with gradients.
///
/// **Shapes**: \[rows, 3 units\] for what the input and the states contribute to the gates reset,
/// update and new; \[rows, units\] for the states before and after the step.
pub(super) fn step(from_input: Tensor<2>, from_state: Tensor<2>, before: Tensor<2>) -> Tensor<2> {
    let ([rows, units], device) = (before.dims(), before.clone().inner().device());
    let [input, state, states] = [&from_input, &from_state, &before].map(values);
    let (mut gates, mut after) = (input.clone(), vec![0.0; states.len()]);
    let isa = Isa::chosen();
    GruStep {
        stride: units,
        from_input: &mut gates,
        from_state: &state,
        before: &states,
        after: &mut after,
    }
    .run(isa);
    if !before.is_autodiff() {
        return matrix(after, rows, &device);
    }

    let (mut by_input, mut by_state) = (vec![0.0; input.len()], state.clone());
    let mut by_before = vec![1.0; states.len()];
    GruGradient {
        stride: units,
        gates: &gates,
        from_state: &mut by_state,
        before: &states,
        by_after: &mut by_before,
        by_input: &mut by_input,
    }
    .run(isa);
    let changes = linearized(from_input, input, by_input) + linearized(from_state, state, by_state);
    let of_gates = changes.reshape([rows, GATES, units]).sum_dim(1).reshape([rows, units]);
    let after = Tensor::from_inner(matrix(after, rows, &device));
    after + of_gates + linearized(before, states, by_before)
}

#[cfg(test)]
mod tests {
    use burn::tensor::activation;

    use super::*;
    use crate::agent::burn::{device, numbers};

    const UNITS: usize = 5;

    /// The formula, with Burn's operations.
    fn plain(from_input: Tensor<2>, from_state: Tensor<2>, before: Tensor<2>) -> Tensor<2> {
        let gate = |all: &Tensor<2>, gate: usize| all.clone().narrow(1, gate * UNITS, UNITS);
        let both = |index| gate(&from_input, index) + gate(&from_state, index);
        let (reset, update) = (activation::sigmoid(both(0)), activation::sigmoid(both(1)));
        let new = activation::tanh(gate(&from_input, 2) + reset * gate(&from_state, 2));
        new.clone() + update * (before - new)
    }

    /// Arguments of three rows without a pattern.
    fn arguments() -> [Tensor<2>; 3] {
        [(0, 3 * UNITS), (1, 3 * UNITS), (2, UNITS)].map(|(seed, columns)| {
            let value = |i: usize| ((i * 31 + seed * 17) % 23) as f32 / 7.0 - 1.5;
            matrix((0..3 * columns).map(value).collect(), 3, &device::training()).require_grad()
        })
    }

    #[test]
    fn values_and_derivatives_are_those_of_the_formula() {
        let computed = |step: fn(Tensor<2>, Tensor<2>, Tensor<2>) -> Tensor<2>| {
            let arguments = arguments();
            let [input, state, before] = arguments.clone();
            let after = step(input, state, before);
            let weights = (0..3 * UNITS).map(|i| (i % 4) as f32 - 1.5).collect();
            let weighted = after.clone() * matrix(weights, 3, &device::training());
            let gradients = weighted.sum().backward();
            let derivatives = arguments.map(|argument| numbers(argument.grad(&gradients).unwrap()));
            (numbers(after), derivatives.concat())
        };
        let (ours, theirs) = (computed(step), computed(plain));
        assert_eq!((ours.0.len(), ours.1.len()), (3 * UNITS, 3 * 7 * UNITS));
        let pairs = ours.0.iter().zip(&theirs.0).chain(ours.1.iter().zip(&theirs.1));
        for (ours, theirs) in pairs {
            assert!((ours - theirs).abs() < 2e-6, "{ours} is not {theirs}");
        }
    }

    #[test]
    fn values_without_gradients_are_those_with_gradients() {
        let [input, state, before] = arguments();
        let plain = step(input.clone().inner(), state.clone().inner(), before.clone().inner());
        assert!(!plain.is_autodiff());
        assert_eq!(numbers(plain), numbers(step(input, state, before)));
    }
}
