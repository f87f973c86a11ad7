//! The summary of an experiment as a table.

use crate::analyse::ArmSummary;

/// One line of the summary: the words that tell the arm, then its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Agent, scenario, sigma and the swept parameters, in the order of the columns.
    pub arm: Vec<String>,
    /// Seeds completed.
    pub seeds: usize,
    /// Mean over seeds of the mean return, in steps walked.
    pub mean_return: f64,
    /// Standard deviation over seeds; `None` for one seed.
    pub sd_return: Option<f64>,
    /// Mean over seeds of the share of test episodes that ended in disengagement.
    pub disengagement_rate: f64,
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
            seeds: summary.seeds,
            mean_return: summary.mean_return,
            sd_return: summary.sd_return,
            disengagement_rate: summary.disengagement_rate,
        }
    };
    (columns, arms.iter().map(line).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::Arm;

    #[test]
    fn swept_parameters_get_columns_and_arms_without_them_stay_empty() {
        let arm = |swept: &[(&str, &str)]| ArmSummary {
            arm: Arm {
                agent: "dqn".to_owned(),
                scenario: "P-H-D".to_owned(),
                sigma: 0.6,
                swept: swept.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned())).collect(),
            },
            seeds: 3,
            mean_return: 1.0,
            sd_return: None,
            disengagement_rate: 0.0,
        };
        let (columns, lines) =
            summary_table(&[arm(&[("agent.batch", "32")]), arm(&[("environment.delta_d", "0.1")])]);
        assert_eq!(columns, ["agent", "scenario", "sigma", "batch", "delta_d"]);
        assert_eq!(lines[0].arm, ["dqn", "P-H-D", "0.6", "32", ""]);
        assert_eq!(lines[1].arm, ["dqn", "P-H-D", "0.6", "", "0.1"]);
    }
}
