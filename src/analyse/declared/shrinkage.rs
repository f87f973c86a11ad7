//! How people differ in the effect of a message in a state, and what an agent with partial pooling knows of it.

use std::collections::HashSet;

use super::arm::{ArmId, arms};
use super::learned::OverTrials;
use crate::job::{HeldDeviation, RecordedPosterior, Scalar};
use crate::manifest::kind::Shrinkage;
use crate::record::JobRecord;

/// What trials learned about the differences between people in some states.
#[derive(Clone, Debug, PartialEq)]
pub struct ShrinkageFigure {
    /// One panel per arm and state.
    pub panels: Vec<ShrinkagePanel>,
    /// Completed trials without posteriors of people, or whose agent does not see such states.
    pub lacking: usize,
}

/// What the trials of an arm learned about a state by their last update.
#[derive(Clone, Debug, PartialEq)]
pub struct ShrinkagePanel {
    /// The arm.
    pub name: ArmId,
    /// The state.
    pub state: Vec<f64>,
    /// The number of trials.
    pub trials: usize,
    /// The first trial, which is drawn.
    pub first: TrialOfPeople,
    /// Over the trials: the mean of the common effect, the deviation of people's effects from the common one that the agent
    /// learned or was given, and the share of its variance that the posteriors of people have resolved.
    pub over: [OverTrials; 3],
    /// The number of trials in which an estimated deviation is held, as [`HeldDeviation::NAMED`] lists it.
    pub held: [usize; 3],
}

/// What a trial learned about people in a state.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialOfPeople {
    /// The seed.
    pub seed: u64,
    /// The posterior mean of the common effect.
    pub common: f64,
    /// The standard deviation of people's effects around the common one.
    pub deviation: f64,
    /// The posterior means and standard deviations of people's effects, the smallest mean first, with the people's numbers.
    pub people: Vec<(u32, f64, f64)>,
    /// Where estimated deviations are held.
    pub held: Vec<HeldDeviation>,
}

impl TrialOfPeople {
    /// The share of the variance of people's effects that is known on average: 1 minus the mean posterior variance of an
    /// effect divided by the variance before data of the person; 0 without a deviation.
    pub fn resolved(&self) -> f64 {
        let variances = self.people.iter().map(|(_, _, sd)| sd * sd);
        let mean = variances.sum::<f64>() / self.people.len().max(1) as f64;
        let before = self.deviation * self.deviation;
        if before > 0.0 { (1.0 - mean / before).max(0.0) } else { 0.0 }
    }

    /// The people whose interval of two standard deviations does not hold the common effect.
    pub fn apart(&self) -> usize {
        let is_apart = |(_, mean, sd): &&(u32, f64, f64)| (mean - self.common).abs() > 1.96 * sd;
        self.people.iter().filter(is_apart).count()
    }
}

/// What the jobs learned about people in the states.
pub fn figure(kind: &Shrinkage, jobs: &[&JobRecord]) -> ShrinkageFigure {
    let (mut panels, mut lacking) = (Vec::new(), HashSet::new());
    for arm in arms(jobs, &[]) {
        for state in &kind.states.0 {
            let mut trials = Vec::new();
            for job in &arm.jobs {
                match trial(job, kind.action, state) {
                    Some(trial) => trials.push(trial),
                    None if job.completed().is_some() => _ = lacking.insert(job.job_key),
                    None => {}
                }
            }
            panels.extend(panel(arm.name.clone(), state, trials));
        }
    }
    ShrinkageFigure { panels, lacking: lacking.len() }
}

/// What a trial knew after its last update; `None` without posteriors of people in such states.
fn trial(job: &JobRecord, action: u32, state: &[f64]) -> Option<TrialOfPeople> {
    let posteriors = &job.completed()?.posteriors;
    let last = posteriors.iter().map(|one| one.update).max()?;
    let is_last = |one: &&RecordedPosterior| one.update == last && u32::from(one.action) == action;
    let mut of_last = posteriors.iter().filter(is_last);
    let common = of_last.clone().find(|one| one.person == 0)?;
    let deviation = common.deviation(state)?;
    let person = |one: &RecordedPosterior| {
        let (mean, sd) = one.effect(state)?;
        Some((one.person, mean, sd))
    };
    let people = of_last.by_ref().filter(|one| one.person > 0).map(person);
    let mut people: Vec<(u32, f64, f64)> = people.collect::<Option<_>>()?;
    people.sort_by(|one, other| one.1.total_cmp(&other.1));
    let held = scales(job, common.deviation.len()).map(|scales| common.held(state, &scales));
    let (common, _) = common.effect(state)?;
    Some(TrialOfPeople {
        seed: job.seed,
        common,
        deviation,
        people,
        held: held.unwrap_or_default(),
    })
}

/// The scales of the deviations of effects, \[features\]; `None` if they are not estimated.
fn scales(job: &JobRecord, features: usize) -> Option<Vec<f64>> {
    let is_word = |name: &str, word: &str| matches!(job.setting(name), Some(Scalar::Text(text)) if text == word);
    if !is_word("agent.person_sd", "estimated") {
        return None;
    }
    let same = |name: &str| job.number(name).map(|sd| vec![sd; features]);
    let scales = match job.setting("agent.effect_sds") {
        _ if !is_word("agent.prior_from", "none") => same("agent.noise_sd")?,
        Some(Scalar::Text(list)) if list.len() > 2 => serde_json::from_str(list).ok()?,
        _ => same("agent.prior_sd")?,
    };
    // Without centring, an effect is the difference of two regressions, which are both held.
    let factor = if job.number("agent.action_centring") == Some(1.0) { 1.0 } else { 2f64.sqrt() };
    Some(scales.into_iter().map(|scale| factor * scale).collect())
}

fn panel(name: ArmId, state: &[f64], trials: Vec<TrialOfPeople>) -> Option<ShrinkagePanel> {
    let over = |number: fn(&TrialOfPeople) -> f64| {
        OverTrials::of(&trials.iter().map(number).collect::<Vec<_>>())
    };
    let over = [
        over(|trial| trial.common)?,
        over(|trial| trial.deviation)?,
        over(TrialOfPeople::resolved)?,
    ];
    let held = HeldDeviation::NAMED
        .map(|(held, _)| trials.iter().filter(|trial| trial.held.contains(&held)).count());
    let count = trials.len();
    let first = trials.into_iter().min_by_key(|trial| trial.seed)?;
    Some(ShrinkagePanel { name, state: state.to_vec(), trials: count, first, over, held })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_resolved_is_the_share_of_the_variance_that_is_gone() {
        let people = vec![(2, -1.0, 0.5), (1, 0.0, 1.0), (3, 3.0, 0.5)];
        let held = Vec::new();
        let trial = TrialOfPeople { seed: 1, common: 0.5, deviation: 2.0, people, held };
        // (0.25 + 1 + 0.25) / 3 = 0.5 of 4.
        assert_eq!(trial.resolved(), 0.875);
        assert_eq!(trial.apart(), 2);
        let alike = TrialOfPeople { deviation: 0.0, ..trial };
        assert_eq!(alike.resolved(), 0.0);
    }
}
