//! `jitai optimum`: the best mean return that any policy can reach, in environments given on the
//! command line or by manifests.

use std::collections::HashSet;
use std::io::{self, Write};
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::thread;

use crate::cli::output::{Cell, Format, Rows};
use crate::cli::setting::{adjusted, sets, with_parameter};
use crate::cli::{Error, Exit, check};
use crate::env::inference_error;
use crate::env::{Environment, Scenario};
use crate::key::Keyed;
use crate::manifest::Manifest;
use crate::optimum::{self, Effort, StateHidden};
use crate::plan;

/// Compute the best mean return that any policy can reach, in scenarios that show H and D
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Manifests (TOML files): the optimum of each of their environments and scenarios
    #[arg(value_name = "MANIFEST", conflicts_with_all = ["scenarios", "sigmas", "settings"])]
    manifests: Vec<PathBuf>,
    /// What the policy observes; several with commas
    #[arg(
        long = "scenario",
        value_name = "SCENARIO",
        value_delimiter = ',',
        default_value = "C-H-D,P-H-D,L-H-D"
    )]
    scenarios: Vec<Scenario>,
    /// Standard deviation of the context feature; several with commas
    #[arg(long = "sigma", value_name = "SIGMA", value_delimiter = ',', default_value = "0.6")]
    sigmas: Vec<String>,
    /// Another environment parameter, as in a manifest's [environment], such as horizon=100; may be
    /// repeated
    #[arg(long = "set", value_name = "NAME=VALUE")]
    settings: Vec<String>,
    /// How many times as long an optimum may take as it usually does at most (ten seconds or so), for a
    /// smaller error
    #[arg(long, value_name = "TIMES", default_value = "1")]
    effort: NonZeroU32,
    /// How rows are written
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
}

/// An error that nobody needs to be told of, in steps walked.
const SMALL_ERROR: f64 = 0.5;
/// How many times as long is proposed where errors are larger.
const LONGER: NonZeroU32 = NonZeroU32::new(10).expect("above 0");

const COLUMNS: [&str; 5] = ["scenario", "sigma", "context_error", "optimum", "optimum_error"];

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let threads = thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    let mut optima = Optima { effort: Effort { threads, times: arguments.effort }, inexact: 0 };
    if arguments.manifests.is_empty() {
        of_arguments(arguments, &mut optima)?;
    } else {
        of_manifests(&check::load_all(&arguments.manifests)?, arguments.format, &mut optima)?;
    }
    if let Some(told) = inexact(optima.inexact, optima.effort.times) {
        writeln!(io::stderr(), "{told}")?;
    }
    Ok(Exit::Done)
}

/// Optima under way.
struct Optima {
    effort: Effort,
    /// How many were found with an error that is not small.
    inexact: usize,
}

impl Optima {
    /// The last of [`COLUMNS`].
    fn find(
        &mut self,
        environment: &Environment,
        scenario: &Scenario,
    ) -> Result<[Cell<'static>; 2], StateHidden> {
        let found = optimum::optimum(environment, scenario, self.effort)?;
        self.inexact += usize::from(found.error > SMALL_ERROR);
        Ok([Cell::Rounded(found.mean_return, 1), Cell::Rounded(found.error, 2)])
    }
}

/// What is told of optima with errors that are not small, if there are any: what makes them smaller.
fn inexact(count: usize, times: NonZeroU32) -> Option<String> {
    let longer = times.saturating_mul(LONGER);
    let them = match count {
        0 => return None,
        1 => "one optimum".to_owned(),
        many => format!("{many} optima"),
    };
    let remedy = format!("--effort {longer} takes up to {LONGER} times as long for smaller errors");
    Some(format!("{them} may be more than {SMALL_ERROR} off; {remedy}"))
}

fn of_manifests(manifests: &[Manifest], format: Format, optima: &mut Optima) -> Result<(), Error> {
    let swept = swept(manifests);
    let columns = ["experiment"].iter().chain(&COLUMNS).chain(&swept);
    let columns: Vec<String> = columns.map(ToString::to_string).collect();
    let mut rows = Rows::new(format, &columns, io::stdout().lock())?;
    let mut hidden: Vec<StateHidden> = Vec::new();
    for manifest in manifests {
        for (environment, scenario) in cells(manifest) {
            let found = optima.find(&environment, &scenario).unwrap_or_else(|error| {
                if !hidden.contains(&error) {
                    hidden.push(error);
                }
                [Cell::Empty, Cell::Empty]
            });
            let of_key = |key: &&str| match &environment.to_json()[*key] {
                serde_json::Value::String(word) => Cell::text(word.clone()),
                other => Cell::Nested(other.clone()),
            };
            let mut row = vec![Cell::text(&manifest.name)];
            row.extend(known(&environment, &scenario).into_iter().chain(found));
            row.extend(swept.iter().map(of_key));
            rows.row(&row)?;
        }
    }
    rows.finish()?;
    Ok(hidden.iter().try_for_each(|error| writeln!(io::stderr(), "{error}"))?)
}

fn of_arguments(arguments: &Arguments, optima: &mut Optima) -> Result<(), Error> {
    let refused = |error: StateHidden| Error::Usage(error.to_string());
    for scenario in &arguments.scenarios {
        optimum::shows_state(scenario).map_err(refused)?;
    }
    let environment = |sigma: &String| {
        let option = format!("--sigma {sigma}");
        let noisy = with_parameter(Environment::paper(0.0), "sigma", sigma.trim(), &option)?;
        adjusted(noisy, &arguments.settings)
    };
    if let Some(setting) = arguments.settings.iter().find(|setting| sets(setting, "sigma")) {
        let help = "several with commas, are given by --sigma";
        return Err(Error::Usage(format!("--set {setting}: standard deviations, {help}")));
    }
    let environments = arguments.sigmas.iter().map(environment).collect::<Result<Vec<_>, _>>()?;
    let mut rows = Rows::new(arguments.format, &COLUMNS.map(str::to_owned), io::stdout().lock())?;
    for scenario in &arguments.scenarios {
        for environment in &environments {
            let found = optima.find(environment, scenario).map_err(refused)?;
            let row: Vec<Cell<'_>> =
                known(environment, scenario).into_iter().chain(found).collect();
            rows.row(&row)?;
        }
    }
    Ok(rows.finish()?)
}

/// The first of [`COLUMNS`], which need no computation.
fn known(environment: &Environment, scenario: &Scenario) -> [Cell<'static>; 3] {
    let error = inference_error(environment.sigma);
    let sigma = Cell::Real(environment.sigma);
    [Cell::text(scenario.to_string()), sigma, Cell::Rounded(error, 4)]
}

/// The environments and scenarios of a manifest's jobs, in their order, none twice.
fn cells(manifest: &Manifest) -> Vec<(Environment, Scenario)> {
    let mut seen = HashSet::new();
    let distinct = plan::jobs(manifest).filter_map(|planned| {
        let (environment, scenario) = (planned.job.environment, planned.job.scenario);
        let is_new = seen.insert((format!("{environment:?}"), scenario.clone()));
        is_new.then_some((environment, scenario))
    });
    distinct.collect()
}

/// The keys of the environment, sigma aside, in which the manifests' environments differ.
fn swept(manifests: &[Manifest]) -> Vec<&'static str> {
    let Some(first) = manifests.first() else { return Vec::new() };
    let differs = |key: &str| {
        let usual = first.environment.get(key);
        manifests.iter().any(|manifest| {
            let ours = manifest.environment.get(key);
            ours.is_some_and(|values| values.len() > 1) || ours != usual
        })
    };
    let keys = first.environment.iter().map(|(key, _)| key.name);
    keys.filter(|key| *key != "sigma" && differs(key)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_that_are_not_small_are_told_with_what_makes_them_smaller() {
        let times = |times| NonZeroU32::new(times).unwrap();
        assert_eq!(inexact(0, times(1)), None);
        assert_eq!(
            inexact(1, times(1)).unwrap(),
            "one optimum may be more than 0.5 off; --effort 10 takes up to 10 times as long for \
             smaller errors"
        );
        assert!(inexact(3, times(20)).unwrap().starts_with("3 optima may be more than 0.5 off"));
        assert!(inexact(3, times(20)).unwrap().contains("--effort 200 takes"));
    }
}
