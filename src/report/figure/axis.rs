//! Axes, which map numbers to positions, with round numbers as ticks.

use super::ticks::{linear, logarithmic, round_step};
use super::{FAINT, GRID, INK, NumberFormat, TEXT, fitting, rising_title, text};
use crate::job::Scalar;
use crate::report::data_table::{shown, signed};
use crate::report::scene::{Anchor, Mark, SceneShape, Stroke, Weight, width};

/// An axis of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Title with unit.
    title: String,
    /// The numbers at its ends, which are finite and differ.
    range: (f64, f64),
    /// The mapping of numbers to positions.
    scale: AxisScale,
    /// How its numbers are written.
    numbers: NumberFormat,
    /// Ascending numbers before the range, each at a position of its own before a break of the axis: 0 on a
    /// logarithmic axis.
    aside: Vec<f64>,
    /// The ascending numbers of the points, if they are few: the ticks where they fit.
    marked: Vec<f64>,
}

/// The mapping of numbers to positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisScale {
    /// Linear.
    Linear,
    /// Logarithmic.
    Log,
}

/// A labelled number of an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// Its position along the axis: 0 at the first end, 1 at the second.
    pub share: f64,
    /// Its label.
    pub label: String,
    /// Whether it is 0.
    pub is_zero: bool,
}

/// The rectangle between the axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Position of its left edge.
    pub left: f64,
    /// Position of its upper edge.
    pub top: f64,
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
}

/// The largest number of an axis. Larger differences could overflow.
const MOST: f64 = 1e300;

impl Axis {
    /// An axis that reaches from `low` to `high`. Numbers that are not finite, and an empty range, are replaced
    /// by an axis around the number that is left.
    pub fn new(title: String, range: (f64, f64), scale: AxisScale, numbers: NumberFormat) -> Axis {
        let (low, high) = match range {
            (low, high) if low.is_finite() && high.is_finite() => (low.min(high), low.max(high)),
            (low, _) if low.is_finite() => (low, low),
            (_, high) if high.is_finite() => (high, high),
            _ => (0.0, 1.0),
        };
        let (low, high) = (low.clamp(-MOST, MOST), high.clamp(-MOST, MOST));
        let scale = if low > 0.0 { scale } else { AxisScale::Linear };
        let range = match scale {
            _ if low < high => (low, high),
            AxisScale::Log => (low / 2.0, low * 2.0),
            AxisScale::Linear if low == 0.0 => (-1.0, 1.0),
            AxisScale::Linear => {
                let half = (low.abs() / 2.0).max(f64::MIN_POSITIVE);
                (low - half, low + half)
            }
        };
        Axis { title, range, scale, numbers, aside: Vec::new(), marked: Vec::new() }
    }

    /// A logarithmic axis of these numbers. Numbers that are not above 0, or far below all others, stand aside.
    pub fn logarithmic(title: String, values: &[f64], numbers: NumberFormat) -> Axis {
        let (aside, rest) = apart(values);
        let low = rest.first().copied().unwrap_or(1.0);
        let high = rest.last().copied().unwrap_or(low);
        Axis { aside, ..Axis::new(title, (low, high), AxisScale::Log, numbers) }
    }

    /// The axis, extended slightly beyond its ends so that marks at the ends do not cover labels.
    pub fn padded(mut self) -> Axis {
        const PART: f64 = 0.03;
        let (low, high) = self.range;
        self.range = match self.scale {
            AxisScale::Linear => (low - PART * (high - low), high + PART * (high - low)),
            AxisScale::Log => {
                let more = (PART * (high.log10() - low.log10())).min(1.0);
                let more = 10_f64.powf(more);
                ((low / more).max(f64::MIN_POSITIVE.min(low)), (high * more).min(f64::MAX))
            }
        };
        self
    }

    /// The axis with ticks at these numbers, if they are few and fit.
    pub fn with_marked(self, mut numbers: Vec<f64>) -> Axis {
        const MOST_MARKED: usize = 12;
        numbers.sort_by(f64::total_cmp);
        numbers.dedup();
        numbers.retain(|number| !self.aside.contains(number));
        let marked = if numbers.len() > MOST_MARKED { Vec::new() } else { numbers };
        Axis { marked, ..self }
    }

    /// The ticks at the numbers of the points, and at those that stand aside; none if labels count from another
    /// number.
    fn marked_ticks(&self) -> Vec<Tick> {
        if self.marked.is_empty() || self.base().is_some() {
            return Vec::new();
        }
        let label = |number: f64| match self.numbers {
            NumberFormat::Plain => signed(&Scalar::Real(number).to_string()),
            NumberFormat::Percent => shown(number * 100.0, usize::from(number != 0.0)),
        };
        let tick = |number: &f64| Tick {
            share: self.share(*number),
            label: label(*number),
            is_zero: *number == 0.0,
        };
        self.aside.iter().chain(&self.marked).map(tick).collect()
    }

    /// The numbers at its ends.
    pub fn range(&self) -> (f64, f64) {
        self.range
    }

    /// The axis with other ends.
    pub fn with_range(self, range: (f64, f64)) -> Axis {
        Axis::new(self.title, range, self.scale, self.numbers)
    }

    /// The position of a number along the axis: 0 at the first end, 1 at the second.
    pub fn share(&self, number: f64) -> f64 {
        let before = self.before();
        if let Some(at) = self.aside.iter().position(|one| *one == number) {
            return before * (at as f64 + 0.35) / self.aside.len() as f64;
        }
        let (low, high) = self.range;
        let share = match self.scale {
            AxisScale::Linear => (number - low) / (high - low),
            AxisScale::Log => (number.log10() - low.log10()) / (high.log10() - low.log10()),
        };
        before + (1.0 - before) * share
    }

    /// The share of the axis before its break; 0 if it has none.
    pub fn before(&self) -> f64 {
        const EACH: f64 = 0.24;
        const MOST: f64 = 0.5;
        (EACH * self.aside.len() as f64).min(MOST)
    }

    /// The title with unit. If the numbers of the axis are nearly equal, their labels count from a number that
    /// the title names.
    pub fn title(&self) -> String {
        match self.base() {
            Some((words, base)) if base < 0.0 => {
                format!("{} + {}", self.title, words.trim_start_matches('-'))
            }
            Some((words, _)) => format!("{} − {words}", self.title),
            None => self.title.clone(),
        }
    }

    /// The number, in displayed unit, from which labels count if the numbers of the axis are nearly equal.
    fn base(&self) -> Option<(String, f64)> {
        /// Labels have about this many digits at most.
        const NEARLY_EQUAL: f64 = 1e-5;
        let (low, high) = self.displayed();
        let span = high - low;
        if self.scale == AxisScale::Log || span >= low.abs().max(high.abs()) * NEARLY_EQUAL {
            return None;
        }
        let decimals = (-span.log10().ceil()).clamp(0.0, 300.0) as usize;
        let text = format!("{low:.decimals$}");
        let text = match text.contains('.') {
            true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
            false => text,
        };
        let base = text.parse().ok()?;
        Some((text, base))
    }

    /// The ends in displayed unit.
    fn displayed(&self) -> (f64, f64) {
        let unit = match self.numbers {
            NumberFormat::Plain => 1.0,
            NumberFormat::Percent => 100.0,
        };
        (self.range.0 * unit, self.range.1 * unit)
    }

    /// About `wanted` round numbers along the axis, and the numbers that stand aside.
    pub fn ticks(&self, wanted: usize) -> Vec<Tick> {
        let (low, high) = self.displayed();
        let before = self.before();
        let behind_break = |share: f64| before + (1.0 - before) * share;
        let aside = self.aside.iter().map(|number| Tick {
            share: self.share(*number),
            label: signed(&Scalar::Real(*number).to_string()),
            is_zero: *number == 0.0,
        });
        let of_range: Vec<Tick> = match self.scale {
            AxisScale::Linear => {
                let base = self.base().map_or(0.0, |(_, base)| base);
                let ends = (low - base, high - base);
                let tick = |(number, label): (f64, String)| Tick {
                    share: behind_break((number - ends.0) / (ends.1 - ends.0)),
                    label,
                    is_zero: number == 0.0 && base == 0.0,
                };
                linear(ends, wanted).into_iter().map(tick).collect()
            }
            AxisScale::Log => {
                let span = high.log10() - low.log10();
                let tick = |(number, label): (f64, String)| Tick {
                    share: behind_break((number.log10() - low.log10()) / span),
                    label,
                    is_zero: false,
                };
                logarithmic((low, high), wanted).into_iter().map(tick).collect()
            }
        };
        aside.chain(of_range).collect()
    }

    /// The distance of about `wanted` round numbers along a linear axis.
    pub fn step(&self, wanted: usize) -> f64 {
        round_step((self.range.1 - self.range.0) / wanted as f64)
    }

    /// As many round numbers, at most `wanted`, as fit an axis of this length without touching each other.
    pub fn ticks_along(&self, length: f64, wanted: usize) -> Vec<Tick> {
        const BETWEEN: f64 = 3.5;
        let fit = |one: &Tick, other: &Tick| {
            let halves = (tick_width(one) + tick_width(other)) / 2.0;
            (other.share - one.share) * length >= halves + BETWEEN
        };
        let fits = |ticks: &[Tick]| ticks.windows(2).all(|pair| fit(&pair[0], &pair[1]));
        let marked = self.marked_ticks();
        if !marked.is_empty() && fits(&marked) {
            return marked;
        }
        let counts = (1..=wanted.max(1)).rev().map(|wanted| self.ticks(wanted));
        for ticks in counts {
            if fits(&ticks) {
                return ticks;
            }
        }
        // Ticks of no number fit all together: those that touch an earlier one are left out.
        let mut kept: Vec<Tick> = Vec::new();
        for tick in self.ticks(wanted.min(3)) {
            if kept.last().is_none_or(|last| fit(last, &tick)) {
                kept.push(tick);
            }
        }
        kept
    }
}

/// Width of the label of a tick.
pub fn tick_width(tick: &Tick) -> f64 {
    width(&tick.label, TEXT, Weight::Regular)
}

/// The distinct numbers in two ascending lists: those that stand aside on a logarithmic axis, and all others.
/// Numbers that are not above 0 stand aside, and numbers many powers of ten below at least two others.
fn apart(values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    const POWERS: f64 = 9.0;
    let mut values: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let mut at = values.iter().take_while(|value| **value <= 0.0).count();
    while values.len() > at + 2 && values[at + 1].log10() - values[at].log10() > POWERS {
        at += 1;
    }
    let rest = values.split_off(at);
    (values, rest)
}

/// The range from `low` to `high`, extended to round numbers.
pub fn round_range(low: f64, high: f64) -> (f64, f64) {
    let (low, high) = (low.clamp(-MOST, MOST), high.clamp(-MOST, MOST));
    let size = low.abs().max(high.abs());
    let span = match high - low {
        span if span > 0.0 => span,
        _ if size > 0.0 => size,
        _ => 1.0,
    };
    let step = round_step(span / 8.0);
    let (least, most) = ((low / step).floor() * step, (high / step).ceil() * step);
    if least < most { (least, most) } else { (least - step, most + step) }
}

impl Frame {
    /// The position of a point.
    pub fn position(&self, (x, y): (&Axis, &Axis), at: (f64, f64)) -> (f64, f64) {
        // Points beyond the ends are drawn at the edge.
        let down = (1.0 - y.share(at.1)).clamp(0.0, 1.0);
        (self.left + x.share(at.0) * self.width, self.top + down * self.height)
    }

    /// The ticks of the horizontal axis, as many as fit.
    pub fn ticks_across(x: &Axis, width: f64) -> Vec<Tick> {
        let room = if x.scale == AxisScale::Log { 42.0 } else { 37.0 };
        x.ticks_along(width, (width / room) as usize)
    }

    /// Grid, ticks and titles.
    pub fn axes(&self, (x, y): (&Axis, &Axis)) -> Vec<Mark> {
        let mut marks: Vec<Mark> = Vec::new();
        let plain = (TEXT, Weight::Regular);
        let bottom = self.top + self.height;
        for Tick { share, label, .. } in y.ticks(HEIGHT_TICKS) {
            let height = self.top + (1.0 - share) * self.height;
            let points = vec![(self.left, height), (self.left + self.width, height)];
            marks.push(SceneShape::Line { points, stroke: Stroke::solid(GRID, 0.6) }.into());
            let at = (self.left - 4.0, height + TEXT * 0.35);
            marks.push(text(at, label, plain, FAINT, Anchor::End).into());
        }
        for Tick { share, label, .. } in Frame::ticks_across(x, self.width) {
            let across = self.left + share * self.width;
            let points = vec![(across, bottom), (across, bottom + 3.0)];
            marks.push(SceneShape::Line { points, stroke: Stroke::solid(FAINT, 0.7) }.into());
            let at = (across, bottom + 4.0 + TEXT);
            marks.push(text(at, label, plain, FAINT, Anchor::Middle).into());
        }
        marks.extend(self.bottom_line(x));
        let at = (self.left + self.width / 2.0, bottom + 6.5 + 2.0 * TEXT);
        marks.push(fitting(at, x.title(), (TEXT, self.width + 40.0), INK).into());
        let middle = (11.0, self.top + self.height / 2.0);
        let title = rising_title(middle, y.title(), self.height + 24.0);
        marks.push(title.into());
        marks
    }

    /// The line below the frame, with two strokes at a break of the axis.
    fn bottom_line(&self, x: &Axis) -> Vec<Mark> {
        /// Half of the gap, and half of the height of the strokes beside it.
        const GAP: f64 = 1.6;
        const HALF: f64 = 3.0;
        let (left, right) = (self.left, self.left + self.width);
        let bottom = self.top + self.height;
        let line = |points: Vec<(f64, f64)>| -> Mark {
            SceneShape::Line { points, stroke: Stroke::solid(FAINT, 0.8) }.into()
        };
        let level = |from: f64, to: f64| line(vec![(from, bottom), (to, bottom)]);
        if x.aside.is_empty() {
            return vec![level(left, right)];
        }
        let middle = left + (x.before() - 0.02) * self.width;
        let stroke = |at: f64| line(vec![(at - 1.0, bottom + HALF), (at + 1.0, bottom - HALF)]);
        vec![
            level(left, middle - GAP),
            stroke(middle - GAP),
            stroke(middle + GAP),
            level(middle + GAP, right),
        ]
    }
}

/// Approximate number of ticks of a vertical axis.
pub(super) const HEIGHT_TICKS: usize = 5;

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(range: (f64, f64), scale: AxisScale) -> Axis {
        Axis::new("σ".to_owned(), range, scale, NumberFormat::Plain)
    }

    fn labels(axis: &Axis, wanted: usize) -> String {
        let labels: Vec<String> = axis.ticks(wanted).into_iter().map(|tick| tick.label).collect();
        labels.join(" ")
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let linear = |low, high| axis((low, high), AxisScale::Linear);
        assert_eq!(linear(0.0, 0.42).ticks(5).len(), 5);
        assert_eq!(labels(&linear(0.0, 3100.0), 5), "0 1000 2000 3000");
        let log = axis((100.0, 15000.0), AxisScale::Log);
        assert_eq!(labels(&log, 5), "100 300 1000 3000 10000");
        assert_eq!(round_range(-30.0, 812.0), (-200.0, 1000.0));
        assert_eq!(round_range(0.0, 3254.0), (0.0, 3500.0));
        let (low, high) = round_range(5.0, 5.0);
        assert!(low <= 5.0 && high >= 5.0 && low < high);
    }

    #[test]
    fn numbers_are_written_to_their_step() {
        let mut axis = axis((0.0, 1.0), AxisScale::Linear);
        assert_eq!(labels(&axis, 4), "0 0.25 0.50 0.75 1.00");
        axis.numbers = NumberFormat::Percent;
        assert_eq!(labels(&axis, 5), "0 20 40 60 80 100");
        let axis = self::axis((1e-5, 100.0), AxisScale::Log);
        let written = "1e-5 3e-5 1e-4 3e-4 0.001 0.003 0.01 0.03 0.1 0.3 1 3 10 30 100";
        assert_eq!(labels(&axis, 20), written);
        assert_eq!(axis.ticks(8).len(), 8);
        assert_eq!(labels(&axis, 4), "1e-5 0.001 0.1 10");
    }

    #[test]
    fn large_and_small_numbers_have_an_exponent() {
        let label = |low, high| labels(&axis((low, high), AxisScale::Linear), 4);
        assert_eq!(label(0.0, 6.2e6), "0 2e6 4e6 6e6");
        assert_eq!(label(-1e6, 1.5e6), "−1e6 0 1e6");
        assert_eq!(label(0.0, 1e6), "0 2.5e5 5e5 7.5e5 1e6");
        assert_eq!(label(0.0, 8e5), "0 200000 400000 600000 800000");
        assert_eq!(label(0.0, 1e-7), "0 2.5e-8 5e-8 7.5e-8 1e-7");
        assert_eq!(label(-1e300, 1e300), "−1e300 −5e299 0 5e299 1e300");
        assert_eq!(label(0.0, f64::INFINITY), label(0.0, 0.0));
        let log = axis((1e5, 1e8), AxisScale::Log);
        assert_eq!(labels(&log, 8), "100000 300000 1e6 3e6 1e7 3e7 1e8");
    }

    #[test]
    fn labels_of_nearly_equal_numbers_count_from_a_number_in_the_title() {
        let close = axis((0.6, 0.600_000_000_000_000_1), AxisScale::Linear);
        assert_eq!(close.title(), "σ − 0.6");
        assert_eq!(labels(&close, 4), "0 5e-17 1e-16");
        assert_eq!((close.share(0.6), close.share(0.600_000_000_000_000_1)), (0.0, 1.0));
        let large = axis((1_000_000.001, 1_000_000.009), AxisScale::Linear);
        assert_eq!(large.title(), "σ − 1000000");
        assert_eq!(labels(&large, 4), "0.002 0.004 0.006 0.008");
        let negative = axis((-500.000_3, -500.000_1), AxisScale::Linear);
        assert_eq!(negative.title(), "σ + 500");
        assert_eq!(axis((0.6, 0.601), AxisScale::Linear).title(), "σ");
    }

    #[test]
    fn a_constant_has_an_axis_around_it_and_tiny_numbers_keep_their_place() {
        for value in [0.0, 5.0, -3e7, 1e-300, f64::MIN_POSITIVE, 1e300] {
            for scale in [AxisScale::Linear, AxisScale::Log] {
                let axis = axis((value, value), scale);
                let ticks = axis.ticks(5);
                assert!((0.2..0.8).contains(&axis.share(value)), "{value} {axis:?}");
                assert!((1..20).contains(&ticks.len()), "{value} {ticks:?}");
                assert!(ticks.iter().all(|tick| (-0.1..1.1).contains(&tick.share)), "{ticks:?}");
            }
            let (low, high) = round_range(value, value);
            assert!(low < high && low <= value && value <= high, "{value}: {low} {high}");
        }
    }

    #[test]
    fn zero_and_numbers_far_below_stand_aside_on_a_logarithmic_axis() {
        let make_axis =
            |values: &[f64]| Axis::logarithmic(String::new(), values, NumberFormat::Plain);
        let zero = make_axis(&[0.1, 0.0, 0.001]).padded();
        let shares = [0.0, 0.001, 0.01, 0.1].map(|value| zero.share(value));
        assert!(shares.windows(2).all(|pair| pair[1] - pair[0] > 0.08), "{shares:?}");
        assert!(shares[0] > 0.0 && shares[3] < 1.0);
        assert_eq!(labels(&zero, 8), "0 0.001 0.003 0.01 0.03 0.1");
        let far = make_axis(&[1e-300, 1e-3, 1e-2, 1e-1]).padded();
        assert_eq!(labels(&far, 3), "1e-300 0.001 0.01 0.1");
        assert!(far.share(1e-2) - far.share(1e-3) > 0.3);
        // Two numbers alone are the ends of their axis.
        let two = make_axis(&[1e-300, 1e-3]).padded();
        assert!(two.before() == 0.0 && two.share(1e-3) - two.share(1e-300) > 0.8);
        assert!(two.ticks(4).len() >= 3);
        assert_eq!(make_axis(&[-2.0, 0.0, 1.0, 100.0]).before(), 0.48);
        // Every number of the first axis is labelled in a column of a journal.
        let along: Vec<String> =
            far.ticks_along(189.0, 4).into_iter().map(|tick| tick.label).collect();
        assert_eq!(along.join(" "), "1e-300 0.001 0.003 0.01 0.03 0.1");
        assert_eq!(make_axis(&[]).before(), 0.0);
    }

    #[test]
    fn a_logarithmic_axis_within_a_power_of_ten_has_round_numbers() {
        assert_eq!(labels(&axis((0.12, 0.25), AxisScale::Log), 3), "0.15 0.20 0.25");
    }

    #[test]
    fn as_many_labels_stand_along_an_axis_as_fit() {
        let axis = axis((0.0, 8e5), AxisScale::Linear);
        for length in [10.0, 40.0, 80.0, 160.0, 300.0] {
            let ticks = axis.ticks_along(length, 8);
            let apart = ticks.windows(2).all(|pair| {
                let halves = (tick_width(&pair[0]) + tick_width(&pair[1])) / 2.0;
                (pair[1].share - pair[0].share) * length > halves
            });
            assert!(!ticks.is_empty() && apart, "{length} {ticks:?}");
        }
    }
}
