//! Tests of PPO with a GRU: the effects of padding and resets.

use std::ops::Range;

use crate::agent::ppo::Minibatch;
use crate::agent::ppo_tests::Drawn;
use crate::agent::reference_tests::{assert_close, assert_weights_close};

/// The given rows of a minibatch, with the memory before its first row.
fn cut(whole: &Minibatch, rows: Range<usize>) -> Minibatch {
    let mut part = whole.clone();
    part.observations.clear();
    part.observations.extend(&whole.observations, rows.clone());
    let numbers = |numbers: &[f32]| numbers[rows.clone()].to_vec();
    part.actions = whole.actions[rows.clone()].to_vec();
    part.chosen = whole.chosen[rows.clone()].to_vec();
    part.log_probabilities = numbers(&whole.log_probabilities);
    part.values = numbers(&whole.values);
    part.advantages = numbers(&whole.advantages);
    part.returns = numbers(&whole.returns);
    let sequences = part.sequences.as_mut().unwrap();
    sequences.firsts = sequences.firsts[rows.clone()].to_vec();
    sequences.real = sequences.real[rows].to_vec();
    part
}

#[test]
fn longer_padding_changes_nothing() {
    for i in 0..8 {
        let (lanes, steps) = (3, 6);
        let mut case = Drawn::gru(i, lanes, steps + 4);
        let mut whole = case.minibatch();
        let rows = lanes * steps;
        // The last four steps do not count.
        whole.sequences.as_mut().unwrap().real[rows..].fill(false);
        let (losses, gradient) = case.learned(&whole);
        let (expected, other) = case.learned(&cut(&whole, 0..rows));
        assert_close(&losses, &expected, 1e-6, "losses");
        assert_weights_close(&gradient, &other, 1e-6, "padding");
    }
}

#[test]
fn two_episodes_in_one_lane_are_the_two_apart() {
    for i in 0..8 {
        let mut case = Drawn::gru(i, 1, 9);
        let mut both = case.minibatch();
        let sequences = both.sequences.as_mut().unwrap();
        sequences.firsts.fill(false);
        (sequences.firsts[0], sequences.firsts[4]) = (true, true);
        let (losses, gradient) = case.learned(&both);
        let part = |rows| {
            let mut part = cut(&both, rows);
            // An episode that begins must ignore the memory before it.
            part.sequences.as_mut().unwrap().memory.fill(9.0);
            case.learned(&part)
        };
        let (first, second) = (part(0..4), part(4..9));
        let mean = |a: f32, b: f32| (4.0 * a + 5.0 * b) / 9.0;
        let expected: [f32; 5] = std::array::from_fn(|i| mean(first.0[i], second.0[i]));
        assert_close(&losses, &expected, 1e-6, "losses");
        let mut expected = first.1.clone();
        for (name, tensor) in &mut expected.tensors {
            let other = &second.1.tensors[name].values;
            tensor.values.iter_mut().zip(other).for_each(|(a, b)| *a = mean(*a, *b));
        }
        assert_weights_close(&gradient, &expected, 1e-5, "gradient");
    }
}
