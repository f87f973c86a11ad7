//! Axes, which map numbers to positions, with round numbers as ticks.

use super::{FAINT, GRID, INK, Numbers, TEXT, fitting, rising_title, text};
use crate::report::data_table::shown;
use crate::report::scene::{Anchor, Mark, Shape, Stroke, Weight};

/// An axis of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Title with unit.
    pub title: String,
    /// The numbers at its ends.
    pub range: (f64, f64),
    /// The mapping of numbers to positions.
    pub scale: AxisScale,
    /// How its numbers are written.
    pub numbers: Numbers,
}

/// The mapping of numbers to positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisScale {
    /// Linear.
    Linear,
    /// Logarithmic.
    Log,
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

impl Axis {
    /// The position of a number along the axis: 0 at the first end, 1 at the second.
    pub fn share(&self, number: f64) -> f64 {
        let (low, high) = self.range;
        match self.scale {
            AxisScale::Linear => (number - low) / (high - low),
            AxisScale::Log => (number / low).log10() / (high / low).log10(),
        }
    }

    /// About `wanted` round numbers along the axis.
    pub fn ticks(&self, wanted: usize) -> Vec<f64> {
        let (low, high) = self.range;
        match self.scale {
            AxisScale::Linear => {
                let step = round_step((high - low) / wanted as f64);
                let first = (low / step - 1e-9).ceil() as i64;
                let last = (high / step + 1e-9).floor() as i64;
                (first..=last).map(|at| at as f64 * step).collect()
            }
            AxisScale::Log => {
                let powers = || low.log10().floor() as i32..=high.log10().ceil() as i32;
                let inside = |tick: &f64| (low * 0.999..=high * 1.001).contains(tick);
                let tick = |power: i32, digit: f64| digit * 10_f64.powi(power);
                let halves = powers().flat_map(|power| [tick(power, 1.0), tick(power, 3.0)]);
                let ticks: Vec<f64> = halves.filter(inside).collect();
                if ticks.len() <= wanted + 1 {
                    return ticks;
                }
                let whole: Vec<f64> =
                    powers().map(|power| tick(power, 1.0)).filter(inside).collect();
                let every = whole.len().div_ceil(wanted.max(1));
                whole.into_iter().step_by(every).collect()
            }
        }
    }

    /// The label of a number.
    pub fn written(&self, number: f64, step: f64) -> String {
        let (number, step) = match self.numbers {
            Numbers::Plain => (number, step),
            Numbers::Percent => (number * 100.0, step * 100.0),
        };
        if self.scale == AxisScale::Log && number < 1e-3 {
            return format!("{number:.0e}");
        }
        let decimals = (0..4).find(|digits| {
            let scaled = step * 10_f64.powi(*digits);
            (scaled - scaled.round()).abs() < 1e-6
        });
        shown(number, decimals.unwrap_or(4) as usize)
    }
}

/// The range from `low` to `high`, extended to round numbers.
pub fn round_range(low: f64, high: f64) -> (f64, f64) {
    let span = if high > low { high - low } else { high.abs().max(1.0) };
    let step = round_step(span / 8.0);
    ((low / step).floor() * step, (high / step).ceil() * step)
}

/// The smallest of 1, 2, 2.5, 5 and 10 times a power of ten that is at least `step`, with 1 % tolerance.
fn round_step(step: f64) -> f64 {
    let power = 10_f64.powf(step.log10().floor());
    let digit = [1.0, 2.0, 2.5, 5.0, 10.0].into_iter().find(|digit| digit * power >= step * 0.99);
    digit.unwrap_or(10.0) * power
}

impl Frame {
    /// The position of a point.
    pub fn place(&self, (x, y): (&Axis, &Axis), at: (f64, f64)) -> (f64, f64) {
        // Points beyond the ends are drawn at the edge.
        let down = (1.0 - y.share(at.1)).clamp(0.0, 1.0);
        (self.left + x.share(at.0) * self.width, self.top + down * self.height)
    }

    /// Grid, ticks and titles.
    pub fn axes(&self, (x, y): (&Axis, &Axis)) -> Vec<Mark> {
        let mut marks: Vec<Mark> = Vec::new();
        let plain = (TEXT, Weight::Regular);
        let bottom = self.top + self.height;
        let ticks = y.ticks(5);
        let step = ticks.get(1).map_or(1.0, |second| second - ticks[0]);
        for tick in &ticks {
            let height = self.top + (1.0 - y.share(*tick)) * self.height;
            let points = vec![(self.left, height), (self.left + self.width, height)];
            marks.push(Shape::Line { points, stroke: Stroke::solid(GRID, 0.6) }.into());
            let at = (self.left - 4.0, height + TEXT * 0.35);
            marks.push(text(at, y.written(*tick, step), plain, FAINT, Anchor::End).into());
        }
        let room = if x.scale == AxisScale::Log { 42.0 } else { 37.0 };
        let ticks = x.ticks((self.width / room) as usize);
        let step = ticks.get(1).map_or(1.0, |second| second - ticks[0]);
        for tick in &ticks {
            let across = self.left + x.share(*tick) * self.width;
            let points = vec![(across, bottom), (across, bottom + 3.0)];
            marks.push(Shape::Line { points, stroke: Stroke::solid(FAINT, 0.7) }.into());
            let at = (across, bottom + 4.0 + TEXT);
            let step = if x.scale == AxisScale::Log { *tick } else { step };
            marks.push(text(at, x.written(*tick, step), plain, FAINT, Anchor::Middle).into());
        }
        let points = vec![(self.left, bottom), (self.left + self.width, bottom)];
        marks.push(Shape::Line { points, stroke: Stroke::solid(FAINT, 0.8) }.into());
        let at = (self.left + self.width / 2.0, bottom + 6.5 + 2.0 * TEXT);
        marks.push(fitting(at, &x.title, (TEXT, self.width + 40.0), INK).into());
        let middle = (11.0, self.top + self.height / 2.0);
        let title = rising_title(middle, y.title.clone(), self.height + 24.0);
        marks.push(title.into());
        marks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(range: (f64, f64), scale: AxisScale) -> Axis {
        Axis { title: String::new(), range, scale, numbers: Numbers::Plain }
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(axis((0.0, 0.42), AxisScale::Linear).ticks(5).len(), 5);
        let ticks = axis((0.0, 3100.0), AxisScale::Linear).ticks(5);
        assert_eq!(ticks, [0.0, 1000.0, 2000.0, 3000.0]);
        let ticks = axis((100.0, 15000.0), AxisScale::Log).ticks(5);
        assert_eq!(ticks, [100.0, 300.0, 1000.0, 3000.0, 10000.0]);
        assert_eq!(round_range(-30.0, 812.0), (-200.0, 1000.0));
        assert_eq!(round_range(0.0, 3254.0), (0.0, 3500.0));
        let (low, high) = round_range(5.0, 5.0);
        assert!(low <= 5.0 && high >= 5.0);
    }

    #[test]
    fn numbers_are_written_to_their_step() {
        let mut axis = axis((0.0, 1.0), AxisScale::Linear);
        assert_eq!(axis.written(0.25, 0.25), "0.25");
        axis.numbers = Numbers::Percent;
        assert_eq!(axis.written(0.2, 0.1), "20");
        let axis = self::axis((1e-5, 100.0), AxisScale::Log);
        let ticks: Vec<String> =
            axis.ticks(20).iter().map(|tick| axis.written(*tick, *tick)).collect();
        let written = "1e-5 3e-5 1e-4 3e-4 0.001 0.003 0.01 0.03 0.1 0.3 1 3 10 30 100";
        assert_eq!(ticks.join(" "), written);
        assert_eq!(axis.ticks(8).len(), 8);
        let ticks: Vec<String> =
            axis.ticks(4).iter().map(|tick| axis.written(*tick, *tick)).collect();
        assert_eq!(ticks.join(" "), "1e-5 0.001 0.1 10");
    }
}
