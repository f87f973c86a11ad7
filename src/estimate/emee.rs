//! The estimator of the marginal excursion effect: log relative risks of binary outcomes and counts.
//!
//! **Source**: Qian, Yoo, Klasnja, Almirall and Murphy, "Estimating time-varying causal excursion effects in mobile health
//! with binary outcomes", Biometrika 108, 2021, equation 7; its small-sample correction, after Mancl and DeRouen, is that
//! of the authors' R package MRTAnalysis, which takes Student's t.

use super::symmetric::{product, solve};

/// The decisions of an estimate as rows: person, weight, outcome, and the row of X with its centred treatments.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows {
    /// The number of columns of X.
    pub(crate) columns: usize,
    /// The number of columns of the model without treatment, the constant included.
    pub(crate) controls: usize,
    /// The number of columns of each treatment.
    pub(crate) terms: usize,
    /// What is subtracted from the indicator of a treatment.
    pub(crate) centre: f64,
    /// \[rows, 3 + columns\], person by person.
    pub(crate) numbers: Vec<f64>,
}

/// The coefficients with their covariance matrix, \[columns, columns\].
#[derive(Clone, Debug)]
pub(crate) struct Risks {
    pub(crate) coefficients: Vec<f64>,
    pub(crate) covariance: Vec<f64>,
    /// The weighted standard deviation of the residuals.
    pub(crate) residual_sd: f64,
}

/// Why there are no relative risks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum NoRisks {
    /// A person, from 0, has this outcome, which is no count.
    Outcome(usize, f64),
    /// No outcome is above 0.
    Nothing,
    /// The equations have no finite solution.
    Unsolved,
    /// The person of this number, from 0, alone determines a coefficient.
    Determined(usize),
}

/// The most steps of Newton's method.
const MOST_STEPS: usize = 100;
/// The largest last step, in units of the scale of each column.
const LAST_STEP: f64 = 1e-9;

/// A row at some coefficients: U = D r has the derivative −D (r z' + m x') with z the uncentred treatment.
struct AtRow {
    /// Weight over relative risk: D is this number times the centred row.
    multiplier: f64,
    residual: f64,
    /// The expected outcome.
    mean: f64,
    weight: f64,
}

impl Rows {
    /// Adds a row of a person, numbered from 0.
    pub(crate) fn add(&mut self, person: usize, row: &[f64], weight: f64, outcome: f64) {
        self.numbers.extend([person as f64, weight, outcome]);
        self.numbers.extend_from_slice(row);
    }

    fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.numbers.chunks(3 + self.columns)
    }

    /// Sets the uncentred row: the controls, and the terms of the treatment that was given.
    fn uncentre(&self, row: &[f64], out: &mut [f64]) {
        out[..self.controls].copy_from_slice(&row[..self.controls]);
        let blocks = row[self.controls..].chunks(self.terms);
        for (block, out) in blocks.zip(out[self.controls..].chunks_mut(self.terms)) {
            // The first term is the constant.
            let scale = if block[0] > 0.0 { 1.0 / (1.0 - self.centre) } else { 0.0 };
            out.iter_mut().zip(block).for_each(|(out, value)| *out = scale * value);
        }
    }

    fn at(&self, row: &[f64], uncentred: &[f64], coefficients: &[f64]) -> AtRow {
        let sum = |from: usize, to: usize| {
            uncentred[from..to].iter().zip(&coefficients[from..]).map(|(x, c)| x * c).sum::<f64>()
        };
        let (without, effect) = (sum(0, self.controls), sum(self.controls, self.columns));
        let mean = (without + effect).exp();
        let weight = row[1];
        AtRow { multiplier: weight * (-effect).exp(), residual: row[2] - mean, mean, weight }
    }

    /// The equations at some coefficients, and minus their derivative, \[columns, columns\].
    fn equations(&self, coefficients: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let size = self.columns;
        let (mut sums, mut slopes) = (vec![0.0; size], vec![0.0; size * size]);
        let mut uncentred = vec![0.0; size];
        for row in self.rows() {
            self.uncentre(&row[3..], &mut uncentred);
            let at = self.at(row, &uncentred, coefficients);
            for (i, centred) in row[3..].iter().enumerate() {
                let score = at.multiplier * centred;
                sums[i] += score * at.residual;
                for (j, value) in uncentred.iter().enumerate() {
                    let changes = if j < self.controls { at.mean } else { at.mean + at.residual };
                    slopes[i * size + j] += score * changes * value;
                }
            }
        }
        (sums, slopes)
    }

    /// The weighted root mean square of each column, which is positive where columns are independent.
    fn scales(&self) -> Vec<f64> {
        let mut squares = vec![0.0; self.columns];
        let mut weights = 0.0;
        for row in self.rows() {
            weights += row[1];
            squares.iter_mut().zip(&row[3..]).for_each(|(sum, x)| *sum += row[1] * x * x);
        }
        squares.iter().map(|square| (square / weights).sqrt()).collect()
    }

    /// The solution of the equations, and the inverse of minus their derivative there, \[columns, columns\].
    ///
    /// **Errors**: see [`NoRisks`].
    fn solved(&self) -> Result<(Vec<f64>, Vec<f64>), NoRisks> {
        let mean = self.rows().map(|row| row[1] * row[2]).sum::<f64>()
            / self.rows().map(|row| row[1]).sum::<f64>();
        // Without rows, it is not a number.
        if mean.is_nan() || mean <= 0.0 {
            return Err(NoRisks::Nothing);
        }
        let scales = self.scales();
        let size = |sums: &[f64]| -> f64 {
            sums.iter().zip(&scales).map(|(sum, scale)| (sum / scale).abs()).sum()
        };
        let mut now = vec![0.0; self.columns];
        now[0] = mean.ln();
        let (mut sums, mut slopes) = self.equations(&now);
        for _ in 0..MOST_STEPS {
            let inverse = inverse(&slopes, &scales).ok_or(NoRisks::Unsolved)?;
            let step: Vec<f64> = product(&inverse, &sums);
            let largest = step.iter().zip(&scales).map(|(step, scale)| (step * scale).abs());
            let largest = largest.fold(0.0, f64::max);
            if largest < LAST_STEP {
                now.iter_mut().zip(step).for_each(|(now, step)| *now += step);
                return Ok((now, inverse));
            }
            let mut part = 1.0;
            let before = size(&sums);
            loop {
                let next: Vec<f64> =
                    now.iter().zip(&step).map(|(now, step)| now + part * step).collect();
                let (next_sums, next_slopes) = self.equations(&next);
                // A step that leads out of range gives NaN, which is not less.
                if size(&next_sums) < before {
                    (now, sums, slopes) = (next, next_sums, next_slopes);
                    break;
                }
                part /= 2.0;
                if part < 1e-9 {
                    return Err(NoRisks::Unsolved);
                }
            }
        }
        Err(NoRisks::Unsolved)
    }

    /// The coefficients alone, for which one person suffices, and outcomes that are no counts.
    ///
    /// **Errors**: see [`NoRisks`].
    pub(crate) fn coefficients(&self) -> Result<Vec<f64>, NoRisks> {
        self.solved().map(|(coefficients, _)| coefficients)
    }

    /// The coefficients, with standard errors clustered by person and corrected for small samples.
    ///
    /// With B the inverse of minus the derivative, s the person's sum of D r, and G that of m D x', the corrected score
    /// D'(I − H)⁻¹ r equals (I − G B)⁻¹ s.
    ///
    /// **Errors**: see [`NoRisks`].
    pub(crate) fn fit(&self, is_corrected: bool) -> Result<Risks, NoRisks> {
        let is_count = |outcome: f64| outcome >= 0.0 && outcome.fract() == 0.0;
        if let Some(row) = self.rows().find(|row| !is_count(row[2])) {
            return Err(NoRisks::Outcome(row[0] as usize, row[2]));
        }
        let (coefficients, bread) = self.solved()?;
        let size = self.columns;
        let mut covariance = vec![0.0; size * size];
        let (mut squares, mut weights) = (0.0, 0.0);
        let all: Vec<&[f64]> = self.rows().collect();
        let mut uncentred = vec![0.0; size];
        for of_person in all.chunk_by(|one, next| one[0] == next[0]) {
            let (mut score, mut gram) = (vec![0.0; size], vec![0.0; size * size]);
            for row in of_person {
                self.uncentre(&row[3..], &mut uncentred);
                let at = self.at(row, &uncentred, &coefficients);
                squares += at.weight * at.residual * at.residual;
                weights += at.weight;
                for (i, centred) in row[3..].iter().enumerate() {
                    score[i] += at.multiplier * centred * at.residual;
                    for (j, value) in uncentred.iter().enumerate() {
                        gram[i * size + j] += at.multiplier * centred * at.mean * value;
                    }
                }
            }
            if is_corrected {
                let mut rest = vec![0.0; size * size];
                for (i, row) in gram.chunks(size).enumerate() {
                    for j in 0..size {
                        let leverage: f64 = (0..size).map(|k| row[k] * bread[k * size + j]).sum();
                        rest[i * size + j] = f64::from(u8::from(i == j)) - leverage;
                    }
                }
                if !solve(&mut rest, &mut score) {
                    return Err(NoRisks::Determined(of_person[0][0] as usize));
                }
            }
            let part = product(&bread, &score);
            for (row, one) in covariance.chunks_mut(size).zip(&part) {
                row.iter_mut().zip(&part).for_each(|(sum, other)| *sum += one * other);
            }
        }
        Ok(Risks { coefficients, covariance, residual_sd: (squares / weights).sqrt() })
    }
}

/// The inverse of a matrix whose rows and columns have these scales; `None` if it is singular.
fn inverse(matrix: &[f64], scales: &[f64]) -> Option<Vec<f64>> {
    let size = scales.len();
    let largest = (0..size).map(|i| (matrix[i * size + i] / (scales[i] * scales[i])).abs());
    let largest = largest.fold(0.0, f64::max);
    let mut inverse = vec![0.0; size * size];
    for unit in 0..size {
        let scaled = matrix.iter().enumerate();
        let mut scaled: Vec<f64> = scaled
            .map(|(index, value)| value / (scales[index / size] * scales[index % size] * largest))
            .collect();
        let mut column = vec![0.0; size];
        column[unit] = 1.0 / (scales[unit] * largest);
        if !solve(&mut scaled, &mut column) {
            return None;
        }
        for (i, value) in column.into_iter().enumerate() {
            inverse[i * size + unit] = value / scales[i];
        }
    }
    inverse.iter().all(|value| value.is_finite()).then_some(inverse)
}
