//! Whether what trials learn about the effect of a message in a state is more than chance.

use std::collections::HashSet;

use super::arm::{ArmId, arms, decided_by};
use crate::analyse::{BeyondChance, Undefined, beyond_chance, quantile};
use crate::job::Condition;
use crate::key::Parameter;
use crate::manifest::kind::DidItLearn;
use crate::record::JobRecord;

/// What trials learned about some states.
#[derive(Clone, Debug, PartialEq)]
pub struct LearnedFigure {
    /// One panel per arm and state.
    pub panels: Vec<LearnedPanel>,
    /// Completed trials without posteriors, or whose agent does not see such states.
    pub lacking: usize,
}

/// What the trials of an arm learned about a state: the posterior mean of the effect there, divided by its standard
/// deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct LearnedPanel {
    /// The arm, without the keys that remove the effect.
    pub name: ArmId,
    /// The state.
    pub state: Vec<f64>,
    /// The numbers of trials, and of trials without the effect.
    pub trials: [usize; 2],
    /// The statistic after every update.
    pub points: Vec<LearnedPoint>,
    /// The trials after their last update, judged by those without the effect.
    pub judged: BeyondChance,
}

/// The statistic after an update.
#[derive(Clone, Debug, PartialEq)]
pub struct LearnedPoint {
    /// The number of the update.
    pub update: u32,
    /// The day of the trial.
    pub day: f64,
    /// Over the trials, and over the trials without the effect.
    pub over: [OverTrials; 2],
}

/// The distribution of the statistic over trials: its 2.5 %, 50 % and 97.5 % quantiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverTrials {
    /// The lower quantile.
    pub low: f64,
    /// The median.
    pub median: f64,
    /// The upper quantile.
    pub high: f64,
}

impl OverTrials {
    pub(super) fn of(values: &[f64]) -> Option<OverTrials> {
        let at = |share| quantile(values, share).ok();
        Some(OverTrials { low: at(0.025)?, median: at(0.5)?, high: at(0.975)? })
    }
}

impl LearnedPanel {
    /// The median p-value of the trials.
    pub fn median_p(&self) -> Result<f64, Undefined> {
        quantile(&self.judged.p_values, 0.5)
    }
}

/// What the jobs learned about the states.
pub fn figure(kind: &DidItLearn, jobs: &[&JobRecord]) -> LearnedFigure {
    let mut aside: Vec<String> = kind.without.iter().map(Condition::name).collect();
    aside.extend(kind.without_at().map(Parameter::to_string));
    // What follows from these keys, such as a zipped key, removes the effect, too.
    let implied: Vec<String> = aside.iter().flat_map(|name| decided_by(name, jobs)).collect();
    aside.extend(implied);
    let aside: Vec<&str> = aside.iter().map(String::as_str).collect();
    let (mut panels, mut lacking) = (Vec::new(), HashSet::new());
    for arm in arms(jobs, &aside) {
        for state in &kind.states.0 {
            let (with, without) = sides(kind, state, &arm.jobs);
            let mut curves = |jobs: Vec<&JobRecord>| {
                let curve = |job: &JobRecord| {
                    let found = curve(job, kind.action, state);
                    if found.is_none() && job.completed().is_some() {
                        lacking.insert(job.job_key);
                    }
                    found
                };
                jobs.into_iter().filter_map(curve).collect::<Vec<_>>()
            };
            let sides = [curves(with), curves(without)];
            let name = arm.name.clone();
            if sides.iter().any(|curves| !curves.is_empty()) {
                panels.push(panel(name, state, &sides));
            }
        }
    }
    LearnedFigure { panels, lacking: lacking.len() }
}

/// The trials of an arm, and its trials without an effect in a state; each seed once.
fn sides<'j>(
    kind: &DidItLearn,
    state: &[f64],
    jobs: &[&'j JobRecord],
) -> (Vec<&'j JobRecord>, Vec<&'j JobRecord>) {
    let is_here = |job: &JobRecord| {
        let mut at = kind.without_at().zip(state);
        at.all(|(parameter, number)| job.number(&parameter.to_string()) == Some(*number))
    };
    let is_on = |without: bool, job: &&JobRecord| {
        let lacks = kind.without.iter().all(|one| one.is_met_by(job));
        lacks == without && (!without || is_here(job))
    };
    let side = |without| {
        let mut seen = HashSet::new();
        let jobs = jobs.iter().filter(|job| is_on(without, job));
        jobs.filter(|job| seen.insert(job.seed)).copied().collect()
    };
    (side(false), side(true))
}

/// The updates of a trial: their numbers, days and statistics.
type Updates = Vec<(u32, f64, f64)>;

/// The seed of a trial, and its updates.
type Trial = (u64, Updates);

/// The update, the day, and the statistic after each update of a trial; `None` without posteriors of such states.
fn curve(job: &JobRecord, action: u32, state: &[f64]) -> Option<Trial> {
    let per_day = job.number(&Parameter::Trial("decisions_per_day").to_string())?;
    let posteriors = job.completed()?.posteriors.iter();
    let of_action = posteriors.filter(|one| one.person == 0 && u32::from(one.action) == action);
    let point = |one: &crate::job::RecordedPosterior| {
        let statistic = one.standardised_effect(state).filter(|one| one.is_finite())?;
        Some((one.update, f64::from(one.step) / per_day, statistic))
    };
    let points: Updates = of_action.map(point).collect::<Option<_>>()?;
    (!points.is_empty()).then_some((job.seed, points))
}

fn panel(name: ArmId, state: &[f64], sides: &[Vec<Trial>; 2]) -> LearnedPanel {
    // Realities such as an outage are the same in all trials of an arm.
    let updates = sides.iter().flatten().map(|(_, updates)| updates.len()).max().unwrap_or(0);
    let at = |index: usize, trials: &Vec<Trial>| -> Vec<f64> {
        trials.iter().filter_map(|(_, updates)| Some(updates.get(index)?.2)).collect()
    };
    let point = |index: usize| {
        let mut trials = sides.iter().flatten();
        let (update, day, _) = *trials.find_map(|(_, updates)| updates.get(index))?;
        let [with, without] = sides.each_ref().map(|trials| OverTrials::of(&at(index, trials)));
        Some(LearnedPoint { update, day, over: [with?, without?] })
    };
    let last = |trials: &Vec<Trial>| -> Vec<(u64, f64)> {
        trials.iter().filter_map(|(seed, updates)| Some((*seed, updates.last()?.2))).collect()
    };
    let [with, without] = sides.each_ref().map(last);
    LearnedPanel {
        name,
        state: state.to_vec(),
        trials: sides.each_ref().map(Vec::len),
        points: (0..updates).filter_map(point).collect(),
        judged: beyond_chance(&with, &without),
    }
}
