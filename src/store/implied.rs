//! The values of parameters that canonical forms leave out, for the view `parameter`.

use rusqlite::types::{ToSqlOutput, Value as SqlValue};
use rusqlite::{Connection, TransactionBehavior, params};

use crate::plan::{ImpliedParameter, Scalar};

use super::transaction::commit;

impl rusqlite::ToSql for Scalar {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Owned(match self {
            Scalar::Real(real) => SqlValue::Real(*real),
            Scalar::Integer(whole) => SqlValue::Integer(*whole),
            Scalar::Text(text) => SqlValue::Text(text.clone()),
        }))
    }
}

/// Adds the parameters that the file does not have yet, or has with another value. Others stay: a
/// newer release may have added them.
pub(super) fn declare(
    connection: &mut Connection,
    parameters: &[ImpliedParameter],
) -> rusqlite::Result<()> {
    let is_new = |connection: &Connection, parameter: &&ImpliedParameter| {
        connection.query_row(
            "SELECT NOT EXISTS (SELECT 1 FROM implied_parameter
                WHERE name = ?1 AND algorithm = ?2 AND value IS ?3)",
            params![parameter.name, parameter.algorithm.unwrap_or(""), parameter.value],
            |row| row.get::<_, bool>(0),
        )
    };
    let mut new = Vec::new();
    for parameter in parameters {
        if is_new(connection, &parameter)? {
            new.push(parameter);
        }
    }
    if new.is_empty() {
        return Ok(());
    }
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    for ImpliedParameter { name, algorithm, value } in new {
        transaction.execute(
            "INSERT INTO implied_parameter (name, algorithm, value) VALUES (?1, ?2, ?3)
             ON CONFLICT (name, algorithm) DO UPDATE SET value = excluded.value",
            params![name, algorithm.unwrap_or(""), value],
        )?;
    }
    commit(transaction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;
    use crate::store::sample::{begin_session, claim, job};

    #[test]
    fn jobs_without_a_parameter_have_its_implied_value() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("jitai.sqlite");
        let mut store = Store::open(&path).unwrap();
        let session = begin_session(&mut store);
        let noise = |value| ImpliedParameter {
            name: "environment.noise".to_owned(),
            algorithm: None,
            value,
        };
        let of_others = ImpliedParameter {
            name: "agent.window".to_owned(),
            algorithm: Some("reinforce"),
            value: Scalar::Integer(3),
        };
        let known = ImpliedParameter {
            name: "environment.sigma".to_owned(),
            algorithm: None,
            value: Scalar::Real(9.0),
        };
        declare(&mut store.connection, &[noise(Scalar::Real(1.5)), of_others, known]).unwrap();
        declare(&mut store.connection, &[noise(Scalar::Real(0.0))]).unwrap();
        claim(&mut store, session, &job());
        let values = |name: &str| -> Vec<f64> {
            let mut statement = store
                .connection
                .prepare("SELECT value FROM parameter WHERE name = ?1 AND job_key = ?2")
                .unwrap();
            let key = job().key().to_string();
            let rows = statement.query_map([name, &key], |row| row.get(0)).unwrap();
            rows.collect::<rusqlite::Result<_>>().unwrap()
        };
        assert_eq!(values("environment.noise"), [0.0]);
        assert_eq!(values("environment.sigma"), [0.4]);
        assert_eq!(values("agent.window"), [0.0; 0]);
    }
}
