//! Environment parameters on the command line, such as `--set NAME=VALUE`, in the syntax of manifests.

use crate::cli::Error;
use crate::env::StepCount;
use crate::env::StepCountModel;
use crate::key::printable;
use crate::key::{Keyed, SectionName};
use crate::manifest::{self, Fault, Manifest};
use crate::plan;

/// A parameter set by an option.
struct Given<'a> {
    name: &'a str,
    value: &'a str,
    /// The option, as messages name it.
    option: String,
}

/// The environment with settings applied; the settings are validated as in a manifest.
pub(super) fn adjusted(environment: StepCount, settings: &[String]) -> Result<StepCount, Error> {
    let mut given = Vec::new();
    for (i, setting) in settings.iter().enumerate() {
        let (name, value) = name_and_value(setting)?;
        if settings[..i].iter().any(|earlier| sets(earlier, name)) {
            return Err(Error::Usage(format!(
                "--set {setting}: `{name}` is set twice; set it once"
            )));
        }
        given.push(Given { name, value, option: format!("--set {setting}") });
    }
    with_all(environment, &given)
}

/// The environment with another value of one parameter; messages name the `option`.
pub(super) fn with_parameter(
    environment: StepCount,
    name: &str,
    value: &str,
    option: &str,
) -> Result<StepCount, Error> {
    with_all(environment, &[Given { name, value, option: option.to_owned() }])
}

/// The environment of a preset.
pub(super) fn preset(name: &str, sigma: f64) -> Result<StepCount, String> {
    let text = format!(
        "format = 1\nextends = {name:?}\nname = \"simulate\"\nscenarios = [\"C\"]\nseeds = 1\n\
         environment.sigma = {sigma:?}\n"
    );
    let manifest = manifest::parse(name, text.as_bytes()).map_err(|faults| said(faults.list()))?;
    Ok(of_first_job(&manifest))
}

fn with_all(environment: StepCount, given: &[Given]) -> Result<StepCount, Error> {
    let refused = |option: &str, why: &str| Error::Usage(format!("{}: {why}", printable(option)));
    if given.is_empty() {
        return Ok(environment);
    }
    // Each setting becomes one line of TOML.
    if let Some(Given { option, .. }) = given.iter().find(|g| g.value.contains(char::is_control)) {
        return Err(refused(option, "expected a value on one line, without control characters"));
    }
    let (text, first_line) = manifest_of(&environment, given);
    let manifest = manifest::parse("options", text.as_bytes()).map_err(|faults| {
        // A fault after the last option belongs to the last option.
        let option_of = |fault: &Fault| {
            let line = faults.position(fault).map_or(usize::MAX, |position| position.line);
            line.saturating_sub(first_line).min(given.len() - 1)
        };
        let index = faults.list().iter().map(option_of).min().unwrap_or_default();
        let of_option = faults.list().iter().filter(|fault| option_of(fault) == index);
        refused(&given[index].option, &said(of_option))
    })?;
    let environment = manifest.sections[SectionName::Environment].iter();
    for (key, _) in environment.filter(|(_, values)| values.len() > 1) {
        if let Some(Given { option, .. }) = given.iter().find(|given| given.name == key.name) {
            return Err(refused(option, "expected one value, not a sweep"));
        }
    }
    Ok(of_first_job(&manifest))
}

/// A manifest with the values of an environment, the given values last, and the number (from 1) of the
/// line with the first given value.
fn manifest_of(environment: &StepCount, given: &[Given]) -> (String, usize) {
    let mut lines = ["format = 1", "extends = \"paper\"", "name = \"simulate\"", "seeds = 1"]
        .map(str::to_owned)
        .to_vec();
    lines.extend(["scenarios = [\"C\"]".to_owned(), "[environment]".to_owned()]);
    for (key, value) in StepCount::KEYS.iter().zip(environment.to_values()) {
        if given.iter().all(|given| given.name != key.name) {
            lines.push(format!("{} = {value}", key.name));
        }
    }
    let first_line = lines.len() + 1;
    lines.extend(given.iter().map(|given| format!("{} = {}", given.name, quoted(given.value))));
    (lines.join("\n") + "\n", first_line)
}

fn said<'f>(faults: impl IntoIterator<Item = &'f Fault>) -> String {
    let said = faults.into_iter().map(|fault| match fault.hint() {
        Some(hint) => format!("{} ({hint})", fault.message()),
        None => fault.message().to_owned(),
    });
    said.collect::<Vec<_>>().join("; ")
}

fn of_first_job(manifest: &Manifest) -> StepCount {
    let first = plan::jobs(manifest).next().expect("a manifest without a sweep has a job");
    let model: &StepCountModel = first.job.environment.model().expect("a preset is of step_count");
    model.parameters.clone()
}

/// Whether a setting sets this parameter.
pub(super) fn sets(setting: &str, parameter: &str) -> bool {
    name_and_value(setting).is_ok_and(|(name, _)| name == parameter)
}

/// The name and the value of a setting.
pub(super) fn name_and_value(setting: &str) -> Result<(&str, &str), Error> {
    let is_name = |name: &str| {
        !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
    };
    setting
        .split_once('=')
        .map(|(name, value)| (name.trim(), value.trim()))
        .map(|(name, value)| (name.strip_prefix("environment.").unwrap_or(name), value))
        .filter(|(name, _)| is_name(name))
        .ok_or_else(|| Error::Usage(format!("`{setting}`: expected NAME=VALUE, such as sigma=0.4")))
}

/// A value as TOML; words get the quotes that the shell removed.
fn quoted(value: &str) -> String {
    let bare = value.starts_with(|c: char| c.is_ascii_alphabetic())
        && !matches!(value, "true" | "false" | "inf" | "nan");
    if bare { format!("{value:?}") } else { value.to_owned() }
}
