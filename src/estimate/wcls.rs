//! Weighted and centred least squares, from the sums of each person.

use super::symmetric::{inverse, packed, product, solve, times};

/// The sums of a weighted regression by person: X'WX as a packed triangle, X'Wy, the number of rows, the sum of weights, and
/// y'Wy.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sums {
    /// The number of columns of X.
    pub(crate) columns: usize,
    /// \[people, [`Sums::stride`]\].
    pub(crate) numbers: Vec<f64>,
}

/// The coefficients with their covariance matrix, \[columns, columns\].
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    pub(crate) coefficients: Vec<f64>,
    pub(crate) covariance: Vec<f64>,
    /// The number of people with rows.
    pub(crate) people: usize,
    /// The weighted standard deviation of the residuals.
    pub(crate) residual_sd: f64,
    /// By coefficient: the standard error that rounding alone can have, at the scale of the outcome.
    pub(crate) rounding: Vec<f64>,
}

/// The part of the outcome's root mean square up to which a residual is taken for rounding.
const ROUNDING: f64 = 1e-12;

/// Why a regression has no fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoFit {
    /// There are at most as many people as columns.
    People(usize),
    /// This column is a linear combination of the columns before it.
    Dependent(usize),
    /// The person of this number, from 0, alone determines a coefficient.
    Determined(usize),
}

/// Whether the residuals of each person are corrected for the person's own weight in the fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Correction {
    /// The correction of Mancl and DeRouen.
    ManclDeRouen,
    /// None, as in geepack and in lifejacket.
    None,
}

impl Sums {
    fn stride(&self) -> usize {
        packed(self.columns) + self.columns + 3
    }

    /// Adds a row of a person, numbered from 0.
    pub(crate) fn add(&mut self, person: usize, row: &[f64], weight: f64, outcome: f64) {
        let stride = self.stride();
        if self.numbers.len() < (person + 1) * stride {
            self.numbers.resize((person + 1) * stride, 0.0);
        }
        let own = &mut self.numbers[person * stride..(person + 1) * stride];
        let mut index = 0;
        for (i, value) in row.iter().enumerate() {
            let weighted = weight * value;
            for (sum, other) in own[index..=index + i].iter_mut().zip(row) {
                *sum += weighted * other;
            }
            index += i + 1;
        }
        for (sum, value) in own[index..].iter_mut().zip(row) {
            *sum += weight * value * outcome;
        }
        for (sum, value) in
            own[stride - 3..].iter_mut().zip([1.0, weight, weight * outcome * outcome])
        {
            *sum += value;
        }
    }

    /// The sums over people of the number of rows, the weights, and y'Wy.
    fn totals(&self) -> [f64; 3] {
        let stride = self.stride();
        let own =
            |offset: usize| self.numbers.iter().skip(stride - 3 + offset).step_by(stride).sum();
        [0, 1, 2].map(own)
    }

    /// The number of rows.
    pub(crate) fn rows(&self) -> u64 {
        self.totals()[0] as u64
    }

    /// The coefficients alone, for which one person suffices.
    ///
    /// **Errors**: the column that is a linear combination of the columns before it.
    pub(crate) fn coefficients(&self) -> Result<Vec<f64>, usize> {
        self.solved().map(|solved| solved.coefficients)
    }

    fn solved(&self) -> Result<Solved, usize> {
        let (size, triangle) = (self.columns, packed(self.columns));
        let mut all = vec![0.0; triangle + size];
        for own in self.numbers.chunks(self.stride()) {
            all.iter_mut().zip(own).for_each(|(sum, value)| *sum += value);
        }
        let right = all.split_off(triangle);
        let bread = inverse(&all, size)?;
        let mut coefficients = product(&bread, &right);
        // One step of refinement removes the rounding of the inverse.
        let explained = times(&all, &coefficients);
        let rest: Vec<f64> = right.iter().zip(explained).map(|(right, one)| right - one).collect();
        coefficients.iter_mut().zip(product(&bread, &rest)).for_each(|(one, more)| *one += more);
        Ok(Solved { bread, right, coefficients })
    }

    /// The fit, with standard errors clustered by person.
    ///
    /// The leverage of a person is H = X A X'W with A the inverse of the sum of all X'WX. The corrected score
    /// X'W (I - H)⁻¹ r equals (I - X'WX A)⁻¹ X'W r, which needs the person's sums alone.
    pub(crate) fn fit(&self, correction: Correction) -> Result<Fit, NoFit> {
        let scores = self.scores(correction)?;
        let covariance = scores.covariance();
        let [_, weights, squares] = self.totals();
        let size = scores.coefficients.len();
        // Independent residuals of size r give a coefficient the standard error r √A, A its entry on the diagonal of the bread.
        let residual = ROUNDING * (squares / weights).sqrt();
        let of_coefficient = |index: usize| residual * scores.bread[index * size + index].sqrt();
        let rounding = (0..size).map(of_coefficient).collect();
        let Scores { coefficients, residual_sd, of_people, .. } = scores;
        Ok(Fit { coefficients, covariance, people: of_people.len(), residual_sd, rounding })
    }

    /// The scores of the people at the fit.
    ///
    /// **Errors**: as [`Sums::fit`].
    pub(crate) fn scores(&self, correction: Correction) -> Result<Scores, NoFit> {
        let (size, triangle) = (self.columns, packed(self.columns));
        let people = || self.numbers.chunks(self.stride()).map(|own| own.split_at(triangle));
        let counted = people().filter(|(_, own)| own[size] > 0.0).count();
        if counted <= size {
            return Err(NoFit::People(counted));
        }
        let Solved { bread, right, coefficients } = self.solved().map_err(NoFit::Dependent)?;
        // The residuals are orthogonal to X.
        let explained: f64 = right.iter().zip(&coefficients).map(|(sum, one)| sum * one).sum();
        let [_, weights, squares] = self.totals();
        let residual_sd = ((squares - explained).max(0.0) / weights).sqrt();
        let mut of_people = Vec::new();
        let mut matrix = vec![0.0; size * size];
        for (person, (gram, own)) in people().enumerate() {
            if own[size] == 0.0 {
                continue;
            }
            let explained = times(gram, &coefficients);
            let mut score: Vec<f64> =
                own.iter().zip(explained).map(|(sum, explained)| sum - explained).collect();
            if correction == Correction::ManclDeRouen {
                for (j, column) in bread.chunks(size).enumerate() {
                    // The bread is symmetric.
                    for (i, leverage) in times(gram, column).into_iter().enumerate() {
                        matrix[i * size + j] = f64::from(u8::from(i == j)) - leverage;
                    }
                }
                if !solve(&mut matrix, &mut score) {
                    return Err(NoFit::Determined(person));
                }
            }
            of_people.push((person, score));
        }
        Ok(Scores { bread, coefficients, residual_sd, of_people })
    }
}

/// A fit with the score of each person, which is the person's part in the covariance of the coefficients.
#[derive(Clone, Debug)]
pub(crate) struct Scores {
    /// The inverse of X'WX, \[columns, columns\].
    bread: Vec<f64>,
    pub(crate) coefficients: Vec<f64>,
    /// The weighted standard deviation of the residuals.
    pub(crate) residual_sd: f64,
    /// The people with rows, and their scores.
    pub(crate) of_people: Vec<(usize, Vec<f64>)>,
}

impl Scores {
    /// The covariance of the coefficients, \[columns, columns\].
    pub(crate) fn covariance(&self) -> Vec<f64> {
        let size = self.coefficients.len();
        let product = |vector: &[f64]| product(&self.bread, vector);
        let mut meat = vec![0.0; size * size];
        for (_, score) in &self.of_people {
            for (row, one) in meat.chunks_mut(size).zip(score) {
                row.iter_mut().zip(score).for_each(|(sum, other)| *sum += one * other);
            }
        }
        // A M A, whose rows are products of the symmetric A.
        let half: Vec<Vec<f64>> = meat.chunks(size).map(product).collect();
        let mut covariance = vec![0.0; size * size];
        for column in 0..size {
            let of_half: Vec<f64> = half.iter().map(|row| row[column]).collect();
            for (row, value) in product(&of_half).into_iter().enumerate() {
                covariance[row * size + column] = value;
            }
        }
        covariance
    }
}

/// The solution of the normal equations.
struct Solved {
    /// The inverse of X'WX, \[columns, columns\].
    bread: Vec<f64>,
    /// X'Wy.
    right: Vec<f64>,
    coefficients: Vec<f64>,
}
