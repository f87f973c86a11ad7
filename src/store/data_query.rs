//! The queries that a report prints beside its figures, so that readers can fetch the same rows.

use std::fmt::Write as _;

use crate::record::Setting;

/// A query of the public views: which jobs of one experiment, and which part of their results.
#[derive(Clone, Debug, PartialEq)]
pub struct DataQuery {
    /// The experiment's name.
    pub experiment: String,
    /// Names of agents.
    pub agents: Vec<String>,
    /// Scenarios.
    pub scenarios: Vec<String>,
    /// Parameters in which the jobs differ: dotted names, and the values to select.
    pub parameters: Vec<(String, Vec<Setting>)>,
    /// The part of the results.
    pub part: DataPart,
}

/// A part of the results of a job.
#[derive(Clone, Debug, PartialEq)]
pub enum DataPart {
    /// A metric.
    Metric(String),
    /// The learning curve of the mean return.
    LearningCurve,
    /// Choices of action.
    ActionChoice,
    /// Returns of the test episodes.
    Returns,
}

impl DataQuery {
    /// One SELECT statement on the public views.
    pub fn sql(&self) -> String {
        let mut columns = String::from("SELECT run.agent, run.scenario, run.seed");
        let mut conditions = format!(
            "WHERE run.experiment = {} AND run.status = 'completed'\n  AND run.agent IN ({})\n  \
             AND run.scenario IN ({})",
            text(&self.experiment),
            list(&self.agents),
            list(&self.scenarios)
        );
        for (name, values) in &self.parameters {
            let value = format!(
                "(SELECT value FROM parameter WHERE job_key = run.job_key AND name = {})",
                text(name)
            );
            let heading = name.replace('"', "\"\"");
            let _ = write!(columns, ",\n  {value} AS \"{heading}\"");
            let values: Vec<String> = values.iter().map(literal).collect();
            let _ = write!(conditions, "\n  AND {value} IN ({})", values.join(", "));
        }
        let (part, join) = match &self.part {
            DataPart::Metric(name) => (
                format!("metric.value AS \"{}\"", name.replace('"', "\"\"")),
                format!(
                    "JOIN metric ON metric.job_key = run.job_key AND metric.name = {}",
                    text(name)
                ),
            ),
            DataPart::LearningCurve => (
                "curve.episode, curve.value AS mean_return".to_owned(),
                "JOIN learning_curve AS curve ON curve.job_key = run.job_key\n  AND curve.metric = \
                 'mean_return'"
                    .to_owned(),
            ),
            DataPart::ActionChoice => (
                "choice.p_low, choice.p_high, choice.context, choice.action, choice.count"
                    .to_owned(),
                "JOIN action_choice AS choice ON choice.job_key = run.job_key".to_owned(),
            ),
            DataPart::Returns => (
                "test.episode, test.total_reward".to_owned(),
                "JOIN evaluation_episode AS test ON test.job_key = run.job_key".to_owned(),
            ),
        };
        let order = 3 + self.parameters.len();
        let order: Vec<String> = (1..=order).map(|place| place.to_string()).collect();
        format!(
            "{columns},\n  {part}\nFROM run_summary AS run\n{join}\n{conditions}\nORDER BY {}\n",
            order.join(", ")
        )
    }
}

/// A text as SQL writes it.
pub fn text(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}

/// A value as SQL compares it.
fn literal(setting: &Setting) -> String {
    match setting {
        Setting::Number(number) => number.to_string(),
        Setting::Text(word) => text(word),
    }
}

fn list(words: &[String]) -> String {
    words.iter().map(|word| text(word)).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_leave_their_quotes() {
        let query = DataQuery {
            experiment: "x' OR 1=1 --".to_owned(),
            agents: vec!["dqn".to_owned()],
            scenarios: vec!["P-H-D".to_owned()],
            parameters: vec![
                ("environment.sigma".to_owned(), vec![Setting::Number(0.6)]),
                ("agent.algorithm".to_owned(), vec![Setting::Text("it's".to_owned())]),
            ],
            part: DataPart::Metric("mean_return".to_owned()),
        };
        let sql = query.sql();
        assert!(sql.contains("run.experiment = 'x'' OR 1=1 --' AND"), "{sql}");
        assert!(sql.contains("'environment.sigma') IN (0.6)"), "{sql}");
        assert!(sql.contains("'agent.algorithm') IN ('it''s')"), "{sql}");
        assert!(sql.ends_with("ORDER BY 1, 2, 3, 4, 5\n"), "{sql}");
    }
}
