//! Quasi-random points of the unit cube, which cover it more evenly than independent points.

use crate::rng::{Purpose, Stream};

/// The points of a cube of `dimensions` dimensions, without end; the first points do not depend on how many are
/// taken.
///
/// Point i has the coordinates `frac(s_j + (i + 1) / φ^j)` for j = 1, …, d, where φ is the positive root of
/// `x^(d + 1) = x + 1`, and the shift s of all points is drawn from the stream of `seed`.
///
/// **Source**: Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018, the sequence R_d. The
/// random shift is Cranley and Patterson's, 1976.
pub(in crate::manifest) fn points(seed: u64, dimensions: usize) -> impl Iterator<Item = Vec<f64>> {
    let mut stream = Stream::new(seed, Purpose::Search);
    let root = root(dimensions);
    let steps: Vec<(f64, f64)> =
        (1..=dimensions).map(|j| (stream.unit(), libm::pow(root, -(j as f64)))).collect();
    (1_u64..)
        .map(move |i| steps.iter().map(|(shift, step)| (shift + i as f64 * step).fract()).collect())
}

/// The positive root of `x^(dimensions + 1) = x + 1`.
fn root(dimensions: usize) -> f64 {
    let inverse = 1.0 / (dimensions as f64 + 1.0);
    // A contraction, whose slope is below a third: the error is below the last bit after these steps.
    (0..64).fold(1.5, |x: f64, _| libm::pow(1.0 + x, inverse))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_powers_of_the_generalised_golden_ratios() {
        // Roberts, 2018: the golden ratio, the plastic number, and their successor.
        let known = [1.618_033_988_749_895, 1.324_717_957_244_746, 1.220_744_084_605_759_5];
        for (dimensions, expected) in (1..).zip(known) {
            assert!((root(dimensions) - expected).abs() < 1e-14, "{dimensions}");
        }
    }

    #[test]
    fn every_interval_of_the_first_points_has_its_share() {
        // Of 64 points, an eighth of the range of each coordinate has 8 ± 2; of independent points, 8 ± 5.
        let first: Vec<Vec<f64>> = points(1, 2).take(64).collect();
        for coordinate in 0..2 {
            for part in 0..8 {
                let inside = |point: &&Vec<f64>| (point[coordinate] * 8.0) as usize == part;
                let count = first.iter().filter(inside).count();
                assert!((6..=10).contains(&count), "{coordinate} {part} {count}");
            }
        }
    }

    #[test]
    fn another_seed_shifts_all_points() {
        let [one, other] = [1, 2].map(|seed| points(seed, 1).take(2).collect::<Vec<_>>());
        let between = |points: &[Vec<f64>]| (points[1][0] - points[0][0]).rem_euclid(1.0);
        assert_ne!(one, other);
        assert!((between(&one) - between(&other)).abs() < 1e-12);
    }
}
