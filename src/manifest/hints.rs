//! Hints for valid manifests that probably differ from the author's intent.

use super::declared::{DeclaredAgent, Manifest};
use super::printable;
use crate::key::{Parameter, Value};

/// Hints on a valid manifest, as fragments.
pub fn hints(manifest: &Manifest) -> Vec<String> {
    manifest.agents.iter().filter_map(|agent| layers_like_a_sweep(manifest, agent)).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::parse;

    #[test]
    fn widths_that_grow_look_like_a_sweep() {
        let hints = |layers: &str| {
            let text = format!(
                "format = 1\nname = \"t\"\nscenarios = [\"P\"]\nseeds = 1\nenvironment.sigma = 1.0\n\
                 [[agent]]\nname = \"a\"\nalgorithm = \"dueling_dqn\"\nlayers = {layers}\n"
            );
            hints(&parse("t", text.as_bytes()).unwrap())
        };
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
