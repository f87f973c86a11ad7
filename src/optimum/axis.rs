//! Nodes along one variable of the state, and interpolation between them: linear, and cubic where the
//! values do not jump.

use std::array;

/// Numbers closer than this are one number that was computed in two ways.
const ROUNDING: f64 = 1e-10;

/// Most strides from 0 to 1 for which there are nodes where the steps asked for are longer.
const MOST_STRIDES: usize = 100;

/// Equal parts that an axis is cut into, for each of its nodes: they tell where to look for a number.
const PARTS_A_NODE: usize = 2;

/// Increasing nodes, none below 0, at least two, four for cubics. Where the values jump there are two
/// nodes of one position: the first holds the limit from below, the second the value itself.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    nodes: Vec<f64>,
    /// Parts in a unit of length.
    parts: f64,
    /// For each part, the first node that a number in it can be next to.
    first_nodes: Vec<usize>,
    /// For the cubic from each node on, what Lagrange's products of its four are divided by: as factors.
    /// Of an axis without jumps.
    factors: Vec<[f64; 4]>,
}

/// A place between two neighbouring nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// The lower of the nodes.
    pub node: usize,
    /// The upper one's share, in [0, 1].
    pub weight: f64,
}

/// A place among neighbouring nodes, by a cubic through their values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Among {
    /// The lowest of the nodes.
    pub node: usize,
    /// The share of each; they add up to 1, and may be below 0.
    pub weights: [f64; 4],
}

/// Which of the two values at a jump is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// The limit from below.
    Below,
    /// The value itself.
    At,
}

impl Axis {
    fn new(nodes: Vec<f64>) -> Axis {
        let count = PARTS_A_NODE * nodes.len();
        let parts = count as f64 / nodes[nodes.len() - 1];
        // Nodes a rounding below a number are looked for, and one at the end of a part may be counted to
        // the next.
        let begins = |part: usize| part as f64 / parts - 2.0 * ROUNDING;
        let first_nodes =
            (0..count).map(|part| nodes.partition_point(|node| *node < begins(part))).collect();
        Axis { nodes, parts, first_nodes, factors: vec![] }
    }

    /// Nodes from 0 to 1 in steps of at most 1 / `steps`, and in so many `times` longer ones elsewhere
    /// than from one number to another. A `stride` is a multiple of the steps, so that adding it leads
    /// from node to node, unless that took more than [`MOST_STRIDES`]; and of the longer ones, unless it
    /// is shorter. There are at least 3 of the longer ones.
    pub fn with_stride(stride: f64, steps: usize, [from, to]: [f64; 2], times: usize) -> Axis {
        debug_assert!(steps / times >= 3, "a cubic goes through four nodes");
        let most = 1.0 / steps as f64;
        let is_short = stride < most && stride * (MOST_STRIDES as f64) < 1.0;
        let step = if is_short {
            most
        } else {
            let in_a_stride = (stride / most).ceil();
            let longer = (in_a_stride / times as f64).ceil() * times as f64;
            stride / if in_a_stride < times as f64 { in_a_stride } else { longer }
        };
        let is_node = |i: usize, x: f64| (from..=to).contains(&x) || i.is_multiple_of(times);
        let before_one = (0..)
            .map(|i| (i, i as f64 * step))
            .take_while(|(_, x)| *x < 1.0 - ROUNDING)
            .filter_map(|(i, x)| is_node(i, x).then_some(x));
        let axis = Axis::new(before_one.chain([1.0]).collect());
        let factor = |near: &[f64], i: usize| 1.0 / from_others(near, i, near[i]);
        let cubics = axis.nodes.windows(4);
        let factors = cubics.map(|near| array::from_fn(|i| factor(near, i))).collect();
        Axis { factors, ..axis }
    }

    /// Nodes at 0, at the `lines` between it and `end`, two at each of the `jumps` there, and at `end`,
    /// where the node stands for the limit. Lines within `apart` of a jump are that jump.
    pub fn with_jumps(end: f64, lines: &[f64], jumps: &[f64], apart: f64) -> Axis {
        let is_inside = |x: &f64| apart < *x && *x < end - apart;
        let is_apart = |x: &f64| jumps.iter().all(|jump| (x - jump).abs() >= apart);
        let mut inner: Vec<f64> = lines.iter().copied().filter(is_apart).collect();
        inner.sort_by(f64::total_cmp);
        inner.dedup_by(|x, below| *x - *below < apart);
        inner.extend(jumps.iter().flat_map(|jump| [*jump, *jump]));
        inner.retain(is_inside);
        inner.sort_by(f64::total_cmp);
        let mut nodes = vec![0.0];
        nodes.extend(inner);
        nodes.push(end);
        Axis::new(nodes)
    }

    /// These nodes, at least one and all below `end`, which is another.
    pub fn through(mut nodes: Vec<f64>, end: f64) -> Axis {
        debug_assert!(!nodes.is_empty() && nodes.iter().all(|node| *node < end));
        nodes.push(end);
        Axis::new(nodes)
    }

    pub fn nodes(&self) -> &[f64] {
        &self.nodes
    }

    /// Which side of a jump a node is on.
    pub fn side(&self, node: usize) -> Side {
        let ends_a_piece = self.nodes.get(node + 1).is_none_or(|next| *next == self.nodes[node]);
        if ends_a_piece { Side::Below } else { Side::At }
    }

    /// The place of a number; the ends of the axis stand for what lies beyond them.
    pub fn place(&self, x: f64, side: Side) -> Place {
        let last = self.nodes.len() - 1;
        let part = ((x * self.parts) as usize).min(self.first_nodes.len() - 1);
        let first = self.first_nodes[part];
        let below = self.nodes[first..].iter().take_while(|node| **node < x - ROUNDING);
        let near = first + below.count();
        if near > last {
            return Place { node: last - 1, weight: 1.0 };
        }
        if self.nodes[near] <= x + ROUNDING {
            let twin = self.nodes.get(near + 1).is_some_and(|next| *next == self.nodes[near]);
            let node = if twin && side == Side::At { near + 1 } else { near };
            let lower = node.min(last - 1);
            return Place { node: lower, weight: (node - lower) as f64 };
        }
        debug_assert!(near > 0, "nothing below the first node is asked for");
        let (lower, upper) = (self.nodes[near - 1], self.nodes[near]);
        Place { node: near - 1, weight: (x - lower) / (upper - lower) }
    }

    /// The place of a number from 0 to 1 on an axis without jumps: Lagrange's cubic through the two
    /// nodes on either side, or through the four at an end.
    pub fn among(&self, x: f64) -> Among {
        let Place { node: between, weight } = self.place(x, Side::At);
        let node = between.saturating_sub(1).min(self.nodes.len() - 4);
        let weights = if weight == 0.0 || weight == 1.0 {
            // Exactly one of them.
            let at = between - node + weight as usize;
            array::from_fn(|i| if i == at { 1.0 } else { 0.0 })
        } else {
            let (near, factors) = (&self.nodes[node..][..4], self.factors[node]);
            array::from_fn(|i| from_others(near, i, x) * factors[i])
        };
        Among { node, weights }
    }
}

/// The product of how far a number is from each of some but one.
fn from_others(near: &[f64], but: usize, x: f64) -> f64 {
    let others = near.iter().enumerate().filter(|(i, _)| *i != but);
    others.map(|(_, other)| x - other).product()
}

impl Place {
    /// The value there, of the values of the two nodes.
    #[inline(always)]
    pub fn between(self, lower: f64, upper: f64) -> f64 {
        (1.0 - self.weight) * lower + self.weight * upper
    }

    /// The values there of several functions, of each node's values.
    #[inline(always)]
    pub fn of_each<const N: usize>(self, values: &[[f64; N]]) -> [f64; N] {
        let (lower, upper) = (values[self.node], values[self.node + 1]);
        array::from_fn(|i| self.between(lower[i], upper[i]))
    }
}

impl Among {
    /// The value there, of the four nodes' values.
    #[inline(always)]
    pub fn of(self, values: [f64; 4]) -> f64 {
        let ([a, b, c, d], [of_a, of_b, of_c, of_d]) = (self.weights, values);
        a * of_a + b * of_b + c * of_c + d * of_d
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_between_neighbours_and_jumps_have_two_sides() {
        // A line that is a rounding away from the jump is the jump.
        let axis = Axis::with_jumps(1.0, &[0.4, 0.6 - 1e-12, 0.8, 0.2, 1.0], &[0.6, 1.2], 1e-9);
        let expected = [0.0, 0.2, 0.4, 0.6, 0.6, 0.8, 1.0];
        assert!(axis.nodes().iter().zip(expected).all(|(ours, x)| (ours - x).abs() < 1e-15));
        let values = [0.0, 2.0, 4.0, 6.0, 16.0, 18.0, 20.0];
        let at = |x, side| axis.place(x, side).of_each::<1>(values.as_chunks().0)[0];
        assert!((at(0.3, Side::At) - 3.0).abs() < 1e-12);
        assert_eq!((at(0.6, Side::Below), at(0.6, Side::At)), (6.0, 16.0));
        // One rounding away from the jump is at the jump.
        assert_eq!(at(0.6 - 1e-16, Side::At), 16.0);
        assert_eq!((at(1.0, Side::At), at(7.0, Side::At)), (20.0, 20.0));
        let sides: Vec<Side> = (0..7).map(|node| axis.side(node)).collect();
        assert_eq!(sides.iter().filter(|side| **side == Side::Below).count(), 2);
        assert_eq!((sides[3], sides[6]), (Side::Below, Side::Below));
    }

    /// By halving, without parts.
    fn near(axis: &Axis, x: f64) -> usize {
        axis.nodes().partition_point(|node| *node < x - ROUNDING)
    }

    #[test]
    fn parts_lead_to_the_node_that_halving_finds() {
        // At the end of a part there are twins; others are crowded in one.
        let jumps = [1e-3, 1.1e-3, 0.3, 0.300_1, 0.699_999];
        let ninths: [f64; 8] = array::from_fn(|i| (i + 1) as f64 / 9.0);
        let axes = [
            Axis::with_jumps(0.7, &ninths.map(|ninth| 0.7 * ninth), &jumps, 1e-9),
            Axis::with_jumps(1.0, &[0.125, 0.25, 0.375, 0.5, 0.625, 0.875], &[0.25, 0.5], 1e-9),
            Axis::with_stride(0.013, 20, [0.0, 1.0], 1),
            Axis::with_stride(0.013, 40, [0.2, 0.6], 4),
            Axis::through(vec![0.1, 0.2, 0.7], 0.700_000_1),
        ];
        for axis in axes {
            let ends = (0..axis.first_nodes.len()).map(|part| part as f64 / axis.parts);
            let at: Vec<f64> = ends.chain(axis.nodes().iter().copied()).collect();
            let about = |x: f64| {
                let by = [0.0, 0.9 * ROUNDING, ROUNDING, 1.1 * ROUNDING, 2.0 * ROUNDING, 1e-5];
                [x.next_up(), x.next_down()]
                    .into_iter()
                    .chain(by.map(|by| x + by))
                    .chain(by.map(|by| x - by))
            };
            for x in at.into_iter().flat_map(about).chain([1.0, 7.0]) {
                if x < axis.nodes()[0] {
                    continue;
                }
                let near = near(&axis, x);
                for (side, twin) in [(Side::Below, 0), (Side::At, 1)] {
                    let place = axis.place(x, side);
                    let Some(node) = axis.nodes().get(near) else {
                        assert_eq!((place.node, place.weight), (near - 2, 1.0), "{x}");
                        continue;
                    };
                    let is_at = *node <= x + ROUNDING;
                    let has_twin = axis.nodes().get(near + 1) == Some(node);
                    let on = near + if has_twin { twin } else { 0 };
                    match is_at {
                        true => assert_eq!(place.node as f64 + place.weight, on as f64, "{x}"),
                        false => assert_eq!(place.node, near - 1, "{x}"),
                    }
                }
            }
        }
    }

    #[test]
    fn a_stride_leads_from_node_to_node() {
        // The last stride is too short to lead to another node.
        for (stride, steps) in
            [(0.05, 30), (0.3, 7), (0.01, 10), (0.013, 3), (0.0, 10), (1.0, 3), (1e-3, 4)]
        {
            let axis = Axis::with_stride(stride, steps, [0.0, 1.0], 1);
            assert!(
                axis.nodes().windows(2).all(|pair| pair[1] - pair[0] <= 1.0 / steps as f64 + 1e-12)
            );
            let most = (2 * steps).max(MOST_STRIDES) + 1;
            assert!(axis.nodes().len() <= most, "{stride} {steps}");
            if stride < 1.0 / MOST_STRIDES as f64 {
                assert_eq!(axis.nodes().len(), steps + 1, "{stride} {steps}");
                continue;
            }
            for x in axis.nodes().iter().filter(|x| **x + stride <= 1.0) {
                let place = axis.place(x + stride, Side::At);
                assert!(place.weight == 0.0 || place.weight == 1.0, "{stride} {x}");
                let [led_to] = place.of_each(axis.nodes().as_chunks().0);
                assert!((led_to - x - stride).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn elsewhere_a_stride_leads_from_node_to_node_as_well() {
        for (stride, steps, times) in [(0.05, 78, 4), (0.3, 20, 4), (0.011, 400, 2)] {
            let (from, to) = (0.3, 0.55);
            let axis = Axis::with_stride(stride, steps, [from, to], times);
            let (mut longest, mut led) = ([0.0; 2], 0);
            for pair in axis.nodes().windows(2) {
                let is_elsewhere = pair[1] < from || to < pair[0];
                let longest = &mut longest[usize::from(is_elsewhere)];
                *longest = f64::max(*longest, pair[1] - pair[0]);
                if is_elsewhere && pair[0] + stride <= 1.0 {
                    let place = axis.place(pair[0] + stride, Side::At);
                    assert!(place.weight == 0.0 || place.weight == 1.0, "{stride} {pair:?}");
                    led += 1;
                }
            }
            // Where the two kinds meet, a step is of the longer ones.
            let step = 1.0 / steps as f64;
            assert!(longest[1] < step * times as f64 + 1e-12, "{longest:?}");
            assert!(longest[1] > 0.7 * step * times as f64 && longest[0] <= longest[1]);
            let inside = axis.nodes().iter().filter(|x| (from..=to).contains(*x)).count();
            assert!(inside as f64 >= (to - from) / step - 1.0 && led > 1, "{inside} {led}");
        }
    }

    #[test]
    fn cubics_are_kept_between_the_nodes_and_at_the_ends() {
        let interpolated = |axis: &Axis, x: f64, value: fn(f64) -> f64| {
            let among = axis.among(x);
            among.of(array::from_fn(|i| value(axis.nodes()[among.node + i])))
        };
        let cubic = |x: f64| 2.0 - 3.0 * x + 5.0 * x * x - 7.0 * x * x * x;
        // The last step is shorter than the others where the stride is no part of 1.
        for (stride, steps, times) in [(0.3, 3, 1), (0.05, 40, 1), (0.0, 3, 1), (0.07, 40, 4)] {
            let axis = Axis::with_stride(stride, steps, [0.3, 0.5], times);
            for i in 0..=100 {
                let x = f64::from(i) / 100.0;
                let ours = interpolated(&axis, x, cubic);
                assert!((ours - cubic(x)).abs() < 1e-13, "{stride} {x}: {ours}");
            }
            let node = axis.nodes()[axis.nodes().len() - 2];
            assert!((interpolated(&axis, node, |x| x.powi(9)) - node.powi(9)).abs() < 1e-13);
        }
    }
}
