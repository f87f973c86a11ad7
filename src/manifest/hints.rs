//! Hints for valid manifests that probably differ from the author's intent.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};
use std::{env, fs};

use crate::agent::{UNAVAILABLE, longest_episode};
use crate::job::Condition;
use crate::key::printable;
use crate::key::{Constraint, Key, Parameter, SectionName, Value, Violation};
use crate::manifest::analysis::declared::Analysis;
use crate::manifest::analysis::kind::{AnalysisKind, DidItLearn, LearningCurve};
use crate::manifest::commas::decimal_commas;
use crate::manifest::data;
use crate::manifest::declared::{DeclaredAgent, Manifest};
use crate::manifest::estimate::declared::DeclaredEstimate;
use crate::manifest::grid::Grid;
use crate::manifest::parameter::Parameters;
use crate::manifest::text::written::share;
use crate::text::Fault;

/// Standard deviation of the context feature above which the feature says next to nothing.
const LARGE_SIGMA: f64 = 10.0;

/// Number of rollouts below which PPO has hardly begun to learn.
const FEW_ROLLOUTS: u64 = 50;

/// Hints on a valid manifest, as fragments.
pub fn hints(manifest: &Manifest) -> Vec<String> {
    let mut hints: Vec<String> = large_sigma(manifest).into_iter().collect();
    for (index, agent) in manifest.agents.iter().enumerate() {
        hints.extend(layers_like_a_sweep(manifest, agent));
        hints.extend(keys_without_effect(manifest, agent));
        hints.extend(minibatch_of_one_step(agent));
        hints.extend(few_rollouts(manifest, index));
        let of = format!("agent {}", printable(&agent.name));
        hints.extend(missing_programs(manifest, &of, &agent.parameters));
    }
    hints.extend(poolings_without_effect(manifest));
    hints.extend(missing_programs(
        manifest,
        "the environment",
        &manifest.sections[SectionName::Environment],
    ));
    hints.extend(manifest.analyses.iter().flat_map(|one| long_windows(manifest, one)));
    hints.extend(manifest.analyses.iter().filter_map(|one| few_references(manifest, one)));
    hints.extend(manifest.estimates.iter().flat_map(|one| certain_choices(manifest, one)));
    hints.extend(data::notes(manifest));
    let lists = decimal_commas(&manifest.source);
    let hint = |list: &Fault| {
        let remedy = list.hint().unwrap_or_default();
        format!("a comma between digits separates two values; if it is a decimal comma, {remedy}")
    };
    hints.extend(lists.iter().map(hint));
    hints
}

/// A hint for a feature noise that is probably a percentage.
fn large_sigma(manifest: &Manifest) -> Option<String> {
    let values = manifest.sections[SectionName::Environment].get("sigma")?;
    let large = values.iter().find_map(|value| match value {
        Value::Real(sigma) if *sigma >= LARGE_SIGMA => Some(*sigma),
        _ => None,
    })?;
    Some(format!(
        "`environment.sigma` = {large} is {large} times the difference between the two contexts, so the \
         feature says next to nothing; {large} % is written {}",
        share(large)
    ))
}

/// Hints for groups of everybody, and for posteriors that are recorded of nobody.
fn poolings_without_effect(manifest: &Manifest) -> Vec<String> {
    let people = manifest.sections[SectionName::Trial].get("people").unwrap_or_default();
    let fewest = people.iter().min_by(by_size);
    let mut hints = Vec::new();
    let of_everybody = |value: &Value| matches!((value, fewest), (Value::Integer(size), Some(Value::Integer(fewest))) if size >= fewest);
    if is_pooled(manifest, of_everybody) {
        hints.push(
            "a group of `pooling` in [trial] that has everybody is `pooling = \"full\"`".to_owned(),
        );
    }
    let recorded = manifest.sections[SectionName::Evaluation].get("record_posteriors");
    let shares = |value: &Value| matches!(value, Value::Choice("full" | "partial"));
    if recorded.is_some_and(|values| values.contains(&Value::Flag(true)))
        && is_pooled(manifest, |_| true)
        && !is_pooled(manifest, shares)
    {
        hints.push(
            "`record_posteriors` has no effect with an agent for each person or group: it needs \
             `pooling = \"full\"` or `\"partial\"`"
                .to_owned(),
        );
    }
    hints
}

/// A hint for trials without an effect that are too few to judge others.
fn few_references(manifest: &Manifest, analysis: &Analysis) -> Option<String> {
    let AnalysisKind::DidItLearn(kind) = &analysis.kind else { return None };
    let is_swept = |index| {
        let grid = Grid::of(manifest, index);
        kind.without.iter().any(|condition| grid.is_swept(condition.parameter))
    };
    // Otherwise another manifest has the other side.
    let has_both = (0..manifest.agents.len()).any(is_swept);
    let (seeds, least) = (manifest.seeds().count(), DidItLearn::FEWEST);
    (has_both && seeds <= least).then(|| {
        format!(
            "analysis {} judges a trial by {} without the effect, the twin of its seed left out, and a p-value of 0.05 needs \
             {least}; write seeds = {} or more",
            printable(&analysis.name),
            seeds - 1,
            least + 1
        )
    })
}

/// Hints for agents that may choose with probability 0 or 1, which leaves an effect undefined.
fn certain_choices(manifest: &Manifest, estimate: &DeclaredEstimate) -> Vec<String> {
    let has_estimate = |agent: &&DeclaredAgent| {
        let chosen = estimate.agents.as_ref();
        chosen.is_none_or(|chosen| chosen.contains(&agent.name))
    };
    let may_be_certain = |agent: &&DeclaredAgent| {
        let are_all = |key: &str, is: fn(&Value) -> bool| {
            agent.parameters.get(key).is_some_and(|values| values.iter().all(is))
        };
        let is_positive: fn(&Value) -> bool = |value| matches!(value, Value::Real(of) if *of > 0.0);
        agent.parameters.get("pi_min").is_some()
            && !are_all("pi_min", is_positive)
            && !are_all("smoothing", is_positive)
            && !are_all("allocation", |value| matches!(value, Value::Choice("logistic")))
    };
    let agents = manifest.agents.iter().filter(has_estimate).filter(may_be_certain);
    let hint = |agent: &DeclaredAgent| {
        format!(
            "the estimate {} fails in trials where agent {} chooses with probability 0 or 1; a `pi_min` above 0 \
             prevents that",
            printable(&estimate.declaration.name),
            printable(&agent.name)
        )
    };
    agents.map(hint).collect()
}

/// Hints for agents whose training is shorter than the window of a learning curve.
fn long_windows(manifest: &Manifest, analysis: &Analysis) -> Vec<String> {
    let AnalysisKind::LearningCurve(LearningCurve { window }) = analysis.kind else {
        return Vec::new();
    };
    let strides =
        manifest.sections[SectionName::Evaluation].get("curve_stride").unwrap_or_default();
    if let Some(Value::Integer(stride)) = strides.iter().max_by(by_size)
        && *stride > u64::from(window)
    {
        return vec![format!(
            "`window` = {window} of analysis {} is shorter than `curve_stride` = {stride}, so its means are over \
             {stride} episodes",
            printable(&analysis.name)
        )];
    }
    let is_analysed = |agent: &&DeclaredAgent| {
        let names = |condition: &Condition| {
            condition.parameter != Parameter::AGENT_NAME
                || condition.values.contains(&agent.names[0])
        };
        analysis.conditions.iter().all(names)
    };
    let short = manifest.agents.iter().filter(is_analysed).filter_map(|agent| {
        let values = agent.parameters.get("episodes")?;
        let most = values.iter().max_by(by_size)?;
        let Value::Integer(most) = most else { return None };
        (*most < u64::from(window)).then(|| {
            format!(
                "`window` = {window} of analysis {} is longer than the training of agent {} (`episodes` = \
                 {most}), whose lines stay empty",
                printable(&analysis.name),
                printable(&agent.name),
            )
        })
    });
    short.collect()
}

/// A hint for a budget of PPO that ends after a few rollouts.
fn few_rollouts(manifest: &Manifest, index: usize) -> Option<String> {
    const EPISODES: Parameter = Parameter::Agent("episodes");
    const HORIZON: Parameter = Parameter::Environment("horizon");
    const UNPAID_LAST_STEP: Parameter = Parameter::Environment("unpaid_last_step");
    const LANES: Parameter = Parameter::Agent("lanes");
    const STEPS: Parameter = Parameter::Agent("steps");
    const FEW: Constraint = Constraint {
        parameters: &[EPISODES, HORIZON, UNPAID_LAST_STEP, LANES, STEPS],
        violation: |of| {
            let steps = of.whole(EPISODES).saturating_mul(longest_episode(of));
            let rollouts = steps.div_ceil(of.whole(LANES).saturating_mul(of.whole(STEPS)));
            let noun = if rollouts == 1 { "rollout" } else { "rollouts" };
            (rollouts < FEW_ROLLOUTS).then(|| {
                Violation::Contradiction(format!(
                    "learns from at most {rollouts} {noun}: `episodes` = {} of at most {} steps make {} \
                     steps, and a rollout takes {} (`lanes` times `steps`); raise `episodes`, or lower \
                     `lanes` or `steps`",
                    of.whole(EPISODES),
                    longest_episode(of),
                    steps,
                    of.whole(LANES).saturating_mul(of.whole(STEPS)),
                ))
            })
        },
    };
    let agent = &manifest.agents[index];
    // How long the episodes of a program can be is not known yet.
    if agent.algorithm.name() != "ppo" || manifest.family().is_external() {
        return None;
    }
    match Grid::of(manifest, index).violation(&FEW)?.1 {
        Violation::Contradiction(says) => Some(format!("agent {} {says}", printable(&agent.name))),
        _ => None,
    }
}

/// Hints for outside programs that this machine does not have.
fn missing_programs(manifest: &Manifest, of: &str, parameters: &Parameters) -> Vec<String> {
    let commands = parameters.iter().find(|(key, _)| key.name == "command");
    let commands = commands.map_or(&[][..], |(_, values)| values);
    let folder = Path::new(&manifest.path).parent().unwrap_or(Path::new(""));
    let hint = |value: &Value| {
        let Value::Words(words) = value else { return None };
        let (program, arguments) = words.split_first()?;
        let (program, reason) = match why_missing(program, folder) {
            Some(reason) => (program, reason),
            None => (arguments.iter().find(|word| is_missing_script(word, folder))?, NOT_THERE),
        };
        let program = printable(program);
        Some(format!("`command` of {of} cannot start on this machine: {program} {reason}"))
    };
    commands.iter().filter_map(hint).collect()
}

const NOT_THERE: &str = "does not exist; the path is relative to the folder of the manifest";

/// Whether an argument of an interpreter is the name of a script that does not exist.
fn is_missing_script(word: &str, folder: &Path) -> bool {
    const SCRIPTS: [&str; 8] = ["py", "R", "r", "jl", "sh", "js", "pl", "awk"];
    let path = Path::new(word);
    let is_script = path.extension().is_some_and(|form| SCRIPTS.iter().any(|known| form == *known));
    is_script && !word.starts_with('-') && !folder.join(path).exists()
}

/// Why a program cannot be started; `None` if it can. A path starts from the folder of the manifest.
fn why_missing(program: &str, folder: &Path) -> Option<&'static str> {
    if program.contains('/') {
        return match fs::metadata(folder.join(program)) {
            Err(_) => Some(NOT_THERE),
            Ok(kind) if !kind.is_file() => Some("is not a file"),
            Ok(kind) if !is_executable(&kind) => Some("is not executable"),
            Ok(_) => None,
        };
    }
    let path = env::var_os("PATH").unwrap_or_default();
    let is_here = |folder: PathBuf| {
        fs::metadata(folder.join(program)).is_ok_and(|kind| kind.is_file() && is_executable(&kind))
    };
    let is_found = env::split_paths(&path).any(is_here);
    (!is_found).then_some("is in no folder of the PATH")
}

fn is_executable(file: &fs::Metadata) -> bool {
    std::os::unix::fs::PermissionsExt::mode(&file.permissions()) & 0o111 != 0
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

/// A key that has an effect under a condition only; at other values it changes the job key and not the
/// result.
struct Conditional {
    key: &'static str,
    has_effect: fn(&Manifest, &DeclaredAgent) -> bool,
    /// What follows "has no effect".
    says: &'static str,
}

const CONDITIONAL: &[Conditional] = &[
    Conditional { key: "units", has_effect: has_gru, says: "without `recurrent = \"gru\"`" },
    Conditional {
        key: "layers_before_gru",
        has_effect: has_gru,
        says: "without `recurrent = \"gru\"`",
    },
    Conditional {
        key: "sequence",
        has_effect: |manifest, agent| {
            let values =
                |key| manifest.sections[SectionName::Environment].get(key).unwrap_or_default();
            let longest = values("horizon").iter().max_by(by_size);
            let has_more = values("unpaid_last_step").contains(&Value::Flag(true));
            let is_shorter = |value: &Value| {
                longest.is_none_or(|most| match by_size(&value, &most) {
                    Ordering::Equal => has_more,
                    order => order.is_lt(),
                })
            };
            any(agent, "sequence", |value| *value != Value::Integer(0) && is_shorter(value))
        },
        says: "if no episode is longer",
    },
    Conditional {
        key: "probability_draws",
        has_effect: |_, agent| {
            let draws = any(agent, "action_centring", |value| *value == Value::Flag(true))
                || any(agent, "smoothing", |value| *value != Value::Real(0.0));
            draws && any(agent, "draw", |value| *value == Value::Choice("step"))
        },
        says: "without `action_centring` or `smoothing`, and with `draw = \"episode\"`",
    },
    Conditional {
        key: UNAVAILABLE,
        has_effect: |manifest, agent| {
            let index = manifest.agents.iter().position(|other| other.name == agent.name);
            let grid = Grid::of(manifest, index.expect("the agent is declared"));
            grid.environments().any(|environment| environment.can_withhold())
        },
        says: "where a message can be sent at every step",
    },
    Conditional {
        key: "person_sd",
        has_effect: |manifest, _| is_pooled(manifest, |value| *value == Value::Choice("partial")),
        says: "without `pooling = \"partial\"` in [trial]",
    },
    Conditional { key: "first_update", has_effect: updates, says: UPDATES },
    Conditional { key: "update_interval", has_effect: updates, says: UPDATES },
];

const UPDATES: &str = "with `update = \"once\"` or `posterior = \"reset\"`";

/// Whether a trial has such a pooling.
fn is_pooled(manifest: &Manifest, is_met: impl Fn(&Value) -> bool) -> bool {
    manifest.sections[SectionName::Trial].get("pooling").unwrap_or_default().iter().any(is_met)
}

/// Whether any value of a key meets a condition.
fn any(agent: &DeclaredAgent, key: &str, is_met: impl Fn(&Value) -> bool) -> bool {
    let values = agent.parameters.get(key).unwrap_or_default();
    values.iter().any(is_met)
}

fn has_gru(_: &Manifest, agent: &DeclaredAgent) -> bool {
    any(agent, "recurrent", |value| *value != Value::Choice("none"))
}

fn updates(_: &Manifest, agent: &DeclaredAgent) -> bool {
    // The key of the same name of other algorithms does not depend on `update`.
    agent.parameters.get("update").is_none()
        || any(agent, "update", |value| *value != Value::Choice("once"))
            && any(agent, "posterior", |value| *value != Value::Choice("reset"))
}

/// The order of whole numbers.
fn by_size(one: &&Value, other: &&Value) -> Ordering {
    let whole = |value: &Value| if let Value::Integer(whole) = value { *whole } else { 0 };
    whole(one).cmp(&whole(other))
}

/// Hints for keys that no job of an agent reads.
fn keys_without_effect(manifest: &Manifest, agent: &DeclaredAgent) -> Vec<String> {
    let idle = CONDITIONAL.iter().filter_map(|conditional| {
        let is_key = |(key, _): &(&'static Key, &[Value])| key.name == conditional.key;
        let (key, values) = agent.parameters.iter().find(is_key)?;
        let is_set = values.iter().any(|value| Some(value) != key.default().as_ref());
        (is_set && !(conditional.has_effect)(manifest, agent)).then(|| {
            format!(
                "`{}` of agent {} has no effect {}",
                key.name,
                printable(&agent.name),
                conditional.says
            )
        })
    });
    idle.collect()
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
    fn poolings_that_change_nothing_are_named() {
        let hints_for = |trial: &str, agent: &str| {
            let text = format!(
                "format = 1\nname = \"t\"\nscenarios = [\"P\"]\nseeds = 1\nenvironment.sigma = 1.0\n\
                 trial = {{ people = 6, days = 25, decisions_per_day = 2{trial} }}\n[evaluation]\non = \"trial\"\n\
                 record_posteriors = true\n[[agent]]\nname = \"a\"\nalgorithm = \"linear_thompson\"\n{agent}\n"
            );
            hints(&parse("t", text.as_bytes()).unwrap())
        };
        for (trial, agent, says) in [
            (
                "",
                "person_sd = 1",
                Some("`person_sd` of agent a has no effect without `pooling = \"partial\"`"),
            ),
            (", pooling = \"partial\"", "person_sd = 1", None),
            (", pooling = \"none\"", "", Some("`record_posteriors` has no effect")),
            (", pooling = [3, \"full\"]", "", None),
            (", pooling = [6, \"full\"]", "", Some("is `pooling = \"full\"`")),
        ] {
            let found = hints_for(trial, agent);
            assert_eq!(found.len(), usize::from(says.is_some()), "{trial} {agent}: {found:?}");
            assert!(says.is_none_or(|says| found[0].contains(says)), "{found:?}");
        }
    }

    #[test]
    fn what_an_agent_does_without_messages_has_no_effect_where_all_can_be_sent() {
        let agent = "algorithm = \"dueling_dqn\"\nunavailable = \"chosen\"";
        let hint =
            "`unavailable` of agent a has no effect where a message can be sent at every step";
        for environment in ["sigma = 0.4", "sigma = 0.4\nmessage_budget = 50"] {
            assert_eq!(hints_of(environment, agent), [hint], "{environment}");
        }
        for environment in ["availability = [1.0, 0.5]", "message_budget = 49"] {
            let environment = format!("sigma = 0.4\n{environment}");
            assert!(hints_of(&environment, agent).is_empty(), "{environment}");
        }
    }

    fn hints_of(environment: &str, agent: &str) -> Vec<String> {
        let text = format!(
            "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nseeds = 1\n[environment]\n{environment}\n\
             [[agent]]\nname = \"a\"\n{agent}\n"
        );
        hints(&parse("t", text.as_bytes()).unwrap())
    }

    #[test]
    fn an_estimate_needs_an_agent_that_randomises_every_choice() {
        let found = |keys: &str| {
            let keys =
                format!("algorithm = \"linear_thompson\"\n{keys}\n[[estimate]]\nname = \"effect\"");
            hints_of("sigma = 0.4", &keys)
        };
        let hint = "the estimate effect fails in trials where agent a chooses with probability 0 or 1; a `pi_min` \
                    above 0 prevents that";
        assert_eq!(found(""), [hint]);
        assert_eq!(found("pi_min = [0.1, 0.0]"), [hint]);
        assert_eq!(found("pi_min = 0.1"), [""; 0]);
        assert_eq!(found("smoothing = 0.1"), [""; 0]);
        assert_eq!(
            found("pi_min = 0.0\n[[agent]]\nname = \"b\"\nalgorithm = \"rule\"\nrule = \"random\""),
            [hint]
        );
        let rule = "algorithm = \"rule\"\nrule = \"random\"\n[[estimate]]\nname = \"effect\"";
        assert_eq!(hints_of("sigma = 0.4", rule), [""; 0]);
    }

    #[test]
    fn keys_that_no_job_reads_have_no_effect() {
        let bandit = |keys: &str| {
            hints_of(
                "sigma = 0.4",
                &format!("algorithm = \"linear_thompson\"\nwarm_up = 5\n{keys}"),
            )
        };
        for (keys, key) in [
            ("probability_draws = 500", "probability_draws"),
            ("probability_draws = 500\nsmoothing = 0.1\ndraw = \"episode\"", "probability_draws"),
            ("first_update = 3\nupdate = \"once\"", "first_update"),
            ("update_interval = 3\nupdate = \"once\"", "update_interval"),
            ("first_update = [3, 4]\nposterior = \"reset\"", "first_update"),
        ] {
            let hints = bandit(keys);
            assert_eq!(hints.len(), 1, "{keys}: {hints:?}");
            assert!(
                hints[0].starts_with(&format!("`{key}` of agent a has no effect")),
                "{hints:?}"
            );
        }
        for keys in [
            "probability_draws = 500\nsmoothing = 0.1",
            "probability_draws = 500\naction_centring = true\npi_min = 0.1",
            "first_update = 3\nupdate = [\"once\", \"episode\"]",
            "",
        ] {
            assert!(bandit(keys).is_empty(), "{keys}: {:?}", bandit(keys));
        }
        let other = hints_of("sigma = 0.4", "algorithm = \"dueling_dqn\"\nupdate_interval = 4");
        assert!(other.is_empty(), "{other:?}");
        let dqn = "algorithm = \"dueling_dqn\"\nrecurrent = \"gru\"\nsequence =";
        let long = hints_of("sigma = 0.4\nhorizon = 20", &format!("{dqn} 20"));
        assert_eq!(long, ["`sequence` of agent a has no effect if no episode is longer"]);
        for shorter in ["19", "0", "[10, 30]"] {
            let hints = hints_of("sigma = 0.4\nhorizon = 20", &format!("{dqn} {shorter}"));
            assert!(hints.is_empty(), "{shorter}: {hints:?}");
        }
    }

    #[test]
    fn a_budget_of_a_few_rollouts_hardly_trains_ppo() {
        let ppo = |keys: &str| hints_of("sigma = 0.4", &format!("algorithm = \"ppo\"\n{keys}"));
        // 700 episodes of 50 steps in rollouts of 16 lanes and 50 steps: 43.75.
        let [hint] = &ppo("episodes = 700")[..] else { panic!() };
        assert!(
            hint.starts_with("agent a learns from at most 44 rollouts: `episodes` = 700 of"),
            "{hint}"
        );
        assert!(ppo("episodes = 800").is_empty());
        assert_eq!(ppo("episodes = 800\nlanes = [16, 32]").len(), 1);
    }

    #[test]
    fn a_window_longer_than_the_training_leaves_a_line_empty() {
        let hints = |episodes: &str, analysis: &str| {
            let agent = format!("algorithm = \"reinforce\"\nepisodes = {episodes}\n{analysis}");
            hints_of("sigma = 0.4", &agent)
        };
        let curve = "[[analysis]]\nname = \"c\"\nkind = \"learning_curve\"\nwindow = 500";
        let [hint] = &hints("[20, 499]", curve)[..] else { panic!() };
        let longer = "`window` = 500 of analysis c is longer than the training of agent a \
                      (`episodes` = 499), whose lines stay empty";
        assert_eq!(hint, longer);
        assert!(hints("[20, 500]", curve).is_empty());
        assert!(hints("20", "").is_empty());
    }

    #[test]
    fn a_comma_between_digits_may_be_a_decimal_comma() {
        let rule = "algorithm = \"rule\"\nrule = \"random\"";
        let [hint] = &hints_of("sigma = [40,5, 6]", rule)[1..] else { panic!() };
        assert!(hint.ends_with("if it is a decimal comma, write sigma = [40.5, 6]"), "{hint}");
        for plain in
            ["sigma = [0,5]", "sigma = [1, 2, 3]", "sigma = [0,1,2]", "sigma = [0.1,0.2, 0.3]"]
        {
            assert!(hints_of(plain, rule).is_empty(), "{plain}");
        }
    }

    #[test]
    fn a_percentage_is_a_large_sigma() {
        let rule = "algorithm = \"rule\"\nrule = \"random\"";
        let [hint] = &hints_of("sigma = [40, 80]", rule)[..] else { panic!() };
        assert!(hint.starts_with("`environment.sigma` = 40 is 40 times"), "{hint}");
        assert!(hint.ends_with("40 % is written 0.4"), "{hint}");
        assert!(hints_of("sigma = [0.4, 5]", rule).is_empty());
    }

    #[test]
    fn outside_programs_that_this_machine_lacks_are_named() {
        let outside = |command: &str| {
            hints_of(
                "sigma = 0.4",
                &format!("algorithm = \"external\"\nversion = \"1\"\ncommand = {command}"),
            )
        };
        for (command, reason) in [
            ("[\"no-such-program\"]", "no-such-program is in no folder of the PATH"),
            ("[\"./no-such-program\", \"x\"]", "./no-such-program does not exist"),
            ("[\"/tmp\"]", "/tmp is not a file"),
            ("[\"sh\", \"-e\", \"x.sh\"]", "x.sh does not exist"),
        ] {
            let [hint] = &outside(command)[..] else { panic!("{command}") };
            assert!(hint.contains(reason), "{hint}");
        }
        assert!(outside("[\"sh\", \"-c\", \"exit\"]").is_empty());
        assert!(outside("[\"/bin/sh\"]").is_empty());
        assert_eq!(outside("[[\"sh\"], [\"no-such-program\"]]").len(), 1);
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
