//! The gates of a GRU with gradients, on values that [`crate::kernel`] computes.
//!
//! Written with Burn's operations on whole gates, a step would take some twenty of them, and as many for
//! the gradient. Matrices of a few rows are computed faster than an operation begins.

use burn::tensor::{Tensor, TensorData};

use crate::agent::burn::values;
use crate::kernel::{GATES, GruGradient, GruStep, Isa};

/// The states after a step, as in [`GruStep`], with gradients.
///
/// **Shapes**: \[rows, 3 units\] for what the input and the states contribute to the gates reset, update
/// and new; \[rows, units\] for the states before and after the step.
pub(super) fn step(from_input: Tensor<2>, from_state: Tensor<2>, before: Tensor<2>) -> Tensor<2> {
    let ([rows, units], device) = (before.dims(), before.clone().inner().device());
    let constant = |values: Vec<f32>| {
        let columns = values.len() / rows;
        Tensor::<2>::from_data(TensorData::new(values, [rows, columns]), &device)
    };
    let tracked = before.is_autodiff();
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
    if !tracked {
        return constant(after);
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
    // The sum of arguments times derivatives, and of a rest, has the values and the derivatives of the
    // step.
    for (row, after) in after.chunks_exact_mut(units).enumerate() {
        let mut subtract = |arguments: &[f32], derivatives: &[f32], start: usize| {
            let products = arguments[start..][..units].iter().zip(&derivatives[start..][..units]);
            after.iter_mut().zip(products).for_each(|(after, (x, by))| *after -= x * by);
        };
        subtract(&states, &by_before, row * units);
        for gate in row * GATES..(row + 1) * GATES {
            subtract(&input, &by_input, gate * units);
            subtract(&state, &by_state, gate * units);
        }
    }
    let constant = |values| Tensor::from_inner(constant(values));
    let products = from_input * constant(by_input) + from_state * constant(by_state);
    let of_gates = products.reshape([rows, GATES, units]).sum_dim(1).reshape([rows, units]);
    of_gates + before * constant(by_before) + constant(after)
}

#[cfg(test)]
mod tests {
    use burn::tensor::activation;

    use super::*;
    use crate::agent::burn::{device, matrix, numbers};

    const UNITS: usize = 5;

    /// The formula, with Burn's operations.
    fn plain(from_input: Tensor<2>, from_state: Tensor<2>, before: Tensor<2>) -> Tensor<2> {
        let gate = |all: &Tensor<2>, gate: usize| all.clone().narrow(1, gate * UNITS, UNITS);
        let both = |place| gate(&from_input, place) + gate(&from_state, place);
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
        let of = |step: fn(Tensor<2>, Tensor<2>, Tensor<2>) -> Tensor<2>| {
            let arguments = arguments();
            let [input, state, before] = arguments.clone();
            let after = step(input, state, before);
            let weights = (0..3 * UNITS).map(|i| (i % 4) as f32 - 1.5).collect();
            let weighted = after.clone() * matrix(weights, 3, &device::training());
            let gradients = weighted.sum().backward();
            let derivatives = arguments.map(|argument| numbers(argument.grad(&gradients).unwrap()));
            (numbers(after), derivatives.concat())
        };
        let (ours, theirs) = (of(step), of(plain));
        assert_eq!((ours.0.len(), ours.1.len()), (3 * UNITS, 3 * 7 * UNITS));
        let pairs = ours.0.iter().zip(&theirs.0).chain(ours.1.iter().zip(&theirs.1));
        for (ours, theirs) in pairs {
            assert!((ours - theirs).abs() < 2e-6, "{ours} is not {theirs}");
        }
    }

    #[test]
    fn values_without_gradients_are_those_with_gradients_but_for_rounding() {
        let [input, state, before] = arguments();
        let plain = step(input.clone().inner(), state.clone().inner(), before.clone().inner());
        assert!(!plain.is_autodiff());
        let tracked = numbers(step(input, state, before));
        for (tracked, plain) in tracked.iter().zip(numbers(plain)) {
            assert!((tracked - plain).abs() < 1e-6, "{tracked} is not {plain}");
        }
    }
}
