//! The estimates of a pilot's coefficients: by person, or one for everybody.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::env::declared::{DrawPredictor, EffectSource, FitLaw, FitMethod, FittedDraw, Pilot};
use crate::fit::likelihood;
use crate::fit::newton::{Minimum, Objective, minimise};
use crate::fit::solve::Orthogonal;
use crate::rng::{Purpose, Stream, open_unit_from_bits};

/// The size of a logit from which its probability counts as 0 or 1.
const CERTAIN: f64 = 15.0;
/// The relative difference from which two optima differ.
const SAME: f64 = 1e-6;
/// Factors of the standard deviation at the starts of a search that can end in several optima.
const STARTS: [f64; 6] = [1.0, 0.3, 3.0, 0.1, 2.0, 6.0];
/// The most that a start moves a coefficient.
const MOVED: f64 = 1.0;

/// What the data of a person do not say, of a draw.
#[derive(Clone, Debug, PartialEq)]
pub enum FitNote {
    /// There are not more rows than coefficients.
    FewRows,
    /// All values are this one.
    Constant(f64),
    /// A combination of features tells the values apart without error.
    Separated,
    /// A coefficient that the rows do not determine, by its index in the pilot.
    NotIdentified(usize),
    /// A coefficient that is left out, because a value of its variable is rare.
    Rare(usize),
    /// The number of starts that ended in an optimum that is not the best.
    OtherOptima(usize),
    /// The number of starts that ran off to a density without bound.
    Unbounded(usize),
    /// No start ended in an optimum.
    NotConverged,
}

/// The estimates of one draw, of a person or of everybody.
#[derive(Clone, Debug)]
pub struct GroupFit {
    /// The person; `None` for everybody.
    pub person: Option<usize>,
    /// The number of rows.
    pub rows: usize,
    /// The coefficients that were estimated, by their index in the pilot.
    pub free: Vec<usize>,
    /// Their estimates.
    pub values: Vec<f64>,
    /// The covariance of the normal approximation, \[free, free\]; empty if there is none.
    pub covariance: Vec<f64>,
    /// What was minimised: half the sum of squares, or minus the log posterior density.
    pub objective: f64,
    /// The Euclidean norm of its gradient.
    pub gradient_norm: f64,
    /// The sum of squared residuals and the number of weights, of normal draws.
    pub squares: Option<(f64, usize)>,
    /// What the data do not say.
    pub notes: Vec<FitNote>,
}

impl GroupFit {
    /// Whether the estimates can be simulated.
    pub fn is_usable(&self) -> bool {
        let refused = [FitNote::FewRows, FitNote::Separated, FitNote::NotConverged];
        !self.notes.iter().any(|note| refused.contains(note))
    }

    /// The standard error of a coefficient, by its index in the pilot; `None` if it has none.
    pub fn error_of(&self, coefficient: usize) -> Option<f64> {
        let slot = self.free.iter().position(|one| *one == coefficient)?;
        let variance = self.covariance.get(slot * self.free.len() + slot)?;
        Some(variance.sqrt()).filter(|error| error.is_finite())
    }
}

/// The estimates of all coefficients.
#[derive(Clone, Debug)]
pub struct Fit {
    /// \[draws\], each by group.
    pub groups: Vec<Vec<GroupFit>>,
    /// \[people, coefficients\]; NaN where there is no estimate.
    pub values: Vec<Vec<f64>>,
    /// \[people, imputed columns\].
    pub imputed: Vec<Vec<f64>>,
    /// Whether each person has all coefficients.
    pub is_complete: Vec<bool>,
    /// Parameters of the model that were estimated.
    pub parameters: Vec<(String, f64)>,
}

/// The signal that stops a fit, and the receiver of its progress.
pub struct Fitting<'a> {
    /// Whether to stop.
    pub stop: &'a AtomicBool,
    /// Receives the number of fits done and of all fits.
    pub progress: &'a mut dyn FnMut(usize, usize),
}

/// Fits that are shared among workers before progress is shown.
const TOGETHER: usize = 64;

impl Fit {
    /// Estimates the coefficients of a pilot; `None` if it was stopped.
    pub fn new(pilot: &Pilot, fitting: &mut Fitting<'_>) -> Option<Fit> {
        let people: Vec<Option<usize>> = match pilot.pooled {
            true => vec![None],
            false => (0..pilot.people.len()).map(Some).collect(),
        };
        let tasks: Vec<(usize, Option<usize>)> = (0..pilot.draws.len())
            .flat_map(|draw| people.iter().map(move |person| (draw, *person)))
            .collect();
        let mut done: Vec<GroupFit> = Vec::with_capacity(tasks.len());
        for chunk in tasks.chunks(TOGETHER) {
            if fitting.stop.load(Ordering::Relaxed) {
                return None;
            }
            done.extend(side_by_side(chunk, |(draw, person)| group(pilot, *draw, *person)));
            (fitting.progress)(done.len(), tasks.len());
        }
        let mut groups: Vec<Vec<GroupFit>> = Vec::new();
        for _ in &pilot.draws {
            groups.push(done.drain(..people.len()).collect());
        }
        Some(Fit::of(pilot, groups))
    }

    /// The estimates of groups.
    pub(super) fn of(pilot: &Pilot, groups: Vec<Vec<GroupFit>>) -> Fit {
        let mut values = vec![vec![f64::NAN; pilot.coefficients.len()]; pilot.people.len()];
        for (draw, groups) in pilot.draws.iter().zip(&groups) {
            for group in groups.iter().filter(|group| group.is_usable()) {
                let people = group.person.map_or(0..pilot.people.len(), |one| one..one + 1);
                for own in &mut values[people] {
                    for index in coefficients(draw) {
                        // What the data do not determine is 0.
                        own[index] = 0.0;
                    }
                    for (index, value) in group.free.iter().zip(&group.values) {
                        own[*index] = *value;
                    }
                }
            }
        }
        let is_complete: Vec<bool> =
            values.iter().map(|own| own.iter().all(|value| value.is_finite())).collect();
        let mut parameters: Vec<(String, f64)> = Vec::new();
        for (index, coefficient) in pilot.coefficients.iter().enumerate() {
            if let (true, Some(own)) = (coefficient.is_parameter, values.first()) {
                parameters.push((coefficient.name.clone(), own[index]));
            }
        }
        let replayed: Vec<String> =
            pilot.replayed().into_iter().map(|(name, _)| name.to_owned()).collect();
        for (draw, groups) in pilot.draws.iter().zip(&groups) {
            let sd = draw.predictors.get(1).filter(|_| is_normal(draw.law));
            // Residuals that are replayed are the whole noise.
            let is_replayed = replayed.contains(&format!("residual_{}", draw.name));
            if let Some(name) = sd.filter(|_| !is_replayed).and_then(|sd| sd.parameter.clone())
                && let Some(sd) = residual_sd(groups)
                && !parameters.iter().any(|(known, _)| *known == name)
            {
                parameters.push((name, sd));
            }
        }
        let imputed = imputed(pilot, &groups, &values, &is_complete);
        Fit { groups, values, imputed, is_complete, parameters }
    }

    /// The effects that the data of some people do not determine, by their index, each with the number of these people.
    pub fn unidentified_effects(&self, pilot: &Pilot) -> Vec<(usize, usize)> {
        let mut found = Vec::new();
        for (index, _) in pilot.coefficients.iter().enumerate().filter(|(_, one)| one.is_effect) {
            let is_missing =
                |group: &&GroupFit| group.notes.contains(&FitNote::NotIdentified(index));
            let count = self.groups.iter().flatten().filter(is_missing).count();
            if count > 0 {
                found.push((index, count));
            }
        }
        found
    }
}

/// The parameters of a draw in one of its rows, by the values of all coefficients; what is not estimated is 0.
pub(super) fn parameters(draw: &FittedDraw, row: usize, values: &[f64]) -> Vec<f64> {
    let parameter = |predictor: &DrawPredictor| {
        let width = predictor.coefficients.len();
        let design = &predictor.design[row * width..(row + 1) * width];
        let terms = design.iter().zip(&predictor.coefficients);
        terms.fold(predictor.offset[row], |sum, (x, index)| sum + x * values[*index])
    };
    draw.predictors.iter().map(parameter).collect()
}

/// The results of tasks in their order, by all processors.
pub(super) fn side_by_side<T: Sync, R: Send>(tasks: &[T], run: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let workers = thread::available_parallelism().map_or(1, usize::from);
    let size = tasks.len().div_ceil(workers).max(1);
    let run = &run;
    thread::scope(|scope| {
        let workers: Vec<_> = tasks
            .chunks(size)
            .map(|tasks| scope.spawn(move || tasks.iter().map(run).collect::<Vec<R>>()))
            .collect();
        let join = |worker: thread::ScopedJoinHandle<'_, Vec<R>>| match worker.join() {
            Ok(results) => results,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        workers.into_iter().flat_map(join).collect()
    })
}

pub(super) fn is_normal(law: FitLaw) -> bool {
    matches!(law, FitLaw::Normal | FitLaw::Lognormal)
}

/// The standard deviation of the residuals of all groups; `None` without one.
pub(super) fn residual_sd(groups: &[GroupFit]) -> Option<f64> {
    let usable = groups.iter().filter(|group| group.is_usable());
    let sums = usable.filter_map(|group| Some((group.squares?, group.rows)));
    let [squares, degrees] = sums.fold([0.0, 0.0], |[sum, degrees], ((squares, weights), rows)| {
        [sum + squares, degrees + rows as f64 - weights as f64]
    });
    (degrees > 0.0).then(|| (squares / degrees).sqrt())
}

/// The coefficients of a draw, each once.
pub(super) fn coefficients(draw: &FittedDraw) -> BTreeSet<usize> {
    draw.predictors.iter().flat_map(|one| one.coefficients.iter().copied()).collect()
}

/// The imputed numbers of every person.
fn imputed(
    pilot: &Pilot,
    groups: &[Vec<GroupFit>],
    values: &[Vec<f64>],
    is_complete: &[bool],
) -> Vec<Vec<f64>> {
    let size = |(draw, parameter): (usize, usize)| match pilot.effect {
        EffectSource::Fitted => 0.0,
        EffectSource::Standardised(share) => share * residual_sd(&groups[draw]).unwrap_or(f64::NAN),
        EffectSource::ShareOfWeights(share) => {
            let predictor = &pilot.draws[draw].predictors[parameter];
            let is_weight = |index: &&usize| {
                !pilot.coefficients[**index].is_effect && !is_level(predictor, **index)
            };
            let weights: Vec<usize> =
                predictor.coefficients.iter().filter(is_weight).copied().collect();
            let people = values.iter().zip(is_complete).filter(|(_, complete)| **complete);
            let sizes = people.flat_map(|(own, _)| weights.iter().map(|index| own[*index].abs()));
            let (sum, count) =
                sizes.fold((0.0, 0.0), |(sum, count), size| (sum + size, count + 1.0));
            share * sum / count
        }
    };
    let of = pilot.imputed.iter().map(|column| match column.sign {
        0.0 => 0.0,
        sign => sign * size(column.of),
    });
    let of: Vec<f64> = of.collect();
    vec![of; pilot.people.len()]
}

/// Whether a coefficient multiplies the same number in every row: an intercept.
fn is_level(predictor: &DrawPredictor, coefficient: usize) -> bool {
    let width = predictor.coefficients.len();
    let Some(own) = predictor.coefficients.iter().position(|one| *one == coefficient) else {
        return false;
    };
    let mut column = predictor.design.iter().skip(own).step_by(width);
    let first = column.next();
    column.all(|x| Some(x) == first)
}

/// The estimates of one draw, of a person or of everybody.
fn group(pilot: &Pilot, draw: usize, person: Option<usize>) -> GroupFit {
    let draw = &pilot.draws[draw];
    let rows = match person {
        Some(person) => draw.people[person].clone(),
        None => 0..draw.decisions.len(),
    };
    Group::new(pilot, draw, person, rows).fit()
}

/// The rows of a group.
pub(super) struct Group<'a> {
    draw: &'a FittedDraw,
    person: Option<usize>,
    rows: Range<usize>,
    /// The coefficients that are estimated.
    free: Vec<usize>,
    notes: Vec<FitNote>,
    /// The only start of a search, by coefficient of the pilot; `None` for the usual ones.
    start: Option<&'a [f64]>,
}

impl<'a> Group<'a> {
    pub fn new(
        pilot: &Pilot,
        draw: &'a FittedDraw,
        person: Option<usize>,
        rows: Range<usize>,
    ) -> Group<'a> {
        let mut notes = Vec::new();
        let mut free = Vec::new();
        for index in coefficients(draw) {
            let is_rare = pilot.coefficients[index].rare.iter().any(|rare| {
                let (least, values) = &pilot.rare[*rare];
                let count = |value: f64| {
                    let own = draw.decisions[rows.clone()].iter();
                    own.filter(|one| values[**one as usize] == value).count() as f64
                };
                let most = rows.len() as f64 * least;
                count(0.0) <= most || count(1.0) <= most
            });
            if is_rare {
                notes.push(FitNote::Rare(index));
            } else {
                free.push(index);
            }
        }
        Group { draw, person, rows, free, notes, start: None }
    }

    /// The group with estimates of nearly the same rows, from which a search starts.
    pub fn from(self, start: &'a [f64]) -> Group<'a> {
        Group { start: Some(start).filter(|start| start.iter().all(|x| x.is_finite())), ..self }
    }

    /// The column of a coefficient in a parameter; `None` if the parameter does not have it.
    fn column(&self, parameter: usize, coefficient: usize) -> Option<Vec<f64>> {
        let predictor = &self.draw.predictors[parameter];
        let width = predictor.coefficients.len();
        let own = predictor.coefficients.iter().position(|one| *one == coefficient)?;
        Some(self.rows.clone().map(|row| predictor.design[row * width + own]).collect())
    }

    /// The columns of the free coefficients, with those of all parameters one behind the other.
    fn columns(&self, parameters: Range<usize>) -> Vec<Vec<f64>> {
        let column = |coefficient: &usize| {
            let parts = parameters.clone().flat_map(|parameter| {
                let column = self.column(parameter, *coefficient);
                column.unwrap_or_else(|| vec![0.0; self.rows.len()])
            });
            parts.collect()
        };
        self.free.iter().map(column).collect()
    }

    pub fn fit(mut self) -> GroupFit {
        let outcome = &self.draw.outcome[self.rows.clone()];
        if let [first, rest @ ..] = outcome
            && rest.iter().all(|value| value == first)
        {
            self.notes.push(FitNote::Constant(*first));
        }
        let has_prior = matches!(self.draw.method, FitMethod::Map(_));
        let kept = Orthogonal::new(self.columns(0..self.draw.predictors.len())).kept;
        let dependent: Vec<usize> =
            (0..self.free.len()).filter(|index| !kept.contains(index)).collect();
        for index in &dependent {
            self.notes.push(FitNote::NotIdentified(self.free[*index]));
        }
        if self.rows.len() <= self.free.len() && (!has_prior || self.rows.is_empty()) {
            self.notes.push(FitNote::FewRows);
            return self.without_estimate();
        }
        if !has_prior {
            self.free = kept.into_iter().map(|index| self.free[index]).collect();
        }
        match (is_normal(self.draw.law), self.draw.method) {
            (true, FitMethod::LeastSquares) if self.deviation().is_some() => {
                self.least_squares(0.0)
            }
            (true, FitMethod::Ridge(penalty)) if self.deviation().is_some() => {
                self.least_squares(penalty)
            }
            _ => self.likeliest(),
        }
    }

    fn without_estimate(self) -> GroupFit {
        GroupFit {
            person: self.person,
            rows: self.rows.len(),
            free: Vec::new(),
            values: Vec::new(),
            covariance: Vec::new(),
            objective: f64::NAN,
            gradient_norm: f64::NAN,
            squares: None,
            notes: self.notes,
        }
    }

    /// What a closed form does with the standard deviation: nothing, or one coefficient times a number; `None` if it cannot.
    fn deviation(&self) -> Option<Option<(usize, f64)>> {
        let sd = &self.draw.predictors[1];
        let of_mean = &self.draw.predictors[0].coefficients;
        match sd.coefficients[..] {
            [] => Some(None),
            [own] if !of_mean.contains(&own) => {
                let column = self.column(1, own)?;
                let first = *column.first()?;
                let is_plain = first > 0.0
                    && column.iter().all(|x| *x == first)
                    && self.rows.clone().all(|row| sd.offset[row] == 0.0);
                is_plain.then_some(Some((own, first)))
            }
            _ => None,
        }
    }

    /// Least squares, with this multiple of the sum of squared weights, in closed form.
    fn least_squares(mut self, penalty: f64) -> GroupFit {
        let deviation = self.deviation().flatten();
        self.free.retain(|one| deviation.is_none_or(|(own, _)| own != *one));
        let mean = &self.draw.predictors[0];
        let rest = self.rows.clone().map(|row| self.draw.outcome[row] - mean.offset[row]);
        let mut rest: Vec<f64> = rest.collect();
        let columns = self.columns(0..1);
        let penalties: Vec<f64> = columns
            .iter()
            .map(|column| if column.iter().all(|x| *x == column[0]) { 0.0 } else { penalty })
            .collect();
        let mut augmented = columns.clone();
        for (index, column) in augmented.iter_mut().enumerate().filter(|_| penalty > 0.0) {
            let root = |other: usize| if other == index { penalties[index].sqrt() } else { 0.0 };
            column.extend((0..penalties.len()).map(root));
        }
        let orthogonal = Orthogonal::new(augmented);
        let target =
            rest.iter().copied().chain(vec![0.0; if penalty > 0.0 { columns.len() } else { 0 }]);
        let found = orthogonal.nearest(&target.collect::<Vec<f64>>());
        let mut values = vec![0.0; self.free.len()];
        orthogonal.kept.iter().zip(found).for_each(|(index, value)| values[*index] = value);
        for (column, value) in columns.iter().zip(&values) {
            rest.iter_mut().zip(column).for_each(|(rest, x)| *rest -= value * x);
        }
        let squares: f64 = rest.iter().map(|x| x * x).sum();
        let weights = values.len();
        let variance = squares / (self.rows.len() - weights.min(self.rows.len() - 1)) as f64;
        let shrunk: f64 =
            values.iter().zip(&penalties).map(|(value, own)| own * value * value).sum();
        let size = values.len();
        let mut curvature = DMatrix::zeros(size, size);
        let mut gradient = DVector::zeros(size);
        for i in 0..size {
            let along: f64 = columns[i].iter().zip(&rest).map(|(x, rest)| x * rest).sum();
            gradient[i] = penalties[i] * values[i] - along;
            for j in 0..size {
                curvature[(i, j)] = columns[i].iter().zip(&columns[j]).map(|(x, y)| x * y).sum();
            }
            curvature[(i, i)] += penalties[i];
        }
        let scale = if variance > 0.0 { variance } else { 1.0 };
        let mut covariance = inverse(&curvature).map(|one| one * variance);
        if let Some((own, factor)) = deviation {
            // The standard deviation is the last one, independent of the others.
            values.push(variance.sqrt() / factor);
            self.free.push(own);
            covariance = covariance.map(|one| {
                let mut more = one.resize(size + 1, size + 1, 0.0);
                let degrees = self.rows.len().saturating_sub(size).max(1) as f64;
                more[(size, size)] = variance / (2.0 * degrees) / (factor * factor);
                more
            });
        }
        GroupFit {
            person: self.person,
            rows: self.rows.len(),
            free: self.free,
            values,
            covariance: covariance.map_or(Vec::new(), |one| one.as_slice().to_vec()),
            objective: 0.5 * (squares + shrunk),
            gradient_norm: gradient.norm() / scale,
            squares: Some((squares, weights)),
            notes: self.notes,
        }
    }

    /// The largest likelihood or posterior density, from one start or several.
    fn likeliest(mut self) -> GroupFit {
        let likelihood = Likelihood::new(&self, self.draw.method);
        let starts = self.starts();
        let ends: Vec<Minimum> = starts.iter().map(|start| minimise(&likelihood, start)).collect();
        let converged = ends.iter().filter(|end| end.has_converged());
        let best = converged.clone().min_by(|one, other| one.value.total_cmp(&other.value));
        let Some(best) = best else {
            self.notes.push(FitNote::NotConverged);
            let nearest =
                ends.iter().min_by(|one, other| one.gradient_norm.total_cmp(&other.gradient_norm));
            let gradient_norm = nearest.map_or(f64::NAN, |end| end.gradient_norm);
            return GroupFit { gradient_norm, ..self.without_estimate() };
        };
        let differs = |end: &&Minimum| end.value > best.value + SAME * (1.0 + best.value.abs());
        let others = converged.filter(differs).count();
        if others > 0 {
            self.notes.push(FitNote::OtherOptima(others));
        }
        let is_lower = |end: &&Minimum| !end.has_converged() && end.value < best.value - 1.0;
        let unbounded = ends.iter().filter(is_lower).count();
        if unbounded > 0 {
            self.notes.push(FitNote::Unbounded(unbounded));
        }
        if self.is_separated(&likelihood, &best.at) {
            self.notes.push(FitNote::Separated);
        }
        let squares = is_normal(self.draw.law).then(|| {
            let square = |row: usize| {
                let rest = self.draw.outcome[row] - likelihood.parameters(row, &best.at)[0];
                rest * rest
            };
            (self.rows.clone().map(square).sum(), self.free.len())
        });
        GroupFit {
            person: self.person,
            rows: self.rows.len(),
            free: self.free.clone(),
            values: best.at.clone(),
            covariance: inverse(&best.curvature).map_or(Vec::new(), |one| one.as_slice().to_vec()),
            objective: best.value,
            gradient_norm: best.gradient_norm,
            squares,
            notes: self.notes,
        }
    }

    /// Whether logits run off to infinity, where no prior holds them.
    fn is_separated(&self, likelihood: &Likelihood<'_>, at: &[f64]) -> bool {
        let logits = match self.draw.law {
            FitLaw::Bernoulli | FitLaw::Categorical => self.draw.predictors.len(),
            FitLaw::ZeroInflatedPoisson => 1,
            FitLaw::Normal | FitLaw::Lognormal | FitLaw::Poisson => 0,
        };
        let is_certain = |row: usize| {
            likelihood.parameters(row, at)[..logits].iter().any(|logit| logit.abs() > CERTAIN)
        };
        self.rows.clone().any(is_certain)
    }

    /// Where searches start. Functions that bend upwards everywhere have one start.
    fn starts(&self) -> Vec<Vec<f64>> {
        if let Some(start) = self.start {
            return vec![self.free.iter().map(|index| start[*index]).collect()];
        }
        let outcome = &self.draw.outcome[self.rows.clone()];
        let count = outcome.len().max(1) as f64;
        let mean = outcome.iter().sum::<f64>() / count;
        let sd = (outcome.iter().map(|y| (y - mean) * (y - mean)).sum::<f64>() / count).sqrt();
        let sd = if sd > 0.0 { sd } else { 1.0 };
        let positive: Vec<f64> = outcome.iter().copied().filter(|y| *y > 0.0).collect();
        let levels: Vec<f64> = match self.draw.law {
            FitLaw::Normal | FitLaw::Lognormal => vec![mean, sd],
            FitLaw::Bernoulli | FitLaw::Categorical => vec![0.0; self.draw.predictors.len()],
            FitLaw::Poisson => vec![libm::log(mean + 0.1)],
            FitLaw::ZeroInflatedPoisson => {
                let zeros = (count - positive.len() as f64 + 0.5) / (count + 1.0);
                let of_positive = positive.iter().sum::<f64>() / positive.len().max(1) as f64;
                vec![libm::log(zeros / (1.0 - zeros)), libm::log(of_positive + 0.1)]
            }
        };
        let mut base = vec![0.0; self.free.len()];
        let mut of_deviation = vec![false; self.free.len()];
        for (parameter, level) in levels.iter().enumerate() {
            let predictor = &self.draw.predictors[parameter];
            for (slot, index) in self.free.iter().enumerate() {
                let is_own = predictor.coefficients.contains(index);
                of_deviation[slot] |= is_own && parameter == 1 && is_normal(self.draw.law);
            }
            let level_of = |index: &usize| {
                let column = self.column(parameter, *index)?;
                let first = *column.first()?;
                let is_level = first != 0.0 && column.iter().all(|x| *x == first);
                is_level.then_some(first)
            };
            let mut levels = self.free.iter().enumerate();
            if let Some((slot, factor)) =
                levels.find_map(|(slot, index)| Some((slot, level_of(index)?)))
            {
                let offset = predictor.offset[self.rows.start];
                base[slot] = (level - offset) / factor;
            }
        }
        let has_one = match self.draw.law {
            FitLaw::Bernoulli | FitLaw::Poisson | FitLaw::Categorical => true,
            FitLaw::Normal | FitLaw::Lognormal => self.draw.predictors[1].coefficients.is_empty(),
            FitLaw::ZeroInflatedPoisson => false,
        };
        if has_one {
            return vec![base];
        }
        let mut stream = Stream::new(self.person.map_or(0, |one| one as u64 + 1), Purpose::Search);
        let start = |(number, factor): (usize, f64)| {
            let mut start = base.clone();
            for (value, of_deviation) in start.iter_mut().zip(&of_deviation) {
                let moved = (2.0 * open_unit_from_bits(stream.bits()) - 1.0) * MOVED;
                match of_deviation {
                    true => *value *= factor,
                    false if number > 0 => *value += moved,
                    false => {}
                }
            }
            start
        };
        STARTS.into_iter().enumerate().map(start).collect()
    }
}

/// Minus the log-likelihood of a group's rows, and what a prior or penalty adds.
struct Likelihood<'a> {
    draw: &'a FittedDraw,
    rows: Range<usize>,
    /// By parameter.
    parts: Vec<LinearPart>,
    /// By free coefficient: what its square is multiplied with, twice.
    precision: Vec<f64>,
    constant: f64,
}

/// The free coefficients of a parameter.
struct LinearPart {
    /// Their places among all free coefficients.
    slots: Vec<usize>,
    /// \[rows, slots\].
    design: Vec<f64>,
}

impl LinearPart {
    /// The numbers of a row of the group.
    fn row(&self, row: usize) -> &[f64] {
        let width = self.slots.len();
        &self.design[row * width..(row + 1) * width]
    }
}

impl<'a> Likelihood<'a> {
    fn new(group: &Group<'a>, method: FitMethod) -> Likelihood<'a> {
        let draw = group.draw;
        let part = |predictor: &DrawPredictor| {
            let slot = |index: &usize| group.free.iter().position(|one| one == index);
            let own = predictor.coefficients.iter().enumerate();
            let own: Vec<(usize, usize)> =
                own.filter_map(|(column, index)| Some((column, slot(index)?))).collect();
            let width = predictor.coefficients.len();
            let mut design = Vec::with_capacity(group.rows.len() * own.len());
            for row in group.rows.clone() {
                design.extend(own.iter().map(|(column, _)| predictor.design[row * width + column]));
            }
            LinearPart { slots: own.into_iter().map(|(_, slot)| slot).collect(), design }
        };
        let is_level = |index: &usize| {
            let column = |parameter| group.column(parameter, *index);
            { (0..draw.predictors.len()).filter_map(column) }
                .all(|column| column.iter().all(|x| *x == column[0]))
        };
        let precision = |index: &usize| match method {
            FitMethod::Map(sd) => 1.0 / (sd * sd),
            FitMethod::Ridge(penalty) if !is_level(index) => penalty,
            FitMethod::Ridge(_) | FitMethod::LeastSquares | FitMethod::Counts => 0.0,
        };
        let constant =
            group.rows.clone().map(|row| likelihood::constant(draw.law, draw.outcome[row]));
        Likelihood {
            draw,
            rows: group.rows.clone(),
            parts: draw.predictors.iter().map(part).collect(),
            precision: group.free.iter().map(precision).collect(),
            constant: constant.sum(),
        }
    }

    /// The parameters of a row's draw.
    fn parameters(&self, row: usize, at: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.parts.len()];
        self.fill(row, at, &mut out);
        out
    }

    fn fill(&self, row: usize, at: &[f64], out: &mut [f64]) {
        for ((predictor, part), out) in self.draw.predictors.iter().zip(&self.parts).zip(out) {
            let mut sum = predictor.offset[row];
            for (x, slot) in part.row(row - self.rows.start).iter().zip(&part.slots) {
                sum += x * at[*slot];
            }
            *out = sum;
        }
    }

    /// Adds a row to the derivatives, of which the curvature is complete below its diagonal.
    fn derive(
        &self,
        row: usize,
        (first, second): (&[f64], &[f64]),
        (gradient, curvature): (&mut [f64], &mut [f64]),
    ) {
        let size = gradient.len();
        for (k, part) in self.parts.iter().enumerate() {
            for (x, slot) in part.row(row).iter().zip(&part.slots) {
                gradient[*slot] -= first[k] * x;
                for (l, other) in self.parts.iter().enumerate() {
                    let factor = second[k * self.parts.len() + l] * x;
                    if factor == 0.0 {
                        continue;
                    }
                    let column = &mut curvature[slot * size..(slot + 1) * size];
                    for (y, to) in other.row(row).iter().zip(&other.slots) {
                        if to >= slot {
                            column[*to] -= factor * y;
                        }
                    }
                }
            }
        }
    }
}

impl Objective for Likelihood<'_> {
    fn size(&self) -> usize {
        self.precision.len()
    }

    fn evaluate(
        &self,
        at: &[f64],
        mut derivatives: Option<(&mut DVector<f64>, &mut DMatrix<f64>)>,
    ) -> f64 {
        let (count, size) = (self.parts.len(), self.size());
        let mut parameters = vec![0.0; count];
        let (mut first, mut second) = (vec![0.0; count], vec![0.0; count * count]);
        if let Some((gradient, curvature)) = &mut derivatives {
            gradient.fill(0.0);
            curvature.fill(0.0);
        }
        let mut value = -self.constant;
        for row in self.rows.clone() {
            self.fill(row, at, &mut parameters);
            let y = self.draw.outcome[row];
            value -= likelihood::row(self.draw.law, y, &parameters, &mut first, &mut second);
            if let Some((gradient, curvature)) = &mut derivatives {
                let to = (gradient.as_mut_slice(), curvature.as_mut_slice());
                self.derive(row - self.rows.start, (&first, &second), to);
            }
        }
        for (index, precision) in self.precision.iter().enumerate() {
            value += 0.5 * precision * at[index] * at[index];
            if let Some((gradient, curvature)) = &mut derivatives {
                gradient[index] += precision * at[index];
                curvature[(index, index)] += precision;
                for other in index + 1..size {
                    curvature[(index, other)] = curvature[(other, index)];
                }
            }
        }
        if value.is_nan() { f64::INFINITY } else { value }
    }
}

/// The inverse of a positive definite matrix.
fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Cholesky::new(matrix.clone()).map(|root| root.inverse())
}
