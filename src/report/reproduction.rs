//! The comparison with published numbers, in sentences.

use super::data_table::shown;
use crate::analyse::declared::{Distance, Reproduction};
use crate::job::counted;

/// The results of a comparison with published numbers, in sentences.
pub fn reproduction(reproduction: &Reproduction) -> Vec<String> {
    let subjects = reproduction.subjects();
    let counts = subjects.iter().filter_map(|subject| {
        let (inside, outside, open) = reproduction.counts(subject);
        let total = inside + outside + open;
        let open = match open {
            0 => String::new(),
            open => format!(" ({open} not compared yet)"),
        };
        (total > 0).then(|| format!("{inside} of {total} {subject}s{open}"))
    });
    let counts: Vec<String> = counts.collect();
    let competitors = competitors(reproduction);
    if counts.is_empty() {
        return competitors.into_iter().collect();
    }
    let distances = subjects.iter().flat_map(|subject| {
        reproduction.distances(subject).into_iter().map(move |by| distance(subject, &by))
    });
    let distances: Vec<String> = distances.collect();
    let mut sentences = Vec::new();
    if !distances.is_empty() {
        sentences.push(format!("Root mean square error: {}.", distances.join("; ")));
    }
    let (same, all) = reproduction.signs();
    if all > 0 {
        sentences.push(format!(
            "Of the effects with a published p below 0.01, {same} of {all} have the published sign."
        ));
    }
    sentences.push(format!(
        "The joint 95 % interval of the difference, which is wide, includes 0 for {}.",
        counts.join(", ")
    ));
    let equivalent = subjects.iter().filter_map(|subject| {
        let (margin, equivalent, compared) = reproduction.equivalent(subject)?;
        let mut all = reproduction.comparisons.iter();
        let one = all.find(|one| one.subject == **subject)?;
        let margin = match one.is_rate() {
            true => format!("± {} percentage points", shown(100.0 * margin, 1)),
            false => format!("± {} {}", shown(margin, 0), one.return_unit),
        };
        (compared > 0).then(|| format!("{equivalent} of {compared} {subject}s ({margin})"))
    });
    let equivalent: Vec<String> = equivalent.collect();
    if !equivalent.is_empty() {
        sentences.push(format!(
            "Two one-sided tests at 5 % show equivalence within the declared margin for {}.",
            equivalent.join(", ")
        ));
    }
    sentences.extend(competitors);
    sentences
}

/// How our numbers compare with those of other algorithms, in a sentence.
fn competitors(reproduction: &Reproduction) -> Option<String> {
    let [higher, lower, open] = reproduction.competitors();
    let all = higher + lower + open;
    (all > 0).then(|| {
        format!(
            "Beside {} of other algorithms, ours is higher {higher} times, lower {lower} times, and {open} times the joint \
             95 % interval of the difference includes 0.",
            counted(all, "number")
        )
    })
}

/// The overall distance of an agent's numbers from the published numbers.
fn distance(subject: &str, by: &Distance) -> String {
    let Distance { agent, return_unit, mean, root_mean_square, numbers } = by;
    let side = if *mean < 0.0 { "lower" } else { "higher" };
    format!(
        "{agent} {} {return_unit} over {}, ours {} {side} on average",
        shown(*root_mean_square, 0),
        counted(*numbers, subject),
        shown(mean.abs(), 0)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::declared::Comparison;
    use crate::analyse::{Agreement, Interval, Verdict};
    use crate::job::Scalar;
    use crate::job::metric::MEAN_RETURN;

    /// A tile of a heat map with a published value of 100, from which ours differs by `difference`.
    fn tile(difference: f64, verdict: Verdict) -> Comparison {
        let interval = Interval { low: difference - 30.0, high: difference + 30.0 };
        Comparison {
            subject: "heat-map tile".into(),
            competitor: String::new(),
            metric: Some(MEAN_RETURN),
            return_unit: "steps",
            agent: "reinforce".into(),
            scenario: "P-H-D - L-H-D".into(),
            settings: vec![("delta_d", Scalar::Real(0.1)), ("epsilon_d", Scalar::Real(0.2))],
            published: 100.0,
            published_error: Ok(10.0),
            published_p: None,
            ours: Ok(100.0 + difference),
            our_error: Ok(10.0),
            seeds: 3,
            agreement: Ok(Agreement { difference, interval, verdict, equivalence_bound: 80.0 }),
            margin: None,
        }
    }

    #[test]
    fn numbers_of_other_algorithms_stand_beside_ours() {
        let beside = |difference, verdict| Comparison {
            competitor: "another".to_owned(),
            ..tile(difference, verdict)
        };
        let comparisons = vec![
            beside(44.0, Verdict::Outside),
            beside(-40.0, Verdict::Outside),
            beside(-41.0, Verdict::Outside),
            beside(4.0, Verdict::Inside),
        ];
        let says = "Beside 4 numbers of other algorithms, ours is higher 1 times, lower 2 times, and 1 times the joint 95 % \
                    interval of the difference includes 0.";
        assert_eq!(reproduction(&Reproduction { comparisons: comparisons.clone() }), [says]);
        let with_ours = [comparisons, vec![tile(-4.0, Verdict::Inside)]].concat();
        let sentences = reproduction(&Reproduction { comparisons: with_ours });
        assert!(sentences.iter().any(|one| one.contains("1 of 1 heat-map tiles")), "{sentences:?}");
        assert_eq!(sentences.last().map(String::as_str), Some(says));
    }

    #[test]
    fn numbers_that_agree_one_by_one_can_be_too_high_all_together() {
        let comparisons = vec![
            tile(20.0, Verdict::Inside),
            tile(-4.0, Verdict::Inside),
            tile(44.0, Verdict::Outside),
        ];
        let sentences = reproduction(&Reproduction { comparisons });
        // (20 - 4 + 44) / 3; the root of (400 + 16 + 1936) / 3.
        let expected = "Root mean square error: reinforce 28 steps over 3 heat-map tiles, ours 20 \
                        higher on average.";
        assert_eq!(sentences[0], expected);
        assert_eq!(
            sentences[1],
            "The joint 95 % interval of the difference, which is wide, includes 0 for 2 of 3 heat-map \
             tiles."
        );
        let comparisons = vec![tile(-40.0, Verdict::Outside); 2];
        let sentences = reproduction(&Reproduction { comparisons });
        assert!(sentences[0].ends_with("ours 40 lower on average."), "{sentences:?}");
    }
}
