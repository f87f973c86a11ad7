//! The description of a policy: `policy.json`.

use serde_json::{Value as Json, json};

use crate::agent::{
    Activation, Architecture, BanditAllocation, Choice, GruNames, LinearThompson, Weights,
};
use crate::env::{Meaning, ObservationSpec};
use crate::job::Job;
use crate::key::digest;
use crate::store::StoredWeights;

/// The version of the description's form.
const FORMAT: u32 = 1;

/// The entries of the observations of a job, in their order.
pub fn describe_observations(job: &Job) -> Vec<Json> {
    let ObservationSpec { features, one_hot } = job.task().observations();
    let present = job.environment.meanings(&job.scenario);
    // With a history, the features repeat for each of its observations, the oldest first.
    let earlier = (0..features.len() / present.len()).rev();
    let meanings = earlier.flat_map(|back| {
        present.iter().map(move |one| {
            let meaning = match back {
                0 => one.meaning.clone(),
                1 => format!("{}, one step ago", one.meaning),
                _ => format!("{}, {back} steps ago", one.meaning),
            };
            Meaning { meaning, ..one.clone() }
        })
    });
    // JSON has no infinity: an infinite bound becomes `null`.
    let bound = |bound: f32| bound.is_finite().then_some(bound);
    let features = features.iter().zip(meanings).map(|(spec, of)| {
        let Meaning { meaning, unit, scale } = of;
        json!({
            "name": spec.name, "meaning": meaning, "unit": unit, "scale": scale,
            "low": bound(spec.low), "high": bound(spec.high),
        })
    });
    let clock = job.environment.clock();
    let times = (0..one_hot).map(|time| {
        json!({
            "name": format!("t{time}"), "meaning": format!("{clock} is {time}"),
            "unit": "0 or 1", "scale": 1.0, "low": 0.0, "high": 1.0,
        })
    });
    features.chain(times).collect()
}

/// The bits of each number that an agent observes: 64 for bandits in a trial whose simulation shows its full precision.
fn observation_bits(job: &Job) -> u32 {
    let is_bandit = job.agent.parameters::<LinearThompson>().is_some();
    let is_exact = job.environment.has_exact_features() && job.agent.history() == 1;
    if is_bandit && job.trial.is_some() && is_exact { 64 } else { 32 }
}

/// The description of the job of a policy: all that a rule has.
pub fn describe_job(stored: &StoredWeights) -> Json {
    describe_job_with(stored, json!({}))
}

/// The description of the job of a policy, followed by these entries.
fn describe_job_with(stored: &StoredWeights, others: Json) -> Json {
    let job = &stored.job;
    let versions = job.versions();
    let mut described = json!({
        "format": FORMAT,
        "job_key": stored.job_key.to_string(),
        "seed": job.seed,
        "algorithm": job.algorithm(),
        "scenario": job.scenario.to_string(),
        "versions": {
            "jitai": env!("CARGO_PKG_VERSION"),
            "environment": versions.environment,
            "algorithm": versions.algorithm,
        },
        "job": serde_json::from_str::<Json>(&job.canonical()).unwrap_or_default(),
        "features": describe_observations(job),
        "observation_bits": observation_bits(job),
        "actions": job.environment.actions(),
    });
    if let (Json::Object(all), Json::Object(others)) = (&mut described, others) {
        all.extend(others);
    }
    described
}

/// The description of a bandit with these weights and deviates.
pub(super) fn describe_bandit(stored: &StoredWeights, weights: &Weights, deviates: &[f64]) -> Json {
    let job = &stored.job;
    let of: LinearThompson = job.agent.parameters().unwrap_or_default();
    let actions = job.task().interface().actions;
    let mut bias = of.action_bias.clone();
    bias.resize(actions, 0.0);
    let values = |name: &str| weights.doubles.get(name).map_or(&[][..], |array| &array.values);
    let width = weights.doubles.get("mean").map_or(1, |mean| mean.shape[1]);
    let rows = |name: &str| values(name).chunks_exact(width).collect::<Vec<_>>();
    let precisions = rows("precision");
    let mut choice = match of.allocation {
        BanditAllocation::Thompson => json!({ "rule": "thompson", "smoothing": of.smoothing }),
        BanditAllocation::Clipped => json!({ "rule": "clipped" }),
        BanditAllocation::Logistic => json!({
            "rule": "logistic", "lower": of.logistic_lower, "upper": of.logistic_upper,
            "slope": of.logistic_slope, "odds": of.logistic_odds,
        }),
    };
    choice["bias"] = json!(bias);
    choice["pi_min"] = json!(of.pi_min);
    choice["deviates"] = json!(deviates.chunks_exact(actions).collect::<Vec<_>>());
    let mut posterior = json!({
        "features": of.features.word(),
        "action_centring": of.action_centring,
        "one_hot": job.task().observations().one_hot,
        "mean": rows("mean"),
        "precision": precisions.chunks_exact(width).collect::<Vec<_>>(),
    });
    // With partial pooling, the posterior is that of a person of whom nothing is known.
    if weights.doubles.contains_key("person_sd") {
        let (means, regressions) = (rows("person_mean"), rows("mean").len().max(1));
        posterior["person_sd"] = json!(rows("person_sd"));
        posterior["person_mean"] = json!(means.chunks_exact(regressions).collect::<Vec<_>>());
    }
    describe_job_with(stored, json!({ "posterior": posterior, "choice": choice }))
}

/// The description of a policy, which refers to its other files, the weights and the graph.
pub(super) fn describe(
    stored: &StoredWeights,
    (architecture, choice): (&Architecture, Choice),
    [weights, onnx]: [&[u8]; 2],
) -> Json {
    let stacks: Vec<Json> = architecture
        .stacks
        .iter()
        .map(|stack| {
            let mut named = json!({ "hidden": stack.hidden, "heads": stack.heads });
            if let Some(GruNames { before, input, state }) = &stack.gru {
                named["gru"] = json!({ "before": before, "input": input, "state": state });
            }
            named
        })
        .collect();
    let activation = match architecture.activation {
        Activation::Relu => "relu",
        Activation::Tanh => "tanh",
    };
    let (output, choice) = match choice {
        Choice::EpsilonGreedy { epsilon } => {
            ("dueling", json!({ "rule": "epsilon_greedy", "epsilon": epsilon }))
        }
        Choice::Softmax => ("logits", json!({ "rule": "softmax" })),
    };
    describe_job_with(
        stored,
        json!({
            "network": { "activation": activation, "stacks": stacks, "output": output },
            "choice": choice,
            "files": {
                "weights": { "name": "weights.safetensors", "sha256": digest(weights) },
                "onnx": { "name": "policy.onnx", "sha256": digest(onnx) },
            },
        }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::parse;
    use crate::plan;

    #[test]
    fn every_entry_of_a_history_says_how_old_it_is() {
        let text = "format = 1\nname = \"t\"\nscenarios = [\"P-M-S\"]\nseeds = 1\n\
            environment.sigma = 0.4\nenvironment.time_one_hot = true\n\
            [[agent]]\nname = \"a\"\nalgorithm = \"ppo\"\nhistory = 3\n";
        let manifest = parse("t", text.as_bytes()).unwrap();
        let job = plan::jobs(&manifest).next().unwrap().job;
        let described = describe_observations(&job);
        for (name, meaning) in [
            ("P-2", "inferred probability of context 0, 2 steps ago"),
            ("M0-2", "whether the previous action was nothing, 2 steps ago"),
            (
                "M3-1",
                "whether the previous action was a message tailored to context 1, one step ago",
            ),
            ("S-1", "steps walked in the previous step, one step ago"),
            ("M1", "whether the previous action was a message that is not tailored"),
            ("S", "steps walked in the previous step"),
            ("t49", "clock (lagged) is 49"),
        ] {
            let mut entries = described.iter().filter(|entry| entry["name"] == name);
            assert_eq!(entries.next().unwrap()["meaning"], meaning);
            assert!(entries.next().is_none(), "{name}");
        }
        assert_eq!(described.len(), 3 * 6 + 50);
    }
}
