//! `jitai export --after-study`: a trial as the Python package lifejacket takes it.

use std::collections::HashMap;
use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use serde_json::{Value as Json, json};

use crate::agent::LinearThompson;
use crate::cli::{Error, Exit, folder};
use crate::job::{EstimateDeclaration, PlannedJob, distinct};
use crate::manifest::{self, Manifest};
use crate::plan::{self, Filter};
use crate::train::{BanditTrace, Trace, bandit_trace};

/// The analysis, which reads the other files.
const ANALYSIS: &str = include_str!("after_study/analysis.py");

/// The most rows of decisions. The package holds every decision of every person in memory several times.
const MOST_DECISIONS: usize = 1_000_000;

/// Writes the trial that a manifest declares, or the only one of them that a filter leaves.
pub(super) fn write(
    path: &Path,
    filter: Option<&Filter>,
    estimate: Option<&str>,
    out: &Path,
) -> Result<Exit, Error> {
    let manifest = manifest::load(path).map_err(|faults| Error::Manifests(vec![faults]))?;
    let planned = only(&manifest, filter)?;
    let declaration = declaration(&manifest, &planned, estimate)?;
    let refused = |why: String| Error::Usage(format!("--after-study: {why}"));
    let traced = bandit_trace(&planned.job).map_err(|error| refused(error.to_string()))?;
    let agent = planned.job.agent.parameters::<LinearThompson>();
    let agent = agent.ok_or_else(|| refused("the agent is no `linear_thompson`".to_owned()))?;
    if !declaration.is_of_reward() {
        let why = format!(
            "lifejacket analyses the reward, and the outcome of `{}` is `{}`; --estimate chooses another estimate",
            declaration.name, declaration.outcome
        );
        return Err(refused(why));
    }
    if planned.job.task().interface().actions != 2 {
        let why = "lifejacket takes trials with two actions alone; `standard_errors = \"after_study\"` in [[estimate]] \
                   takes any number";
        return Err(refused(why.to_owned()));
    }
    if traced.trace.decisions.iter().any(|one| !one.decision.can_send) {
        let why = "lifejacket needs a choice at every decision, and at some no message can be sent";
        return Err(refused(why.to_owned()));
    }
    folder::make(out)?;
    let names = planned.job.state_names();
    let files = [
        ("decisions.csv", decisions(&traced.trace, &declaration, &names)?),
        ("updates.csv", updates(&traced.trace)),
        ("parameters.csv", parameters(&traced)),
        ("trial.json", format!("{:#}\n", description(&agent, &declaration, &traced))),
        ("analysis.py", ANALYSIS.to_owned()),
    ];
    for (name, text) in files {
        let path = out.join(name);
        let what = format!("write `{}`", path.display());
        fs::write(&path, text).map_err(|source| Error::Io { what, source })?;
        writeln!(io::stderr(), "{}", path.display())?;
    }
    Ok(Exit::Done)
}

/// The only job of a manifest that meets the filter.
fn only(manifest: &Manifest, filter: Option<&Filter>) -> Result<PlannedJob, Error> {
    let meets = |planned: &PlannedJob| filter.is_none_or(|filter| filter.meets(planned));
    let mut found = plan::jobs(manifest).filter(meets);
    match (found.next(), found.next()) {
        (Some(planned), None) => Ok(planned),
        (None, _) => Err(Error::Usage("--filter: no job meets it".to_owned())),
        (Some(_), Some(_)) => {
            let help = "--after-study exports one trial: narrow the jobs, as in --filter agent=thompson,seed=1";
            Err(Error::Usage(help.to_owned()))
        }
    }
}

/// The estimate of this name, or the only one of the job.
fn declaration(
    manifest: &Manifest,
    planned: &PlannedJob,
    name: Option<&str>,
) -> Result<Arc<EstimateDeclaration>, Error> {
    let mut all = manifest.estimates_of(&planned.agent);
    let names: Vec<String> = all.iter().map(|one| one.name.clone()).collect();
    all.retain(|one| name.is_none_or(|name| one.name == name));
    match all.as_slice() {
        [one] => Ok(one.clone()),
        _ if names.is_empty() => {
            Err(Error::Usage("--after-study: the manifest declares no [[estimate]]".to_owned()))
        }
        _ => {
            let help = format!("--estimate: name one of the estimates {}", names.join(", "));
            Err(Error::Usage(help))
        }
    }
}

/// The decisions: a row for every person and step of the trial, those out of the study included.
fn decisions(
    trace: &Trace,
    declaration: &EstimateDeclaration,
    names: &[String],
) -> Result<String, Error> {
    let steps = trace.decisions.iter().map(|one| one.time + 1).max().unwrap_or(0);
    let rows = trace.people.saturating_mul(steps as usize);
    if rows > MOST_DECISIONS {
        let why = format!("{rows} rows of decisions; the maximum is {MOST_DECISIONS}");
        return Err(Error::Usage(format!("--after-study: {why}")));
    }
    let features = distinct(declaration.control.iter().chain(&declaration.moderators));
    let index = |name: &&String| names.iter().position(|known| known == *name);
    let indices: Vec<Option<usize>> = features.iter().map(index).collect();
    let letters = trace.decisions.first().map_or(0, |one| one.observed.len());
    let mut text =
        "person,calendar_t,in_study,policy_num,action,probability,reward,seen_outcome,learned"
            .to_owned();
    (1..=letters).for_each(|number| text += &format!(",seen_{number}"));
    features.iter().for_each(|name| text += &format!(",x_{name}"));
    text.push('\n');
    let known: HashMap<(u32, u32), _> =
        trace.decisions.iter().map(|one| ((one.decision.episode, one.time), one)).collect();
    for person in 1..=trace.people as u32 {
        for time in 0..steps {
            let policy = trace.updates.iter().filter(|update| update.time <= time).count();
            text += &format!("{person},{time}");
            let Some(one) = known.get(&(person, time)) else {
                text += &format!(",0,{policy},0,0,0,0,0");
                text += &",0".repeat(letters + features.len());
                text.push('\n');
                continue;
            };
            let of = &one.decision;
            let (is_seen, learned) = (one.learned.is_some(), one.learned.unwrap_or(0.0));
            text += &format!(
                ",1,{policy},{},{},{},{},{learned}",
                of.action,
                of.probabilities[1],
                of.reward_for(declaration),
                u8::from(is_seen)
            );
            one.observed.iter().for_each(|value| text += &format!(",{value}"));
            for index in &indices {
                let value = index.map_or(f64::from(of.step), |index| of.state[index]);
                text += &format!(",{value}");
            }
            text.push('\n');
        }
    }
    Ok(text)
}

/// The updates: a row for every person whose data count, and the step before which they do.
fn updates(trace: &Trace) -> String {
    let mut text = "policy_num,calendar_t,person,before\n".to_owned();
    for (number, update) in (1..).zip(&trace.updates) {
        let people = (1..).zip(&update.people).filter(|(_, counts)| **counts);
        for (person, _) in people {
            text += &format!("{number},{},{person},{}\n", update.time, update.before);
        }
    }
    text
}

/// The parameters of every update: of each regression, the lower triangle of the precision, row by row, and the product of
/// the precision and the means.
fn parameters(traced: &BanditTrace) -> String {
    let mut text = "policy_num,regression,number,value\n".to_owned();
    for (update, sums) in (1..).zip(&traced.sums) {
        for (regression, own) in sums.chunks(sums.len() / traced.regressions).enumerate() {
            for (number, value) in own.iter().enumerate() {
                text += &format!("{update},{regression},{number},{value}\n");
            }
        }
    }
    text
}

/// What the analysis knows of the agent and of the estimate.
fn description(
    agent: &LinearThompson,
    declaration: &EstimateDeclaration,
    traced: &BanditTrace,
) -> Json {
    let width = traced.width;
    let diagonal =
        |own: &[f64]| -> Vec<f64> { (0..width).map(|i| own[i * (i + 1) / 2 + i]).collect() };
    let prior: Vec<(Vec<f64>, Vec<f64>)> = traced
        .prior
        .chunks(traced.prior.len() / traced.regressions)
        .map(|own| {
            let precisions = diagonal(own);
            let information = &own[own.len() - width..];
            let means = information.iter().zip(&precisions).map(|(sum, one)| sum / one);
            (means.collect(), precisions)
        })
        .collect();
    let (means, precisions): (Vec<_>, Vec<_>) = prior.into_iter().unzip();
    let bias = |action: usize| agent.action_bias.get(action).copied().unwrap_or(0.0);
    let (allocation, features) = (agent.allocation.word(), agent.features.word());
    json!({
        "features": traced.trace.decisions.first().map_or(0, |one| one.observed.len()),
        "width": width,
        "regressions": traced.regressions,
        "agent": {
            "action_centring": agent.action_centring,
            "allocation": allocation,
            "features": features,
            "bias": bias(1) - bias(0),
            "pi_min": agent.pi_min,
            "lower": agent.logistic_lower,
            "upper": agent.logistic_upper,
            "slope": agent.logistic_slope,
            "log_odds": agent.logistic_odds.ln(),
            "noise_variance": agent.noise_sd * agent.noise_sd,
            "prior_means": means,
            "prior_precisions": precisions,
        },
        "estimate": {
            "name": declaration.name,
            "control": declaration.control,
            "moderators": declaration.moderators,
            "numerator": declaration.numerator,
        },
    })
}
