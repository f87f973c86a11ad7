//! Captions that say what is seen, in sentences made of the numbers.

use super::data_table::shown;
use super::figure::{Numbers, arm_label, settings_label};
use super::words::unit_numbers;
use crate::analyse::declared::{
    ActionPanel, Chosen, Content, ContrastRow, CurveFigure, CurveLine, CurvePoint, Distance,
    ErrorFigure, Finding, HeatFigure, LearningPanel, Reproduction, Scale, Subject,
};
use crate::analyse::{FEW_SEEDS, Moments, Undefined, detectable, quantile, welch_t_test};

/// Below this, a corrected p value counts as a finding.
const ALPHA: f64 = 0.05;
/// Of more lines than this, a caption would say too much.
const MANY_LINES: usize = 12;

/// What a reader sees in a finding.
pub fn caption(finding: &Finding) -> String {
    let metric = finding.metric;
    let mut sentences = match &finding.content {
        Content::Contrast(rows) => contrast(rows, metric),
        Content::Curve(figure) => curve(figure, metric),
        Content::LearningCurve { window, panels } => learning(panels, *window),
        Content::HeatMap(figures) => {
            figures.iter().filter_map(|figure| heat(figure, metric)).collect()
        }
        Content::ActionChoice(panels) => actions(panels),
        Content::Selection(chosen) => {
            chosen.iter().filter_map(|one| selected(one, metric)).collect()
        }
        Content::InferenceError(figure) => errors(figure),
    };
    let jobs = finding.jobs;
    if jobs.completed < jobs.total() {
        let (missing, total) = (jobs.total() - jobs.completed, jobs.total());
        let failed = match jobs.failed {
            0 => String::new(),
            failed => format!(", {failed} of them failed"),
        };
        sentences.push(format!("Missing: {missing} of {total} jobs{failed}."));
    }
    sentences.join(" ")
}

/// A metric's number with its unit.
fn amount(value: f64, metric: &str) -> String {
    match unit_numbers(metric) {
        (Numbers::Percent, decimals) => format!("{} %", shown(value * 100.0, decimals)),
        (Numbers::Plain, decimals) => shown(value, decimals),
    }
}

fn contrast(rows: &[ContrastRow], metric: &str) -> Vec<String> {
    let Some(row) = rows.first() else { return Vec::new() };
    let (first, second) = &row.sides;
    let answered: Vec<&ContrastRow> =
        rows.iter().filter(|row| row.contrast.difference.is_ok()).collect();
    let above = |row: &&&ContrastRow| row.contrast.difference.is_ok_and(|value| value > 0.0);
    let clear = |row: &&&ContrastRow| row.corrected.is_ok_and(|corrected| corrected.holm < ALPHA);
    let (higher, certain) =
        (answered.iter().filter(above).count(), answered.iter().filter(clear).count());
    let reasons = reasons(rows);
    if answered.is_empty() {
        return vec![format!(
            "{first} and {second} could be compared in none of {} comparisons: {reasons}.",
            rows.len()
        )];
    }
    let mut sentences = vec![format!(
        "{first} is above {second} in {higher} of {} comparisons; {certain} differ by more than \
         chance (Holm-corrected p < {ALPHA} over the family).",
        answered.len()
    )];
    if answered.len() < rows.len() {
        let open = rows.len() - answered.len();
        sentences.push(format!("{open} more could not be made: {reasons}."));
    }
    let largest = answered.iter().max_by(|one, other| {
        let size = |row: &ContrastRow| row.contrast.difference.map_or(0.0, f64::abs);
        size(one).total_cmp(&size(other))
    });
    if let Some((row, Ok(difference))) = largest.map(|row| (row, row.contrast.difference)) {
        let (size, place) = (amount(difference, metric), arm_label(&row.name));
        sentences.push(format!("The largest difference is {size} ({place})."));
    }
    let fewest = answered.iter().map(|row| row.contrast.seeds.0.min(row.contrast.seeds.1)).min();
    if let Some(fewest) = fewest.filter(|fewest| *fewest < FEW_SEEDS) {
        let detectable: Vec<f64> =
            answered.iter().filter_map(|row| row.contrast.detectable.ok()).collect();
        let middle = quantile(&detectable, 0.5).map_or_else(
            |_| String::new(),
            |median| {
                let size = amount(median, metric);
                format!("; the median difference that they detect with 80 % power is {size}")
            },
        );
        sentences.push(format!("Few seeds: {fewest} a side{middle}."));
    }
    sentences
}

/// Why comparisons have no difference, each reason once.
fn reasons(rows: &[ContrastRow]) -> String {
    let mut reasons: Vec<String> = Vec::new();
    for reason in rows.iter().filter_map(|row| row.contrast.difference.err()) {
        let reason = reason.to_string();
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    reasons.join("; ")
}

fn mean(values: &[f64]) -> Option<f64> {
    Moments::of(values).ok().map(|moments| moments.mean)
}

/// What can be said of two means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Apart {
    /// They differ by more than chance.
    Surely,
    /// Chance makes such differences.
    Perhaps,
    /// There are too few seeds for a test.
    Untested,
}

/// Whether the means of two points differ, as one of so many pairs that are looked at: by Welch's t,
/// with Bonferroni's correction. Means of seeds that are all alike differ if they are not the same.
fn apart(one: &CurvePoint, other: &CurvePoint, pairs: usize) -> Apart {
    match welch_t_test(one.sample.values(), other.sample.values()) {
        Ok(test) if test.p * (pairs as f64) < ALPHA => Apart::Surely,
        Err(Undefined::NoVariance) => Apart::Surely,
        Ok(_) => Apart::Perhaps,
        Err(_) => Apart::Untested,
    }
}

/// How many pairs of points are looked at for what is told of the courses of lines, and of how far
/// two are apart.
fn pairs(lines: &[CurveLine]) -> usize {
    let of_ends_and_turns = |line: &CurveLine| 1 + 2 * line.points.len().saturating_sub(2);
    let between = if let [first, _] = lines { first.points.len() } else { 0 };
    lines.iter().map(of_ends_and_turns).sum::<usize>() + between
}

/// How a line goes from its first point to its last, by way of its highest and lowest point where
/// these are above or below both, as one of so many pairs of points.
fn course(
    line: &CurveLine,
    metric: &str,
    at: impl Fn(f64) -> String,
    pairs: usize,
) -> Option<String> {
    let seen = line.points.iter().filter_map(|point| Some((point, mean(point.sample.values())?)));
    let seen: Vec<(&CurvePoint, f64)> = seen.collect();
    let (first, last) = (*seen.first()?, *seen.last()?);
    let told = |(point, mean): (&CurvePoint, f64)| (amount(mean, metric), at(point.x));
    let name = arm_label(&line.name);
    let ((from, start), (to, end)) = (told(first), told(last));
    if seen.len() == 1 {
        return Some(format!("{name} is at {from} at {start}."));
    }
    let highest = seen.iter().copied().max_by(|one, other| one.1.total_cmp(&other.1))?;
    let lowest = seen.iter().copied().min_by(|one, other| one.1.total_cmp(&other.1))?;
    let is_turn = |point: &(&CurvePoint, f64)| {
        [first, last].iter().all(|end| {
            told(*end).0 != told(*point).0 && apart(end.0, point.0, pairs) == Apart::Surely
        })
    };
    let mut turns: Vec<_> = [highest, lowest].into_iter().filter(is_turn).collect();
    turns.sort_by(|one, other| one.0.x.total_cmp(&other.0.x));
    if !turns.is_empty() {
        let turns = turns.into_iter().map(|turn| {
            let (value, place) = told(turn);
            format!("{value} at {place}")
        });
        let way = turns.collect::<Vec<_>>().join(" and ");
        return Some(format!(
            "{name} goes from {from} at {start} by way of {way} to {to} at {end}."
        ));
    }
    if from == to {
        return Some(format!("{name} is at {from} both at {start} and at {end}."));
    }
    let ends = format!("{name} is at {from} at {start} and at {to} at {end}");
    Some(match apart(first.0, last.0, pairs) {
        Apart::Surely => {
            let verb = if last.1 < first.1 { "falls" } else { "rises" };
            format!("{name} {verb} from {from} at {start} to {to} at {end}.")
        }
        Apart::Perhaps => format!("{ends}, which is not told apart from chance."),
        Apart::Untested => format!("{ends}, with too few seeds for a test."),
    })
}

fn curve(figure: &CurveFigure, metric: &str) -> Vec<String> {
    let is_error = figure.axis == "context_inference_error";
    let at = |x: f64| match is_error {
        true => format!("{} % error", shown(x * 100.0, 0)),
        false => x.to_string(),
    };
    let lines = figure.lines.as_slice();
    if lines.len() > MANY_LINES {
        return vec![format!("{} lines; the table has their points.", lines.len())];
    }
    let pairs = pairs(lines);
    let mut sentences: Vec<String> =
        lines.iter().filter_map(|line| course(line, metric, at, pairs)).collect();
    sentences.extend(lines.iter().filter_map(shares));
    if let [first, second] = lines {
        let gap = first.points.iter().filter_map(|point| {
            let other = second.points.iter().find(|other| other.x == point.x)?;
            let gap = mean(point.sample.values())? - mean(other.sample.values())?;
            Some((point.x, gap, apart(point, other, pairs)))
        });
        let widest = gap.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
        if let Some((x, gap, Apart::Surely)) = widest {
            let (size, place) = (amount(gap.abs(), metric), at(x));
            if size != amount(0.0, metric) {
                sentences.push(format!("They are furthest apart at {place}, by {size}."));
            }
        }
    }
    let counts = lines.iter().flat_map(|line| &line.points).map(|point| point.sample.n());
    if let Some(fewest) = counts.filter(|n| *n > 0).min().filter(|n| *n < FEW_SEEDS) {
        let middle = detectable_between(lines, fewest).map_or_else(String::new, |median| {
            let size = amount(median, metric);
            format!("; the median difference that two such points detect with 80 % power is {size}")
        });
        sentences.push(format!("Few seeds: {fewest} a point{middle}."));
    }
    sentences
}

/// The median, over the points of so many seeds, of the difference that is detected between two
/// points that vary as this one does; `None` where none varies.
fn detectable_between(lines: &[CurveLine], seeds: usize) -> Option<f64> {
    let deviations = detectable(seeds, seeds).ok()?;
    let points = lines.iter().flat_map(|line| &line.points);
    let sds = points.filter(|point| point.sample.n() == seeds).filter_map(|point| {
        let sd = Moments::of(point.sample.values()).ok()?.sd.ok()?;
        (sd > 0.0).then_some(sd * deviations)
    });
    quantile(&sds.collect::<Vec<f64>>(), 0.5).ok()
}

/// The shares of the optimum that a line reaches.
fn shares(line: &CurveLine) -> Option<String> {
    let share = |point: &CurvePoint| {
        let (_, best) = line.optimum.iter().find(|(x, best)| *x == point.x && *best > 0.0)?;
        Some(mean(point.sample.values())? / best * 100.0)
    };
    let mut reached: Vec<f64> = line.points.iter().filter_map(share).collect();
    reached.sort_by(f64::total_cmp);
    let (least, most) = (shown(*reached.first()?, 0), shown(*reached.last()?, 0));
    let name = arm_label(&line.name);
    Some(match least == most {
        true => format!("{name} reaches {most} % of the optimum."),
        false => format!("{name} reaches {least} to {most} % of the optimum."),
    })
}

fn learning(panels: &[LearningPanel], window: u32) -> Vec<String> {
    let line = |line: &crate::analyse::declared::LearningLine| {
        let name = arm_label(&line.name);
        if line.points.is_empty() && line.seeds.0 > 0 {
            return Some(format!(
                "{name} has no line: its training is shorter than the window of {window} episodes."
            ));
        }
        let (_, end, _) = line.points.last()?;
        let (_, start, _) = line.points.first()?;
        let goal = start + 0.9 * (end - start);
        let reached = line.points.iter().find(|(_, mean, _)| (mean - start) / (end - start) >= 0.9);
        let when = reached
            .filter(|_| end > start && goal.is_finite())
            .map_or_else(String::new, |(episode, _, _)| {
                format!(", nine tenths of the way by episode {episode}")
            });
        Some(format!("{name} ends at {}{when}.", shown(*end, 0)))
    };
    panels.iter().flat_map(|panel| &panel.lines).filter_map(line).collect()
}

fn heat(figure: &HeatFigure, metric: &str) -> Option<String> {
    let cells = || figure.cells.iter().filter_map(|cell| Some((cell, cell.value.ok()?)));
    let (least, _) = cells().min_by(|one, other| one.1.total_cmp(&other.1)).map(|c| (c.1, c.0))?;
    let (top, most) = cells().max_by(|one, other| one.1.total_cmp(&other.1))?;
    let last = |dotted: &str| dotted.rsplit('.').next().unwrap_or(dotted).to_owned();
    let above = match figure.scale {
        Scale::Difference => {
            let above = cells().filter(|(_, value)| *value > 0.0).count();
            format!(" is above 0 in {above} of {} cells, and", cells().count())
        }
        Scale::Mean => String::new(),
    };
    let subject = format!("{}, {}{above}", figure.agent, figure.subject.replace(" - ", " − "));
    let (least, most) = (amount(least, metric), amount(most, metric));
    if least == most {
        return Some(format!("{subject} is {most} in every cell."));
    }
    let place = match cells().filter(|(_, value)| amount(*value, metric) == most).count() {
        1 => format!("at {} = {} and {} = {}", last(&figure.x.0), top.x, last(&figure.y.0), top.y),
        tied => format!("in {tied} of {} cells", cells().count()),
    };
    Some(format!("{subject} goes from {least} to {most}, the most {place}."))
}

fn actions(panels: &[ActionPanel]) -> Vec<String> {
    let tailored = |panel: &ActionPanel, bin: usize| {
        let shares = panel.bins.get(bin)?.shares?;
        Some((shares[2].0 + shares[3].0) * 100.0)
    };
    let sentence = |panel: &ActionPanel| {
        let middle = panel.bins.len() / 2;
        let (certain, unsure) = (tailored(panel, 0)?, tailored(panel, middle)?);
        let bin = &panel.bins[middle];
        Some(format!(
            "{} tailors {} % of its actions where context 1 is likely, and {} % where the \
             probability is {} to {}.",
            arm_label(&panel.name),
            shown(certain, 0),
            shown(unsure, 0),
            shown(bin.low, 1),
            shown(bin.high, 1)
        ))
    };
    panels.iter().filter_map(sentence).collect()
}

fn selected(chosen: &Chosen, metric: &str) -> Option<String> {
    // Of a single one nothing is chosen.
    let [best, _, ..] = chosen.candidates.as_slice() else { return None };
    let mean = best.mean.ok()?;
    let rule = chosen.rule.replace('_', " ");
    let (place, settings) = (arm_label(&chosen.place), settings_label(&best.settings));
    let (amount, of) = (amount(mean, metric), chosen.candidates.len());
    Some(format!("By the {rule}, {place}: {settings}, {amount} (best of {of})."))
}

fn errors(figure: &ErrorFigure) -> Vec<String> {
    let mut sentences = Vec::new();
    let last = figure.points.iter().max_by(|one, other| one.sigma.total_cmp(&other.sigma));
    if let Some(point) = last {
        let (error, sigma) = (shown(point.exact * 100.0, 1), point.sigma);
        sentences.push(format!("The exact error is {error} % at σ = {sigma}."));
    }
    if figure.points.iter().any(|point| point.seen.is_some()) {
        sentences.push(
            "Seen in tests counts every step; where the first context is fixed, it is known, and \
             less is seen by that step's share."
                .to_owned(),
        );
    }
    let far = figure.published.iter().filter_map(|(sigma, rate)| {
        let point = figure.points.iter().find(|point| point.sigma == *sigma)?;
        Some((*sigma, rate - point.exact))
    });
    if let Some((sigma, gap)) = far.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs())) {
        let gap = shown(gap * 100.0, 1);
        sentences.push(format!(
            "The published rates are counts of 1000 draws; the furthest is off by {gap} points, at \
             σ = {sigma}."
        ));
    }
    sentences
}

/// What a comparison with published numbers came to.
pub fn reproduction(reproduction: &Reproduction) -> Vec<String> {
    let subjects = [Subject::Effect, Subject::CurvePoint, Subject::HeatCell, Subject::ErrorRate];
    let counts = subjects.iter().filter_map(|subject| {
        let (inside, outside, open) = reproduction.counts(*subject);
        let total = inside + outside + open;
        let open = match open {
            0 => String::new(),
            open => format!(" ({open} without an answer yet)"),
        };
        (total > 0).then(|| format!("{inside} of {total} {}s{open}", subject.name()))
    });
    let counts: Vec<String> = counts.collect();
    if counts.is_empty() {
        return Vec::new();
    }
    let mut sentences = vec![format!(
        "Ours and the published number differ by no more than chance (the joint 95 % interval of \
         the difference holds 0) for {}.",
        counts.join(", ")
    )];
    for subject in [Subject::CurvePoint, Subject::HeatCell] {
        sentences.extend(reproduction.distances(subject).iter().map(|by| distance(subject, by)));
    }
    let (same, all) = reproduction.signs();
    if all > 0 {
        sentences.push(format!(
            "Of the effects with a published p below 0.01, {same} of {all} have the published sign."
        ));
    }
    sentences.extend(outside(reproduction));
    sentences
}

/// How far an agent's numbers are from the published ones, all together.
fn distance(subject: Subject, by: &Distance) -> String {
    let Distance { agent, mean, root_mean_square, numbers } = by;
    let side = if *mean < 0.0 { "lower" } else { "higher" };
    format!(
        "{agent}: over {numbers} {}s, root mean square error of {} steps; ours are {} steps {side} in the \
         mean.",
        subject.name(),
        shown(*root_mean_square, 0),
        shown(mean.abs(), 0)
    )
}

/// Most numbers that are listed one by one.
const MOST_OUTSIDE: usize = 20;

/// The numbers that differ by more than chance.
fn outside(reproduction: &Reproduction) -> Option<String> {
    let told = reproduction.outside().map(|(one, difference)| {
        let settings = one.settings.iter().map(|(name, value)| format!("{name} = {value}"));
        let words = [one.subject.name(), &one.agent, &one.scenario].map(str::to_owned);
        let place: Vec<String> =
            words.into_iter().filter(|word| !word.is_empty()).chain(settings).collect();
        let digits = if one.subject == Subject::ErrorRate { 3 } else { 0 };
        let side = if difference < 0.0 { "lower" } else { "higher" };
        format!("{} (ours {} {side})", place.join(" "), shown(difference.abs(), digits))
    });
    let told: Vec<String> = told.collect();
    match told.len() {
        0 => None,
        many if many > MOST_OUTSIDE => {
            Some(format!("Outside are {many} numbers; the table below has them."))
        }
        _ => Some(format!("Outside: {}.", told.join("; "))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::declared::{ArmId, Comparison};
    use crate::analyse::{Agreement, Contrast, Design, Interval, Sample, Verdict};

    /// A line of an arm called `dqn`, with three seeds at 1, 2 and so on: a mean, and how far the
    /// other two seeds are from it.
    fn line(points: &[(f64, f64)]) -> CurveLine {
        let point = |(x, (mean, spread)): (f64, &(f64, f64))| {
            let values = [(1, *mean), (2, mean - spread), (3, mean + spread)];
            CurvePoint { x, parameter: x, sample: Sample::new(values, 0, 0).unwrap() }
        };
        CurveLine {
            name: ArmId { agent: "dqn".into(), scenario: String::new(), settings: Vec::new() },
            points: (1..).map(f64::from).zip(points).map(point).collect(),
            optimum: Vec::new(),
            published: Vec::new(),
        }
    }

    #[test]
    fn a_course_tells_of_trends_and_turns_beyond_chance_alone() {
        for (points, told) in [
            (&[(5.0, 1.0)][..], "is at 5 at 1."),
            (&[(90.0, 1.0), (50.0, 1.0), (20.0, 1.0)], "falls from 90 at 1 to 20 at 3."),
            (&[(20.0, 1.0), (90.0, 1.0)], "rises from 20 at 1 to 90 at 2."),
            (&[(20.0, 1.0), (20.0, 1.0)], "is at 20 both at 1 and at 2."),
            (
                &[(20.0, 9.0), (30.0, 9.0)],
                "is at 20 at 1 and at 30 at 2, which is not told apart from chance.",
            ),
            (
                &[(50.0, 1.0), (90.0, 1.0), (20.0, 1.0)],
                "goes from 50 at 1 by way of 90 at 2 to 20 at 3.",
            ),
            (
                &[(50.0, 1.0), (5.0, 1.0), (90.0, 1.0), (50.0, 1.0)],
                "goes from 50 at 1 by way of 5 at 2 and 90 at 3 to 50 at 4.",
            ),
            // The turn is within chance.
            (&[(50.0, 1.0), (55.0, 40.0), (20.0, 1.0)], "falls from 50 at 1 to 20 at 3."),
            // Without a spread, every difference counts.
            (&[(50.0, 0.0), (55.0, 0.0)], "rises from 50 at 1 to 55 at 2."),
        ] {
            let line = line(points);
            let pairs = pairs(std::slice::from_ref(&line));
            let course = course(&line, "mean_return", |x| x.to_string(), pairs).unwrap();
            assert_eq!(course, format!("dqn {told}"), "{points:?}");
        }
    }

    #[test]
    fn a_difference_counts_for_less_the_more_pairs_are_looked_at() {
        // t is 5.0 with 4 degrees of freedom: p is 0.0075.
        let line = line(&[(20.0, 9.0), (56.742, 9.0)]);
        assert_eq!(apart(&line.points[0], &line.points[1], 6), Apart::Surely);
        assert_eq!(apart(&line.points[0], &line.points[1], 7), Apart::Perhaps);
        let course = |pairs| course(&line, "mean_return", |x| x.to_string(), pairs).unwrap();
        assert!(course(6).contains("rises") && course(7).contains("not told apart"));
    }

    #[test]
    fn one_seed_is_no_trend() {
        let mut line = line(&[(20.0, 1.0), (90.0, 1.0), (30.0, 1.0)]);
        line.points[2].sample = Sample::new([(1, 30.0)], 0, 2).unwrap();
        let figure = CurveFigure { axis: "environment.sigma".into(), lines: vec![line] };
        let told = "dqn is at 20 at 1 and at 30 at 3, with too few seeds for a test.";
        assert_eq!(curve(&figure, "mean_return"), [told, "Few seeds: 1 a point."]);
    }

    #[test]
    fn few_seeds_are_told_with_what_they_detect() {
        // Three seeds detect 3.07 deviations; the median of 10, 20, 40 and 50 is 30.
        let lines = vec![line(&[(90.0, 10.0), (90.0, 50.0), (90.0, 40.0), (90.0, 20.0)])];
        let figure = CurveFigure { axis: "environment.sigma".into(), lines };
        let told = curve(&figure, "mean_return");
        let few = "Few seeds: 3 a point; the median difference that two such points detect with \
                   80 % power is 92.";
        assert_eq!(told.last().unwrap(), few);
    }

    /// A comparison of two sides of two seeds each; the second side is so far from the first.
    fn comparison(spread: f64, difference: f64) -> ContrastRow {
        let first = Sample::new([(1, 50.0 - spread), (2, 50.0 + spread)], 0, 0).unwrap();
        let second = first.seeds().iter().zip(first.values());
        let second = second.map(|(seed, value)| (*seed, value - difference));
        row(first.clone(), Sample::new(second, 0, 0).unwrap())
    }

    fn row(first: Sample, second: Sample) -> ContrastRow {
        ContrastRow {
            sides: ("ok".into(), "boom".into()),
            name: ArmId { agent: "dqn".into(), scenario: String::new(), settings: Vec::new() },
            error: None,
            contrast: Contrast::new(&first, &second, Design::Independent),
            family: String::new(),
            corrected: Err(Undefined::NoSeeds),
            published: None,
            first,
            second,
        }
    }

    #[test]
    fn the_median_of_an_even_number_is_between_the_middle_two() {
        let rows = [comparison(10.0, 1.0), comparison(30.0, 2.0)];
        let detectable = rows.each_ref().map(|row| row.contrast.detectable.unwrap());
        let median = shown((detectable[0] + detectable[1]) / 2.0, 0);
        let told = contrast(&rows, "mean_return").join(" ");
        assert!(told.ends_with(&format!("with 80 % power is {median}.")), "{told}");
    }

    #[test]
    fn comparisons_that_could_not_be_made_are_told_with_the_reason() {
        let failed = || row(Sample::new([(1, 5.0)], 0, 0).unwrap(), Sample::new([], 3, 0).unwrap());
        let told = contrast(&[failed(), failed()], "mean_return");
        let none = "ok and boom could be compared in none of 2 comparisons: no seed completed.";
        assert_eq!(told, [none]);
        let told = contrast(&[failed(), comparison(1.0, 5.0)], "mean_return").join(" ");
        assert!(told.starts_with("ok is above boom in 1 of 1 comparisons;"), "{told}");
        assert!(told.contains(" 1 more could not be made: no seed completed."), "{told}");
    }

    #[test]
    fn two_lines_are_told_to_be_apart_beyond_chance_alone() {
        let figure = |second: &[(f64, f64)]| CurveFigure {
            axis: "environment.sigma".into(),
            lines: vec![line(&[(20.0, 1.0), (20.0, 1.0)]), line(second)],
        };
        let told = |second: &[(f64, f64)]| curve(&figure(second), "mean_return").join(" ");
        let clear = told(&[(20.0, 1.0), (60.0, 1.0)]);
        assert!(clear.contains("They are furthest apart at 2, by 40."), "{clear}");
        let noise = told(&[(20.0, 1.0), (60.0, 90.0)]);
        assert!(!noise.contains("furthest"), "{noise}");
    }

    /// A cell of a heat map that is published as 100, and differs from it by so much.
    fn cell(difference: f64, verdict: Verdict) -> Comparison {
        let interval = Interval { low: difference - 30.0, high: difference + 30.0 };
        Comparison {
            subject: Subject::HeatCell,
            agent: "reinforce".into(),
            scenario: "P-H-D - L-H-D".into(),
            settings: vec![("delta_d", 0.1), ("epsilon_d", 0.2)],
            published: 100.0,
            published_error: Ok(10.0),
            published_p: None,
            ours: Ok(100.0 + difference),
            our_error: Ok(10.0),
            seeds: 3,
            agreement: Ok(Agreement { difference, interval, verdict }),
        }
    }

    #[test]
    fn numbers_that_agree_one_by_one_can_be_too_high_all_together() {
        let comparisons = vec![
            cell(20.0, Verdict::Inside),
            cell(-4.0, Verdict::Inside),
            cell(44.0, Verdict::Outside),
        ];
        let told = reproduction(&Reproduction { comparisons });
        // (20 - 4 + 44) / 3; the root of (400 + 16 + 1936) / 3.
        assert_eq!(
            told[1..],
            [
                "reinforce: over 3 heat-map cells, root mean square error of 28 steps; ours are 20 \
                 steps higher in the mean.",
                "Outside: heat-map cell reinforce P-H-D - L-H-D delta_d = 0.1 epsilon_d = 0.2 (ours \
                 44 higher).",
            ]
        );
        let comparisons = vec![cell(-40.0, Verdict::Outside); MOST_OUTSIDE + 1];
        let told = reproduction(&Reproduction { comparisons });
        assert!(told[1].ends_with("ours are 40 steps lower in the mean."), "{told:?}");
        assert_eq!(told[2], "Outside are 21 numbers; the table below has them.");
    }

    #[test]
    fn many_lines_are_not_told_one_by_one() {
        let lines = vec![line(&[(20.0, 1.0), (90.0, 1.0)]); MANY_LINES + 1];
        let figure = CurveFigure { axis: "environment.sigma".into(), lines };
        assert_eq!(curve(&figure, "mean_return"), ["13 lines; the table has their points."]);
    }
}
