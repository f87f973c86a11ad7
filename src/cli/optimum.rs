//! `jitai optimum`: the best mean return that any policy can reach in the environments of the command
//! line or of manifests.

use std::collections::HashSet;
use std::io::{self, Write};
use std::path::PathBuf;

use crate::cli::counting::Counting;
use crate::cli::output::{Format, OutputField, OutputRows};
use crate::cli::setting::{adjusted, sets, with_parameter};
use crate::cli::{Error, Exit, StoreArgument, check};
use crate::env::StepCountModel;
use crate::env::context_error;
use crate::env::{self, Family, Population, Scenario, StepCount};
use crate::job::Job;
use crate::job::{environment_text, people_text};
use crate::key::{Keyed, SectionName};
use crate::manifest::{Manifest, Varying};
use crate::optimum::{self, NoOptimum, Optimum};
use crate::plan::{self};

/// Compute the best mean return that any policy can reach, for scenarios that show H and D
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Manifests (TOML files); computes the optimum for each of their environments and scenarios
    #[arg(value_name = "MANIFEST", conflicts_with_all = ["scenarios", "sigmas", "settings"])]
    manifests: Vec<PathBuf>,
    /// Scenarios that the policy observes, separated by commas
    #[arg(
        long = "scenario",
        value_name = "SCENARIO",
        value_delimiter = ',',
        default_value = "C-H-D,P-H-D,L-H-D",
        value_parser = env::letters
    )]
    scenarios: Vec<Scenario>,
    /// Standard deviations of the context feature, separated by commas
    #[arg(long = "sigma", value_name = "SIGMA", value_delimiter = ',', default_value = "0.6")]
    sigmas: Vec<String>,
    /// Another environment parameter, as in a manifest's [environment], such as horizon=100;
    /// repeatable
    #[arg(long = "set", value_name = "NAME=VALUE")]
    settings: Vec<String>,
    /// Output format
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

const COLUMNS: [&str; 5] = ["scenario", "sigma", "context_error", "optimum", "optimum_error"];

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    if arguments.manifests.is_empty() {
        of_arguments(arguments)?;
    } else {
        let manifests = check::load_all(&arguments.manifests, &[], &arguments.store)?;
        of_manifests(&manifests, arguments.format)?;
    }
    Ok(Exit::Done)
}

fn of_manifests(manifests: &[Manifest], format: Format) -> Result<(), Error> {
    let swept = swept(manifests);
    let columns = ["experiment"].iter().chain(&COLUMNS).chain(&swept);
    let columns: Vec<String> = columns.map(ToString::to_string).collect();
    let mut rows = OutputRows::new(format, &columns, io::stdout().lock())?;
    let mut missing: Vec<NoOptimum> = Vec::new();
    for manifest in manifests {
        let family = manifest.family();
        if family != Family::first() {
            let error = NoOptimum::Family { family: family.name };
            return Err(Error::Usage(format!("{}: {error}", manifest.path)));
        }
        let problems = problems(manifest);
        // The optimum is undefined for participants who differ.
        let alike = problems.iter().filter(|(.., people)| people.is_homogeneous());
        let pairs: Vec<_> = alike.map(|(one, other, _)| (one, other)).collect();
        let mut computed = found_of(&pairs).into_iter();
        for (environment, scenario, people) in &problems {
            let found = optimum::check_people(people)
                .and_then(|()| computed.next().expect("one for each problem of alike people"));
            let found = found.map(optimum_and_error).unwrap_or_else(|error| {
                if !missing.contains(&error) {
                    missing.push(error);
                }
                [OutputField::Empty, OutputField::Empty]
            });
            let of_key = |key: &&str| match &environment.to_json()[*key] {
                serde_json::Value::String(word) => OutputField::text(word.clone()),
                other => OutputField::Nested(other.clone()),
            };
            let mut row = vec![OutputField::text(&manifest.name)];
            row.extend(known(environment, scenario).into_iter().chain(found));
            row.extend(swept.iter().map(of_key));
            rows.row(&row)?;
        }
    }
    rows.finish()?;
    Ok(missing.iter().try_for_each(|error| writeln!(io::stderr(), "{error}"))?)
}

fn of_arguments(arguments: &Arguments) -> Result<(), Error> {
    let environment = |sigma: &String| {
        let option = format!("--sigma {sigma}");
        let noisy = with_parameter(StepCount::paper(0.0), "sigma", sigma.trim(), &option)?;
        adjusted(noisy, &arguments.settings)
    };
    if let Some(setting) = arguments.settings.iter().find(|setting| sets(setting, "sigma")) {
        let help = "use --sigma, which takes several values separated by commas";
        return Err(Error::Usage(format!("--set {setting}: {help}")));
    }
    let environments = arguments.sigmas.iter().map(environment).collect::<Result<Vec<_>, _>>()?;
    let of_scenario = |scenario| environments.iter().map(move |e| (e, scenario));
    let pairs: Vec<_> = arguments.scenarios.iter().flat_map(of_scenario).collect();
    let refused = |error: NoOptimum| Error::Usage(error.to_string());
    for (environment, scenario) in &pairs {
        optimum::check(environment, scenario).map_err(refused)?;
    }
    let mut rows =
        OutputRows::new(arguments.format, &COLUMNS.map(str::to_owned), io::stdout().lock())?;
    for ((environment, scenario), found) in pairs.iter().zip(found_of(&pairs)) {
        let found = optimum_and_error(found.map_err(refused)?);
        let row: Vec<OutputField<'_>> =
            known(environment, scenario).into_iter().chain(found).collect();
        rows.row(&row)?;
    }
    Ok(rows.finish()?)
}

/// The last two columns of [`COLUMNS`]: the optimum and its error.
fn optimum_and_error(found: Optimum) -> [OutputField<'static>; 2] {
    [OutputField::Rounded(found.mean_return, 1), OutputField::Rounded(found.error, 2)]
}

/// The first three columns of [`COLUMNS`], which need no optimum.
fn known(environment: &StepCount, scenario: &Scenario) -> [OutputField<'static>; 3] {
    let error = context_error(environment.sigma, environment.context_probability);
    let sigma = OutputField::Real(environment.sigma);
    [OutputField::text(scenario.to_string()), sigma, OutputField::Rounded(error, 4)]
}

/// The distinct environments, scenarios and populations of a manifest's jobs, in job order.
fn problems(manifest: &Manifest) -> Vec<(StepCount, Scenario, Population)> {
    let mut seen = HashSet::new();
    let distinct = plan::jobs(manifest).filter_map(|planned| {
        let Job { environment, scenario, .. } = &planned.job;
        let is_new = seen.insert((
            environment_text(environment),
            people_text(environment),
            scenario.clone(),
        ));
        let StepCountModel { parameters, population } = planned.job.task().model().clone();
        is_new.then(|| (parameters, scenario.clone(), population))
    });
    distinct.collect()
}

/// The optimum of each environment and scenario, in order; shows progress on standard error.
fn found_of(pairs: &[(&StepCount, &Scenario)]) -> Vec<Result<Optimum, NoOptimum>> {
    let mut shown = Counting::new(pairs.len(), "optima");
    optimum::several(pairs, |_| shown.one_more())
}

/// The keys of the environment, except sigma, in which the manifests' environments differ.
fn swept(manifests: &[Manifest]) -> Vec<&'static str> {
    let keys =
        manifests.iter().flat_map(|manifest| manifest.sections[SectionName::Environment].iter());
    let values = keys.flat_map(|(key, values)| values.iter().map(|value| ("", key.name, value)));
    let differs = Varying::among(values).names();
    let names = StepCount::KEYS.iter().map(|key| key.name);
    names.filter(|name| *name != "sigma" && differs.iter().any(|one| one == name)).collect()
}
