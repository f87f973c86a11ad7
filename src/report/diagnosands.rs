//! The diagnosands of a manifest: expressions of SQL over the estimates of trials.
//!
//! The store evaluates them; their Monte Carlo errors come from groups of trials that are left out.

use super::kinds::operating::COLUMNS;
use crate::analyse::declared::{Diagnosand, Finding, FindingContent};
use crate::analyse::{MonteCarloMean, Undefined, jackknife};
use crate::job::Effect;
use crate::manifest::{Analysis, AnalysisKind, Faults, Manifest};
use crate::store::{Diagnosed, diagnosand_fault};
use crate::text::{Fault, FaultList, Source};

/// The diagnosands of an analysis: names and expressions.
fn of(analysis: &Analysis) -> &[(String, String)] {
    match &analysis.kind {
        AnalysisKind::OperatingCharacteristics(kind) => &kind.diagnosands.all,
        _ => &[],
    }
}

/// Checks the expressions of a manifest.
///
/// **Errors**: what is wrong with them, with positions.
pub fn check_diagnosands(manifest: &Manifest) -> Result<(), Faults> {
    let mut faults = FaultList::default();
    for analysis in &manifest.analyses {
        for (name, expression) in of(analysis) {
            let is_taken = COLUMNS.iter().any(|(known, _)| known.trim_start_matches('.') == name);
            let why = match is_taken {
                true => Some("the table has a column of this name; choose another".to_owned()),
                false => diagnosand_fault(expression),
            };
            let Some(why) = why else { continue };
            let message = format!("`diagnosands`: `{name}`: {why}");
            let span = match &analysis.kind {
                AnalysisKind::OperatingCharacteristics(kind) => kind.diagnosands.span,
                _ => None,
            };
            let span = span.filter(|span| span.end <= manifest.source.len());
            let fault = match span {
                Some(span) => Fault::at(span, message),
                None => Fault::whole(message),
            };
            faults.add(fault.help(HELP));
        }
    }
    if faults.is_empty() {
        return Ok(());
    }
    Err(faults.of(&manifest.path, Source::new(&manifest.source)))
}

const HELP: &str =
    "write an aggregate over the rows of the view `estimate`, as in \"avg(p_value < 0.01)\"";

/// Computes the diagnosands of an analysis from the trials of its finding.
pub(super) fn add(analysis: &Analysis, finding: &mut Finding) {
    let FindingContent::Operating(figure) = &mut finding.content else { return };
    for row in &mut figure.rows {
        let diagnosands = of(analysis).iter();
        let diagnosands = diagnosands
            .map(|(name, expression)| (name.clone(), diagnosed(&row.trials, expression)));
        row.diagnosands = diagnosands.collect();
    }
}

fn diagnosed(trials: &[Result<Effect, String>], expression: &str) -> Diagnosand {
    let diagnosed = Diagnosed::new(trials)?;
    let value = diagnosed.value(expression, None)?;
    let value = value.ok_or_else(|| "it is no number".to_owned())?;
    if diagnosed.has_extreme(expression)? {
        return Ok(MonteCarloMean { value, interval: Err(Undefined::Extreme) });
    }
    Ok(jackknife(value, &diagnosed.without_each(expression)?))
}
