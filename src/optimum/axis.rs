//! Grid nodes along habituation and along disengagement risk, and interpolation between them.

use std::array;
use std::collections::BTreeSet;

use crate::env::StepCount;
use crate::env::{Action, apply_action};

/// Jumps of the value that are closer than this share nodes.
const APART: f64 = 1e-9;
/// The largest number of habituation increments from 0 to 1 for which nodes are aligned with increments.
const MOST_ALIGNED: f64 = 100.0;
/// How much a wrong message shrinks a jump, as the equivalent number of suitable messages. It determines the
/// order of the jumps.
const COST_OF_A_MISTAKE: u32 = 7;

/// Node positions in increasing order, starting at 0.
#[derive(Clone, Debug)]
pub(super) struct GridAxis(Vec<f64>);

/// A position between two neighbouring nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Linear {
    /// The lower node.
    node: usize,
    /// The weight of the upper node, in [0, 1].
    weight: f64,
}

/// A position among four neighbouring nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cubic {
    /// The lowest of the nodes.
    pub node: usize,
    /// The weight of each node; they sum to 1, and some may be negative.
    pub weights: [f64; 4],
}

impl GridAxis {
    /// Nodes of habituation from 0 to 1, at most 1 / `steps` apart; `steps` is at least 3.
    ///
    /// Nodes are spaced so that a message's increment leads from node to node, unless increments are tiny.
    pub fn habituation(e: &StepCount, steps: usize) -> GridAxis {
        let most = 1.0 / steps as f64;
        let is_tiny = e.epsilon_h * MOST_ALIGNED < 1.0;
        let spacing = if is_tiny { most } else { e.epsilon_h / (e.epsilon_h / most).ceil() };
        let positions = (0..).map(|i| f64::from(i) * spacing);
        GridAxis(positions.take_while(|x| *x < 1.0 - APART).chain([1.0]).collect())
    }

    /// Nodes of disengagement risk from 0 to the threshold, at most the threshold / `steps` apart, and two
    /// nodes for each of the `jumps` largest jumps of the value: one at the jump and one at the largest
    /// number below it. The threshold is one of the jumps; its upper node only closes the axis.
    pub fn disengagement(e: &StepCount, steps: usize, jumps: usize) -> GridAxis {
        let threshold = e.disengagement_threshold;
        let even = (0..steps).map(|i| threshold * i as f64 / steps as f64);
        let jumps = jumps_of_the_value(e, jumps).into_iter().chain([threshold]);
        let pairs = jumps.flat_map(|jump| [jump.next_down(), jump]);
        let mut nodes: Vec<f64> = even.chain(pairs).filter(|d| *d <= threshold).collect();
        nodes.sort_by(f64::total_cmp);
        nodes.dedup();
        GridAxis(nodes)
    }

    /// The positions of the nodes.
    pub fn nodes(&self) -> &[f64] {
        &self.0
    }

    /// The lower node of the interval that contains `x` or is nearest to it.
    fn interval(&self, x: f64) -> usize {
        let above = self.0.partition_point(|node| *node <= x);
        above.clamp(1, self.0.len() - 1) - 1
    }

    /// The position of `x` for linear interpolation.
    pub fn linear(&self, x: f64) -> Linear {
        let node = self.interval(x);
        let (lower, upper) = (self.0[node], self.0[node + 1]);
        Linear { node, weight: (x - lower) / (upper - lower) }
    }

    /// The position of `x` for Lagrange's cubic through the two nodes on either side of `x`, or through the
    /// four outermost nodes at an end. The axis must have at least four nodes.
    pub fn cubic(&self, x: f64) -> Cubic {
        let node = self.interval(x).saturating_sub(1).min(self.0.len() - 4);
        let near = &self.0[node..][..4];
        let weight = |i: usize| {
            let others = (0..4).filter(|j| *j != i).map(|j| near[j]);
            let (above, below) =
                others.fold((1.0, 1.0), |(a, b), other| (a * (x - other), b * (near[i] - other)));
            above / below
        };
        Cubic { node, weights: array::from_fn(weight) }
    }
}

impl Linear {
    /// The interpolated value, given the value of every node.
    #[inline(always)]
    pub fn of(self, values: &[f64]) -> f64 {
        (1.0 - self.weight) * values[self.node] + self.weight * values[self.node + 1]
    }
}

/// The disengagement risks below the threshold at which the value jumps: at most `most` of the largest jumps,
/// in no particular order.
///
/// From the risk `danger`, a wrong message ends the episode, so the value jumps there. The value also jumps
/// at each risk from which a suitable or a wrong message leads to a jump, by the same amount or less.
fn jumps_of_the_value(e: &StepCount, most: usize) -> Vec<f64> {
    let threshold = e.disengagement_threshold;
    let [suitable, wrong] = [Action::tailored_to(0), Action::tailored_to(1)];
    let leads_to = |action, target: f64| {
        first_from_zero(threshold, |d| apply_action(e, 0, action, 0.0, d).disengagement >= target)
    };
    let danger = leads_to(wrong, threshold);
    // Ordered by cost, which approximates decreasing size. For these numbers, the order of the bits is the
    // order of the values.
    let mut waiting = BTreeSet::from([(0, danger.to_bits())]);
    let mut found: Vec<f64> = Vec::new();
    while found.len() < most
        && let Some((cost, bits)) = waiting.pop_first()
    {
        let jump = f64::from_bits(bits);
        let is_inside = 0.0 < jump && jump < threshold;
        if !is_inside || found.iter().any(|other| (other - jump).abs() < APART) {
            continue;
        }
        found.push(jump);
        // Above `danger`, tailored messages are rare, so a jump keeps its size.
        let smaller = u32::from(jump < danger);
        waiting.insert((cost + smaller, leads_to(suitable, jump).to_bits()));
        waiting.insert((cost + COST_OF_A_MISTAKE, leads_to(wrong, jump).to_bits()));
    }
    found
}

/// The smallest number in [0, `end`) with a property that all larger numbers also have; `end` if there is
/// none.
fn first_from_zero(end: f64, has: impl Fn(f64) -> bool) -> f64 {
    let (mut from, mut to) = (0, end.to_bits());
    while from < to {
        let middle = from + (to - from) / 2;
        if has(f64::from_bits(middle)) { to = middle } else { from = middle + 1 }
    }
    f64::from_bits(to)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(delta_d: f64, epsilon_d: f64, disengagement_threshold: f64) -> StepCount {
        let paper = StepCount::paper(0.8);
        StepCount { delta_d, epsilon_d, disengagement_threshold, ..paper }
    }

    #[test]
    fn an_increment_leads_from_node_to_node() {
        for (epsilon_h, steps) in [(0.05, 30), (0.3, 7), (0.01, 10), (0.013, 3), (1.0, 3)] {
            let axis =
                GridAxis::habituation(&StepCount { epsilon_h, ..with(0.1, 0.4, 1.0) }, steps);
            let nodes = axis.nodes();
            assert!(nodes.windows(2).all(|pair| pair[0] < pair[1]));
            assert!(nodes.windows(2).all(|pair| pair[1] - pair[0] < 1.0 / steps as f64 + 1e-12));
            for x in nodes.iter().map(|x| x + epsilon_h).filter(|x| *x <= 1.0) {
                assert!(nodes.iter().any(|node| (node - x).abs() < 1e-12), "{epsilon_h} {x}");
            }
        }
        // Aligned nodes for tiny increments would be too many.
        for epsilon_h in [0.0, 1e-9, 0.009] {
            let axis = GridAxis::habituation(&StepCount { epsilon_h, ..with(0.1, 0.4, 1.0) }, 10);
            assert_eq!(axis.nodes().len(), 11);
        }
    }

    /// This makes the difference between two grids reflect the error along habituation.
    #[test]
    fn twice_as_many_steps_are_always_more_nodes() {
        for thousandths in 0..=1000 {
            let epsilon_h = f64::from(thousandths) / 1000.0;
            let environment = StepCount { epsilon_h, ..with(0.1, 0.4, 1.0) };
            let nodes = |steps| GridAxis::habituation(&environment, steps).nodes().len();
            let (coarse, fine) = (nodes(80), nodes(160));
            assert!(5 * fine > 6 * coarse && fine < 250, "{epsilon_h}: {coarse} {fine}");
        }
    }

    #[test]
    fn a_jump_is_kept_between_its_two_nodes() {
        let e = with(0.1, 0.4, 1.0);
        let axis = GridAxis::disengagement(&e, 10, 1);
        let ends = |d: f64| d + 0.4 >= 1.0;
        let values: Vec<f64> = axis.nodes().iter().map(|d| f64::from(u8::from(ends(*d)))).collect();
        for i in 0..1000 {
            let d = f64::from(i) / 1000.0;
            let [below, at] = [0.6_f64.next_down(), 0.6];
            for d in [d, below, at] {
                let exact = f64::from(u8::from(ends(d)));
                assert_eq!(axis.linear(d).of(&values), exact, "{d}");
            }
        }
    }

    #[test]
    fn jumps_are_followed_upwards_first_where_no_mistake_is_made() {
        let sorted = |most| {
            let mut jumps = jumps_of_the_value(&with(0.1, 0.4, 1.0), most);
            jumps.sort_by(f64::total_cmp);
            jumps
        };
        let upwards: Vec<f64> = (0..5).map(|i| 0.6 / 0.9_f64.powi(i)).collect();
        let are_near = |ours: &[f64], others: &[f64]| {
            ours.len() == others.len()
                && ours.iter().zip(others).all(|(one, other)| (one - other).abs() < 1e-12)
        };
        assert!(are_near(&sorted(3), &upwards[..3]) && are_near(&sorted(5), &upwards));
        // Then the risks that lead there by one mistake.
        let mistaken: Vec<f64> = upwards.iter().map(|jump| jump - 0.4).collect();
        assert!(are_near(&sorted(10), &[mistaken, upwards].concat()), "{:?}", sorted(10));
        assert!(jumps_of_the_value(&with(0.1, 0.0, 1.0), 10).is_empty());
    }

    /// Ten times 0.1 adds up to less than 1 in f64, so eleven mistakes end an episode, not ten.
    #[test]
    fn jumps_are_where_rounded_sums_reach_the_threshold() {
        let mut jumps = jumps_of_the_value(&with(0.0, 0.1, 1.0), 100);
        jumps.sort_by(f64::total_cmp);
        assert_eq!(jumps.len(), 10);
        let sums = std::iter::successors(Some(0.0), |sum| Some(sum + 0.1));
        let sums: Vec<f64> = sums.take_while(|sum| *sum < 1.0).collect();
        assert_eq!(sums.len(), 11);
        let reached = |sum: &f64| jumps.iter().filter(|jump| *jump <= sum).count();
        let reached: Vec<usize> = sums.iter().map(reached).collect();
        assert_eq!(reached, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
    }

    #[test]
    fn cubics_are_exact_for_cubics_everywhere() {
        let value = |x: f64| 2.0 - 3.0 * x + 5.0 * x * x - 7.0 * x * x * x;
        for (epsilon_h, steps) in [(0.3, 3), (0.05, 40), (0.0, 3)] {
            let axis =
                GridAxis::habituation(&StepCount { epsilon_h, ..with(0.1, 0.4, 1.0) }, steps);
            for x in (0..=100).map(|i| f64::from(i) / 100.0) {
                let Cubic { node, weights } = axis.cubic(x);
                let near = axis.nodes()[node..].iter().map(|x| value(*x));
                let ours: f64 =
                    weights.iter().zip(near).map(|(weight, value)| weight * value).sum();
                assert!((ours - value(x)).abs() < 1e-12, "{epsilon_h} {x}: {ours}");
            }
        }
    }
}
