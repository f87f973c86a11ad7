//! `jitai check --try`: starts the programs of environments and checks the contract, and rolls models.

use std::io::{self, Write};
use std::sync::Arc;

use serde_json::{Value as Json, json};

use crate::analyse::grouped;
use crate::cli::output::counted;
use crate::env::declared::{DeclaredModel, Rolled};
use crate::env::outside::{OutsideModel, Trial, try_program};
use crate::estimate::Layout;
use crate::job::{distinct, environment_text};
use crate::key::printable;
use crate::manifest::{DeclaredEstimate, Manifest};
use crate::plan;
use crate::train::misfit;

/// A trial of an environment: its parameters as a user would write them, and the result or the fault.
pub(super) struct Tried {
    parameters: String,
    result: Result<Passed, String>,
}

/// What was seen of an environment that passed.
enum Passed {
    Program(Trial),
    Model(Rolled),
}

/// Tries every environment of a manifest that is an outside program or a model.
pub(super) fn of_manifest(manifest: &Manifest) -> Vec<Tried> {
    if manifest.family().with_parameters.is_none() {
        return Vec::new();
    }
    let jobs = plan::jobs(manifest).map(|planned| planned.job);
    let environments = jobs.map(|job| (environment_text(&job.environment), job));
    let mut all = Vec::new();
    for (_, jobs) in grouped(environments) {
        if let Some(model) = jobs[0].environment.model::<DeclaredModel>() {
            let parameters = model.given().map(|(name, value)| format!("{name} = {value}"));
            let parameters = parameters.collect::<Vec<_>>().join(", ");
            all.push(Tried { parameters, result: model.rolled().map(Passed::Model) });
        }
        let Some(model) = jobs[0].environment.model::<OutsideModel>() else { continue };
        let launch = model.launch(manifest.folder());
        let parameters: Vec<String> =
            launch.parameters.iter().map(|(name, value)| format!("{name} = {value}")).collect();
        let result = try_program(&launch, Arc::new(|| false)).map_err(|error| error.to_string());
        let suited = result.and_then(|trial| {
            let Trial { description, .. } = &trial;
            let misfits = jobs.iter().filter_map(|job| misfit(job, description));
            let mut names = description.state.clone();
            names.extend(jobs[0].trial.iter().flat_map(|trial| trial.state_names()));
            let estimates =
                manifest.estimates.iter().filter_map(|DeclaredEstimate { declaration, .. }| {
                    let fault =
                        Layout::of(declaration, description.actions.len(), &names.clone().into())
                            .err()?;
                    Some(format!("the estimate `{}`: {fault}", declaration.name))
                });
            let faults = distinct(misfits.chain(estimates));
            if faults.is_empty() { Ok(Passed::Program(trial)) } else { Err(faults.join("; ")) }
        });
        all.push(Tried { parameters: parameters.join(", "), result: suited });
    }
    all
}

/// Prints the trials of a manifest that programs passed; returns the faults of the others.
pub(super) fn show(manifest: &Manifest, trials: &[Tried]) -> io::Result<Vec<String>> {
    let mut out = io::stdout().lock();
    let mut faults = Vec::new();
    for Tried { parameters, result } in trials {
        let of = if parameters.is_empty() { String::new() } else { format!(" with {parameters}") };
        match result {
            Ok(Passed::Program(Trial { description, speeds: [(_, one), (lanes, many)] })) => {
                writeln!(
                    out,
                    "  environment{of}: keeps the contract; {}, {}, horizon {}; {} steps per second with 1 lane, {} \
                 with {lanes}",
                    counted(description.features.len(), "feature"),
                    counted(description.actions.len(), "action"),
                    description.horizon,
                    rounded(*one),
                    rounded(*many),
                )?
            }
            Ok(Passed::Model(rolled)) => {
                writeln!(
                    out,
                    "  model{of}: {} of {} people, all numbers finite; {} decisions per second",
                    counted(rolled.decisions as usize, "decision"),
                    rolled.people,
                    rounded(rolled.speed),
                )?;
                for (name, least, most) in &rolled.ranges {
                    writeln!(out, "    {name}: {least:.4} to {most:.4}")?;
                }
            }
            Err(fault) => {
                faults.push(printable(&format!("{}: environment{of}: {fault}", manifest.path)));
            }
        }
    }
    Ok(faults)
}

/// The trials as JSON.
pub(super) fn as_json(manifest: &Manifest, trials: &[Tried]) -> Vec<Json> {
    let one = |Tried { parameters, result }: &Tried| match result {
        Ok(Passed::Program(trial)) => json!({
            "path": manifest.path, "parameters": parameters, "description": trial.description,
            "speeds": trial.speeds,
        }),
        Ok(Passed::Model(rolled)) => json!({
            "path": manifest.path, "parameters": parameters, "rolled": rolled,
        }),
        Err(fault) => json!({ "path": manifest.path, "parameters": parameters, "fault": fault }),
    };
    trials.iter().map(one).collect()
}

/// A speed with two digits.
fn rounded(speed: f64) -> String {
    let scale = 10_f64.powf(speed.max(1.0).log10().floor() - 1.0).max(1.0);
    ((speed / scale).round() * scale).to_string()
}
