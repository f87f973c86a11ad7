//! Hints for valid manifests that probably differ from the author's intent.

use super::declared::{DeclaredAgent, Manifest};
use super::printable;
use crate::key::{Key, Parameter, Value};

/// Hints on a valid manifest, as fragments.
pub fn hints(manifest: &Manifest) -> Vec<String> {
    let of_agent =
        |agent| layers_like_a_sweep(manifest, agent).into_iter().chain(keys_without_gru(agent));
    manifest.agents.iter().flat_map(of_agent).collect()
}

/// A hint for `layers = [32, 64, 128]`: widths that increase from the input on are rare in a network and
/// common in a sweep.
fn layers_like_a_sweep(manifest: &Manifest, agent: &DeclaredAgent) -> Option<String> {
    let values = manifest.values(agent, Parameter::Agent("layers"))?;
    let [Value::Wholes(widths)] = values else { return None };
    if widths.len() < 2 || !widths.is_sorted_by(|one, next| one < next) {
        return None;
    }
    let each: Vec<String> = widths.iter().map(|width| format!("[{width}]")).collect();
    Some(format!(
        "`layers = {widths:?}` of agent {} is one network with {} hidden layers; a sweep of networks \
         with one layer each is `layers = [{}]`",
        printable(&agent.name),
        widths.len(),
        each.join(", ")
    ))
}

/// Hints for keys of a GRU in an agent without one: they change the job key and not the result.
fn keys_without_gru(agent: &DeclaredAgent) -> Vec<String> {
    let none = Value::Choice("none");
    if agent.parameters.get("recurrent").is_none_or(|values| values.iter().any(|v| *v != none)) {
        return Vec::new();
    }
    let of_gru = |name: &str| ["units", "layers_before_gru"].contains(&name);
    let declared = agent.parameters.iter().filter(|(key, values)| {
        of_gru(key.name) && values.iter().any(|value| Some(value) != key.default().as_ref())
    });
    let hint = |(key, _): (&'static Key, _)| {
        format!(
            "`{}` of agent {} has no effect without `recurrent = \"gru\"`",
            key.name,
            printable(&agent.name)
        )
    };
    declared.map(hint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::parse;

    /// The hints for an agent with this line.
    fn hints_for(line: &str) -> Vec<String> {
        let text = format!(
            "format = 1\nname = \"t\"\nscenarios = [\"P\"]\nseeds = 1\nenvironment.sigma = 1.0\n\
             [[agent]]\nname = \"a\"\nalgorithm = \"dueling_dqn\"\n{line}\n"
        );
        hints(&parse("t", text.as_bytes()).unwrap())
    }

    #[test]
    fn keys_of_a_gru_have_no_effect_without_one() {
        let hint = "`units` of agent a has no effect without `recurrent = \"gru\"`";
        for line in ["units = 128", "units = [64, 128]"] {
            assert_eq!(hints_for(line), [hint], "{line}");
        }
        let other = hint.replace("units", "layers_before_gru");
        assert_eq!(hints_for("layers = [8, 8]\nlayers_before_gru = 2"), [other]);
        for line in ["units = 64", "batch = 8", "recurrent = [\"none\", \"gru\"]\nunits = 32"] {
            assert!(hints_for(line).is_empty(), "{line}");
        }
    }

    #[test]
    fn widths_that_grow_look_like_a_sweep() {
        let hints = |layers: &str| hints_for(&format!("layers = {layers}"));
        assert_eq!(
            hints("[32, 64]"),
            [
                "`layers = [32, 64]` of agent a is one network with 2 hidden layers; a sweep of networks \
             with one layer each is `layers = [[32], [64]]`"
            ]
        );
        for usual in ["[128, 128]", "[128, 64]", "[64]", "[[32], [64]]", "[[32, 64], [64, 128]]"] {
            assert!(hints(usual).is_empty(), "{usual}");
        }
    }
}
