//! Roots of functions of one variable.

/// The root of a continuous function between two ends at which its signs differ, to within a few units
/// in the last place. If the signs are equal, returns the end at which the function is nearer to 0.
///
/// **Source**: Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a
/// nonlinear function without using derivatives", 1997.
pub(crate) fn root(function: impl Fn(f64) -> f64, ends: (f64, f64)) -> f64 {
    let ((mut a, mut b), mut part) = (ends, 0.5);
    let (mut at_a, mut at_b) = (function(a), function(b));
    if at_a.signum() == at_b.signum() {
        return if at_a.abs() < at_b.abs() { a } else { b };
    }
    // Bisection alone would converge within this many steps.
    for _ in 0..200 {
        let x = a + part * (b - a);
        let at_x = function(x);
        let (c, at_c) = if at_x.signum() == at_a.signum() {
            (a, at_a)
        } else {
            let before = (b, at_b);
            (b, at_b) = (a, at_a);
            before
        };
        (a, at_a) = (x, at_x);
        let (nearest, at_nearest) = if at_a.abs() < at_b.abs() { (a, at_a) } else { (b, at_b) };
        let least = 2.0 * f64::EPSILON * nearest.abs() / (b - a).abs();
        if at_nearest == 0.0 || least > 0.5 || b == a {
            return nearest;
        }
        part = next_part((a, at_a), (b, at_b), (c, at_c)).clamp(least, 1.0 - least);
    }
    b
}

/// The next step as a share of the way from `a` to `b`: by inverse quadratic interpolation where
/// Chandrupatla's criterion admits it, else one half.
fn next_part((a, at_a): (f64, f64), (b, at_b): (f64, f64), (c, at_c): (f64, f64)) -> f64 {
    let xi = (a - b) / (c - b);
    let phi = (at_a - at_b) / (at_c - at_b);
    if phi * phi < xi && (1.0 - phi).powi(2) < 1.0 - xi {
        let first = at_a / (at_b - at_a) * at_c / (at_b - at_c);
        first + (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b)
    } else {
        0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_are_found_to_rounding() {
        let near = |found: f64, true_root: f64| {
            assert!((found - true_root).abs() <= 1e-15 * true_root.abs(), "{found} {true_root}");
        };
        near(root(|x| x * x - 2.0, (0.0, 2.0)), 2f64.sqrt());
        near(root(|x| (x - 1.0).powi(9), (0.0, 3.0)), 1.0);
        near(root(|x| 1.0 - (-x).exp() - 0.5, (0.0, 700.0)), 2f64.ln());
    }

    #[test]
    fn without_a_change_of_sign_the_nearer_end_is_the_answer() {
        assert_eq!(root(|x| x + 1.0, (0.0, 2.0)), 0.0);
    }
}
