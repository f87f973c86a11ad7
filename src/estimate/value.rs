//! The value of a policy: the mean outcome of its decisions, from decisions that others made.
//!
//! The policy takes over at a decision and makes k decisions one after the other; the value is the mean of their outcomes.
//! Every decision counts at which such a course can begin, with at least k decisions to the end of the person's stay. A
//! terminal state ends a course with outcomes of 0, if the person's stay would have had the rest of it: whether a course counts
//! must not depend on what the actions lead to. A course that is cut off does not count.
//!
//! **Source**: Precup, Sutton and Singh, "Eligibility traces for off-policy policy evaluation", ICML 2000, for weights per
//! decision, and self-normalised; Jiang and Li, "Doubly robust off-policy value evaluation for reinforcement learning",
//! ICML 2016, equation 10, with linear models of the outcomes to come, which are fitted to other people than those whose
//! outcomes they predict (Chernozhukov and others, "Double/debiased machine learning", Econometrics Journal 21, 2018).

use super::symmetric::{inverse, packed, product};

/// Below this effective sample size a value is refused.
pub(crate) const LEAST_SIZE: f64 = 10.0;
/// The most groups of people whose outcomes are predicted from all others.
const FOLDS: usize = 20;

/// The decisions of all people, person by person.
#[derive(Clone, Debug, Default)]
pub(crate) struct Courses {
    /// The number of decisions of a course.
    pub(crate) steps: usize,
    /// The number of control features, the constant included.
    pub(crate) controls: usize,
    /// The number of features that the effect of each message depends on, the constant included.
    pub(crate) terms: usize,
    pub(crate) actions: usize,
    /// The probabilities of the policy at all decisions, \[decisions, actions\].
    pub(crate) policy: Vec<f64>,
    /// The control features and the terms of all decisions, \[decisions, controls + terms\].
    pub(crate) features: Vec<f64>,
    pub(crate) made: Vec<Made>,
    /// The decisions of each person's stay, \[people\]; empty if all stay to the end of the longest episode.
    pub(crate) stays: Vec<u32>,
    /// The first person, from 1, and step at which the policy is no probability, and what it is.
    pub(crate) misfit: Option<(u32, u32, f64)>,
}

/// A decision that was made.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Made {
    /// The person, from 0.
    pub(crate) person: usize,
    pub(crate) step: u32,
    pub(crate) action: usize,
    /// Whether a message could be sent.
    pub(crate) can_send: bool,
    /// The probability of the action under the policy, divided by that under which it was taken. Not a number if the policy
    /// is not known there.
    pub(crate) ratio: f64,
    /// Not a number if it is not known.
    pub(crate) outcome: f64,
    /// Whether the episode ended with it in a terminal state.
    pub(crate) terminated: bool,
}

/// An estimate, and what each person adds to its error.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Valued {
    pub(crate) value: f64,
    /// \[people with courses\].
    pub(crate) parts: Vec<f64>,
}

impl Valued {
    pub(crate) fn standard_error(&self) -> f64 {
        self.parts.iter().map(|part| part * part).sum::<f64>().sqrt()
    }
}

/// The value of a policy.
#[derive(Clone, Debug)]
pub(crate) struct Values {
    /// By inverse probability, self-normalised, and doubly robust.
    pub(crate) values: [Valued; 3],
    /// The people with courses, from 0.
    pub(crate) people: Vec<usize>,
    /// The number of courses.
    pub(crate) courses: usize,
    /// The number of equally weighted courses that say as much.
    pub(crate) effective_size: f64,
    /// The standard deviation of an outcome under the policy.
    pub(crate) outcome_sd: f64,
}

impl Values {
    /// The difference to the values of another policy, with errors of the differences of each person. The effective sample
    /// size is the smaller one.
    pub(crate) fn less(&self, other: &Values) -> Values {
        let mut people = [&self.people[..], &other.people].concat();
        people.sort_unstable();
        people.dedup();
        // A person without courses adds nothing to the error.
        let part = |of: &Values, term: usize, person: &usize| {
            of.people.binary_search(person).map_or(0.0, |index| of.values[term].parts[index])
        };
        let difference = |term: usize| Valued {
            value: self.values[term].value - other.values[term].value,
            parts: people
                .iter()
                .map(|one| part(self, term, one) - part(other, term, one))
                .collect(),
        };
        Values {
            values: [0, 1, 2].map(difference),
            courses: self.courses.min(other.courses),
            effective_size: self.effective_size.min(other.effective_size),
            outcome_sd: self.outcome_sd,
            people,
        }
    }
}

/// Why a value has no number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum NoValue {
    /// The number of people with courses, of at least two.
    People(usize),
    /// The effective sample size of this number of courses is too small.
    Size(f64, usize),
    /// One person has all the weight.
    Determined,
}

/// The sums of the courses of a person; those by number of steps are \[steps\].
#[derive(Clone, Debug)]
struct OfPerson {
    person: usize,
    courses: f64,
    /// Weights, and weighted outcomes.
    weights: Vec<f64>,
    outcomes: Vec<f64>,
    /// What the model predicts under the policy less what it predicts of the actions, by decisions that remain,
    /// \[steps, columns\].
    predicted: Vec<f64>,
}

impl Courses {
    fn width(&self) -> usize {
        self.controls + self.terms
    }

    /// The number of coefficients of the model of an outcome.
    pub(crate) fn columns(&self) -> usize {
        self.controls + (self.actions - 1) * self.terms
    }

    /// Adds `scale` times the regressors of a decision with these probabilities of the actions.
    fn add_row(&self, index: usize, scale: f64, share: impl Fn(usize) -> f64, sums: &mut [f64]) {
        let features = &self.features[index * self.width()..(index + 1) * self.width()];
        let (controls, terms) = features.split_at(self.controls);
        sums.iter_mut().zip(controls).for_each(|(sum, value)| *sum += scale * value);
        for (action, sums) in sums[self.controls..].chunks_mut(self.terms).enumerate() {
            let scale = scale * share(action + 1);
            sums.iter_mut().zip(terms).for_each(|(sum, value)| *sum += scale * value);
        }
    }

    /// Adds the regressors of the action that was taken.
    fn add_taken(&self, index: usize, scale: f64, sums: &mut [f64]) {
        let taken = self.made[index].action;
        self.add_row(index, scale, |action| f64::from(u8::from(action == taken)), sums);
    }

    /// Adds the regressors under the policy; where no message can be sent, none is.
    fn add_policy(&self, index: usize, scale: f64, sums: &mut [f64]) {
        let can_send = f64::from(u8::from(self.made[index].can_send));
        let policy = &self.policy[index * self.actions..(index + 1) * self.actions];
        self.add_row(index, scale, |action| can_send * policy[action], sums);
    }

    /// The last decision of a course that begins at a decision, behind its end; `None` if it does not count. The person's
    /// stay has `stay` decisions, and the episode ends before the index `end`.
    fn course(&self, start: usize, end: usize, stay: usize) -> Option<usize> {
        let last = (start + self.steps).min(end);
        let course = &self.made[start..last];
        let is_whole = course.len() == self.steps || course.last()?.terminated;
        let is_in_time = course[0].step as usize + self.steps <= stay;
        let are_known = (start..last).all(|index| self.is_known(index));
        (is_whole && is_in_time && are_known).then_some(last)
    }

    /// Whether a decision has its outcome, its features and the policy.
    fn is_known(&self, index: usize) -> bool {
        let features = &self.features[index * self.width()..(index + 1) * self.width()];
        let Made { outcome, ratio, .. } = self.made[index];
        outcome.is_finite() && ratio.is_finite() && features.iter().all(|one| one.is_finite())
    }

    /// Whether the person's next decision stands behind a decision.
    fn is_followed(&self, index: usize) -> bool {
        let (one, next) = (&self.made[index], self.made.get(index + 1));
        next.is_some_and(|next| one.person == next.person && one.step + 1 == next.step)
    }

    /// The index behind the last of the decisions of a person that follow one another from an index.
    fn end(&self, start: usize) -> usize {
        start + 1 + (start..self.made.len()).take_while(|index| self.is_followed(*index)).count()
    }

    /// The sums of each person with courses, the sum of the squares of the weights of whole courses, and the sum of weighted
    /// squares of outcomes by steps.
    fn sums(&self) -> (Vec<OfPerson>, f64, Vec<f64>) {
        let (steps, columns) = (self.steps, self.columns());
        let longest = self.made.iter().map(|one| one.step as usize + 1).max().unwrap_or(0);
        let (mut people, mut squares) = (Vec::<OfPerson>::new(), 0.0);
        let mut squared_outcomes = vec![0.0; steps];
        let mut end = 0;
        for start in 0..self.made.len() {
            if start >= end {
                end = self.end(start);
            }
            let person = self.made[start].person;
            let stay = self.stays.get(person).map_or(longest, |stay| *stay as usize);
            let Some(last) = self.course(start, end, stay) else { continue };
            if people.last().is_none_or(|known| known.person != person) {
                people.push(OfPerson {
                    person,
                    courses: 0.0,
                    weights: vec![0.0; steps],
                    outcomes: vec![0.0; steps],
                    predicted: vec![0.0; steps * columns],
                });
            }
            let own = people.last_mut().expect("a person was added");
            own.courses += 1.0;
            let mut weight = 1.0;
            for (step, index) in (start..last).enumerate() {
                let remaining = &mut own.predicted[(steps - 1 - step) * columns..][..columns];
                self.add_policy(index, weight, remaining);
                let Made { ratio, outcome, .. } = self.made[index];
                weight *= ratio;
                self.add_taken(index, -weight, remaining);
                own.weights[step] += weight;
                own.outcomes[step] += weight * outcome;
                squared_outcomes[step] += weight * outcome * outcome;
            }
            own.weights[last - start..].iter_mut().for_each(|sum| *sum += weight);
            squares += weight * weight;
        }
        (people, squares, squared_outcomes)
    }

    /// The value.
    ///
    /// **Errors**: see [`NoValue`].
    pub(crate) fn value(&self) -> Result<Values, NoValue> {
        let (people, squares, squared_outcomes) = self.sums();
        if people.len() < 2 {
            return Err(NoValue::People(people.len()));
        }
        let steps = self.steps;
        let total = |of: &dyn Fn(&OfPerson) -> f64| people.iter().map(of).sum::<f64>();
        let courses = total(&|own| own.courses);
        let weights: Vec<f64> = (0..steps).map(|step| total(&|own| own.weights[step])).collect();
        let whole = weights[steps - 1];
        let effective_size = if squares > 0.0 { whole * whole / squares } else { 0.0 };
        if effective_size < LEAST_SIZE {
            return Err(NoValue::Size(effective_size, courses as usize));
        }
        let means: Vec<f64> =
            (0..steps).map(|step| total(&|own| own.outcomes[step]) / weights[step]).collect();
        let per_step = |sum: f64| sum / steps as f64;
        // Means of people, each weighted by its number of courses.
        let weighted = people.iter().map(|own| per_step(own.outcomes.iter().sum()));
        let inverse_probability = mean(&people, courses, &weighted.collect::<Vec<_>>())?;
        let parts = people.iter().map(|own| {
            let each = (0..steps).map(|step| {
                let rest = weights[step] - own.weights[step];
                (own.outcomes[step] - own.weights[step] * means[step]) / rest
            });
            per_step(each.sum())
        });
        let self_normalised = known(per_step(means.iter().sum()), parts.collect())?;
        let robust = mean(&people, courses, &self.robust(&people))?;
        let spread = squared_outcomes.iter().zip(&weights).zip(&means);
        let spread =
            spread.map(|((square, weight), mean)| (square / weight - mean * mean).max(0.0));
        Ok(Values {
            values: [inverse_probability, self_normalised, robust],
            people: people.iter().map(|own| own.person).collect(),
            courses: courses as usize,
            effective_size,
            outcome_sd: per_step(spread.sum()).sqrt(),
        })
    }

    /// The doubly robust sum of each person's courses, \[people\].
    fn robust(&self, people: &[OfPerson]) -> Vec<f64> {
        let columns = self.columns();
        let models = self.models();
        let sum = |own: &OfPerson| {
            let model = &models[own.person % models.len()];
            let predicted: f64 = own.predicted.iter().zip(model).map(|(sum, one)| sum * one).sum();
            debug_assert_eq!(model.len(), self.steps * columns);
            (own.outcomes.iter().sum::<f64>() + predicted) / self.steps as f64
        };
        people.iter().map(sum).collect()
    }

    /// For each group of people, the model of the outcomes to come by decisions that remain, from all other people,
    /// \[groups\]\[steps, columns\].
    fn models(&self) -> Vec<Vec<f64>> {
        let people = self.made.last().map_or(0, |one| one.person + 1);
        let folds = people.clamp(1, FOLDS);
        let columns = self.columns();
        let triangle = packed(columns);
        // The products of the regressors, with the outcome, and with the regressors of the next decision under the policy.
        let width = triangle + columns + columns * columns;
        let mut sums = [vec![0.0; folds * width], vec![0.0; folds * width]];
        let (mut taken, mut next) = (vec![0.0; columns], vec![0.0; columns]);
        for (index, one) in self.made.iter().enumerate() {
            if !self.is_known(index) {
                continue;
            }
            taken.fill(0.0);
            next.fill(0.0);
            self.add_taken(index, 1.0, &mut taken);
            let is_followed = self.is_followed(index);
            let is_followed = is_followed && self.is_known(index + 1);
            if is_followed {
                self.add_policy(index + 1, 1.0, &mut next);
            }
            let fold = one.person % folds;
            add_products(&mut sums[0][fold * width..][..width], &taken, one.outcome, &next);
            // Of what comes after a decision that is cut off, nothing is known.
            if is_followed || one.terminated {
                add_products(&mut sums[1][fold * width..][..width], &taken, one.outcome, &next);
            }
        }
        let others = |sums: &[f64], fold: usize| {
            let mut rest = vec![0.0; width];
            for (_, one) in sums.chunks(width).enumerate().filter(|(other, _)| *other != fold) {
                rest.iter_mut().zip(one).for_each(|(sum, one)| *sum += one);
            }
            rest
        };
        let model = |fold: usize| {
            let (last, earlier) = (others(&sums[0], fold), others(&sums[1], fold));
            let mut model = fitted(&last, columns, &vec![0.0; columns]);
            let mut after = model.clone();
            for _ in 1..self.steps {
                after = fitted(&earlier, columns, &after);
                model.extend_from_slice(&after);
            }
            model
        };
        (0..folds).map(model).collect()
    }
}

fn add_products(sums: &mut [f64], taken: &[f64], outcome: f64, next: &[f64]) {
    let columns = taken.len();
    let (triangle, rest) = sums.split_at_mut(packed(columns));
    let mut index = 0;
    for (i, value) in taken.iter().enumerate() {
        for (sum, other) in triangle[index..=index + i].iter_mut().zip(taken) {
            *sum += value * other;
        }
        index += i + 1;
        rest[i] += value * outcome;
        let products = &mut rest[columns + i * columns..][..columns];
        products.iter_mut().zip(next).for_each(|(sum, next)| *sum += value * next);
    }
}

/// The least-squares coefficients of the outcome and of what the model `after` predicts from the next decision on. Columns
/// that are linear combinations of the columns before them have the coefficient 0.
fn fitted(sums: &[f64], columns: usize, after: &[f64]) -> Vec<f64> {
    let (triangle, rest) = sums.split_at(packed(columns));
    let to_come = product(&rest[columns..], after);
    let right: Vec<f64> = rest.iter().zip(to_come).map(|(now, later)| now + later).collect();
    let mut kept: Vec<usize> = (0..columns).collect();
    let mut coefficients = vec![0.0; columns];
    loop {
        let entry = |i: usize, j: usize| triangle[packed(i.max(j)) + i.min(j)];
        let pairs = kept.iter().enumerate();
        let own: Vec<f64> =
            pairs.flat_map(|(at, i)| kept[..=at].iter().map(|j| entry(*i, *j))).collect();
        match inverse(&own, kept.len()) {
            Ok(bread) => {
                let right: Vec<f64> = kept.iter().map(|i| right[*i]).collect();
                let solved = if kept.is_empty() { right } else { product(&bread, &right) };
                kept.iter().zip(solved).for_each(|(i, one)| coefficients[*i] = one);
                return coefficients;
            }
            Err(dependent) => _ = kept.remove(dependent),
        }
    }
}

/// The mean over courses of sums by person, with a standard error whose residuals are corrected for the person's own share
/// of the mean (Mancl and DeRouen).
fn mean(people: &[OfPerson], courses: f64, sums: &[f64]) -> Result<Valued, NoValue> {
    let value = sums.iter().sum::<f64>() / courses;
    let parts = people.iter().zip(sums);
    let parts = parts.map(|(own, sum)| (sum - own.courses * value) / (courses - own.courses));
    known(value, parts.collect())
}

fn known(value: f64, parts: Vec<f64>) -> Result<Valued, NoValue> {
    let valued = Valued { value, parts };
    if valued.standard_error().is_finite() { Ok(valued) } else { Err(NoValue::Determined) }
}
