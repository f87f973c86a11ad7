//! The numbers of a model's lanes, and the execution of its program on them.

use std::ops::Range;
use std::sync::Arc;

use pulp::{Simd, WithSimd};

use crate::env::declared::expression::{Binary, Summary, Unary};
use crate::env::declared::model::{Clock, Moment, ProbabilityTable};
use crate::env::declared::numbers;
use crate::env::declared::program::{
    Check, DrawInstruction, DrawSource, Instruction, LaneProgram, Operand, Ring,
};
use crate::env::declared::rows::Numbers;
use crate::env::variates::Expansion;
use crate::kernel::Isa;

/// The number of lanes that an instruction computes at a time, so that buffers stay in the fastest memory.
const TILE: usize = 128;

/// The numbers of all lanes.
#[derive(Clone, Debug)]
pub(super) struct LaneColumns {
    program: Arc<LaneProgram>,
    /// \[columns\], each \[lanes\].
    pub all: Vec<Vec<f64>>,
    /// \[buffers\], each \[tile\].
    buffers: Vec<Vec<f64>>,
    /// \[tile\].
    valid: Vec<bool>,
}

/// Buffers for the numbers of a few lanes.
#[derive(Clone, Debug)]
pub(super) struct FewLanes {
    columns: LaneColumns,
    times: Vec<u32>,
    words: Vec<u64>,
    rows: Vec<u32>,
    /// Every lane takes part.
    all: Vec<bool>,
}

impl FewLanes {
    /// Buffers for lanes of a program.
    pub fn new(program: Arc<LaneProgram>) -> FewLanes {
        FewLanes {
            columns: LaneColumns::new(program, TILE),
            times: vec![0; TILE],
            words: vec![0; TILE],
            rows: vec![0; TILE],
            all: vec![true; TILE],
        }
    }
}

/// What an execution needs beside the columns, \[lanes\] each.
#[derive(Debug)]
pub(super) struct Inputs<'a> {
    /// The lanes that are computed.
    pub span: Range<usize>,
    /// The number of steps of the lanes so far.
    pub clock: u64,
    /// The number of decisions before the present one.
    pub times: &'a [u32],
    /// The words of the draws.
    pub words: &'a [u64],
    /// Lanes whose draws are made.
    pub drawn: &'a [bool],
    /// Lanes whose numbers are checked.
    pub checked: &'a [bool],
    /// The rows that are replayed, and the row of each lane; empty without rows.
    pub replay: Option<(&'a Numbers, &'a [u32])>,
    /// The columns of the rows.
    pub replayed: &'a [usize],
}

/// A number out of its range.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutOfRange {
    pub check: Check,
    pub lane: usize,
    pub value: f64,
}

impl LaneColumns {
    /// Columns of this number of lanes.
    pub fn new(program: Arc<LaneProgram>, lanes: usize) -> LaneColumns {
        let mut all = vec![vec![0.0; lanes]; program.columns];
        for (column, value) in &program.constants {
            all[*column].fill(*value);
        }
        let tile = lanes.min(TILE);
        let buffers = vec![vec![0.0; tile]; program.buffers];
        LaneColumns { program, all, buffers, valid: vec![false; tile] }
    }

    /// Sets the clocks of lanes, of which `entered` has the days of the trial on which their people entered.
    pub fn set_clocks(&mut self, span: Range<usize>, times: &[u32], entered: &[f64], per_day: u32) {
        let per_day = f64::from(per_day);
        // Half a decision later the quotient is no whole number, so that rounding does not matter.
        let day = |time: u32| ((f64::from(time) + 0.5) / per_day).floor();
        for (clock, column) in &self.program.clocks {
            let out = self.all[*column][span.clone()].iter_mut().zip(&times[span.clone()]);
            match clock {
                Clock::Step => out.for_each(|(out, time)| *out = f64::from(*time)),
                Clock::Day => out.for_each(|(out, time)| *out = day(*time)),
                Clock::Slot => {
                    out.for_each(|(out, time)| *out = f64::from(*time) - per_day * day(*time));
                }
                Clock::CalendarDay => {
                    let entered = &entered[span.clone()];
                    out.zip(entered).for_each(|((out, time), from)| *out = from + day(*time));
                }
            }
        }
    }

    /// Computes the quantities of a stage. Returns the first number that is out of its range.
    pub fn compute(&mut self, stage: Moment, inputs: &Inputs<'_>) -> Option<OutOfRange> {
        let program = Arc::clone(&self.program);
        let instructions = &program.stages[stage as usize];
        Isa::chosen().run(Execution { columns: self, instructions, inputs })
    }

    /// Computes the quantities of a stage in a few lanes alone, with the buffers of `few`. The inputs are of all lanes, and
    /// these draw and are checked.
    pub fn compute_few(
        &mut self,
        few: &mut FewLanes,
        lanes: &[usize],
        stage: Moment,
        inputs: &Inputs<'_>,
    ) -> Option<OutOfRange> {
        let mut broken = None;
        let FewLanes { columns, times, words, rows, all } = few;
        for lanes in lanes.chunks(columns.valid.len()) {
            for (own, from) in columns.all.iter_mut().zip(&self.all) {
                own.iter_mut().zip(lanes).for_each(|(own, lane)| *own = from[*lane]);
            }
            times.iter_mut().zip(lanes).for_each(|(own, lane)| *own = inputs.times[*lane]);
            words.iter_mut().zip(lanes).for_each(|(own, lane)| *own = inputs.words[*lane]);
            let replay = inputs.replay.map(|(numbers, from)| {
                rows.iter_mut().zip(lanes).for_each(|(own, lane)| *own = from[*lane]);
                (numbers, &rows[..])
            });
            let inputs = Inputs {
                span: 0..lanes.len(),
                clock: inputs.clock,
                times,
                words,
                drawn: all,
                checked: all,
                replay,
                replayed: inputs.replayed,
            };
            let found = columns.compute(stage, &inputs);
            broken = broken.or(found.map(|found| OutOfRange { lane: lanes[found.lane], ..found }));
            for column in &self.program.values {
                let (own, all) = (&columns.all[*column], &mut self.all[*column]);
                lanes.iter().zip(own).for_each(|(lane, value)| all[*lane] = *value);
            }
        }
        broken
    }

    /// Remembers the values of a decision in these lanes.
    pub fn remember(&mut self, span: Range<usize>, clock: u64, drawn: &[bool]) {
        let program = Arc::clone(&self.program);
        for (ring, value) in &program.rings {
            // The value of the present decision is the one that the next one finds at a lag of 1.
            let mut newest = std::mem::take(&mut self.all[ring.column(clock, 0)]);
            newest[span.clone()].copy_from_slice(&self.all[*value][span.clone()]);
            self.all[ring.column(clock, 0)] = newest;
        }
        for (total, value) in &program.totals {
            let mut sums = std::mem::take(&mut self.all[*total]);
            let own = sums[span.clone()].iter_mut().zip(&self.all[*value][span.clone()]);
            for ((sum, value), drawn) in own.zip(&drawn[span.clone()]) {
                if *drawn {
                    *sum += value;
                }
            }
            self.all[*total] = sums;
        }
    }

    /// Forgets the totals of a lane.
    pub fn forget(&mut self, lane: usize) {
        for (total, _) in &self.program.totals {
            self.all[*total][lane] = 0.0;
        }
    }
}

/// The execution of instructions.
struct Execution<'a> {
    columns: &'a mut LaneColumns,
    instructions: &'a [Instruction],
    inputs: &'a Inputs<'a>,
}

impl WithSimd for Execution<'_> {
    type Output = Option<OutOfRange>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Option<OutOfRange> {
        let Execution { columns, instructions, inputs } = self;
        let Range { start: mut first, end } = inputs.span;
        let mut broken = None;
        while first < end {
            let tile = Tile { first, count: (end - first).min(TILE) };
            for instruction in instructions {
                let found = columns.execute(instruction, tile, inputs);
                if broken.is_none() {
                    broken = found;
                }
            }
            first += TILE;
        }
        broken
    }
}

/// Some of the lanes.
#[derive(Clone, Copy)]
struct Tile {
    first: usize,
    count: usize,
}

impl Tile {
    #[inline(always)]
    fn of<T>(self, lanes: &[T]) -> &[T] {
        &lanes[self.first..self.first + self.count]
    }
}

/// Calls `$run` with each function as a constant, so that its loop is compiled for it.
macro_rules! each_function {
    ($kind:ident, $function:expr, [$($name:ident)*], |$constant:ident| $run:expr) => {
        match $function {
            $($kind::$name => {
                const FUNCTION: $kind = $kind::$name;
                let $constant = FUNCTION;
                $run
            })*
        }
    };
}

impl LaneColumns {
    #[inline(always)]
    fn read(&self, operand: Operand, tile: Tile) -> &[f64] {
        match operand {
            Operand::Column(column) => tile.of(&self.all[column]),
            Operand::Buffer(buffer) => &self.buffers[buffer][..tile.count],
        }
    }

    /// Takes out the numbers that an instruction writes: no instruction reads its destination.
    #[inline(always)]
    fn take(&mut self, to: Operand) -> Vec<f64> {
        match to {
            Operand::Column(column) => std::mem::take(&mut self.all[column]),
            Operand::Buffer(buffer) => std::mem::take(&mut self.buffers[buffer]),
        }
    }

    /// Puts back what [`LaneColumns::take`] took.
    #[inline(always)]
    fn put(&mut self, to: Operand, numbers: Vec<f64>) {
        match to {
            Operand::Column(column) => self.all[column] = numbers,
            Operand::Buffer(buffer) => self.buffers[buffer] = numbers,
        }
    }

    #[inline(always)]
    fn execute(
        &mut self,
        instruction: &Instruction,
        tile: Tile,
        inputs: &Inputs<'_>,
    ) -> Option<OutOfRange> {
        let to = match instruction {
            Instruction::Check(check) => return self.check(check, tile, inputs),
            Instruction::DrawInstruction(draw) => {
                self.validate(draw, tile, inputs);
                draw.to
            }
            Instruction::Copy(.., to)
            | Instruction::Unary(.., to)
            | Instruction::Binary(.., to)
            | Instruction::Select(.., to)
            | Instruction::Lag(.., to)
            | Instruction::Window(.., to)
            | Instruction::Total(.., to)
            | Instruction::Linear(.., to)
            | Instruction::Replay(.., to) => *to,
        };
        // Closures around numbers, as of `for_each`, would be compiled for the least instruction set, because several sets
        // call them.
        let mut numbers = self.take(to);
        let out = match to {
            Operand::Column(_) => &mut numbers[tile.first..tile.first + tile.count],
            Operand::Buffer(_) => &mut numbers[..tile.count],
        };
        self.write(instruction, tile, inputs, out);
        self.put(to, numbers);
        None
    }

    #[inline(always)]
    fn write(&self, instruction: &Instruction, tile: Tile, inputs: &Inputs<'_>, out: &mut [f64]) {
        match instruction {
            Instruction::Copy(from, _) => out.copy_from_slice(self.read(*from, tile)),
            Instruction::Unary(function, x, _) => {
                let x = self.read(*x, tile);
                each_function!(
                    Unary, function,
                    [Minus Not Abs Exp Log Sqrt Sigmoid NormalCdf Floor Round],
                    |f| for (out, x) in out.iter_mut().zip(x) {
                        *out = numbers::unary(f, *x);
                    }
                );
            }
            Instruction::Binary(function, [x, y], _) => {
                let (x, y) = (self.read(*x, tile), self.read(*y, tile));
                each_function!(
                    Binary, function,
                    [
                        Plus Minus Times Divided Modulo Power Less AtMost Greater AtLeast Equal
                        Unequal And Or Min Max Default
                    ],
                    |f| for ((out, x), y) in out.iter_mut().zip(x).zip(y) {
                        *out = numbers::binary(f, *x, *y);
                    }
                );
            }
            Instruction::Select([condition, x, y], _) => {
                let [condition, x, y] = [condition, x, y].map(|of| self.read(*of, tile));
                for (((out, condition), x), y) in out.iter_mut().zip(condition).zip(x).zip(y) {
                    *out = numbers::select(*condition, *x, *y);
                }
            }
            Instruction::Lag(ring, back, _) => {
                let past = tile.of(&self.all[ring.column(inputs.clock, u64::from(*back))]);
                let times = tile.of(inputs.times);
                for ((out, past), time) in out.iter_mut().zip(past).zip(times) {
                    *out = if time >= back { *past } else { f64::NAN };
                }
            }
            Instruction::Window(ring, weights, divisor, _) => {
                self.window(*ring, (weights, *divisor), tile, inputs, out);
            }
            Instruction::Total(total, summary, _) => {
                let sums = tile.of(&self.all[*total]);
                let times = tile.of(inputs.times);
                for ((out, sum), time) in out.iter_mut().zip(sums).zip(times) {
                    *out = match summary {
                        Summary::Mean => numbers::divided(*sum, f64::from(*time)),
                        Summary::Sum | Summary::Count => *sum,
                    };
                }
            }
            Instruction::Linear(terms, _) => self.linear(terms, tile, out),
            Instruction::DrawInstruction(draw) => self.draw(draw, tile, inputs, out),
            Instruction::Replay(column, _) => {
                if let Some((rows, row)) = inputs.replay {
                    let column = inputs.replayed[*column];
                    for (out, row) in out.iter_mut().zip(tile.of(row)) {
                        let row = *row as usize;
                        *out = if row < rows.rows() { rows.number(row, column) } else { f64::NAN };
                    }
                }
            }
            Instruction::Check(_) => {}
        }
    }

    #[inline(always)]
    fn check(&self, check: &Check, tile: Tile, inputs: &Inputs<'_>) -> Option<OutOfRange> {
        let numbers = self.read(check.of, tile);
        let (least, most) = check.range;
        let is_good = |x: f64| (x >= least) & (x <= most);
        // Without a look at who is checked, which is seldom needed.
        let mut are_good = true;
        for x in numbers {
            are_good &= is_good(*x);
        }
        if are_good {
            return None;
        }
        let mut lanes = numbers.iter().zip(tile.of(inputs.checked));
        let lane = lanes.position(|(x, checked)| *checked && !is_good(*x))?;
        Some(OutOfRange { check: *check, lane: tile.first + lane, value: numbers[lane] })
    }

    #[inline(always)]
    fn linear(&self, terms: &[(Operand, Vec<Operand>)], tile: Tile, out: &mut [f64]) {
        out.fill(0.0);
        for (coefficient, factors) in terms {
            let coefficient = self.read(*coefficient, tile);
            match factors[..] {
                [] => {
                    for (out, c) in out.iter_mut().zip(coefficient) {
                        *out += c;
                    }
                }
                [x] => {
                    let x = self.read(x, tile);
                    for ((out, c), x) in out.iter_mut().zip(coefficient).zip(x) {
                        *out += c * x;
                    }
                }
                [x, y] => {
                    let (x, y) = (self.read(x, tile), self.read(y, tile));
                    for (((out, c), x), y) in out.iter_mut().zip(coefficient).zip(x).zip(y) {
                        *out += c * (x * y);
                    }
                }
                _ => {
                    for (lane, (out, c)) in out.iter_mut().zip(coefficient).enumerate() {
                        let factors = factors.iter().map(|x| self.read(*x, tile)[lane]);
                        *out += c * factors.product::<f64>();
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn window(
        &self,
        ring: Ring,
        (weights, divisor): (&[f64], f64),
        tile: Tile,
        inputs: &Inputs<'_>,
        out: &mut [f64],
    ) {
        out.fill(0.0);
        let newest = ring.newest(inputs.clock);
        for (back, weight) in (1..).zip(weights) {
            let past = tile.of(&self.all[ring.column_from(newest, back)]);
            for (out, past) in out.iter_mut().zip(past) {
                *out += weight * past;
            }
        }
        let length = weights.len() as u32;
        for (out, time) in out.iter_mut().zip(tile.of(inputs.times)) {
            *out = if *time >= length { *out / divisor } else { f64::NAN };
        }
    }

    /// Marks the lanes that draw and whose parameters are in their ranges.
    #[inline(always)]
    fn validate(&mut self, draw: &DrawInstruction, tile: Tile, inputs: &Inputs<'_>) {
        let mut valid = std::mem::take(&mut self.valid);
        valid[..tile.count].copy_from_slice(tile.of(inputs.drawn));
        for (parameter, (least, most)) in draw.parameters.iter().zip(&draw.ranges) {
            for (valid, x) in valid.iter_mut().zip(self.read(*parameter, tile)) {
                *valid &= (*x >= *least) & (*x <= *most);
            }
        }
        self.valid = valid;
    }

    #[inline(always)]
    fn draw(&self, draw: &DrawInstruction, tile: Tile, inputs: &Inputs<'_>, out: &mut [f64]) {
        let valid = &self.valid[..tile.count];
        let words = tile.of(inputs.words);
        let mut few: [&[f64]; 4] = [&[]; 4];
        let many: Vec<&[f64]>;
        let parameters = match draw.parameters.len() {
            count @ 0..=4 => {
                for (slot, parameter) in few.iter_mut().zip(&draw.parameters) {
                    *slot = self.read(*parameter, tile);
                }
                &few[..count]
            }
            _ => {
                many = draw.parameters.iter().map(|of| self.read(*of, tile)).collect();
                &many[..]
            }
        };
        match &draw.distribution {
            DrawSource::DrawLaw(distribution) => {
                distribution.draw(parameters, (words, draw.stream), valid, out);
            }
            DrawSource::ProbabilityTable(table) => {
                for (lane, (out, valid)) in out.iter_mut().zip(valid).enumerate() {
                    let given = parameters.iter().map(|of| of[lane]);
                    let mut words = Expansion(words[lane] ^ draw.stream);
                    *out = match valid {
                        true => table.drawn(given, words.open_unit()),
                        false => f64::NAN,
                    };
                }
            }
        }
    }
}

impl ProbabilityTable {
    /// The value in which a share of the weights of the rows with these given values falls; NaN if there is no such row.
    fn drawn(&self, given: impl ExactSizeIterator<Item = f64> + Clone, share: f64) -> f64 {
        let width = given.len();
        let fits = |row: usize| {
            let mut own = self.given[row * width..(row + 1) * width].iter();
            given.clone().all(|x| own.next() == Some(&x))
        };
        let rows = || (0..self.values.len()).filter(|row| fits(*row)).map(|row| self.values[row]);
        let all: f64 = rows().map(|(_, weight)| weight).sum();
        let (mut before, mut last) = (0.0, f64::NAN);
        for (value, weight) in rows() {
            if weight > 0.0 {
                last = value;
            }
            before += weight;
            if share * all < before {
                return value;
            }
        }
        last
    }
}
