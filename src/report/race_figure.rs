//! The figure of a race: the mean of every arm over its seeds so far, rung by rung, to where it left.
//!
//! In: a race with its results. Out: a drawing, or none before an arm has completed a rung. Arms that left are thin
//! and grey. Means on fresh seeds, of the winner and of agents without draws, are lines across: they are compared with
//! each other, and the means of the race with each other.

use super::figure::{
    Axis, AxisScale, COLORS, Chart, DASHES, FAINT, INK, Line, Look, MOST_ARMS, Marker,
    NumberFormat, PlottedPoint, Spread, Style, axes, draw, seeds,
};
use super::kinds::{amount, metric_words, spread};
use super::race_context::{RaceContext, end, known, mean_of};
use super::scene::{Color, Facets, Scene};
use crate::analyse::mean_interval;
use crate::job::{Measure, Score, counted};
use crate::key::shortened;
use crate::manifest::FigureKeys;
use crate::plan::{Entrant, Fate, RaceOutcome, Rung};

/// Height in mm: the best of many arms are close to each other, beside the worst.
const HEIGHT: f64 = 100.0;

/// The winner, and arms in the race.
const IN_RACE: Color = COLORS[0];

/// What the figures of races show, in sentences.
pub(super) fn caption(metric: Measure) -> String {
    format!(
        "Mean of {} over the seeds so far, after each rung. Blue: the winner, with its 95 % interval after the last rung, \
         or arms in the race. Grey: arms that left, to their last complete rung; a diamond: a job failed. Dashed: means \
         on the fresh seeds, which no arm raced with.",
        metric_words(metric)
    )
}

/// The figure of a race; `None` before an arm has completed a rung.
pub(super) fn race_figure(context: &RaceContext<'_>) -> Option<Scene> {
    let (race, search) = (context.race, context.search);
    // The best arms are drawn last, above the others.
    let courses: Vec<Line> =
        race.arms().into_iter().rev().flat_map(|arm| of_arm(context, arm)).collect();
    if courses.is_empty() {
        return None;
    }
    let reached = match race.outcome {
        RaceOutcome::Running => search.rungs.len(),
        RaceOutcome::Won { .. } | RaceOutcome::Lost => race.rungs.len(),
    };
    let rungs: Vec<f64> = search.rungs.iter().take(reached).map(|seeds| *seeds as f64).collect();
    let mut lines = across(context, &rungs);
    lines.extend(courses);
    let heading = Some(context.label(&race.agent));
    let title = "seeds per arm (logarithmic)";
    let description = format!("race of {}: {} against {title}", race.agent, context.metric.title());
    let blue = match context.won() {
        Some(_) => "winner with 95 % interval",
        None => "in the race",
    };
    let note = format!("Blue: {blue}; grey: left the race; dashed: fresh seeds.");
    let charts = [Chart { heading, description, lines, note }];
    let style = Style::of(&FigureKeys { height: Some(HEIGHT), ..FigureKeys::default() });
    let x = (title.to_owned(), NumberFormat::Plain, AxisScale::Log);
    let (_, y) = axes(&charts, x, context.metric, &style);
    let x = Axis::logarithmic(title.to_owned(), &rungs, NumberFormat::Plain)
        .padded()
        .with_marked(rungs);
    draw(&charts, &(x, y), &style).pop()
}

/// The course of an arm, and a mark at its end; nothing for an arm that has completed no rung.
fn of_arm(context: &RaceContext<'_>, (_, last, entrant): (usize, &Rung, &Entrant)) -> Vec<Line> {
    let is_final = context.race.rungs.last() == Some(last) && last.entrants.len() <= MOST_ARMS;
    let name = format!("arm {}", entrant.arm + 1);
    let label = if is_final { name.clone() } else { String::new() };
    let fate = end(entrant.fate, last.entrants.len());
    let settings = shortened(&context.settings(entrant.arm));
    let point = |(at, one): (usize, &Entrant)| {
        let mean = one.mean()?;
        let n = seeds(std::iter::once(one.values.len()));
        let interval = mean_interval(&one.values);
        let spread = spread(interval, context.metric);
        let mean_words = amount(mean, context.metric);
        let tip = format!("{name} ({settings}): {mean_words}{spread}, {n}; {fate}");
        // Those of few seeds would stretch the axis.
        let is_end = entrant.fate == Fate::Won && std::ptr::eq(one, entrant);
        let interval = interval.ok().filter(|_| is_end).map(|one| (one.low, one.high));
        let x = context.search.rungs[at] as f64;
        Some(PlottedPoint { x, y: mean, interval, is_single: false, tip })
    };
    let mut points: Vec<PlottedPoint> =
        context.race.course(entrant.arm).into_iter().filter_map(point).collect();
    let line = |label, (color, marker), points, spread| Line {
        label,
        look: Look { color, dash: None, marker },
        points,
        reference: Vec::new(),
        spread,
        facets: Facets::new(),
    };
    let look = match entrant.fate {
        Fate::Won => return vec![line(label, (IN_RACE, Marker::Disc), points, Spread::Bars)],
        Fate::Undecided | Fate::GoesOn => (IN_RACE, Marker::Disc),
        Fate::Failed => (left(), Marker::Diamond),
        Fate::Behind | Fate::Worse | Fate::NotShownWorse => (left(), Marker::Disc),
    };
    let Some(last) = points.pop() else { return Vec::new() };
    points.push(PlottedPoint { tip: String::new(), ..last });
    vec![
        line(String::new(), look, points, Spread::Exact),
        line(label, look, vec![last], Spread::Points),
    ]
}

/// The colour of arms that left.
fn left() -> Color {
    FAINT.towards(Color::WHITE, 0.45)
}

/// The means on fresh seeds, from the first to the last of these rungs: of the winner, and of agents without draws.
fn across(context: &RaceContext<'_>, rungs: &[f64]) -> Vec<Line> {
    let winner = match &context.race.outcome {
        RaceOutcome::Won { arm, fresh } => Some((format!("arm {}", arm + 1), IN_RACE, &fresh[..])),
        RaceOutcome::Running | RaceOutcome::Lost => None,
    };
    let references = context.references.iter();
    let references = references.map(|one| (context.label(&one.agent), INK, &one.fresh[..]));
    let dashes = DASHES.iter().flatten().cycle();
    let line = |((name, color, fresh), dash): ((String, Color, &[Score]), &(f64, f64))| {
        let values: Vec<f64> = known(fresh).into_iter().map(|(_, value)| value).collect();
        let y = mean_of(&values).ok()?;
        let n = counted(values.len(), "fresh seed");
        let tip = format!("{name}: {}, {n}", amount(y, context.metric));
        let point =
            |x: &f64| PlottedPoint { x: *x, y, interval: None, is_single: false, tip: tip.clone() };
        let ends = [rungs.first()?, rungs.last()?];
        Some(Line {
            label: format!("{name}, fresh"),
            look: Look { color, dash: Some(*dash), marker: Marker::Disc },
            points: ends.map(point).into(),
            reference: Vec::new(),
            spread: Spread::Level,
            facets: Facets::new(),
        })
    };
    winner.into_iter().chain(references).zip(dashes).filter_map(line).collect()
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::job::JobKey;
    use crate::job::metric::MEAN_RETURN;
    use crate::manifest::parse;
    use crate::plan::{Races, jobs};
    use crate::report::scene::{SceneShape, Stroke};

    const TEXT: &str = r#"
format = 1
name = "t"
scenarios = ["P-H-D"]
environment.sigma = 0.6
search = { samples = 4, rungs = [1, 3], keep = 0.5, fresh = 2 }
[[agent]]
name = "a"
label = "Drawn"
algorithm = "reinforce"
learning_rate = { log_uniform = [1e-4, 1e-2] }
[[agent]]
name = "b"
algorithm = "rule"
rule = "never"
"#;

    /// The figure of the race in which arms earn these returns per seed, and agent `b` earns 6.
    fn figure(returns: [&[f64]; 4]) -> Option<Scene> {
        let manifest = parse("t", TEXT.as_bytes()).unwrap();
        let all: Vec<(JobKey, usize, u64)> = jobs(&manifest)
            .filter(|planned| &*planned.agent == "a")
            .map(|planned| (planned.form.key(), planned.job.seed))
            .enumerate()
            // Each arm has 3 seeds of the race and 2 fresh ones.
            .map(|(at, (key, seed))| (key, at / 5, seed))
            .collect();
        let score = |key: &JobKey| match all.iter().find(|(known, ..)| known == key) {
            None => Score::Value(6.0),
            Some((_, arm, seed)) => {
                let value = returns[*arm].get(*seed as usize - 1);
                value.map_or(Score::Open, |value| Score::Value(*value))
            }
        };
        let scores = |keys: &[JobKey], _| Ok::<_, Infallible>(keys.iter().map(score).collect());
        let races = Races::of(&manifest, scores).unwrap().unwrap();
        let search = manifest.search.as_ref().unwrap();
        let metric = MEAN_RETURN.in_unit("points");
        let (race, references) = (&races.races[0], &races.references[..]);
        race_figure(&RaceContext { race, manifest: &manifest, search, metric, references })
    }

    /// The lines of a colour that belong to a series: the number of points, and whether they are dashed.
    fn lines(scene: &Scene, color: Color) -> Vec<(usize, bool)> {
        let line = |shape: &SceneShape| match shape {
            SceneShape::Line { points, stroke: Stroke { color: found, dash, .. } } => {
                (*found == color).then_some((points.len(), dash.is_some()))
            }
            _ => None,
        };
        let of_series = scene.marks.iter().filter(|mark| mark.series.is_some());
        of_series.filter_map(|mark| line(&mark.shape)).collect()
    }

    fn texts(scene: &Scene) -> Vec<&str> {
        let texts = scene.marks.iter().filter_map(|mark| match &mark.shape {
            SceneShape::Text { text, .. } => Some(text.as_str()),
            _ => None,
        });
        texts.collect()
    }

    fn tips(scene: &Scene, words: &str) -> usize {
        let tips = scene.marks.iter().filter_map(|mark| mark.tip.as_ref());
        tips.filter(|tip| tip.contains(words)).count()
    }

    #[test]
    fn every_arm_ends_where_it_left_and_the_winner_stands_out() {
        let scene = figure([&[1.0], &[4.0, 1.0, 1.0], &[3.0, 3.0, 6.0, 5.0, 9.0], &[2.0]]).unwrap();
        // The winner has its course with an interval at the second rung, and its fresh mean; the other line of ink is
        // the agent without draws. The arm that lost in the last rung has a line.
        let mut winner = lines(&scene, IN_RACE);
        winner.sort_unstable();
        assert_eq!(winner, [(2, false), (2, false), (2, true)]);
        assert_eq!(lines(&scene, INK), [(2, true)]);
        assert_eq!(lines(&scene, left()), [(2, false)]);
        // Means of 4 and 7 beside each other; the other arms have one point each.
        let tipped =
            ["arm 3 (learning_rate=", "arm 2 (", "arm 1 (", "arm 4 (", "arm 3: 7, 2 fresh seeds"];
        assert_eq!(tipped.map(|words| tips(&scene, words)), [2, 2, 1, 1, 2]);
        assert_eq!(tips(&scene, "4, 95 % interval −0.3 to 8, n = 3 seeds; has won"), 1);
        let texts = texts(&scene);
        for label in ["arm 3", "arm 2", "arm 3, fresh", "b, fresh", "Drawn", "1", "3"] {
            assert_eq!(texts.iter().filter(|text| **text == label).count(), 1, "{label} {texts:?}");
        }
        assert!(!texts.contains(&"arm 1"));
    }

    #[test]
    fn a_race_without_a_complete_rung_has_no_winner_and_before_any_arm_no_figure() {
        assert!(figure([&[], &[], &[], &[]]).is_none());
        let scene = figure([&[1.0], &[4.0], &[], &[]]).unwrap();
        let texts = texts(&scene);
        assert!(texts.iter().any(|text| text.starts_with("Blue: in the race;")), "{texts:?}");
        assert_eq!(tips(&scene, "in the race"), 2);
    }
}
