//! The summary of an experiment as a table.

use crate::analyse::{ArmSummary, Means};

/// One line of the summary: the words that tell the arm, then its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Agent, scenario, sigma and the swept parameters, in the order of the columns.
    pub arm: Vec<String>,
    /// Seeds completed, and of how many if some are missing: `6`, `1 of 6`.
    pub seeds: String,
    /// Means over the seeds completed; `None` if there are none.
    pub means: Option<Means>,
}

/// The names of the columns that tell the arms, and a line an arm.
pub fn summary_table(arms: &[ArmSummary]) -> (Vec<String>, Vec<Line>) {
    let mut swept: Vec<&str> = Vec::new();
    for (name, _) in arms.iter().flat_map(|summary| &summary.arm.swept) {
        if !swept.contains(&name.as_str()) {
            swept.push(name);
        }
    }
    let mut columns: Vec<String> = ["agent", "scenario", "sigma"].map(str::to_owned).to_vec();
    columns.extend(swept.iter().map(|name| name.rsplit('.').next().unwrap_or(name).to_owned()));
    let line = |summary: &ArmSummary| {
        let arm = &summary.arm;
        let mut words = vec![arm.agent.clone(), arm.scenario.clone(), arm.sigma.to_string()];
        words.extend(swept.iter().map(|name| {
            let value = arm.swept.iter().find(|(known, _)| known == name);
            value.map_or_else(String::new, |(_, value)| value.clone())
        }));
        Line {
            arm: words,
            seeds: match (summary.seeds, summary.declared) {
                (seeds, declared) if seeds == declared => seeds.to_string(),
                (seeds, declared) => format!("{seeds} of {declared}"),
            },
            means: summary.means,
        }
    };
    (columns, arms.iter().map(line).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::Arm;

    #[test]
    fn swept_parameters_get_columns_and_missing_seeds_are_told() {
        let arm = |swept: &[(&str, &str)]| ArmSummary {
            arm: Arm {
                agent: "dqn".to_owned(),
                scenario: "P-H-D".to_owned(),
                sigma: 0.6,
                swept: swept.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned())).collect(),
            },
            declared: 3,
            seeds: if swept[0].0 == "agent.batch" { 3 } else { 0 },
            means: None,
        };
        let (columns, lines) =
            summary_table(&[arm(&[("agent.batch", "32")]), arm(&[("environment.delta_d", "0.1")])]);
        assert_eq!(columns, ["agent", "scenario", "sigma", "batch", "delta_d"]);
        assert_eq!(lines[0].arm, ["dqn", "P-H-D", "0.6", "32", ""]);
        assert_eq!(lines[1].arm, ["dqn", "P-H-D", "0.6", "", "0.1"]);
        assert_eq!((lines[0].seeds.as_str(), lines[1].seeds.as_str()), ("3", "0 of 3"));
    }
}
