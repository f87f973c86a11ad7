//! Bayesian linear regression with Gaussian prior and known noise.
//!
//! A regression keeps the precision Λ and Λm, to which a step adds x x' / noise² and x r / noise².
//! These sums do not depend on when the precision is factored. It is factored only before a draw or
//! a prediction.

use std::mem;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::state::resumable;

/// The posterior of the coefficients of one regression, in accumulated form.
#[derive(Clone, Debug, PartialEq)]
pub struct Regression {
    /// Λ, the inverse of the covariance.
    pub precision: DMatrix<f64>,
    /// Λm, with the mean m.
    pub information: DVector<f64>,
}

impl Regression {
    /// The prior: independent coefficients with these means and standard deviations.
    pub fn prior(means: &[f64], sds: &[f64]) -> Self {
        let precisions = DVector::from_iterator(sds.len(), sds.iter().map(|sd| 1.0 / (sd * sd)));
        let information = precisions.iter().zip(means).map(|(precision, mean)| precision * mean);
        Regression {
            information: DVector::from_iterator(means.len(), information),
            precision: DMatrix::from_diagonal(&precisions),
        }
    }

    /// Adds an observed reward with its regressors.
    #[inline(always)]
    pub fn learn(&mut self, regressors: &[f64], reward: f64, noise_variance: f64) {
        // Slices, which the compiler turns into vector instructions.
        let columns = self.precision.as_mut_slice().chunks_exact_mut(regressors.len());
        for (column, one) in columns.zip(regressors) {
            let scaled = one / noise_variance;
            column.iter_mut().zip(regressors).for_each(|(sum, other)| *sum += scaled * other);
        }
        let moments = self.information.as_mut_slice().iter_mut().zip(regressors);
        moments.for_each(|(sum, one)| *sum += one * reward / noise_variance);
    }

    /// Removes the prior and all data.
    pub fn clear(&mut self) {
        self.precision.fill(0.0);
        self.information.fill(0.0);
    }

    /// Adds the data of another regression of the same width, which has no prior of its own.
    #[inline(always)]
    pub fn add(&mut self, data: &Regression) {
        let add = |sums: &mut [f64], data: &[f64]| {
            sums.iter_mut().zip(data).for_each(|(sum, one)| *sum += one);
        };
        add(self.precision.as_mut_slice(), data.precision.as_slice());
        add(self.information.as_mut_slice(), data.information.as_slice());
    }

    /// Removes the data of another regression of the same width.
    pub fn subtract(&mut self, data: &Regression) {
        self.precision -= &data.precision;
        self.information -= &data.information;
    }

    /// Copies another regression of the same width.
    pub fn copy_from(&mut self, other: &Regression) {
        self.precision.copy_from(&other.precision);
        self.information.copy_from(&other.information);
    }
}

resumable!([] Regression { each precision, information });

/// A precision that is not positive definite in floating-point arithmetic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotPositiveDefinite;

/// A factored regression: its mean, and the Cholesky factor of its precision.
#[derive(Clone, Debug)]
pub struct Factored {
    /// Cholesky factor of the precision.
    root: Cholesky<f64, Dyn>,
    mean: DVector<f64>,
    /// Buffers for the next factor and for a solution.
    spare: DMatrix<f64>,
    solved: DVector<f64>,
}

impl Factored {
    /// Factors a regression.
    ///
    /// **Errors**: its precision is not positive definite.
    pub fn new(regression: &Regression) -> Result<Self, NotPositiveDefinite> {
        let width = regression.information.len();
        let identity = || DMatrix::identity(width, width);
        let mut factored = Factored {
            root: Cholesky::pack_dirty(identity()),
            mean: DVector::zeros(width),
            spare: identity(),
            solved: DVector::zeros(width),
        };
        factored.renew(regression)?;
        Ok(factored)
    }

    /// Factors a changed regression again, without allocating.
    ///
    /// **Errors**: the precision is not positive definite; the previous factor remains.
    pub fn renew(&mut self, regression: &Regression) -> Result<(), NotPositiveDefinite> {
        let mut matrix = mem::take(&mut self.spare);
        matrix.copy_from(&regression.precision);
        let Some(root) = Cholesky::new(matrix) else {
            self.spare = regression.precision.clone();
            return Err(NotPositiveDefinite);
        };
        self.spare = mem::replace(&mut self.root, root).unpack_dirty();
        self.mean.copy_from(&regression.information);
        self.root.solve_mut(&mut self.mean);
        Ok(())
    }

    /// The covariance of the coefficients.
    pub fn covariance(&self) -> DMatrix<f64> {
        self.root.inverse()
    }

    /// The mean of the coefficients.
    pub fn mean(&self) -> &[f64] {
        self.mean.as_slice()
    }

    /// Λ⁻¹x, for some regressors x.
    pub fn solve(&self, regressors: &[f64]) -> Vec<f64> {
        self.root.solve(&DVector::from_column_slice(regressors)).as_slice().to_vec()
    }

    /// The predicted mean for some regressors.
    pub fn predict(&self, regressors: &[f64]) -> f64 {
        dot(self.mean.as_slice(), regressors)
    }

    /// R⁻¹x, where RR' is the precision. The squared length of R⁻¹x is the variance x'Σx, and the
    /// covariance of x'θ and y'θ is the scalar product of R⁻¹x and R⁻¹y.
    pub fn whiten(&mut self, regressors: &[f64]) -> &[f64] {
        self.solved.as_mut_slice().copy_from_slice(regressors);
        self.root.l_dirty().solve_lower_triangular_unchecked_mut(&mut self.solved);
        self.solved.as_slice()
    }

    /// R⁻¹x as [`Factored::whiten`] computes it, for regressors that are 0 before `start`: the entries from there on, as
    /// those before are 0.
    pub fn whiten_from(&mut self, start: usize, regressors: &[f64]) -> &[f64] {
        let rest = self.solved.len() - start;
        let mut solved = self.solved.rows_mut(start, rest);
        solved.as_mut_slice().copy_from_slice(regressors);
        let root = self.root.l_dirty().view((start, start), (rest, rest));
        root.solve_lower_triangular_unchecked_mut(&mut solved);
        &self.solved.as_slice()[start..]
    }

    /// Replaces standard normal deviates z in place by coefficients m + R'⁻¹z.
    pub fn draw(&mut self, deviates: &mut [f64]) {
        self.solved.as_mut_slice().copy_from_slice(deviates);
        self.root.l_dirty().tr_solve_lower_triangular_unchecked_mut(&mut self.solved);
        let drawn = deviates.iter_mut().zip(&self.mean).zip(&self.solved);
        drawn.for_each(|((coefficient, mean), solved)| *coefficient = mean + solved);
    }
}

/// The scalar product, summed from first to last.
pub fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}
