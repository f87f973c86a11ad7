//! A fit against its data: the same numbers of the pilot and of simulated pilots, held-out days, and a long simulation.

use std::ops::Range;
use std::sync::atomic::Ordering;

use crate::analyse::{mean_and_sd, quantile};
use crate::env::declared::{FittedDraw, LongRun, Pilot, PilotWorld};
use crate::estimate::{Correction, Sums};
use crate::fit::estimate::{Fit, Fitting, Group, GroupFit, parameters, side_by_side};
use crate::fit::solve::Orthogonal;
use crate::fit::{likelihood, output};

/// Lanes of a simulation, so that its numbers stay in memory that is near.
const LANES: usize = 4096;
/// Numbers of simulated decisions that are kept at a time.
const MOST_KEPT: usize = 2_000_000;
/// The size of outcomes, relative to the largest of the pilot, from which a simulation explodes.
const EXPLODED: f64 = 100.0;
/// Every fifth day is held out.
const HELD_OUT: usize = 5;
/// Days of a week.
const WEEK: usize = 7;

/// A number of the pilot beside simulated pilots.
#[derive(Clone, Debug)]
pub struct CheckedNumber {
    /// What it is.
    pub name: String,
    /// Of the pilot.
    pub pilot: f64,
    /// The mean over simulated pilots.
    pub mean: f64,
    /// Their standard deviation: the error of the pilot's number if the model is right.
    pub sd: f64,
    /// The 2.5 % and 97.5 % quantiles.
    pub interval: (f64, f64),
}

impl CheckedNumber {
    fn new(name: impl Into<String>, pilot: f64, simulated: &[f64]) -> CheckedNumber {
        let mut known: Vec<f64> = simulated.iter().copied().filter(|x| x.is_finite()).collect();
        known.sort_by(f64::total_cmp);
        let (mean, sd) = match known.is_empty() {
            true => (f64::NAN, f64::NAN),
            false => with_sd(&known),
        };
        let at = |share: f64| quantile(&known, share).unwrap_or(f64::NAN);
        CheckedNumber { name: name.into(), pilot, mean, sd, interval: (at(0.025), at(0.975)) }
    }

    /// How many errors the pilot is away from the simulated pilots.
    pub fn off(&self) -> f64 {
        (self.pilot - self.mean) / self.sd
    }
}

/// A mean, and a standard deviation, which is NaN if there are fewer than two numbers.
fn with_sd(numbers: &[f64]) -> (f64, f64) {
    let (mean, sd) = mean_and_sd(numbers);
    (mean, sd.unwrap_or(f64::NAN))
}

/// The error of a draw on days that were not fitted.
#[derive(Clone, Debug)]
pub struct HeldOut {
    /// The draw.
    pub draw: String,
    /// The number of rows that were held out.
    pub rows: usize,
    /// The root mean square error of the model, and of each person's mean.
    pub errors: [f64; 2],
}

/// How a fit compares with its data.
#[derive(Clone, Debug)]
pub struct Check {
    /// The number of simulated pilots.
    pub simulations: usize,
    /// Numbers of all people.
    pub numbers: Vec<CheckedNumber>,
    /// The mean outcome by week and by decision of the day.
    pub weeks: Vec<CheckedNumber>,
    /// The mean outcome by decision of the day.
    pub slots: Vec<CheckedNumber>,
    /// Each person's mean.
    pub people: Vec<CheckedNumber>,
    /// Each person's variance, without zeros.
    pub variances: Vec<CheckedNumber>,
    /// The effect of an action by weighted and centred least squares, and its standard error in the pilot.
    pub effect: Option<(CheckedNumber, f64)>,
    /// Whether chance chose an action at some decision.
    pub has_randomised: bool,
    /// Errors on held-out days.
    pub held_out: Vec<HeldOut>,
    /// A simulation of the days of the model, or why it failed.
    pub long_run: Result<LongRun, String>,
    /// The largest outcome of the pilot, by size.
    pub largest: f64,
    /// Why pilots cannot be simulated.
    pub failure: Option<String>,
}

impl Check {
    /// Simulates pilots and compares; `None` if it was stopped.
    pub fn new(
        pilot: &Pilot,
        fit: &Fit,
        (seed, simulations): (u64, u32),
        fitting: &mut Fitting<'_>,
    ) -> Option<Check> {
        let people = output::people(pilot, fit);
        let people = String::from_utf8(people).unwrap_or_default();
        let world = pilot.world(&people, &fit.is_complete, &fit.parameters);
        let frame = Frame::new(pilot, &fit.is_complete);
        let recorded = frame.numbers(&frame.outcomes, &frame.actions, &frame.features);
        let mut simulated: Vec<Vec<f64>> = Vec::new();
        let mut failure = None;
        let world = match world {
            Ok(world) => world,
            Err(says) => {
                return Some(frame.check(&recorded, &[], Err(says.clone()), Some(says)));
            }
        };
        let batches = batches(&world, simulations);
        for batches in
            batches.chunks(2 * std::thread::available_parallelism().map_or(1, usize::from))
        {
            if fitting.stop.load(Ordering::Relaxed) {
                return None;
            }
            let results = side_by_side(batches, |batch: &Range<u32>| {
                let pilots = world.pilots(seed, batch.clone())?;
                let numbers = pilots
                    .iter()
                    .map(|one| frame.numbers(&one.outcomes, &one.actions, &one.features));
                Ok::<Vec<Vec<f64>>, String>(numbers.collect())
            });
            for result in results {
                match result {
                    Ok(numbers) => simulated.extend(numbers),
                    Err(says) => failure = failure.or(Some(says)),
                }
            }
            let done = batches.last().map_or(0, |batch| batch.end as usize);
            (fitting.progress)(done, simulations as usize);
        }
        let mut check = frame.check(&recorded, &simulated, world.long_run(seed), failure);
        check.held_out = held_out(pilot, fit);
        Some(check)
    }

    /// Whether a long simulation fails, or its outcomes exceed those of the pilot by far.
    pub fn explodes(&self) -> bool {
        match &self.long_run {
            Ok(run) => run.largest > EXPLODED * self.largest.max(f64::MIN_POSITIVE),
            Err(_) => true,
        }
    }
}

/// How many of these numbers of people lie outside of their own intervals, and how many have one.
pub(super) fn outside(numbers: &[CheckedNumber]) -> (usize, usize) {
    let known = || numbers.iter().filter(|one| (one.pilot - one.mean).is_finite());
    let is_outside =
        |one: &&CheckedNumber| one.pilot < one.interval.0 || one.pilot > one.interval.1;
    (known().filter(is_outside).count(), known().count())
}

/// Numbers of pilots that are simulated together.
fn batches(world: &PilotWorld, simulations: u32) -> Vec<Range<u32>> {
    let people = world.people().max(1);
    let by_memory = MOST_KEPT / world.decisions().max(1);
    let size = (LANES / people).min(by_memory).max(1) as u32;
    (0..simulations)
        .step_by(size as usize)
        .map(|first| first..(first + size).min(simulations))
        .collect()
}

/// The decisions that are compared, and what the pilot has there.
struct Frame {
    /// \[people\]: their decisions with an outcome.
    people: Vec<Vec<usize>>,
    names: Vec<String>,
    /// \[decisions\].
    weeks: Vec<usize>,
    slots: Vec<usize>,
    per_day: usize,
    outcomes: Vec<f64>,
    actions: Vec<f64>,
    features: Vec<Vec<f64>>,
    probabilities: Vec<f64>,
    /// The features that the effect is controlled for.
    control: Vec<usize>,
}

/// The numbers of all people, in the order of [`Frame::numbers`].
const NAMES: [&str; 10] = [
    "share of zeros",
    "mean",
    "variance within people",
    "variance within people, without zeros",
    "variance between people",
    "lower quartile of people",
    "median of people",
    "upper quartile of people",
    "autocorrelation at lag 1",
    "trend per week",
];

impl Frame {
    fn new(pilot: &Pilot, takes_part: &[bool]) -> Frame {
        let mut observed = pilot.observed();
        let outcomes = observed.pop().unwrap_or_default();
        observed.pop();
        let per_day = pilot.decisions_per_day();
        let size = outcomes.len();
        let (mut weeks, mut slots) = (vec![0; size], vec![0; size]);
        let (mut people, mut names) = (Vec::new(), Vec::new());
        for (person, takes_part) in pilot.people.iter().zip(takes_part) {
            for (step, decision) in person.decisions.clone().enumerate() {
                weeks[decision] = step / (per_day * WEEK);
                slots[decision] = step % per_day;
            }
            if *takes_part {
                let is_known = |one: &usize| pilot.used[*one] && !outcomes[*one].is_nan();
                people.push(person.decisions.clone().filter(is_known).collect());
                names.push(person.name.clone());
            }
        }
        let mut frame = Frame {
            people,
            names,
            weeks,
            slots,
            per_day,
            outcomes,
            actions: pilot.actions[0].clone(),
            features: observed,
            probabilities: pilot.probabilities(),
            control: Vec::new(),
        };
        frame.control = frame.controls();
        frame
    }

    /// The features that vary and do not depend on one another.
    fn controls(&self) -> Vec<usize> {
        let rows: Vec<usize> = self.randomised().map(|(_, decision)| decision).collect();
        let is_known =
            |feature: &usize| rows.iter().all(|row| self.features[*feature][*row].is_finite());
        let known: Vec<usize> = (0..self.features.len()).filter(is_known).collect();
        let columns = known
            .iter()
            .map(|feature| rows.iter().map(|row| self.features[*feature][*row]).collect());
        let columns = [vec![1.0; rows.len()]].into_iter().chain(columns).collect();
        let kept = Orthogonal::new(columns).kept;
        kept.into_iter().filter(|index| *index > 0).map(|index| known[index - 1]).collect()
    }

    /// The decisions at which chance chose, each with its person.
    fn randomised(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let all = self.people.iter().enumerate();
        let all = all.flat_map(|(person, own)| own.iter().map(move |decision| (person, *decision)));
        all.filter(|(_, decision)| {
            let p = self.probabilities[*decision];
            p > 0.0 && p < 1.0 && !self.actions[*decision].is_nan()
        })
    }

    /// The numbers of a pilot: those of [`NAMES`], the means by week, by decision of the day and by person, the variance of each
    /// person without zeros, the effect of an action and its standard error.
    fn numbers(&self, outcomes: &[f64], actions: &[f64], features: &[Vec<f64>]) -> Vec<f64> {
        let weeks = self.weeks.iter().max().map_or(0, |last| last + 1);
        let mut by_week = vec![[0.0; 2]; weeks];
        let mut by_slot = vec![[0.0; 2]; self.per_day];
        let (mut means, mut variances) = (Vec::new(), Vec::new());
        let (mut zeros, mut sum, mut count) = (0.0, 0.0, 0.0);
        let (mut within, mut of_within) = (0.0, 0.0);
        let [mut lagged, mut squares, mut trend, mut of_weeks] = [0.0; 4];
        for own in &self.people {
            let size = own.len() as f64;
            let mean = own.iter().map(|one| outcomes[*one]).sum::<f64>() / size;
            let week = own.iter().map(|one| self.weeks[*one] as f64).sum::<f64>() / size;
            let mut own_squares = 0.0;
            for (index, decision) in own.iter().enumerate() {
                let (outcome, off) = (outcomes[*decision], outcomes[*decision] - mean);
                zeros += f64::from(u8::from(outcome == 0.0));
                sum += outcome;
                count += 1.0;
                own_squares += off * off;
                let in_week = self.weeks[*decision] as f64 - week;
                trend += off * in_week;
                of_weeks += in_week * in_week;
                for (sums, slot) in
                    [(&mut by_week, self.weeks[*decision]), (&mut by_slot, self.slots[*decision])]
                {
                    sums[slot][0] += outcome;
                    sums[slot][1] += 1.0;
                }
                if index > 0 && own[index - 1] + 1 == *decision {
                    lagged += off * (outcomes[own[index - 1]] - mean);
                }
            }
            squares += own_squares;
            if own.len() > 1 {
                within += own_squares / (size - 1.0);
                of_within += 1.0;
            }
            means.push(mean);
            let others: Vec<f64> = { own.iter().map(|one| outcomes[*one]) }
                .filter(|outcome| *outcome != 0.0)
                .collect();
            let sd = if others.len() > 1 { with_sd(&others).1 } else { f64::NAN };
            variances.push(sd * sd);
        }
        let known: Vec<f64> = variances.iter().copied().filter(|one| one.is_finite()).collect();
        let mut sorted: Vec<f64> = means.iter().copied().filter(|mean| mean.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| quantile(&sorted, share).unwrap_or(f64::NAN);
        let between = if sorted.len() > 1 { with_sd(&sorted).1 } else { f64::NAN };
        let mut all = vec![
            zeros / count,
            sum / count,
            within / of_within,
            known.iter().sum::<f64>() / known.len() as f64,
            between * between,
            at(0.25),
            at(0.5),
            at(0.75),
            lagged / squares,
            trend / of_weeks,
        ];
        all.extend(by_week.iter().chain(&by_slot).map(|[sum, count]| sum / count));
        all.extend(means);
        all.extend(variances);
        all.extend(self.effect(outcomes, actions, features));
        all
    }

    /// The effect of an action, by weighted and centred least squares, with its standard error.
    fn effect(&self, outcomes: &[f64], actions: &[f64], features: &[Vec<f64>]) -> [f64; 2] {
        let rows = || self.randomised().map(|(_, decision)| self.probabilities[decision]);
        let count = rows().count();
        if count == 0 {
            return [f64::NAN; 2];
        }
        let share = rows().sum::<f64>() / count as f64;
        let columns = self.control.len() + 2;
        let mut sums = Sums { columns, ..Sums::default() };
        let mut row = vec![1.0; columns];
        for (person, decision) in self.randomised() {
            let (p, taken) = (self.probabilities[decision], actions[decision] > 0.0);
            for (to, feature) in row[1..].iter_mut().zip(&self.control) {
                *to = features[*feature][decision];
            }
            row[columns - 1] = f64::from(u8::from(taken)) - share;
            let weight = if taken { share / p } else { (1.0 - share) / (1.0 - p) };
            sums.add(person, &row, weight, outcomes[decision]);
        }
        match sums.fit(Correction::ManclDeRouen) {
            Ok(fit) => {
                let last = columns - 1;
                [fit.coefficients[last], fit.covariance[last * columns + last].sqrt()]
            }
            Err(_) => [f64::NAN; 2],
        }
    }

    /// The numbers of the pilot beside those of simulated pilots.
    fn check(
        &self,
        recorded: &[f64],
        simulated: &[Vec<f64>],
        long_run: Result<LongRun, String>,
        failure: Option<String>,
    ) -> Check {
        let number = |index: usize, name: String| {
            let all: Vec<f64> = simulated.iter().map(|one| one[index]).collect();
            CheckedNumber::new(name, recorded[index], &all)
        };
        let weeks = self.weeks.iter().max().map_or(0, |last| last + 1);
        let mut first = 0;
        let mut take = |names: Vec<String>| -> Vec<CheckedNumber> {
            let start = first;
            first += names.len();
            names.into_iter().enumerate().map(|(index, name)| number(start + index, name)).collect()
        };
        let numbers = take(NAMES.map(str::to_owned).to_vec());
        let by_week = take((1..=weeks).map(|week| format!("week {week}")).collect());
        let slots =
            take((0..self.per_day).map(|slot| format!("decision {slot} of the day")).collect());
        let people = take(self.names.clone());
        let variances = take(self.names.clone());
        let effect = take(vec!["effect of an action".to_owned()]).pop();
        let error = recorded.last().copied().unwrap_or(f64::NAN);
        let largest = { self.people.iter().flatten() }
            .map(|decision| self.outcomes[*decision].abs())
            .fold(0.0, f64::max);
        Check {
            simulations: simulated.len(),
            numbers,
            weeks: by_week,
            slots,
            people,
            variances,
            has_randomised: self.randomised().next().is_some(),
            effect: effect.filter(|one| one.pilot.is_finite()).map(|one| (one, error)),
            held_out: Vec::new(),
            long_run,
            largest,
            failure,
        }
    }
}

/// The errors of every draw on every fifth day, whose rows the fit does not have.
fn held_out(pilot: &Pilot, fit: &Fit) -> Vec<HeldOut> {
    let per_day = pilot.decisions_per_day();
    let mut is_held_out = vec![false; pilot.used.len()];
    for person in &pilot.people {
        for (step, decision) in person.decisions.clone().enumerate() {
            is_held_out[decision] = step / per_day % HELD_OUT == HELD_OUT - 1;
        }
    }
    let mut all = Vec::new();
    let parts = |draw: &FittedDraw, held: bool| {
        draw.of_rows(|row| is_held_out[draw.decisions[row] as usize] == held)
    };
    let training: Vec<FittedDraw> = pilot.draws.iter().map(|draw| parts(draw, false)).collect();
    let people: Vec<Option<usize>> = match pilot.pooled {
        true => vec![None],
        false => (0..pilot.people.len()).map(Some).collect(),
    };
    let groups: Vec<Vec<GroupFit>> = training
        .iter()
        .map(|draw| {
            side_by_side(&people, |person: &Option<usize>| {
                let rows = person.map_or(0..draw.decisions.len(), |one| draw.people[one].clone());
                Group::new(pilot, draw, *person, rows).from(&fit.values[person.unwrap_or(0)]).fit()
            })
        })
        .collect();
    let refitted = Fit::of(pilot, groups);
    for (draw, trained) in pilot.draws.iter().zip(&training) {
        let test = parts(draw, true);
        let (mut rows, mut squares) = (0, [0.0; 2]);
        for person in (0..pilot.people.len())
            .filter(|one| fit.is_complete[*one] && refitted.is_complete[*one])
        {
            let known = &trained.outcome[trained.people[person].clone()];
            let mean = known.iter().sum::<f64>() / known.len() as f64;
            for row in test.people[person].clone() {
                let at = parameters(&test, row, &refitted.values[person]);
                let errors =
                    [likelihood::mean(draw.law, &at), mean].map(|one| test.outcome[row] - one);
                squares.iter_mut().zip(errors).for_each(|(sum, error)| *sum += error * error);
                rows += 1;
            }
        }
        if rows > 0 {
            let errors = squares.map(|sum| (sum / rows as f64).sqrt());
            all.push(HeldOut { draw: draw.name.clone(), rows, errors });
        }
    }
    all
}
