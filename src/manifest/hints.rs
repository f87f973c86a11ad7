//! Hints for valid manifests that probably differ from the author's intent.

use super::declared::{DeclaredAgent, Manifest};
use super::printable;
use crate::key::{Key, Parameter, Value};

/// Hints on a valid manifest, as fragments.
pub fn hints(manifest: &Manifest) -> Vec<String> {
    let of_agent = |agent| {
        let layers = layers_like_a_sweep(manifest, agent);
        layers.into_iter().chain(keys_without_gru(agent)).chain(minibatch_of_one_step(agent))
    };
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

/// A hint for minibatches of one step whose advantage is normalised: it becomes 0, and the policy does not
/// learn from it.
fn minibatch_of_one_step(agent: &DeclaredAgent) -> Option<String> {
    let values = |key| agent.parameters.get(key).unwrap_or_default();
    let wholes = |key| {
        values(key).iter().filter_map(|v| if let Value::Integer(n) = v { Some(*n) } else { None })
    };
    if !values("norm_adv").contains(&Value::Flag(true)) {
        return None;
    }
    // A recurrent network learns from whole lanes.
    let is_recurrent = |word: &Value| *word == Value::Choice("gru");
    let cells = values("recurrent").iter().map(is_recurrent).flat_map(|by_lane| {
        wholes("lanes").flat_map(move |lanes| {
            wholes("steps").flat_map(move |steps| {
                wholes("minibatches").map(move |parts| (by_lane, lanes, steps, parts))
            })
        })
    });
    let is_one_step = |(by_lane, lanes, steps, parts): &(bool, u64, u64, u64)| match by_lane {
        true => *steps == 1 && lanes / parts == 1,
        false => lanes.saturating_mul(*steps) / parts == 1,
    };
    let (_, lanes, steps, parts) = cells.into_iter().find(is_one_step)?;
    Some(format!(
        "`minibatches = {parts}` of agent {} leaves minibatches of one step (`lanes = {lanes}` times \
         `steps = {steps}`), whose advantage `norm_adv` makes 0: the policy does not learn from them",
        printable(&agent.name)
    ))
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
    fn a_normalised_minibatch_of_one_step_teaches_nothing() {
        let hints = |lines: &str| {
            let text = format!(
                "format = 1\nname = \"t\"\nscenarios = [\"P\"]\nseeds = 1\nenvironment.sigma = 1.0\n\
                 [[agent]]\nname = \"a\"\nalgorithm = \"ppo\"\n{lines}\n"
            );
            super::hints(&parse("t", text.as_bytes()).unwrap())
        };
        let few = "lanes = 4\nsteps = 10\n";
        for (lines, lanes, steps, parts) in [
            (format!("{few}minibatches = 40"), 4, 10, 40),
            // Of 30 minibatches, twenty have one step.
            (format!("{few}minibatches = [2, 30]"), 4, 10, 30),
            ("lanes = 1\nsteps = 1\nminibatches = 1".to_owned(), 1, 1, 1),
            ("lanes = 4\nsteps = 1\nminibatches = 4\nrecurrent = \"gru\"".to_owned(), 4, 1, 4),
        ] {
            let hint = format!(
                "`minibatches = {parts}` of agent a leaves minibatches of one step (`lanes = {lanes}` \
                 times `steps = {steps}`), whose advantage `norm_adv` makes 0: the policy does not learn \
                 from them"
            );
            assert_eq!(hints(&lines), [hint], "{lines}");
        }
        for usual in [
            "",
            "lanes = 4\nsteps = 10\nminibatches = 20",
            "lanes = 4\nsteps = 10\nminibatches = 40\nnorm_adv = false",
            "lanes = 4\nsteps = 10\nminibatches = 4\nrecurrent = \"gru\"",
        ] {
            assert!(hints(usual).is_empty(), "{usual}");
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
