//! Arms: jobs that differ in their seed alone, and the parameters that distinguish them.

use crate::job::metric::{
    LOWER_QUARTILE_RETURN, MEAN_LENGTH, MEAN_RETURN, MESSAGE_RATE, MESSAGES, NET_RETURN,
    UPPER_QUARTILE_RETURN,
};
use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap, HashSet};

use crate::analyse::{Sample, grouped, quantile};
use crate::job::{MetricName, MetricUnit, Scalar};
use crate::record::{CompletedRun, JobRecord, JobStatus};

/// The identity of an arm within its analysis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArmId {
    /// Agent's name in the manifest.
    pub agent: String,
    /// Scenario, like `P-H-D`.
    pub scenario: String,
    /// Parameters that differ between the arms of the analysis: dotted name and value.
    pub settings: Vec<(String, Scalar)>,
}

/// The jobs of an arm.
#[derive(Clone, Debug)]
pub struct Arm<'j> {
    /// The identity of the arm.
    pub name: ArmId,
    /// Its jobs, in the manifest's order.
    pub jobs: Vec<&'j JobRecord>,
}

impl Arm<'_> {
    /// The metric of its seeds. A repeated seed counts once, because two agents of equal content share
    /// its job.
    pub fn sample(&self, metric: MetricName) -> Sample {
        let mut seen = HashSet::new();
        let (mut values, mut failed, mut open) = (Vec::new(), 0, 0);
        for job in &self.jobs {
            if !seen.insert(job.seed) {
                continue;
            }
            match &job.status {
                // A completed job without this metric counts as a value that is not finite.
                JobStatus::Completed(_) => {
                    values.push((job.seed, value(job, metric).unwrap_or(f64::NAN)));
                }
                JobStatus::Failed(_) => failed += 1,
                JobStatus::Pending | JobStatus::Interrupted | JobStatus::Running => open += 1,
            }
        }
        let sample = Sample::new(values, failed, open).expect("every seed is taken once");
        let sample = sample.with_given(seen);
        if metric.unit() == MetricUnit::Share { sample.of_shares() } else { sample }
    }

    /// The best mean net return that any policy can reach in the arm's environment, if it is known.
    pub fn optimum(&self) -> Option<f64> {
        self.jobs.iter().find_map(|job| job.optimum)
    }

    /// The best value of a metric that any policy can reach, if it is known: of the net return, and of the
    /// return where messages cost nothing.
    pub fn optimum_of(&self, metric: MetricName) -> Option<f64> {
        let costs =
            || self.jobs.iter().any(|job| value(job, NET_RETURN) != value(job, MEAN_RETURN));
        let has_optimum = metric == NET_RETURN || (metric == MEAN_RETURN && !costs());
        self.optimum().filter(|_| has_optimum)
    }
}

/// The value of a metric of a completed job.
pub fn value(job: &JobRecord, metric: MetricName) -> Option<f64> {
    let run = job.completed()?;
    let recorded = |metric: MetricName| run.metric(&metric.text());
    recorded(metric).or_else(|| match metric {
        metric if metric.quantile().is_some() => quantile(&run.returns, metric.quantile()?).ok(),
        metric if metric == MESSAGES => Some(recorded(MESSAGE_RATE)? * recorded(MEAN_LENGTH)?),
        // It is recorded only where messages cost something.
        metric if metric == NET_RETURN => recorded(MEAN_RETURN),
        _ => None,
    })
}

/// Replaces the test returns of a run by their quartiles, which are all that analyses take from them.
pub fn condense(run: &mut CompletedRun) {
    let returns = std::mem::take(&mut run.returns);
    for metric in [LOWER_QUARTILE_RETURN, UPPER_QUARTILE_RETURN] {
        let share = metric.quantile().unwrap_or_default();
        let quartile = quantile(&returns, share).ok();
        run.metrics.extend(quartile.map(|quartile| (metric.text().into(), quartile)));
    }
}

/// Whether a job matches a row's name. An empty agent or scenario matches any.
pub fn is_at(job: &JobRecord, name: &ArmId) -> bool {
    let is = |wanted: &str, found: &str| wanted.is_empty() || wanted == found;
    let set = |(key, value): &(String, Scalar)| job.setting(key) == Some(value);
    is(&name.agent, &job.agent)
        && is(&name.scenario, &job.scenario)
        && name.settings.iter().all(set)
}

/// The first of each group of neighbouring jobs that differ in their seeds alone.
pub fn cells<'j>(jobs: &[&'j JobRecord]) -> impl Iterator<Item = &'j JobRecord> {
    jobs.chunk_by(|one, next| one.shares_arm(next)).map(|jobs| jobs[0])
}

/// A setting, as a key of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Token<'s> {
    /// The bits of a number.
    Number(u64),
    /// An integer that no number of 64 bits equals.
    Integer(i64),
    /// A word or list.
    Text(&'s str),
}

impl Token<'_> {
    /// The token of a setting.
    pub fn of(setting: &Scalar) -> Token<'_> {
        match setting {
            Scalar::Real(number) => Token::Number(number.to_bits()),
            Scalar::Integer(whole) if (*whole as f64) as i128 != i128::from(*whole) => {
                Token::Integer(*whole)
            }
            Scalar::Integer(whole) => Token::Number((*whole as f64).to_bits()),
            Scalar::Text(text) => Token::Text(text),
        }
    }
}

/// The parameters that differ between jobs of one agent, sorted by name.
pub fn varying(jobs: &[&JobRecord]) -> Vec<String> {
    let mut first = HashMap::new();
    let mut names = BTreeSet::new();
    for job in cells(jobs) {
        let first = first.entry(&*job.agent).or_insert(&*job.settings);
        names.extend(first.differing(&job.settings));
    }
    names.into_iter().map(str::to_owned).collect()
}

/// The varying parameters that are functions of the parameter `by`: among the jobs of each agent,
/// each value of `by` occurs with a single value of the parameter. Keys zipped with `by` are an
/// example. Empty if `by` does not vary.
pub fn decided_by(by: &str, jobs: &[&JobRecord]) -> Vec<String> {
    let mut names = varying(jobs);
    if !names.iter().any(|name| name == by) {
        return Vec::new();
    }
    let decides = |name: &String| {
        let mut values: HashMap<(&str, Token<'_>), Option<&Scalar>> = HashMap::new();
        cells(jobs).all(|job| {
            let value = job.setting(name);
            let Some(at) = job.setting(by) else { return value.is_none() };
            let known = values.entry((&*job.agent, Token::of(at))).or_insert(value);
            *known == value
        })
    };
    names.retain(|name| name != by && decides(name));
    names
}

/// The varying parameters that other parameters of the experiment determine, so that names are
/// distinct without them. Among parameters that determine each other, parameters in `kept` stay;
/// otherwise the parameter with the most values stays, and text comes before numbers.
pub fn implied(jobs: &[&JobRecord], kept: &[String]) -> Vec<String> {
    let mut names = varying(jobs);
    if names.len() < 2 {
        return Vec::new();
    }
    names.sort_by_cached_key(|name| {
        let values = || cells(jobs).filter_map(|job| job.setting(name));
        let distinct: HashSet<Token<'_>> = values().map(Token::of).collect();
        let is_word = values().any(|value| matches!(value, Scalar::Text(_)));
        (!kept.contains(name), Reverse(distinct.len()), !is_word)
    });
    let mut implied: Vec<String> = Vec::new();
    for name in &names {
        if !implied.contains(name) {
            let decided = decided_by(name, jobs);
            implied.extend(decided.into_iter().filter(|one| !kept.contains(one)));
        }
    }
    implied.sort();
    implied.dedup();
    implied
}

/// The arms of some jobs, in order of first appearance. Parameters in `aside` do not distinguish arms.
pub fn arms<'j>(jobs: &[&'j JobRecord], aside: &[&str]) -> Vec<Arm<'j>> {
    let mut names = varying(jobs);
    names.retain(|name| !aside.contains(&name.as_str()));
    let alike = jobs.chunk_by(|one, next| one.shares_arm(next)).map(|jobs| {
        let job = jobs[0];
        let tokens: Vec<Option<Token<'_>>> =
            names.iter().map(|name| job.setting(name).map(Token::of)).collect();
        ((&*job.agent, &*job.scenario, tokens), jobs)
    });
    let arm = |((agent, scenario, _), jobs): ((&str, &str, _), Vec<&[&'j JobRecord]>)| {
        let job = jobs[0][0];
        let settings = names.iter().filter_map(|name| Some((name, job.setting(name)?)));
        let settings = settings.map(|(name, value)| (name.clone(), value.clone())).collect();
        let name = ArmId { agent: agent.to_owned(), scenario: scenario.to_owned(), settings };
        Arm { name, jobs: jobs.concat() }
    };
    grouped(alike).into_iter().map(arm).collect()
}

/// The distinct values of a numeric parameter in ascending order, each with its jobs.
pub fn by_value<'j>(name: &str, jobs: &[&'j JobRecord]) -> Vec<(f64, Vec<&'j JobRecord>)> {
    let mut numbered: Vec<(f64, &'j JobRecord)> =
        jobs.iter().filter_map(|job| Some((job.number(name)?, *job))).collect();
    numbered.sort_by(|(one, _), (other, _)| one.total_cmp(other));
    let alike = numbered.chunk_by(|(one, _), (next, _)| one == next);
    alike.map(|jobs| (jobs[0].0, jobs.iter().map(|(_, job)| *job).collect())).collect()
}

#[cfg(test)]
mod tests {
    use std::slice;

    use super::*;
    use crate::manifest::parse;
    use crate::plan;

    fn jobs(keys: &str) -> Vec<JobRecord> {
        let text = format!(
            "format = 1\nextends = \"paper\"\nname = \"t\"\nscenarios = [\"P-H-D\"]\nseeds = 2\n{keys}"
        );
        let manifest = parse("t", text.as_bytes()).unwrap();
        plan::jobs(&manifest)
            .map(|planned| JobRecord::new(&planned, planned.form.key(), JobStatus::Pending))
            .collect()
    }

    const ZIPPED: &str = "zip = [[\"environment.state_noise\", \"environment.kappa_h\", \"environment.kappa_d\"]]\n\
                          [environment]\nsigma = [0.4, 0.6]\nstate_noise = [\"none\", \"beta\", \"beta\"]\n\
                          kappa_h = [0.0, 5.0, 10.0]\nkappa_d = [0.0, 9.0, 9.0]\n";

    #[test]
    fn settings_are_one_token_where_their_values_are_equal() {
        let two = 1i64 << 53;
        let all = [Scalar::Integer(two), Scalar::Integer(two + 1), Scalar::Real(two as f64)];
        let [even, odd, real] = all.each_ref().map(Token::of);
        assert!(even == real && odd != even);
    }

    #[test]
    fn zipped_keys_are_decided_by_one_that_has_more_values_and_others_are_not() {
        let jobs = jobs(ZIPPED);
        let jobs: Vec<&JobRecord> = jobs.iter().collect();
        let decided = |by| decided_by(by, &jobs);
        let (noise, kappa_d) = ("environment.state_noise", "environment.kappa_d");
        assert_eq!(decided("environment.kappa_h"), [kappa_d, noise]);
        assert_eq!(decided(noise), [kappa_d]);
        assert!(decided("environment.sigma").is_empty());
        assert!(decided("environment.horizon").is_empty(), "it is not varied");
    }

    #[test]
    fn names_of_arms_are_distinct_without_implied_keys() {
        let jobs = jobs(ZIPPED);
        let jobs: Vec<&JobRecord> = jobs.iter().collect();
        let (noise, kappa_d) =
            ("environment.state_noise".to_owned(), "environment.kappa_d".to_owned());
        assert_eq!(implied(&jobs, &[]), [kappa_d.clone(), noise.clone()]);
        assert_eq!(implied(&jobs, slice::from_ref(&noise)), slice::from_ref(&kappa_d));
        // Of two keys with equally many values, the key with text values stays.
        let two = jobs.iter().filter(|job| job.number("environment.kappa_h") != Some(5.0));
        let two: Vec<&JobRecord> = two.copied().collect();
        assert_eq!(implied(&two, &[]), [kappa_d, "environment.kappa_h".to_owned()]);
        let arms = arms(&jobs, &implied(&jobs, &[]).iter().map(String::as_str).collect::<Vec<_>>());
        // Two agents, two sigmas, three versions of the noise.
        assert_eq!(arms.len(), 12);
        assert!(arms.iter().all(|arm| arm.jobs.len() == 2));
    }
}
