//! The content of an export: the rows of every view, the meanings of their columns, and the manifests.

use super::error::StoreError;
use super::read::Reader;

/// The public views, with the order of their rows.
const ORDERS: [(&str, &str); 15] = [
    ("run_summary", "experiment, job_key, agent, attempt"),
    ("parameter", "job_key, name"),
    ("metric", "job_key, name"),
    ("learning_curve", "job_key, metric, episode"),
    ("evaluation_episode", "job_key, episode"),
    ("action_choice", "job_key, p_low, context, action"),
    ("arm_summary", "experiment, job_key, agent"),
    ("decision", "job_key, phase, episode, step"),
    ("participant", "job_key, phase, episode, name"),
    ("manifest", "experiment, number"),
    ("conflict", "job_key, results_sha256"),
    ("estimate", "experiment, job_key, agent, declaration, number"),
    ("every_estimate", "job_key, declaration, number"),
    ("posterior", "job_key, number, action"),
    ("person_posterior", "job_key, number, person, action"),
];

/// The names of the public views, which `docs/store.md` describes.
pub const VIEWS: [&str; ORDERS.len()] = {
    let mut names = [""; ORDERS.len()];
    let mut index = 0;
    while index < names.len() {
        names[index] = ORDERS[index].0;
        index += 1;
    }
    names
};

/// The documentation of the views, which defines their columns.
const REFERENCE: &str = include_str!("../../docs/store.md");

/// The order of the view `estimate` in stores of versions whose view has every estimate, without the column `experiment`.
const EVERY_ESTIMATE: &str = "job_key, declaration, number";

/// The order of the view `manifest` in stores of versions that have the view without the column `number`.
const EARLIER_ORDER: &str = "experiment, used_from";

/// The public views, each with the query for all its rows in a fixed order. If `experiments` is not empty,
/// only the rows of these experiments and their jobs.
fn exports(
    experiments: &[String],
    estimate_order: &'static str,
) -> impl Iterator<Item = (&'static str, String)> {
    let quoted: Vec<String> =
        experiments.iter().map(|name| format!("'{}'", name.replace('\'', "''"))).collect();
    let quoted = quoted.join(", ");
    ORDERS.into_iter().map(move |(view, order)| {
        let order = if view == "estimate" { estimate_order } else { order };
        let of_experiment = order.starts_with("experiment");
        let only = match of_experiment {
            _ if quoted.is_empty() => String::new(),
            true => format!(" WHERE experiment IN ({quoted})"),
            false => format!(
                " WHERE job_key IN (SELECT job.key FROM experiment
                    JOIN experiment_job ON experiment_job.experiment = experiment.id
                    JOIN job ON job.id = experiment_job.job WHERE experiment.name IN ({quoted}))"
            ),
        };
        (view, format!("SELECT * FROM {view}{only} ORDER BY {order}"))
    })
}

/// The documentation of a view's column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewColumn {
    /// The view.
    pub view: &'static str,
    /// The column.
    pub name: &'static str,
    /// The type of its values: `integer`, `real`, `text`, or several types.
    pub kind: &'static str,
    /// The unit; empty if there is none.
    pub unit: &'static str,
    /// The meaning of its values.
    pub meaning: &'static str,
}

/// The columns of all views, in order: the tables of `docs/store.md`.
pub fn columns() -> impl Iterator<Item = ViewColumn> {
    let mut view = "";
    REFERENCE.lines().filter_map(move |line| {
        if let Some(title) = line.strip_prefix("### ") {
            view = title;
        }
        let cells = line.strip_prefix('|')?.strip_suffix('|')?;
        let cells: Vec<&'static str> = cells.split('|').map(str::trim).collect();
        let [name, kind, unit, meaning] = cells[..] else { return None };
        let is_header = name == "column" || name.starts_with("---");
        (!is_header).then_some(ViewColumn { view, name, kind, unit, meaning })
    })
}

impl Reader {
    /// The public views, each with the query for all its rows in a fixed order; `None` for a view that the
    /// store lacks, because an earlier version made it. If `experiments` is not empty, only the rows of these
    /// experiments and their jobs.
    pub fn exports(
        &self,
        experiments: &[String],
    ) -> Result<Vec<(&'static str, Option<String>)>, StoreError> {
        let is_numbered = self.has_column("manifest", "number")?;
        let known = ORDERS.iter().find(|(view, _)| *view == "estimate").map(|(_, order)| *order);
        let declared = known.filter(|_| self.has_column("estimate", "experiment").unwrap_or(false));
        let query = |(view, sql): (&'static str, String)| {
            let sql = match view {
                "manifest" if !is_numbered => sql.replace("experiment, number", EARLIER_ORDER),
                _ => sql,
            };
            Ok((view, self.has_view(view)?.then_some(sql)))
        };
        exports(experiments, declared.unwrap_or(EVERY_ESTIMATE)).map(query).collect()
    }

    /// The experiments, each with the text of its manifest, in the order of their first run.
    pub fn manifests(&self) -> Result<Vec<(String, String)>, StoreError> {
        self.read("read the manifests", |connection| {
            let mut statement =
                connection.prepare_cached("SELECT name, manifest FROM experiment ORDER BY id")?;
            let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use crate::store::{Store, VIEWS};

    #[test]
    fn the_dictionary_has_every_column_of_every_view_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        let mut known: HashMap<&str, Vec<&str>> = HashMap::new();
        for column in columns() {
            known.entry(column.view).or_default().push(column.name);
            assert!(!column.meaning.is_empty() && !column.kind.is_empty(), "{column:?}");
        }
        assert_eq!(known.len(), VIEWS.len());
        for view in VIEWS {
            let statement = store.connection.prepare(&format!("SELECT * FROM {view}")).unwrap();
            assert_eq!(statement.column_names().collect::<Vec<_>>(), known[view], "{view}");
        }
        let views = "SELECT count(*) FROM sqlite_schema WHERE type = 'view'";
        let count: usize = store.connection.query_row(views, [], |row| row.get(0)).unwrap();
        assert_eq!(count, VIEWS.len());
    }
}
