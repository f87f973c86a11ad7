//! Environment parameters on the command line, such as `--set NAME=VALUE`: as a manifest writes them.

use crate::cli::Error;
use crate::env::Environment;
use crate::key::Keyed;
use crate::manifest;
use crate::manifest::printable;
use crate::plan;

/// The environment with settings as a manifest would make them, and with a manifest's checks.
pub(super) fn adjusted(
    mut environment: Environment,
    settings: &[String],
) -> Result<Environment, Error> {
    for (i, setting) in settings.iter().enumerate() {
        let (name, value) = name_and_value(setting)?;
        if settings[..i].iter().any(|earlier| sets(earlier, name)) {
            return Err(Error::Usage(format!("--set {setting}: `{name}` is set a second time")));
        }
        environment = with_parameter(environment, name, value, &format!("--set {setting}"))?;
    }
    Ok(environment)
}

/// The environment with another value of a parameter, given by an option that messages name.
pub(super) fn with_parameter(
    environment: Environment,
    name: &str,
    value: &str,
    option: &str,
) -> Result<Environment, Error> {
    let refused = |why: &str| Error::Usage(format!("{}: {why}", printable(option)));
    // It becomes a line of TOML.
    if value.contains(char::is_control) {
        return Err(refused("a value is one line, without control characters"));
    }
    let text = format!(
        "format = 1\nextends = \"paper\"\nname = \"simulate\"\nscenarios = [\"C\"]\nseeds = 1\n\
         [environment]\n{}{name} = {}\n",
        if name == "sigma" { "" } else { "sigma = 1\n" },
        quoted(value),
    );
    let manifest = manifest::parse(option, text.as_bytes()).map_err(|faults| {
        let said = faults.list().iter().map(|fault| match fault.hint() {
            Some(hint) => format!("{} ({hint})", fault.message()),
            None => fault.message().to_owned(),
        });
        refused(&said.collect::<Vec<_>>().join("; "))
    })?;
    if manifest.environment.iter().any(|(_, values)| values.len() > 1) {
        return Err(refused("expected one value, not a sweep"));
    }
    let set = plan::jobs(&manifest).next().map(|planned| planned.job.environment);
    let mut values = environment.to_values();
    for (place, key) in Environment::KEYS.iter().enumerate() {
        if let Some(set) = set.as_ref().filter(|_| key.name == name) {
            values[place] = set.to_values()[place].clone();
        }
    }
    Ok(Environment::from_values(&values).expect("every value was checked as a manifest's"))
}

/// Whether a setting is one of this parameter.
pub(super) fn sets(setting: &str, parameter: &str) -> bool {
    name_and_value(setting).is_ok_and(|(name, _)| name == parameter)
}

/// The parts of a setting.
fn name_and_value(setting: &str) -> Result<(&str, &str), Error> {
    let is_name = |name: &str| {
        !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
    };
    setting
        .split_once('=')
        .map(|(name, value)| (name.trim(), value.trim()))
        .map(|(name, value)| (name.strip_prefix("environment.").unwrap_or(name), value))
        .filter(|(name, _)| is_name(name))
        .ok_or_else(|| Error::Usage(format!("`{setting}` is not NAME=VALUE, such as sigma=0.4")))
}

/// A value as TOML: words get the quotes that a shell has taken.
fn quoted(value: &str) -> String {
    let bare = value.starts_with(|c: char| c.is_ascii_alphabetic())
        && !matches!(value, "true" | "false" | "inf" | "nan");
    if bare { format!("{value:?}") } else { value.to_owned() }
}
