//! Corrections of p values for the number of tests in a family.

use super::undefined::Undefined;

/// Corrected p values of one test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected {
    /// Holm's p value, which controls the family-wise error rate.
    pub holm: f64,
    /// Benjamini and Hochberg's p value, which controls the false discovery rate.
    pub benjamini_hochberg: f64,
}

/// Corrects the p values of a family, in the order given.
///
/// A test without a p value stays undefined but counts as a member of the family, as if its p were
/// 1. A failed arm therefore does not strengthen the other findings.
///
/// **Source**: Holm, "A simple sequentially rejective multiple test procedure", 1979; Benjamini and
/// Hochberg, "Controlling the false discovery rate", 1995.
pub fn correct(family: &[Result<f64, Undefined>]) -> Vec<Result<Corrected, Undefined>> {
    let members = family.len() as f64;
    let mut corrected: Vec<Result<Corrected, Undefined>> = family
        .iter()
        .map(|p| {
            (*p).and_then(|p| match p {
                p if (0.0..=1.0).contains(&p) => Ok(Corrected { holm: p, benjamini_hochberg: p }),
                _ => Err(Undefined::OutOfRange),
            })
        })
        .collect();
    let mut defined: Vec<&mut Corrected> =
        corrected.iter_mut().filter_map(|test| test.as_mut().ok()).collect();
    defined.sort_by(|a, b| a.holm.total_cmp(&b.holm));
    let mut largest: f64 = 0.0;
    for (rank, test) in defined.iter_mut().enumerate() {
        largest = largest.max(((members - rank as f64) * test.holm).min(1.0));
        test.holm = largest;
    }
    let mut smallest: f64 = 1.0;
    for (rank, test) in defined.iter_mut().enumerate().rev() {
        smallest = smallest.min(members / (rank as f64 + 1.0) * test.benjamini_hochberg);
        test.benjamini_hochberg = smallest;
    }
    corrected
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn families_by_hand() {
        let corrected = correct(&[Ok(0.04), Ok(0.01), Ok(0.03)]);
        let holm: Vec<f64> = corrected.iter().map(|test| test.unwrap().holm).collect();
        assert_eq!(holm, [0.06, 0.03, 0.06]);
        let bh = corrected.iter().map(|test| test.unwrap().benjamini_hochberg);
        assert_eq!(bh.collect::<Vec<f64>>(), [0.04, 0.03, 0.04]);
    }

    #[test]
    fn undefined_tests_count_as_members() {
        let corrected = correct(&[Err(Undefined::NoVariance), Ok(0.01), Ok(f64::NAN), Ok(2.0)]);
        assert_eq!(corrected[0], Err(Undefined::NoVariance));
        assert_eq!(corrected[1], Ok(Corrected { holm: 0.04, benjamini_hochberg: 0.04 }));
        assert_eq!(corrected[2..], [Err(Undefined::OutOfRange); 2]);
        assert!(correct(&[]).is_empty());
    }
}
