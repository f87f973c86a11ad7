//! The queries that a report prints with its figures, so that readers can fetch the same rows.

use crate::job::metric::NET_RETURN;
use std::fmt::Write as _;

use crate::job::{Condition, DataPart, ParticipantRange, Scalar, short_beside, short_name};
use crate::key::Parameter;
use crate::record::JobRecord;

/// A query of the public views: for some jobs of one experiment, and for a part of their results.
#[derive(Clone, Debug, PartialEq)]
pub struct DataQuery {
    /// The experiment's name.
    pub experiment: String,
    /// The conditions that every job meets.
    pub conditions: Vec<Condition>,
    /// Dotted names of the keys that get a column, besides agent, scenario and seed.
    pub columns: Vec<String>,
    /// The part of the results.
    pub part: DataPart,
}

impl DataQuery {
    /// The jobs whose rows the query reads. Conditions on anything but the seed are tested once per arm.
    pub fn among<'j>(&self, jobs: &'j [JobRecord]) -> Vec<&'j JobRecord> {
        let is_of_seed = |one: &&Condition| one.parameter == Parameter::SEED;
        let (of_seeds, of_arms): (Vec<_>, Vec<_>) = self.conditions.iter().partition(is_of_seed);
        let meets = |conditions: &[&Condition], job: &JobRecord| {
            conditions.iter().all(|condition| condition.is_met_by(job))
        };
        let arms = jobs.chunk_by(JobRecord::shares_arm).filter(|arm| meets(&of_arms, &arm[0]));
        arms.flatten().filter(|job| meets(&of_seeds, job)).collect()
    }

    /// One SELECT statement on the public views.
    pub fn sql(&self) -> String {
        let mut columns = String::from("SELECT run.agent, run.scenario, run.seed");
        for name in &self.columns {
            let _ = write!(columns, ",\n  {} AS \"{}\"", key(name), name.replace('"', "\"\""));
        }
        let mut conditions = format!(
            "WHERE run.experiment = {} AND run.status = 'completed'",
            text(&self.experiment)
        );
        for condition in &self.conditions {
            let _ = write!(conditions, "\n  AND {}", rendered(condition));
        }
        let (part, join) = self.part_and_join();
        format!(
            "{columns},\n  {part}\nFROM run_summary AS run\n{join}\n{conditions}\nORDER BY {}\n",
            column_numbers(3 + self.columns.len())
        )
    }

    /// The columns of the part of the results, and the views that have them.
    fn part_and_join(&self) -> (String, String) {
        match self.part {
            // It is recorded only where messages cost something.
            DataPart::Metric(metric) if metric == NET_RETURN => (
                "coalesce(net.value, metric.value) AS mean_net_return".to_owned(),
                "JOIN metric ON metric.job_key = run.job_key AND metric.name = 'mean_return'\n\
                 LEFT JOIN metric AS net ON net.job_key = run.job_key AND net.name = 'mean_net_return'"
                    .to_owned(),
            ),
            DataPart::Metric(name) => (
                format!("metric.value AS \"{name}\""),
                format!(
                    "JOIN metric ON metric.job_key = run.job_key AND metric.name = {}",
                    text(&name.text())
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
            DataPart::Days(most) => (
                "decision.episode, decision.step, coalesce(decision.can_send, decision.available) AS can_send,\n  \
                 decision.action, decision.reward, decision.state"
                    .to_owned(),
                format!(
                    "JOIN decision ON decision.job_key = run.job_key AND decision.phase = 'test'\n  \
                     AND decision.episode <= {most}"
                ),
            ),
            DataPart::Estimates => (
                "estimate.name, estimate.term, estimate.estimate, estimate.standard_error, estimate.low,\n  \
                 estimate.high, estimate.truth, estimate.failure"
                    .to_owned(),
                "JOIN estimate ON estimate.job_key = run.job_key AND estimate.experiment = run.experiment\n  \
                 AND estimate.agent = run.agent"
                    .to_owned(),
            ),
            DataPart::Posteriors => (
                "posterior.number, posterior.step, posterior.action, posterior.mean, posterior.covariance"
                    .to_owned(),
                "JOIN posterior ON posterior.job_key = run.job_key".to_owned(),
            ),
            DataPart::PersonPosteriors => (
                "posterior.number, posterior.step, posterior.person, posterior.action, posterior.mean,\n  \
                 posterior.covariance, posterior.deviation"
                    .to_owned(),
                "JOIN person_posterior AS posterior ON posterior.job_key = run.job_key".to_owned(),
            ),
            DataPart::Participants(range) => (
                "test.episode, test.total_reward, test.length, test.disengaged".to_owned(),
                participants(range),
            ),
            DataPart::Returns => (
                "test.episode, test.total_reward".to_owned(),
                "JOIN evaluation_episode AS test ON test.job_key = run.job_key".to_owned(),
            ),
        }
    }
}

/// The SELECT statement of the mean return of every arm of these experiments; the parameters `shown`, by their dotted
/// names, get a column each.
pub fn mean_returns(experiments: &[&str], shown: &[String]) -> String {
    let names: Vec<String> = experiments.iter().map(|name| text(name)).collect();
    let (mut columns, condition) = match names.as_slice() {
        [name] => (Vec::new(), format!("= {name}")),
        names => (vec!["experiment".to_owned()], format!("IN ({})", names.join(", "))),
    };
    columns.extend(["agent", "scenario"].map(str::to_owned));
    for name in shown {
        // The view has a column of its own for this one.
        if name == "environment.sigma" {
            columns.push(short_name(name).to_owned());
            continue;
        }
        columns.push(format!(
            "(SELECT value FROM parameter AS p WHERE p.job_key = run_summary.job_key AND name = {}) AS {}",
            text(name),
            alias(name, shown)
        ));
    }
    format!(
        "SELECT {}, avg(mean_return) FROM run_summary \
         WHERE status = 'completed' AND experiment {condition} GROUP BY {}",
        columns.join(", "),
        column_numbers(columns.len())
    )
}

/// The numbers of the first columns, as GROUP BY and ORDER BY name columns.
fn column_numbers(columns: usize) -> String {
    (1..=columns).map(|number| number.to_string()).collect::<Vec<_>>().join(", ")
}

/// The test episodes of a range of participants, who are ranked within each job.
fn participants(range: ParticipantRange) -> String {
    let ParticipantRange { parameter, from, to, .. } = range;
    let below = if to < 1.0 { format!(" AND person.share < {to:?}") } else { String::new() };
    format!(
        "JOIN (SELECT job_key, episode,\n    (row_number() OVER (PARTITION BY job_key ORDER BY value, \
         episode) - 1.0)\n    / count(*) OVER (PARTITION BY job_key) AS share\n  FROM participant \
         WHERE phase = 'test' AND name = {}) AS person\n  ON person.job_key = run.job_key AND \
         person.share >= {from:?}{below}\nJOIN evaluation_episode AS test ON test.job_key = \
         run.job_key\n  AND test.episode = person.episode",
        text(parameter)
    )
}

/// A condition as SQL on the rows of `run`.
fn rendered(condition: &Condition) -> String {
    let value = match condition.parameter {
        Parameter::SCENARIO => "run.scenario".to_owned(),
        Parameter::SEED => "run.seed".to_owned(),
        Parameter::AGENT_NAME => "run.agent".to_owned(),
        parameter => key(&parameter.to_string()),
    };
    let values: Vec<String> = condition.scalars().iter().map(literal).collect();
    format!("{value} IN ({})", values.join(", "))
}

/// The value of a key for a job of `run`.
fn key(name: &str) -> String {
    format!("(SELECT value FROM parameter WHERE job_key = run.job_key AND name = {})", text(name))
}

/// The name of a parameter's column, without quotes. A name of one word may be a word of SQL, such as `update`; the
/// column then has the name of the table, too, as where two columns have the same name.
fn alias(dotted: &str, shown: &[String]) -> String {
    let short = short_beside(dotted, shown);
    let name = if short.contains('_') { short } else { dotted };
    name.replace(|letter: char| !letter.is_ascii_alphanumeric(), "_")
}

/// A text as an SQL literal.
fn text(text: &str) -> String {
    format!("'{}'", text.replace('\'', "''"))
}

/// A value as an SQL literal for comparisons.
fn literal(setting: &Scalar) -> String {
    match setting {
        Scalar::Real(number) => number.to_string(),
        Scalar::Integer(number) => number.to_string(),
        Scalar::Text(word) => text(word),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::metric::MEAN_RETURN;
    use crate::key::{Parameter, Value};

    #[test]
    fn no_column_of_a_parameter_is_a_word_of_sql() {
        assert_eq!(alias("agent.update", &[]), "agent_update");
        assert_eq!(alias("environment.parameters.order", &[]), "environment_parameters_order");
        assert_eq!(alias("agent.learning_rate", &[]), "learning_rate");
        assert_eq!(alias("population.delta_d", &[]), "population_delta_d");
        let both = ["agent.batch_size", "environment.parameters.batch_size"].map(str::to_owned);
        let aliases = both.each_ref().map(|name| alias(name, &both));
        assert_eq!(aliases, ["agent_batch_size", "environment_parameters_batch_size"]);
    }

    #[test]
    fn names_cannot_leave_their_quotes() {
        let query = DataQuery {
            experiment: "x' OR 1=1 --".to_owned(),
            conditions: vec![
                Condition::texts(Parameter::AGENT_NAME, ["dqn", "it's"]),
                Condition {
                    parameter: Parameter::Environment("sigma"),
                    values: vec![Value::Real(0.6)],
                },
            ],
            columns: vec!["environment.sigma".to_owned(), "agent.\"x".to_owned()],
            part: DataPart::Metric(MEAN_RETURN),
        };
        let sql = query.sql();
        assert!(sql.contains("run.experiment = 'x'' OR 1=1 --' AND"), "{sql}");
        assert!(sql.contains("run.agent IN ('dqn', 'it''s')"), "{sql}");
        assert!(sql.contains("'environment.sigma') IN (0.6)"), "{sql}");
        assert!(sql.contains("AS \"agent.\"\"x\""), "{sql}");
        assert!(sql.ends_with("ORDER BY 1, 2, 3, 4, 5\n"), "{sql}");
    }
}
