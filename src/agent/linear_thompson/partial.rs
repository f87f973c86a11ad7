//! Partial pooling: each person has coefficients of their own, around coefficients that people have in common.
//!
//! For every regression, θ_i = θ + u_i, where θ has the prior of the agent and u_i ~ N(0, D) with a diagonal D. Given θ,
//! people are independent, so that the posterior follows exactly from messages between the common coefficients and those of
//! each person: N(Λ⁻¹b, Λ⁻¹) seen through the deviation u is N(Λ⁻¹b, Λ⁻¹ + D). The common posterior is the prior times the
//! data of people seen through their deviations; a person's is the common one without the person, seen through the
//! deviation, times the person's own data. The time is linear in people and never depends on the number of decisions.
//!
//! In: the sums of the prior and of people. Out: the posterior of every person, and of a person of whom nothing is known.
//!
//! **Source**: the model is that of Tomkins et al., "IntelligentPooling", Machine Learning 110, 2021, without effects of
//! time. Deviations are estimated by the marginal likelihood of all rewards, whose derivatives are those of Harville,
//! "Maximum likelihood approaches to variance component estimation", JASA 72, 1977.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::agent::linear_thompson::regression::{NotPositiveDefinite, Regression};
use crate::key::{KeyType, Kind, Value};
use crate::state::resumable;

/// How much the coefficients of people deviate from the common ones.
#[derive(Clone, Debug, PartialEq)]
pub enum PersonSd {
    /// By standard deviations that are estimated at every update.
    Estimated,
    /// By this standard deviation.
    Same(f64),
    /// By a standard deviation per feature, or per coefficient.
    Each(Vec<f64>),
}

impl PersonSd {
    /// The first, the smallest and the largest value of an estimated deviation, as multiples of its scale.
    pub const HELD: [f64; 3] = [FIRST, BOUNDS[0], BOUNDS[1]];

    /// The values of the key.
    pub const KIND: Kind = Kind::AnyOf(&[
        Kind::Choice(&["estimated"]),
        Kind::NON_NEGATIVE,
        Kind::Reals { least: 1, most: 1000, min: 0.0, max: 1e6 },
    ]);

    /// The deviations of `count` regressions of `width` coefficients in blocks of `features`; `None` if they are
    /// estimated, or if a list has neither a number per feature nor one per coefficient.
    pub fn of_coefficients(
        &self,
        (count, width): (usize, usize),
        features: usize,
    ) -> Option<Vec<f64>> {
        let all = count * width;
        match self {
            PersonSd::Estimated => None,
            PersonSd::Same(sd) => Some(vec![*sd; all]),
            PersonSd::Each(sds) => (sds.len() == features || sds.len() == all)
                .then(|| sds.iter().copied().cycle().take(all).collect()),
        }
    }
}

impl KeyType for PersonSd {
    fn to_value(&self) -> Value {
        match self {
            PersonSd::Estimated => Value::Choice("estimated"),
            PersonSd::Same(sd) => sd.to_value(),
            PersonSd::Each(sds) => sds.to_value(),
        }
    }

    fn from_value(value: &Value) -> Option<Self> {
        match value {
            Value::Choice("estimated") => Some(PersonSd::Estimated),
            Value::Real(sd) => Some(PersonSd::Same(*sd)),
            Value::Reals(sds) => Some(PersonSd::Each(sds.clone())),
            _ => None,
        }
    }
}

/// The largest number of points at which an update computes the marginal likelihood of a regression.
const POINTS: usize = 10;
/// The estimate is found if no logarithm of a variance would change by more than this.
const CLOSE: f64 = 0.02;
/// The largest change of the logarithm of a variance between two points.
const LONGEST: f64 = 3.0;
/// Estimates stay within these multiples of the scale of a coefficient, and begin with the last.
const BOUNDS: [f64; 2] = [1e-3, 10.0];
const FIRST: f64 = 0.1;
/// From this ratio of a deviation's variance to what is known without it, sums seen through deviations are computed by the
/// covariance: differences of sums would lose their digits.
const WIDE: f64 = 1e6;

/// The pooling of one regression.
#[derive(Clone, Debug)]
pub struct Pooled {
    /// The standard deviations of people's coefficients around the common ones, \[coefficients\].
    sds: Vec<f64>,
    /// The bounds of these, \[coefficients\]; `None` if they are not estimated.
    bounds: Option<Vec<[f64; 2]>>,
    seen: Seen,
    /// The data of people seen through their deviations, \[people\].
    messages: Vec<Regression>,
    common: Regression,
    rest: Regression,
}

/// The marginal likelihood at some deviations, up to a constant, and how to change the logarithms of the variances,
/// \[coefficients\].
struct Point {
    log_likelihood: f64,
    step: Vec<f64>,
}

impl Pooled {
    /// The pooling of a regression with this prior; with these deviations, or else estimated ones. The scale of a
    /// coefficient is the standard deviation of its prior, unless another scale is given: the posterior of a pilot says how
    /// well the common coefficients are known, not how people differ.
    fn new(prior: &Regression, sds: Option<Vec<f64>>, scale: Option<f64>) -> Pooled {
        let of_prior = prior.precision.diagonal().map(|precision| 1.0 / precision.sqrt());
        let scales = of_prior.map(|sd| scale.unwrap_or(sd));
        let bounds = scales.iter().map(|sd| BOUNDS.map(|bound| bound * sd)).collect();
        Pooled {
            bounds: sds.is_none().then_some(bounds),
            sds: sds.unwrap_or_else(|| scales.iter().map(|sd| FIRST * sd).collect()),
            seen: Seen::default(),
            messages: Vec::new(),
            common: prior.clone(),
            rest: prior.clone(),
        }
    }

    /// The pooling of all regressions with these priors; with estimated deviations of this scale, or of the scale of the
    /// priors.
    pub fn all(priors: &[Regression], sds: Option<&[f64]>, scale: Option<f64>) -> Vec<Pooled> {
        let mut first = 0;
        let of_one = |prior: &Regression| {
            let own = first..first + prior.information.len();
            first = own.end;
            Pooled::new(prior, sds.map(|sds| sds[own].to_vec()), scale)
        };
        priors.iter().map(of_one).collect()
    }

    /// The standard deviations of people's coefficients around the common ones, \[coefficients\].
    pub fn sds(&self) -> &[f64] {
        &self.sds
    }

    /// The sums of the common coefficients, after the last [`Pooled::learn`].
    pub fn common(&self) -> &Regression {
        &self.common
    }

    /// The standard deviations of people's effects of messages around the common effects, for states of this number of
    /// features, \[messages\]\[features\].
    pub fn deviations_of_effects(pooled: &[Pooled], features: usize) -> Vec<Vec<f64>> {
        if let [joint] = pooled {
            // Behind the baseline and as many blocks of probabilities.
            let blocks = joint.sds.chunks_exact(features);
            let messages = blocks.len() / 2;
            return blocks.skip(1 + messages).map(<[f64]>::to_vec).collect();
        }
        let effect = |message: &Pooled| {
            let pairs = message.sds.iter().zip(&pooled[0].sds);
            pairs.map(|(with, without)| with.hypot(*without)).collect()
        };
        pooled.iter().skip(1).map(effect).collect()
    }

    /// Learns from the sums of people, and first estimates the deviations if they are to be estimated.
    ///
    /// **Errors**: a precision is not positive definite.
    pub fn learn(
        &mut self,
        prior: &Regression,
        people: &[&Regression],
    ) -> Result<(), NotPositiveDefinite> {
        let Some(bounds) = self.bounds.take() else {
            return self.collect(prior, people).map(|_| ());
        };
        let estimated = self.estimate(prior, people, &bounds);
        self.bounds = Some(bounds);
        estimated
    }

    /// Climbs the marginal likelihood from the last estimate, which stays where the likelihood is flat.
    fn estimate(
        &mut self,
        prior: &Regression,
        people: &[&Regression],
        bounds: &[[f64; 2]],
    ) -> Result<(), NotPositiveDefinite> {
        let mut best = self.point(prior, people)?;
        let (mut from, mut share) = (self.sds.clone(), 1.0);
        for _ in 1..POINTS {
            let mut farthest = 0.0_f64;
            for (index, sd) in self.sds.iter_mut().enumerate() {
                let [least, most] = bounds[index];
                let by = share * best.step[index];
                *sd = (from[index] * libm::exp(by / 2.0)).clamp(least, most);
                farthest = farthest.max(2.0 * libm::log(*sd / from[index]).abs());
            }
            if farthest < CLOSE {
                break;
            }
            // A point whose sums are not positive definite is no better than one with a smaller likelihood.
            match self.point(prior, people) {
                Ok(point) if point.log_likelihood > best.log_likelihood => {
                    (best, share) = (point, 1.0);
                    from.clone_from(&self.sds);
                }
                _ => share *= 0.25,
            }
        }
        self.sds = from;
        self.collect(prior, people).map(|_| ())
    }

    /// Collects the messages of people at the present deviations; returns the marginal log likelihood of what the
    /// people's messages have integrated out.
    fn collect(
        &mut self,
        prior: &Regression,
        people: &[&Regression],
    ) -> Result<f64, NotPositiveDefinite> {
        self.messages.resize(people.len(), prior.clone());
        self.common.copy_from(prior);
        let mut log_likelihood = 0.0;
        for (message, data) in self.messages.iter_mut().zip(people) {
            log_likelihood += self.seen.through(&self.sds, data, message)?;
            self.common.add(message);
        }
        Ok(log_likelihood)
    }

    /// The marginal likelihood at the present deviations, and the scoring step from there.
    ///
    /// With r_i = X_i'P(y - Xm) and K_i = X_i'PX_i, where P is the inverse of the rewards' covariance, the derivative by
    /// the variance d_j is ½ Σ_i (r_ij² - K_ijj), and the expected information nearly ½ Σ_i K_ijj².
    fn point(
        &mut self,
        prior: &Regression,
        people: &[&Regression],
    ) -> Result<Point, NotPositiveDefinite> {
        let mut log_likelihood = self.collect(prior, people)?;
        let root = Cholesky::new(self.common.precision.clone()).ok_or(NotPositiveDefinite)?;
        let mean = root.solve(&self.common.information);
        log_likelihood += 0.5 * self.common.information.dot(&mean);
        let lower = root.l_dirty();
        log_likelihood -= lower.diagonal().iter().map(|x| libm::log(*x)).sum::<f64>();
        let width = self.sds.len();
        let [mut squares, mut shares, mut information] = [(); 3].map(|()| vec![0.0; width]);
        let mut whitened = self.common.precision.clone();
        for message in &self.messages {
            let residual = &message.information - &message.precision * &mean;
            whitened.copy_from(&message.precision);
            lower.solve_lower_triangular_unchecked_mut(&mut whitened);
            for index in 0..width {
                let common = whitened.column(index).norm_squared();
                let share = message.precision[(index, index)] - common;
                squares[index] += residual[index] * residual[index];
                shares[index] += share;
                information[index] += share * share;
            }
        }
        let step = |index: usize| {
            // One person does not show how people differ.
            let has_data = |data: &&&Regression| data.precision[(index, index)] > 0.0;
            if people.iter().filter(has_data).take(2).count() < 2 {
                return 0.0;
            }
            let curvature = self.sds[index] * self.sds[index] * information[index];
            let step = (squares[index] - shares[index]) / curvature;
            // Without data about a coefficient, its deviation stays.
            if step.is_finite() { step.clamp(-LONGEST, LONGEST) } else { 0.0 }
        };
        Ok(Point { log_likelihood, step: (0..width).map(step).collect() })
    }

    /// Writes the posterior of a person: of the person with this number among those of the last
    /// [`Pooled::learn`], whose sums are `data`, or of a person without data.
    ///
    /// **Errors**: a precision is not positive definite.
    pub fn person(
        &mut self,
        person: Option<(usize, &Regression)>,
        out: &mut Regression,
    ) -> Result<(), NotPositiveDefinite> {
        self.rest.copy_from(&self.common);
        if let Some((number, _)) = person {
            self.rest.subtract(&self.messages[number]);
        }
        let mut ratios = self.sds.iter().enumerate();
        if ratios.any(|(index, sd)| sd * sd * self.rest.precision[(index, index)] > WIDE) {
            through_covariance(&self.sds, &self.rest, out)?;
        } else {
            self.seen.through(&self.sds, &self.rest, out)?;
        }
        if let Some((_, data)) = person {
            out.add(data);
        }
        Ok(())
    }
}

resumable!([] Pooled { fixed sds });

/// Writes sums seen through deviations, as [`Seen::through`] does, by the covariance of the coefficients.
///
/// **Errors**: the precision is not positive definite.
fn through_covariance(
    sds: &[f64],
    sums: &Regression,
    out: &mut Regression,
) -> Result<(), NotPositiveDefinite> {
    let known = Cholesky::new(sums.precision.clone()).ok_or(NotPositiveDefinite)?;
    let mean = known.solve(&sums.information);
    let mut covariance = known.inverse();
    for (index, sd) in sds.iter().enumerate() {
        covariance[(index, index)] += sd * sd;
    }
    out.precision = Cholesky::new(covariance).ok_or(NotPositiveDefinite)?.inverse();
    out.information = &out.precision * mean;
    Ok(())
}

/// Buffers of a view through deviations.
#[derive(Clone, Debug, Default)]
struct Seen {
    /// The coefficients with a deviation.
    deviating: Vec<usize>,
    /// The rows of RΛ and of Rb of these coefficients, with R = D^½.
    rows: DMatrix<f64>,
    sums: DVector<f64>,
    /// Memory for I + RΛR.
    square: Option<DMatrix<f64>>,
}

impl Seen {
    /// Writes the sums Λ - ΛR B⁻¹ RΛ and b - ΛR B⁻¹ Rb, with B = I + RΛR: those of the same coefficients, seen through
    /// deviations of these standard deviations R. Returns ½ (b'R B⁻¹ Rb - log |B|).
    ///
    /// **Errors**: B is not positive definite.
    fn through(
        &mut self,
        sds: &[f64],
        sums: &Regression,
        out: &mut Regression,
    ) -> Result<f64, NotPositiveDefinite> {
        out.copy_from(sums);
        self.deviating.clear();
        self.deviating.extend((0..sds.len()).filter(|index| sds[*index] > 0.0));
        let (count, width) = (self.deviating.len(), sds.len());
        if self.rows.shape() != (count, width) {
            self.rows = DMatrix::zeros(count, width);
            self.sums = DVector::zeros(count);
        }
        let mut square = self.square.take().filter(|square| square.nrows() == count);
        let square = square.get_or_insert_with(|| DMatrix::zeros(count, count));
        for (row, &index) in self.deviating.iter().enumerate() {
            self.sums[row] = sds[index] * sums.information[index];
            for column in 0..width {
                self.rows[(row, column)] = sds[index] * sums.precision[(column, index)];
            }
            for (column, &other) in self.deviating.iter().enumerate() {
                let identity = if row == column { 1.0 } else { 0.0 };
                square[(column, row)] = identity + sds[other] * self.rows[(row, other)];
            }
        }
        let root: Cholesky<f64, Dyn> =
            Cholesky::new(std::mem::take(square)).ok_or(NotPositiveDefinite)?;
        let lower = root.l_dirty();
        lower.solve_lower_triangular_unchecked_mut(&mut self.rows);
        lower.solve_lower_triangular_unchecked_mut(&mut self.sums);
        out.precision.gemm_tr(-1.0, &self.rows, &self.rows, 1.0);
        out.information.gemv_tr(-1.0, &self.rows, &self.sums, 1.0);
        let logs = lower.diagonal().iter().map(|x| libm::log(*x)).sum::<f64>();
        self.square = Some(root.unpack_dirty());
        Ok(0.5 * self.sums.norm_squared() - logs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::linear_thompson::regression::Factored;
    use crate::agent::linear_thompson::sampler::normal;
    use crate::rng::{Purpose, Stream};

    const WIDTH: usize = 3;
    const NOISE: f64 = 0.7;
    const PRIOR: ([f64; WIDTH], [f64; WIDTH]) = ([1.0, -0.5, 0.2], [2.0, 1.0, 4.0]);

    /// The rows of people and their rewards, whose coefficients deviate by these standard deviations.
    fn people(counts: &[usize], sds: [f64; WIDTH]) -> Vec<(DMatrix<f64>, DVector<f64>)> {
        let mut stream = Stream::new(5, Purpose::Exploration);
        let mut person = |count: &usize| {
            let own = DVector::from_fn(WIDTH, |j, _| 1.5 - j as f64 + sds[j] * normal(&mut stream));
            let mut entry = |_, j| if j == 0 { 1.0 } else { 2.0 * stream.unit() - 1.0 };
            let rows = DMatrix::from_fn(*count, WIDTH, &mut entry);
            let noise = DVector::from_fn(*count, |_, _| NOISE * normal(&mut stream));
            let rewards = &rows * own + noise;
            (rows, rewards)
        };
        counts.iter().map(&mut person).collect()
    }

    fn sums((rows, rewards): &(DMatrix<f64>, DVector<f64>)) -> Regression {
        let mut sums = Regression::prior(&PRIOR.0, &PRIOR.1);
        sums.clear();
        for (row, reward) in rows.row_iter().zip(rewards.iter()) {
            let row: Vec<f64> = row.iter().copied().collect();
            sums.learn(&row, *reward, NOISE * NOISE);
        }
        sums
    }

    /// A mean and a covariance.
    type Normal = (DVector<f64>, DMatrix<f64>);

    /// The joint normal distribution of the common coefficients, everybody's deviations and all rewards, without any
    /// blocks: for each person and for a person without data the mean and covariance of the coefficients given the
    /// rewards, and the log density of the rewards.
    fn dense(people: &[(DMatrix<f64>, DVector<f64>)], sds: &[f64]) -> (Vec<Normal>, f64) {
        let all = WIDTH * (people.len() + 2);
        let sd = |k: usize| if k < WIDTH { PRIOR.1[k] } else { sds[k % WIDTH] };
        let prior = DMatrix::from_fn(all, all, |i, j| if i == j { sd(i) * sd(i) } else { 0.0 });
        let mean = DVector::from_fn(all, |k, _| if k < WIDTH { PRIOR.0[k] } else { 0.0 });
        let count = people.iter().map(|one| one.0.nrows()).sum();
        let mut rows = DMatrix::zeros(count, all);
        let mut rewards = DVector::zeros(count);
        let mut first = 0;
        for (number, (own, paid)) in people.iter().enumerate() {
            rows.view_mut((first, 0), own.shape()).copy_from(own);
            rows.view_mut((first, WIDTH * (number + 1)), own.shape()).copy_from(own);
            rewards.rows_mut(first, own.nrows()).copy_from(paid);
            first += own.nrows();
        }
        let noise = DMatrix::from_diagonal_element(count, count, NOISE * NOISE);
        let root = Cholesky::new(&rows * &prior * rows.transpose() + noise).unwrap();
        let residual = rewards - &rows * &mean;
        let density = -0.5 * residual.dot(&root.solve(&residual))
            - root.l().diagonal().iter().map(|x| x.ln()).sum::<f64>();
        let gain = &prior * rows.transpose() * root.inverse();
        let mean = mean + &gain * residual;
        let covariance = &prior - &gain * &rows * &prior;
        let person = |number: usize| {
            let add = DMatrix::from_fn(WIDTH, all, |j, k| {
                let is_own = k == j || k == j + WIDTH * (number + 1);
                if is_own { 1.0 } else { 0.0 }
            });
            (&add * &mean, &add * &covariance * add.transpose())
        };
        ((0..=people.len()).map(person).collect(), density)
    }

    /// The pooling of people, and the posteriors of each and of a person without data.
    fn posteriors(sds: Option<&[f64]>, data: &[Regression]) -> (Pooled, Vec<Regression>) {
        let prior = Regression::prior(&PRIOR.0, &PRIOR.1);
        let mut pooled = Pooled::all(std::slice::from_ref(&prior), sds, None).remove(0);
        let sums: Vec<&Regression> = data.iter().collect();
        pooled.learn(&prior, &sums).unwrap();
        let known = data.iter().enumerate().map(Some).chain([None]);
        let posterior = |person| {
            let mut out = prior.clone();
            pooled.person(person, &mut out).unwrap();
            out
        };
        let posteriors = known.map(posterior).collect();
        (pooled, posteriors)
    }

    #[track_caller]
    fn assert_close(ours: &Regression, mean: &[f64], covariance: &DMatrix<f64>) {
        let factored = Factored::new(ours).unwrap();
        for (one, other) in factored.mean().iter().zip(mean) {
            assert!((one - other).abs() < 1e-9 * other.abs().max(1.0), "{one} {other}");
        }
        let difference = (factored.covariance() - covariance).amax();
        assert!(difference < 1e-9 * covariance.amax(), "{difference:e}");
    }

    #[test]
    fn posteriors_are_those_of_the_joint_normal_distribution() {
        let data = people(&[4, 1, 30, 0, 7, 2], [0.5, 0.0, 2.0]);
        let all: Vec<Regression> = data.iter().map(sums).collect();
        for sds in [[0.5, 0.0, 2.0], [1e-4, 3.0, 0.2], [5.0, 8.0, 3.0]] {
            let (_, ours) = posteriors(Some(&sds), &all);
            let (theirs, _) = dense(&data, &sds);
            assert_eq!(ours.len(), theirs.len());
            for (ours, (mean, covariance)) in ours.iter().zip(&theirs) {
                assert_close(ours, mean.as_slice(), covariance);
            }
        }
    }

    #[test]
    fn posteriors_are_those_of_numpy() {
        #[derive(serde::Deserialize)]
        struct File {
            mean: Vec<f64>,
            prior_sd: Vec<f64>,
            noise_sd: f64,
            rows: Vec<Vec<Vec<f64>>>,
            rewards: Vec<Vec<f64>>,
            cases: Vec<Case>,
        }
        #[derive(serde::Deserialize)]
        struct Case {
            person_sd: Vec<f64>,
            people: Vec<Known>,
        }
        #[derive(serde::Deserialize)]
        struct Known {
            mean: Vec<f64>,
            covariance: Vec<Vec<f64>>,
        }
        let file = include_str!("../../../tests/data/partial/posterior.json");
        let file: File = serde_json::from_str(file).unwrap();
        let prior = Regression::prior(&file.mean, &file.prior_sd);
        let sums = |(rows, rewards): (&Vec<Vec<f64>>, &Vec<f64>)| {
            let mut sums = prior.clone();
            sums.clear();
            for (row, reward) in rows.iter().zip(rewards) {
                sums.learn(row, *reward, file.noise_sd * file.noise_sd);
            }
            sums
        };
        let data: Vec<Regression> = file.rows.iter().zip(&file.rewards).map(sums).collect();
        let people: Vec<&Regression> = data.iter().collect();
        for Case { person_sd, people: known } in &file.cases {
            let mut pooled = Pooled::new(&prior, Some(person_sd.clone()), None);
            pooled.learn(&prior, &people).unwrap();
            let all = data.iter().enumerate().map(Some).chain([None]);
            assert_eq!(known.len(), data.len() + 1);
            for (person, Known { mean, covariance }) in all.zip(known) {
                let mut ours = prior.clone();
                pooled.person(person, &mut ours).unwrap();
                let entry = |row: usize, column: usize| covariance[row][column];
                assert_close(&ours, mean, &DMatrix::from_fn(WIDTH, WIDTH, entry));
            }
        }
    }

    #[test]
    fn without_deviations_people_are_one_person_and_with_large_ones_strangers() {
        let data = people(&[4, 30, 7], [0.5, 0.5, 0.5]);
        let all: Vec<Regression> = data.iter().map(sums).collect();
        let mut full = Regression::prior(&PRIOR.0, &PRIOR.1);
        all.iter().for_each(|one| full.add(one));
        let of_full = Factored::new(&full).unwrap();
        for ours in posteriors(Some(&[0.0; WIDTH]), &all).1 {
            assert_close(&ours, of_full.mean(), &of_full.covariance());
        }
        // A stranger has the prior of an agent of his own, with both variances.
        let large = [1e6, 1e6, 1e6];
        let strange: Vec<f64> = PRIOR.1.iter().map(|sd| sd.hypot(1e6)).collect();
        let (_, ours) = posteriors(Some(&large), &all);
        for (ours, data) in ours.iter().zip(&all) {
            let mut own = Regression::prior(&PRIOR.0, &strange);
            own.add(data);
            let own = Factored::new(&own).unwrap();
            assert_close(ours, own.mean(), &own.covariance());
        }
    }

    #[test]
    fn deviations_far_beyond_the_prior_lose_no_digits() {
        let sds = [0.01; WIDTH];
        let prior = Regression::prior(&PRIOR.0, &sds);
        let all = vec![1e6; WIDTH];
        let mut pooled = Pooled::new(&prior, Some(all), None);
        let mut newcomer = prior.clone();
        pooled.person(None, &mut newcomer).unwrap();
        let variance = 1e12 + 1e-4;
        let expected = DMatrix::from_diagonal_element(WIDTH, WIDTH, variance);
        assert_close(&newcomer, &PRIOR.0, &expected);
    }

    #[test]
    fn estimated_deviations_have_the_largest_marginal_likelihood() {
        let data = people(&[12; 40], [0.8, 0.05, 2.0]);
        let all: Vec<Regression> = data.iter().map(sums).collect();
        let prior = Regression::prior(&PRIOR.0, &PRIOR.1);
        let sums: Vec<&Regression> = all.iter().collect();
        let (mut pooled, _) = posteriors(None, &all);
        // The next updates start from the last estimate.
        (0..3).for_each(|_| pooled.learn(&prior, &sums).unwrap());
        let found = pooled.sds().to_vec();
        let (_, best) = dense(&data, &found);
        for index in 0..WIDTH {
            for factor in [0.9, 1.1] {
                let mut other = found.clone();
                other[index] *= factor;
                let (_, density) = dense(&data, &other);
                assert!(density < best + 1e-3, "{found:?}: {index} x {factor}: {density} {best}");
            }
        }
        assert!(
            (found[0] / 0.8 - 1.0).abs() < 0.3 && (found[2] / 2.0 - 1.0).abs() < 0.3,
            "{found:?}"
        );
        // The likelihood that is climbed is that of the rewards, up to a constant.
        let mut differences = Vec::new();
        for sds in [[0.8, 0.1, 2.0], [0.3, 1.0, 0.0], [5.0, 0.5, 0.5]] {
            let mut pooled = Pooled::all(std::slice::from_ref(&prior), Some(&sds), None).remove(0);
            let ours = pooled.point(&prior, &sums).unwrap().log_likelihood;
            differences.push(ours - dense(&data, &sds).1);
        }
        assert!((differences[0] - differences[1]).abs() < 1e-8, "{differences:?}");
        assert!((differences[0] - differences[2]).abs() < 1e-8, "{differences:?}");
    }

    #[test]
    fn deviations_stay_where_the_data_do_not_show_them() {
        let first: Vec<f64> = PRIOR.1.iter().map(|sd| FIRST * sd).collect();
        let data = people(&[12], [0.8, 0.05, 2.0]);
        let alone: Vec<Regression> = data.iter().map(sums).collect();
        assert_eq!(posteriors(None, &alone).0.sds(), first);
        assert_eq!(posteriors(None, &[]).0.sds(), first);
        // Nor does one person among others whose decisions do not concern the regression.
        let none = people(&[12, 0, 0], [0.8, 0.05, 2.0]);
        let one_of_three: Vec<Regression> = none.iter().map(sums).collect();
        assert_eq!(posteriors(None, &one_of_three).0.sds(), first);
        // A feature that is always 0 says nothing about its coefficient.
        let mut data = people(&[12; 9], [0.8, 0.05, 2.0]);
        data.iter_mut().for_each(|(rows, _)| rows.column_mut(1).fill(0.0));
        let all: Vec<Regression> = data.iter().map(sums).collect();
        let (pooled, _) = posteriors(None, &all);
        assert_eq!(pooled.sds()[1], first[1]);
        assert_ne!(pooled.sds()[0], first[0]);
        // People who are alike reach the smallest value.
        let data = people(&[40; 30], [0.0; WIDTH]);
        let all: Vec<Regression> = data.iter().map(sums).collect();
        let (mut pooled, _) = posteriors(None, &all);
        let prior = Regression::prior(&PRIOR.0, &PRIOR.1);
        let sums: Vec<&Regression> = all.iter().collect();
        (0..5).for_each(|_| pooled.learn(&prior, &sums).unwrap());
        let least = |index: usize| pooled.sds()[index] == PersonSd::HELD[1] * PRIOR.1[index];
        assert!((0..WIDTH).any(least), "{:?}", pooled.sds());
    }
}
