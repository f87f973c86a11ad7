//! Lines of the best mean return that any policy can reach.

use super::line::{Line, PlottedPoint, Spread};
use super::look::{Look, Looks, facets, labels};
use crate::analyse::declared::ArmId;
use crate::report::data_table::shown;
use crate::report::scene::Facets;

/// Lines of the best mean return that any policy can reach, without duplicates. If there are
/// several, their labels name the arms.
pub fn optimum_lines<'n>(
    optima: impl Iterator<Item = (&'n ArmId, Vec<(f64, f64)>)>,
    looks: &Looks,
) -> Vec<Line> {
    // The optimum does not depend on the agent, but agents may have it at different positions.
    let (mut names, mut of_names): (Vec<ArmId>, Vec<Optimum>) = (Vec::new(), Vec::new());
    for (name, points) in optima.filter(|(_, points)| !points.is_empty()) {
        let mut of = ArmId { agent: String::new(), ..name.clone() };
        of.settings.retain(|(key, _)| !key.starts_with("agent."));
        if let Some(at) = names.iter().position(|known| *known == of) {
            of_names[at].points.extend(points);
            continue;
        }
        let (look, facets) = (looks.of_optimum(name), facets(&of));
        of_names.push(Optimum { labels: Vec::new(), look, points, facets });
        names.push(of);
    }
    // Settings that all names share do not distinguish them.
    if let [first, .., _] = names.as_slice() {
        let mut shared = first.settings.clone();
        shared.retain(|setting| names.iter().all(|name| name.settings.contains(setting)));
        for name in &mut names {
            name.settings.retain(|setting| !shared.contains(setting));
        }
    }
    // Names with the same optimum share a line.
    let mut distinct: Vec<Optimum> = Vec::new();
    for (mut one, label) in of_names.into_iter().zip(labels(&names.iter().collect::<Vec<_>>())) {
        one.points.sort_by(|one, other| one.0.total_cmp(&other.0));
        one.points.dedup_by_key(|(x, _)| *x);
        match distinct.iter_mut().find(|known| known.points == one.points) {
            Some(known) => {
                known.labels.push(label);
                // The line stays visible while any of its arms is visible.
                known.facets.clear();
            }
            None => distinct.push(Optimum { labels: vec![label], ..one }),
        }
    }
    let is_alone = distinct.len() == 1;
    distinct.into_iter().map(|optimum| optimum.line(is_alone)).collect()
}

/// A line of optima before it is drawn.
struct Optimum {
    /// Labels of the arms that have this optimum.
    labels: Vec<String>,
    look: Look,
    points: Vec<(f64, f64)>,
    facets: Facets,
}

impl Optimum {
    fn line(self, is_alone: bool) -> Line {
        let label = match self.labels.as_slice() {
            [one] if !is_alone => format!("optimum {one}"),
            [one, other] if !is_alone => format!("optimum {one}, {other}"),
            [one, others @ ..] if !is_alone => format!("optimum {one} and {} more", others.len()),
            _ => "optimum".to_owned(),
        };
        let of = self.labels.join(", ");
        let point = |(x, y): &(f64, f64)| {
            let tip = format!("optimum {of}: {}", shown(*y, 0));
            PlottedPoint { x: *x, y: *y, interval: None, is_single: false, tip }
        };
        Line {
            label,
            look: self.look,
            points: self.points.iter().map(point).collect(),
            reference: Vec::new(),
            spread: Spread::Exact,
            facets: self.facets,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Scalar;

    #[test]
    fn optima_that_are_the_same_share_a_line_and_names_have_one() {
        let name = |agent: &str, scenario: &str, sigma: f64| ArmId {
            agent: agent.into(),
            scenario: scenario.into(),
            settings: vec![
                ("agent.layers".into(), Scalar::Text("[64]".into())),
                ("environment.sigma".into(), Scalar::Real(sigma)),
            ],
        };
        let (dqn, reinforce) = (name("dqn", "P-H-D", 0.6), name("reinforce", "P-H-D", 0.6));
        let (blind, noisier) = (name("dqn", "H-D", 0.6), name("dqn", "H-D", 1.0));
        let optima = [
            // Two agents at different positions.
            (&dqn, vec![(2.0, 90.0), (3.0, 80.0)]),
            (&reinforce, vec![(1.0, 95.0), (3.0, 80.0)]),
            // Without the context in the observation, the optimum does not depend on sigma.
            (&blind, vec![(1.0, 40.0)]),
            (&noisier, vec![(1.0, 40.0)]),
        ];
        let looks = Looks::of(optima.iter().map(|(name, _)| *name));
        let lines = optimum_lines(optima.clone().into_iter(), &looks);
        let labels: Vec<&str> = lines.iter().map(|line| line.label.as_str()).collect();
        assert_eq!(labels, ["optimum P-H-D σ=0.6", "optimum H-D σ=0.6, H-D σ=1"]);
        let points: Vec<(f64, f64)> = lines[0].points.iter().map(|p| (p.x, p.y)).collect();
        assert_eq!(points, [(1.0, 95.0), (2.0, 90.0), (3.0, 80.0)]);
        let alone = optimum_lines(optima.into_iter().take(2), &looks);
        assert_eq!(alone.len(), 1);
        assert_eq!(alone[0].label, "optimum");
    }
}
