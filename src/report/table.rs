//! The summary of an experiment as a table.

use crate::analyse::Moments;
use crate::analyse::declared::ArmSummary;
use crate::job::short_beside;
use crate::key::shortened;
use crate::plan::Swept;

/// One line of the summary: the words that identify the arm, then its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct SummaryLine {
    /// Agent, scenario, the headline key of the environment where there is one, and the swept parameters, in the
    /// order of the columns.
    pub arm: Vec<String>,
    /// The number of completed seeds, and of all seeds if some are missing: `6`, `1 of 6`.
    pub seeds: String,
    /// Mean return over the completed seeds, and its standard deviation.
    pub returns: Option<Moments>,
    /// Mean over seeds of the share of test episodes that were terminated.
    pub terminated: Option<Moments>,
}

/// The names of the columns that identify arms, and one line per arm with an ended seed. `swept`
/// holds the further parameters that the experiment sweeps.
pub fn summary_table(arms: &[ArmSummary], swept: &Swept) -> (Vec<String>, Vec<SummaryLine>) {
    let names = swept.names();
    let mut columns: Vec<String> = ["agent", "scenario"].map(str::to_owned).to_vec();
    let headline = arms.iter().find_map(|arm| arm.headline).map(|(key, _)| key);
    columns.extend(headline.map(str::to_owned));
    let columns_beside: Vec<String> = columns.iter().chain(&names).cloned().collect();
    columns.extend(names.iter().map(|name| short_beside(name, &columns_beside).to_owned()));
    let line = |summary: &ArmSummary| {
        let arm = &summary.name;
        let headline = headline.map(|key| {
            let value = summary.headline.filter(|(known, _)| *known == key);
            value.map_or_else(String::new, |(_, value)| value.to_string())
        });
        let mut words = vec![arm.agent.clone(), arm.scenario.clone()];
        words.extend(headline);
        words.extend(names.iter().map(|name| {
            let value = arm.settings.iter().find(|(known, _)| known == name);
            let value = value.filter(|_| swept.is_of(&arm.agent, name));
            value.map_or_else(String::new, |(_, value)| shortened(&value.to_string()))
        }));
        SummaryLine {
            arm: words,
            seeds: match (summary.returns.n(), summary.declared()) {
                (seeds, declared) if seeds == declared => seeds.to_string(),
                (seeds, declared) => format!("{seeds} of {declared}"),
            },
            returns: Moments::of(summary.returns.values()).ok(),
            terminated: Moments::of(summary.terminated.values()).ok(),
        }
    };
    (columns, arms.iter().filter(|arm| arm.has_ended()).map(line).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::Sample;
    use crate::analyse::declared::ArmId;
    use crate::job::Scalar;
    use crate::manifest;

    const MANIFEST: &str = "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nseeds = 3\n\
        environment.sigma = 0.6\n\
        [[agent]]\nname = \"dqn\"\nalgorithm = \"dueling_dqn\"\nbatch = [32, 64]\n\
        [[agent]]\nname = \"reinforce\"\nalgorithm = \"reinforce\"\ngamma = [0.9, 0.8]\n";

    fn arm(agent: &str, settings: &[(&str, f64)], returns: Sample) -> ArmSummary {
        let setting = |(name, value): &(&str, f64)| ((*name).to_owned(), Scalar::Real(*value));
        let settings = settings.iter().map(setting).collect();
        ArmSummary {
            name: ArmId { agent: agent.to_owned(), scenario: "P-H-D".to_owned(), settings },
            returns,
            headline: Some(("sigma", 0.6)),
            ..ArmSummary::default()
        }
    }

    #[test]
    fn swept_parameters_get_columns_and_missing_seeds_are_counted() {
        let swept = Swept::of(&[manifest::parse("t", MANIFEST.as_bytes()).unwrap()]);
        let make_sample = |values: &[f64], failed, open| {
            Sample::new((1..).zip(values.iter().copied()), failed, open).unwrap()
        };
        let both = [("agent.batch", 32.0), ("agent.gamma", 0.9)];
        let (columns, lines) = summary_table(
            &[
                arm("dqn", &both, make_sample(&[96.0, 100.0, 104.0], 0, 0)),
                arm("reinforce", &both[1..], make_sample(&[], 1, 2)),
                arm("reinforce", &both[1..], make_sample(&[], 0, 3)),
            ],
            &swept,
        );
        assert_eq!(columns, ["agent", "scenario", "sigma", "batch", "gamma"]);
        // An agent shows only parameters that it sweeps; an arm without an ended seed has no line.
        assert_eq!(lines.len(), 2);
        assert_eq!(lines[0].arm, ["dqn", "P-H-D", "0.6", "32", ""]);
        assert_eq!(lines[1].arm, ["reinforce", "P-H-D", "0.6", "", "0.9"]);
        assert_eq!((lines[0].seeds.as_str(), lines[1].seeds.as_str()), ("3", "0 of 3"));
        let returns = lines[0].returns.unwrap();
        assert_eq!((returns.mean, returns.sd), (100.0, Ok(4.0)));
        assert_eq!(lines[1].returns, None);
    }
}
