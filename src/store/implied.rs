//! The values of parameters that canonical forms omit, for the view `parameter`.

use std::path::Path;

use rusqlite::types::{ToSqlOutput, Value as SqlValue};
use rusqlite::{Connection, OptionalExtension, TransactionBehavior, params};

use crate::job::ImpliedParameter;
use crate::job::Scalar;

use super::error::StoreError;
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

/// The stored entry of a parameter.
pub(super) enum Known {
    Not,
    Same,
    /// Another value, as an SQL literal.
    Other(String),
}

/// Adds the parameters that the file lacks. Others remain, because a newer release may have added them.
///
/// **Errors**: the file has another value for one of the parameters, which would change the meaning of every
/// job that omits it.
pub(super) fn declare(
    connection: &mut Connection,
    path: &Path,
    parameters: &[ImpliedParameter],
) -> Result<(), StoreError> {
    let failure = |source| StoreError::sqlite(path, "open the store", source);
    let mut new = Vec::new();
    for parameter in parameters {
        match known(connection, parameter).map_err(failure)? {
            Known::Not => new.push(parameter),
            Known::Same => {}
            Known::Other(stored) => {
                let (path, parameter) = (path.to_owned(), parameter.name.clone());
                return Err(StoreError::Reinterpreted { path, parameter, stored });
            }
        }
    }
    add(connection, &new).map_err(failure)
}

pub(super) fn known(
    connection: &Connection,
    parameter: &ImpliedParameter,
) -> rusqlite::Result<Known> {
    let found: Option<(bool, String)> = connection
        .query_row(
            "SELECT value IS ?3, quote(value) FROM implied_parameter
             WHERE name = ?1 AND algorithm = ?2",
            params![parameter.name, parameter.algorithm.unwrap_or(""), parameter.value],
            |row| Ok((row.get(0)?, row.get(1)?)),
        )
        .optional()?;
    Ok(match found {
        None => Known::Not,
        Some((true, _)) => Known::Same,
        Some((false, stored)) => Known::Other(stored),
    })
}

fn add(connection: &mut Connection, new: &[&ImpliedParameter]) -> rusqlite::Result<()> {
    if new.is_empty() {
        return Ok(());
    }
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    for ImpliedParameter { name, algorithm, value } in new {
        transaction.execute(
            "INSERT INTO implied_parameter (name, algorithm, value) VALUES (?1, ?2, ?3)
             ON CONFLICT (name, algorithm) DO NOTHING",
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
        let none = noise(Scalar::Real(0.0));
        let declared = [none.clone(), of_others, known];
        declare(&mut store.connection, &path, &declared).unwrap();
        declare(&mut store.connection, &path, &[none]).unwrap();
        let other = declare(&mut store.connection, &path, &[noise(Scalar::Real(1.5))]);
        let message = other.unwrap_err().to_string();
        assert!(message.contains("without `environment.noise` mean 0.0"), "{message}");
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
