//! People as uncertain as their estimates: files of people that a manifest sweeps.

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::env::declared::Pilot;
use crate::fit::estimate::{Fit, GroupFit, is_normal};
use crate::fit::output;
use crate::kernel::math;
use crate::report::ReportFile;
use crate::rng::{Purpose, Stream, open_unit_from_bits};

/// Where drawn people come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DrawnFrom {
    /// The normal approximation of each estimate.
    Estimates,
    /// The people of the pilot, drawn with replacement.
    People,
}

/// The share of its estimate that a drawn standard deviation has at least.
const LEAST: f64 = 0.05;

/// Files of people, `draw-1.csv` to this number.
pub fn draws(pilot: &Pilot, fit: &Fit, number: u32, from: DrawnFrom, seed: u64) -> Vec<ReportFile> {
    let draw = |number: u32| {
        let mut stream = Stream::of_person(seed, Purpose::Bootstrap, number);
        let bytes = match from {
            DrawnFrom::Estimates => output::people(pilot, &perturbed(pilot, fit, &mut stream)),
            DrawnFrom::People => resampled(&output::people(pilot, fit), &mut stream),
        };
        ReportFile { name: format!("draw-{number}.csv"), bytes }
    };
    (1..=number).map(draw).collect()
}

/// The fit with coefficients from the normal approximation of each group.
fn perturbed(pilot: &Pilot, fit: &Fit, stream: &mut Stream) -> Fit {
    let group = |(draw, group): (usize, &GroupFit)| {
        let size = group.free.len();
        let root = Cholesky::new(DMatrix::from_column_slice(size, size, &group.covariance));
        let Some(root) = root.filter(|_| !group.covariance.is_empty()) else {
            return group.clone();
        };
        let normal = DVector::from_fn(size, |_, _| normal(stream));
        let off = root.l() * normal;
        let sd = pilot.draws[draw].predictors.get(1).filter(|_| is_normal(pilot.draws[draw].law));
        let values = group.values.iter().zip(off.iter()).zip(&group.free);
        let values = values.map(|((value, off), index)| {
            let is_sd = sd.is_some_and(|sd| sd.coefficients.contains(index));
            if is_sd { (value + off).abs().max(LEAST * value.abs()) } else { value + off }
        });
        GroupFit { values: values.collect(), ..group.clone() }
    };
    let mut group = group;
    let groups = fit.groups.iter().enumerate();
    let groups = groups
        .map(|(draw, groups)| groups.iter().map(|one| group((draw, one))).collect())
        .collect();
    Fit { parameters: fit.parameters.clone(), ..Fit::of(pilot, groups) }
}

/// A standard normal number, by Box and Muller.
fn normal(stream: &mut Stream) -> f64 {
    let [radius, turn] = [0, 1].map(|_| open_unit_from_bits(stream.bits()));
    (-2.0 * libm::log(radius)).sqrt() * math::cos_turns(turn)
}

/// The rows of a file of people, drawn with replacement.
fn resampled(people: &[u8], stream: &mut Stream) -> Vec<u8> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(people);
    let rows: Vec<csv::StringRecord> = reader.records().flatten().collect();
    let drawn = (1..rows.len()).map(|_| 1 + stream.below(rows.len() as u32 - 1) as usize);
    let all = [0].into_iter().chain(drawn).map(|index| &rows[index]);
    output::csv_of(all.map(|row| row.iter().map(str::to_owned).collect()))
}
