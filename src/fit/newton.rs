//! Newton's method with exact second derivatives, for functions of few numbers that need not be convex.

use nalgebra::{Cholesky, DMatrix, DVector};

/// A function to be minimised: its value, and its derivatives in the places given; infinite where it is not defined.
pub(super) trait Objective {
    /// The number of arguments.
    fn size(&self) -> usize;
    /// The value; derivatives only if they are asked for.
    fn evaluate(
        &self,
        at: &[f64],
        derivatives: Option<(&mut DVector<f64>, &mut DMatrix<f64>)>,
    ) -> f64;
}

/// Where a search ended.
#[derive(Clone, Debug)]
pub(super) struct Minimum {
    pub at: Vec<f64>,
    pub value: f64,
    pub gradient_norm: f64,
    /// The second derivatives.
    pub curvature: DMatrix<f64>,
}

/// The largest Euclidean norm of a gradient at a minimum.
pub(super) const LARGEST_GRADIENT: f64 = 1e-6;
/// The norm at which a search ends, if rounding lets it come so far.
const SMALL: f64 = 1e-10;
const MOST_STEPS: usize = 200;
/// The share of the decrease that the gradient promises, which a step must have.
const SUFFICIENT: f64 = 1e-4;
const MOST_HALVINGS: usize = 40;

impl Minimum {
    /// Whether the gradient is small enough, and the function bends upwards in all directions.
    pub fn has_converged(&self) -> bool {
        self.gradient_norm <= LARGEST_GRADIENT
            && self.value.is_finite()
            && Cholesky::new(self.curvature.clone()).is_some()
    }
}

/// Searches a minimum from a point.
///
/// A step solves H d = -g; where H is not positive definite, a multiple of its scale is added to the diagonal. A step is
/// halved until the value decreases. Near the minimum rounding hides the decrease, and a step counts if it makes the
/// gradient smaller.
pub(super) fn minimise(objective: &dyn Objective, start: &[f64]) -> Minimum {
    let size = objective.size();
    let mut at = DVector::from_column_slice(start);
    let (mut gradient, mut curvature) = (DVector::zeros(size), DMatrix::zeros(size, size));
    let mut value = objective.evaluate(at.as_slice(), Some((&mut gradient, &mut curvature)));
    let (mut next_gradient, mut next_curvature) = (gradient.clone(), curvature.clone());
    for _ in 0..MOST_STEPS {
        let norm = gradient.norm();
        if !(norm > SMALL && value.is_finite()) {
            break;
        }
        let Some(step) = step(&gradient, &curvature) else { break };
        let slope = gradient.dot(&step);
        let mut share = 1.0;
        let mut has_moved = false;
        for halvings in 0..MOST_HALVINGS {
            let next = &at + share * &step;
            // Most steps are taken whole, and then need the derivatives.
            let is_whole = halvings == 0;
            let derivatives = Some((&mut next_gradient, &mut next_curvature));
            let mut decreased =
                objective.evaluate(next.as_slice(), derivatives.filter(|_| is_whole));
            let is_lower = decreased <= value + SUFFICIENT * share * slope;
            let is_level = (decreased - value).abs() <= 1e-12 * value.abs().max(1.0);
            if decreased.is_finite() && (is_lower || is_level) {
                if !is_whole {
                    let derivatives = Some((&mut next_gradient, &mut next_curvature));
                    decreased = objective.evaluate(next.as_slice(), derivatives);
                }
                if is_lower || next_gradient.norm() < norm {
                    has_moved = next != at;
                    (at, value) = (next, decreased);
                    std::mem::swap(&mut gradient, &mut next_gradient);
                    std::mem::swap(&mut curvature, &mut next_curvature);
                    break;
                }
            }
            share *= 0.5;
        }
        if !has_moved {
            break;
        }
    }
    let gradient_norm = gradient.norm();
    Minimum { at: at.as_slice().to_vec(), value, gradient_norm, curvature }
}

/// A direction of descent.
fn step(gradient: &DVector<f64>, curvature: &DMatrix<f64>) -> Option<DVector<f64>> {
    let diagonal = curvature.diagonal().map(f64::abs);
    let scale = diagonal.max().max(f64::MIN_POSITIVE);
    let mut added = 0.0;
    for _ in 0..60 {
        let mut damped = curvature.clone();
        for (index, own) in diagonal.iter().enumerate() {
            damped[(index, index)] += added * own.max(1e-6 * scale);
        }
        if let Some(root) = Cholesky::new(damped) {
            let step = -root.solve(gradient);
            if step.iter().all(|x| x.is_finite()) {
                return Some(step);
            }
        }
        added = if added == 0.0 { 1e-8 } else { added * 4.0 };
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// (1 - x)² + 100 (y - x²)², by Rosenbrock.
    struct Valley;

    impl Objective for Valley {
        fn size(&self) -> usize {
            2
        }

        fn evaluate(
            &self,
            at: &[f64],
            derivatives: Option<(&mut DVector<f64>, &mut DMatrix<f64>)>,
        ) -> f64 {
            let [x, y] = [at[0], at[1]];
            let off = y - x * x;
            if let Some((gradient, curvature)) = derivatives {
                gradient.copy_from_slice(&[-2.0 * (1.0 - x) - 400.0 * x * off, 200.0 * off]);
                let mixed = -400.0 * x;
                curvature.copy_from_slice(&[
                    2.0 - 400.0 * (off - 2.0 * x * x),
                    mixed,
                    mixed,
                    200.0,
                ]);
            }
            (1.0 - x) * (1.0 - x) + 100.0 * off * off
        }
    }

    #[test]
    fn the_bottom_of_a_bent_valley_is_found() {
        let found = minimise(&Valley, &[-1.2, 1.0]);
        assert!(found.has_converged(), "{found:?}");
        assert!((found.at[0] - 1.0).abs() < 1e-9 && (found.at[1] - 1.0).abs() < 1e-9, "{found:?}");
    }
}
