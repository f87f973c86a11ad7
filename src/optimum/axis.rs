//! Nodes along one variable of the state, and linear interpolation between them.

/// Numbers closer than this are one number that was computed in two ways.
const ROUNDING: f64 = 1e-10;

/// Increasing nodes, at least two. Where the values jump there are two nodes of one position: the
/// first holds the limit from below, the second the value itself.
#[derive(Clone, Debug)]
pub(super) struct Axis(Vec<f64>);

/// A place between two neighbouring nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// The lower of the nodes.
    pub node: usize,
    /// The upper one's share, in [0, 1].
    pub weight: f64,
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
    /// Nodes from 0 to 1 in steps of at most 1 / `steps`, of which `stride` is a multiple, so that
    /// adding it leads from node to node.
    pub fn with_stride(stride: f64, steps: usize) -> Axis {
        let most = 1.0 / steps as f64;
        let step = if stride > 0.0 { stride / (stride / most).ceil() } else { most };
        let before_one = (0..).map(|i| f64::from(i) * step).take_while(|x| *x < 1.0 - ROUNDING);
        Axis(before_one.chain([1.0]).collect())
    }

    /// Nodes from 0 to `end` in steps of at most `end / steps`, two at each of the increasing `jumps`
    /// between. The last stands for the limit at `end`.
    pub fn with_jumps(end: f64, steps: usize, jumps: &[f64]) -> Axis {
        let mut nodes = Vec::new();
        let mut from = 0.0;
        for to in jumps.iter().copied().chain([end]) {
            let parts = ((to - from) / end * steps as f64).ceil().max(1.0);
            nodes.extend((0..parts as u32).map(|i| from + (to - from) * f64::from(i) / parts));
            nodes.push(to);
            from = to;
        }
        Axis(nodes)
    }

    pub fn nodes(&self) -> &[f64] {
        &self.0
    }

    /// Which side of a jump a node is on.
    pub fn side(&self, node: usize) -> Side {
        let ends_a_piece = self.0.get(node + 1).is_none_or(|next| *next == self.0[node]);
        if ends_a_piece { Side::Below } else { Side::At }
    }

    /// The place of a number; the ends of the axis stand for what lies beyond them.
    pub fn place(&self, x: f64, side: Side) -> Place {
        let last = self.0.len() - 1;
        let near = self.0.partition_point(|node| *node < x - ROUNDING);
        if near > last {
            return Place { node: last - 1, weight: 1.0 };
        }
        if self.0[near] <= x + ROUNDING {
            let twin = self.0.get(near + 1).is_some_and(|next| *next == self.0[near]);
            let node = if twin && side == Side::At { near + 1 } else { near };
            let lower = node.min(last - 1);
            return Place { node: lower, weight: (node - lower) as f64 };
        }
        // The nodes begin at 0, and nothing is below.
        let (lower, upper) = (self.0[near - 1], self.0[near]);
        Place { node: near - 1, weight: (x - lower) / (upper - lower) }
    }
}

impl Place {
    /// The value there.
    pub fn of(self, values: &[f64]) -> f64 {
        let (lower, upper) = (values[self.node], values[self.node + 1]);
        (1.0 - self.weight) * lower + self.weight * upper
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_between_neighbours_and_jumps_have_two_sides() {
        let axis = Axis::with_jumps(1.0, 4, &[0.6]);
        let expected = [0.0, 0.2, 0.4, 0.6, 0.6, 0.8, 1.0];
        assert!(axis.nodes().iter().zip(expected).all(|(ours, x)| (ours - x).abs() < 1e-15));
        let values = [0.0, 2.0, 4.0, 6.0, 16.0, 18.0, 20.0];
        let at = |x, side| axis.place(x, side).of(&values);
        assert!((at(0.3, Side::At) - 3.0).abs() < 1e-12);
        assert_eq!((at(0.6, Side::Below), at(0.6, Side::At)), (6.0, 16.0));
        // One rounding away from the jump is at the jump.
        assert_eq!(at(0.6 - 1e-16, Side::At), 16.0);
        assert_eq!((at(1.0, Side::At), at(7.0, Side::At)), (20.0, 20.0));
        let sides: Vec<Side> = (0..7).map(|node| axis.side(node)).collect();
        assert_eq!(sides.iter().filter(|side| **side == Side::Below).count(), 2);
        assert_eq!((sides[3], sides[6]), (Side::Below, Side::Below));
    }

    #[test]
    fn a_stride_leads_from_node_to_node() {
        for (stride, steps) in [(0.05, 30), (0.3, 7), (0.0, 10), (1.0, 3), (1e-3, 4)] {
            let axis = Axis::with_stride(stride, steps);
            assert!(
                axis.nodes().windows(2).all(|pair| pair[1] - pair[0] <= 1.0 / steps as f64 + 1e-12)
            );
            for x in axis.nodes().iter().filter(|x| **x + stride <= 1.0) {
                let weight = axis.place(x + stride, Side::At).weight;
                assert!(weight == 0.0 || weight == 1.0, "{stride} {x}");
            }
        }
    }
}
