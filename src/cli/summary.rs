//! The summary of experiments that `run` ends with.

use std::io::{self, Write};

use crate::analyse;
use crate::cli::Error;
use crate::cli::output::{Cell, Format, Rows, printable};
use crate::env;
use crate::plan::JobKey;
use crate::report::{self, Line};
use crate::store::Reader;

/// Prints mean return ± standard deviation over seeds, an arm a line, for each experiment; returns
/// a completed job, if there is any, for examples.
pub(super) fn print(reader: &Reader, experiments: &[&str]) -> Result<Option<JobKey>, Error> {
    let mut out = io::stdout().lock();
    let mut example = None;
    for experiment in experiments {
        let runs = reader.run_summaries(experiment)?;
        example = example.or(runs.first().map(|run| run.job_key));
        let arms = analyse::summarise(&runs);
        if arms.is_empty() {
            continue;
        }
        writeln!(out, "\n{}: mean return ± sd over seeds, in steps walked", printable(experiment))?;
        let (mut columns, lines) = report::summary_table(&arms);
        columns.extend(
            ["context error", "seeds", "mean return ± sd", "disengaged"].map(str::to_owned),
        );
        let mut rows = Rows::new(Format::Table, &columns, &mut out)?;
        for (line, summary) in lines.iter().zip(&arms) {
            rows.row(&cells(line, env::inference_error(summary.arm.sigma)))?;
        }
        rows.finish()?;
    }
    Ok(example)
}

fn cells(line: &Line, context_error: f64) -> Vec<Cell> {
    let spread = match line.sd_return {
        Some(sd) => format!("{:.1} ± {sd:.1}", line.mean_return),
        None => format!("{:.1}", line.mean_return),
    };
    let word = |text: &String| match text.parse::<f64>() {
        Ok(_) => Cell::Figure(text.clone()),
        Err(_) => Cell::text(text),
    };
    let mut cells: Vec<Cell> = line.arm.iter().map(word).collect();
    cells.extend([
        Cell::Figure(format!("{:.1} %", 100.0 * context_error)),
        Cell::Integer(line.seeds as i64),
        Cell::Figure(spread),
        Cell::Figure(format!("{:.1} %", 100.0 * line.disengagement_rate)),
    ]);
    cells
}
