//! The program of a model: instructions that compute the numbers of many lanes at a time.

use std::collections::HashMap;

use crate::env::declared::distribution::DrawLaw;
use crate::env::declared::expression::{Binary, ExpressionNode, Summary, Unary};
use crate::env::declared::model::{
    Clock, Definition, ModelFile, Moment, NamedExpression, ProbabilityTable, Referent,
};
use crate::env::declared::numbers;

/// Where an instruction finds a number of each lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Operand {
    /// In a column of numbers that last.
    Column(usize),
    /// In a buffer that lasts for one formula.
    Buffer(usize),
}

/// A step of the program, with its destination last.
#[derive(Clone, Debug)]
pub(super) enum Instruction {
    Copy(Operand, Operand),
    Unary(Unary, Operand, Operand),
    Binary(Binary, [Operand; 2], Operand),
    Select([Operand; 3], Operand),
    /// The value of a ring some decisions ago; missing where there is no such decision.
    Lag(Ring, u32, Operand),
    /// The sum of a ring's values of the last decisions with weights, newest first, divided by a number; missing where
    /// there are fewer.
    Window(Ring, Vec<f64>, f64, Operand),
    /// A total of all earlier decisions, or their mean.
    Total(usize, Summary, Operand),
    /// A sum of products.
    Linear(Vec<(Operand, Vec<Operand>)>, Operand),
    DrawInstruction(DrawInstruction),
    /// The column of the rows at this index.
    Replay(usize, Operand),
    /// What is checked.
    Check(Check),
}

/// A draw.
#[derive(Clone, Debug)]
pub(super) struct DrawInstruction {
    pub distribution: DrawSource,
    pub parameters: Vec<Operand>,
    /// The ranges of the parameters.
    pub ranges: Vec<(f64, f64)>,
    /// The number of the stream, by the name of the variable.
    pub stream: u64,
    pub to: Operand,
}

/// What is drawn from.
#[derive(Clone, Debug)]
pub(super) enum DrawSource {
    DrawLaw(DrawLaw),
    ProbabilityTable(ProbabilityTable),
}

/// A number that must lie in a range in every lane that takes part.
#[derive(Clone, Copy, Debug)]
pub(super) struct Check {
    pub of: Operand,
    pub range: (f64, f64),
    pub quantity: usize,
    /// The parameter of a draw; `None` for the quantity itself.
    pub parameter: Option<usize>,
}

/// The last values of a quantity: columns that take turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ring {
    /// The first of the columns.
    pub first: usize,
    /// Their number.
    pub depth: usize,
}

impl Ring {
    /// The column of the value some decisions ago, at most as many as there are, after this number of steps of all lanes.
    #[inline(always)]
    pub fn column(self, clock: u64, back: u64) -> usize {
        self.column_from(self.newest(clock), back as usize)
    }

    /// The index of the value that the present decision will have.
    #[inline(always)]
    pub fn newest(self, clock: u64) -> usize {
        (clock % self.depth as u64) as usize
    }

    /// The column of the value some decisions before this index.
    #[inline(always)]
    pub fn column_from(self, newest: usize, back: usize) -> usize {
        let index = newest + self.depth - back;
        self.first + if index >= self.depth { index - self.depth } else { index }
    }
}

/// A program with the columns that it needs.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneProgram {
    /// The instructions of each stage.
    pub stages: [Vec<Instruction>; Moment::COUNT],
    /// The number of columns, and of buffers.
    pub columns: usize,
    pub buffers: usize,
    /// Columns that are the same in every lane, with their value.
    pub constants: Vec<(usize, f64)>,
    /// The clocks that are used, with their columns.
    pub clocks: Vec<(Clock, usize)>,
    /// The columns of the file of people, \[needed columns\].
    pub people: Vec<usize>,
    /// The column of each quantity, and whether it is computed.
    pub values: Vec<usize>,
    pub needed: Vec<bool>,
    /// The rings, each with the column of its quantity.
    pub rings: Vec<(Ring, usize)>,
    /// The totals of all earlier decisions: their column, and that of the quantity.
    pub totals: Vec<(usize, usize)>,
}

/// The number of the stream of a name.
pub(super) fn stream(name: &str) -> u64 {
    // FNV-1a, mixed as SplitMix64 mixes.
    let hash = name.bytes().fold(0xCBF2_9CE4_8422_2325u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3)
    });
    crate::env::variates::Expansion(hash).bits()
}

/// The program of a model with these values of its parameters.
pub(super) fn compile(model: &ModelFile, parameters: &[f64]) -> LaneProgram {
    let mut compiler = Compiler::new(model, parameters);
    compiler.program.values =
        (0..model.quantities.len()).map(|_| compiler_column(&mut compiler.program)).collect();
    compiler.program.people =
        model.columns.iter().map(|_| compiler_column(&mut compiler.program)).collect();
    let needed = compiler.needed();
    for (stage, order) in model.order.iter().enumerate() {
        for index in order.iter().filter(|index| needed[**index]) {
            compiler.quantity(stage, *index);
        }
    }
    compiler.roles();
    compiler.program.needed = needed;
    compiler.program
}

/// The draws whose parameters are out of their ranges at these values of the model's parameters, whatever else happens:
/// the index of the quantity, of its parameter, and the number. Draws that no role needs do not count.
pub(super) fn impossible_draws(model: &ModelFile, parameters: &[f64]) -> Vec<(usize, usize, f64)> {
    let compiler = Compiler::new(model, parameters);
    let needed = compiler.needed();
    let mut found = Vec::new();
    for (index, quantity) in model.quantities.iter().enumerate().filter(|(one, _)| needed[*one]) {
        let Definition::DrawInstruction(law, formulas) = &quantity.definition else { continue };
        for (parameter, formula) in formulas.iter().enumerate() {
            let (least, most) = law.range(parameter);
            match compiler.constants_of(formula).pop().flatten() {
                Some(value) if !(value >= least && value <= most) => {
                    found.push((index, parameter, value));
                }
                _ => {}
            }
        }
    }
    found
}

/// A new column.
fn compiler_column(program: &mut LaneProgram) -> usize {
    program.columns += 1;
    program.columns - 1
}

struct Compiler<'m> {
    model: &'m ModelFile,
    parameters: &'m [f64],
    program: LaneProgram,
    /// By the bits of their values.
    constants: HashMap<u64, usize>,
    clocks: HashMap<Clock, usize>,
    /// By quantity.
    rings: HashMap<usize, Ring>,
    /// By quantity.
    totals: HashMap<usize, usize>,
    /// Buffers that are free.
    free: Vec<usize>,
}

/// A part of a formula: a constant, or where it is found.
#[derive(Clone, Copy, Debug)]
enum Part {
    Constant(f64),
    At(Operand),
}

impl<'m> Compiler<'m> {
    fn new(model: &'m ModelFile, parameters: &'m [f64]) -> Compiler<'m> {
        Compiler {
            model,
            parameters,
            program: LaneProgram::default(),
            constants: HashMap::new(),
            clocks: HashMap::new(),
            rings: HashMap::new(),
            totals: HashMap::new(),
            free: Vec::new(),
        }
    }

    fn constant(&mut self, value: f64) -> Operand {
        let program = &mut self.program;
        let column = *self.constants.entry(value.to_bits()).or_insert_with(|| {
            let column = compiler_column(program);
            program.constants.push((column, value));
            column
        });
        Operand::Column(column)
    }

    fn target(&mut self, target: Referent) -> Part {
        match target {
            Referent::One => Part::Constant(1.0),
            Referent::ModelParameter(index) => Part::Constant(self.parameters[index]),
            Referent::Column(index) => Part::At(Operand::Column(self.program.people[index])),
            Referent::Quantity(index) => Part::At(Operand::Column(self.program.values[index])),
            Referent::Clock(clock) => {
                let program = &mut self.program;
                let column = *self.clocks.entry(clock).or_insert_with(|| {
                    let column = compiler_column(program);
                    program.clocks.push((clock, column));
                    column
                });
                Part::At(Operand::Column(column))
            }
        }
    }

    fn operand(&mut self, part: Part) -> Operand {
        match part {
            Part::Constant(value) => self.constant(value),
            Part::At(operand) => operand,
        }
    }

    fn ring(&mut self, quantity: usize) -> Ring {
        if let Some(ring) = self.rings.get(&quantity) {
            return *ring;
        }
        let depth = self.model.quantities[quantity].back.max(1) as usize;
        let ring = Ring { first: self.program.columns, depth };
        self.program.columns += depth;
        self.program.rings.push((ring, self.program.values[quantity]));
        self.rings.insert(quantity, ring);
        ring
    }

    fn total(&mut self, quantity: usize) -> usize {
        let program = &mut self.program;
        let value = program.values[quantity];
        *self.totals.entry(quantity).or_insert_with(|| {
            let column = compiler_column(program);
            program.totals.push((column, value));
            column
        })
    }

    fn buffer(&mut self) -> Operand {
        Operand::Buffer(self.free.pop().unwrap_or_else(|| {
            self.program.buffers += 1;
            self.program.buffers - 1
        }))
    }

    fn release(&mut self, operands: &[Operand]) {
        for operand in operands {
            if let Operand::Buffer(buffer) = operand {
                self.free.push(*buffer);
            }
        }
    }

    /// The quantities that a role needs at these values of the parameters.
    fn needed(&self) -> Vec<bool> {
        let roles = &self.model.roles;
        let features = roles.features.iter().map(|feature| feature.source);
        let others = [roles.outcome, roles.reward].into_iter().chain(roles.available);
        let others = others.chain(roles.ends).chain(roles.state.iter().copied());
        let mut open: Vec<Referent> = features.chain(others.map(Referent::Quantity)).collect();
        let mut needed = vec![false; self.model.quantities.len()];
        while let Some(referent) = open.pop() {
            let Referent::Quantity(index) = referent else { continue };
            if std::mem::replace(&mut needed[index], true) {
                continue;
            }
            let definition = &self.model.quantities[index].definition;
            match definition {
                Definition::Linear(_) => {
                    open.extend(definition.referents().into_iter().map(|(referent, _)| referent));
                }
                _ => open.extend(ModelFile::formulas(definition).iter().flat_map(|formula| {
                    let read = self.read_nodes(formula);
                    let mut windows = formula.windows.iter();
                    let mut referents = Vec::new();
                    for (node, read) in formula.expression.nodes.iter().zip(read) {
                        let referent = match node {
                            ExpressionNode::WrittenName(name) => Some(formula.targets[*name]),
                            ExpressionNode::PastWindow(_) => {
                                windows.next().map(|window| Referent::Quantity(*window))
                            }
                            _ => None,
                        };
                        referents.extend(referent.filter(|_| read));
                    }
                    referents
                })),
            }
        }
        needed
    }

    /// Whether each node of a formula is read at these values of the parameters: a constant has no parts, and an `if` with a
    /// constant condition has one branch.
    fn read_nodes(&self, formula: &NamedExpression) -> Vec<bool> {
        let nodes = &formula.expression.nodes;
        let constants = self.constants_of(formula);
        let mut read = vec![false; nodes.len()];
        if let Some(last) = read.last_mut() {
            *last = true;
        }
        for index in (0..nodes.len()).rev().filter(|index| constants[*index].is_none()) {
            if !read[index] {
                continue;
            }
            match &nodes[index] {
                ExpressionNode::Number(_)
                | ExpressionNode::WrittenName(_)
                | ExpressionNode::PastWindow(_) => {}
                ExpressionNode::Unary(_, of) => read[*of] = true,
                ExpressionNode::Binary(_, of) => of.iter().for_each(|of| read[*of] = true),
                ExpressionNode::If([condition, one, other]) => match constants[*condition] {
                    Some(condition) => read[if condition != 0.0 { *one } else { *other }] = true,
                    None => [condition, one, other].iter().for_each(|of| read[**of] = true),
                },
            }
        }
        read
    }

    /// The values of the nodes of a formula that numbers and parameters determine.
    fn constants_of(&self, formula: &NamedExpression) -> Vec<Option<f64>> {
        let names = &formula.expression.names;
        let mut constants: Vec<Option<f64>> = Vec::with_capacity(formula.expression.nodes.len());
        for node in &formula.expression.nodes {
            constants.push(match node {
                ExpressionNode::Number(value) => Some(*value),
                ExpressionNode::WrittenName(name) => match formula.targets[*name] {
                    Referent::One => Some(1.0),
                    Referent::ModelParameter(index) if names[*name].back == 0 => {
                        Some(self.parameters[index])
                    }
                    _ => None,
                },
                ExpressionNode::Unary(function, of) => {
                    constants[*of].map(|x| numbers::unary(*function, x))
                }
                ExpressionNode::Binary(function, [one, other]) => {
                    match (constants[*one], constants[*other]) {
                        (Some(x), Some(y)) => Some(numbers::binary(*function, x, y)),
                        _ => None,
                    }
                }
                ExpressionNode::If([condition, one, other]) => match constants[*condition] {
                    Some(condition) if condition.is_nan() => Some(f64::NAN),
                    Some(condition) => constants[if condition != 0.0 { *one } else { *other }],
                    None => None,
                },
                ExpressionNode::PastWindow(_) => None,
            });
        }
        constants
    }

    fn quantity(&mut self, stage: usize, index: usize) {
        let model = self.model;
        let to = Operand::Column(self.program.values[index]);
        let quantity = &model.quantities[index];
        match &quantity.definition {
            Definition::Action | Definition::Probability => {}
            Definition::Replay(column) => {
                self.program.stages[stage].push(Instruction::Replay(*column, to));
            }
            Definition::NamedExpression(formula) => {
                let part = self.formula(stage, formula, Some(to));
                match part {
                    Part::At(at) if at == to => {}
                    part => {
                        let from = self.operand(part);
                        self.program.stages[stage].push(Instruction::Copy(from, to));
                        self.release(&[from]);
                    }
                }
            }
            Definition::DrawInstruction(distribution, formulas) => {
                let ranges = (0..formulas.len()).map(|index| distribution.range(index)).collect();
                self.draw(stage, index, DrawSource::DrawLaw(*distribution), formulas, ranges);
            }
            Definition::ProbabilityTable(table, formulas) => {
                let ranges = vec![(f64::MIN, f64::MAX); formulas.len()];
                self.draw(
                    stage,
                    index,
                    DrawSource::ProbabilityTable(table.clone()),
                    formulas,
                    ranges,
                );
            }
            Definition::Linear(terms) => {
                let mut sums = Vec::new();
                for term in terms {
                    let coefficient = self.target(term.coefficient);
                    let coefficient = self.operand(coefficient);
                    let factors: Vec<Part> =
                        term.factors.iter().map(|factor| self.target(*factor)).collect();
                    let factors = factors.into_iter().map(|part| self.operand(part)).collect();
                    sums.push((coefficient, factors));
                }
                self.program.stages[stage].push(Instruction::Linear(sums, to));
            }
        }
    }

    fn draw(
        &mut self,
        stage: usize,
        quantity: usize,
        distribution: DrawSource,
        formulas: &[NamedExpression],
        ranges: Vec<(f64, f64)>,
    ) {
        let mut parameters = Vec::new();
        for (index, formula) in formulas.iter().enumerate() {
            let part = self.formula(stage, formula, None);
            let of = self.operand(part);
            let check = Check { of, range: ranges[index], quantity, parameter: Some(index) };
            self.program.stages[stage].push(Instruction::Check(check));
            parameters.push(of);
        }
        self.release(&parameters.clone());
        let stream = stream(&self.model.quantities[quantity].name);
        let to = Operand::Column(self.program.values[quantity]);
        let draw = DrawInstruction { distribution, parameters, ranges, stream, to };
        self.program.stages[stage].push(Instruction::DrawInstruction(draw));
    }

    /// Computes a formula, into `to` where it ends with an instruction.
    fn formula(&mut self, stage: usize, formula: &NamedExpression, to: Option<Operand>) -> Part {
        let nodes = &formula.expression.nodes;
        let (constants, read) = (self.constants_of(formula), self.read_nodes(formula));
        let mut parts: Vec<Part> = Vec::with_capacity(nodes.len());
        let mut windows = formula.windows.iter();
        for (index, node) in nodes.iter().enumerate() {
            let to = to.filter(|_| index + 1 == nodes.len());
            let of_window = match node {
                ExpressionNode::PastWindow(_) => windows.next(),
                _ => None,
            };
            if constants[index].is_some() || !read[index] {
                parts.push(Part::Constant(constants[index].unwrap_or(f64::NAN)));
                continue;
            }
            let part = match node {
                ExpressionNode::Number(value) => Part::Constant(*value),
                ExpressionNode::WrittenName(name) => {
                    let target = formula.targets[*name];
                    match (formula.expression.names[*name].back, target) {
                        (0, _) | (_, Referent::One) => self.target(target),
                        (back, Referent::Quantity(quantity)) => {
                            let ring = self.ring(quantity);
                            self.emit(stage, to, &[], |_, to| Instruction::Lag(ring, back, to))
                        }
                        _ => unreachable!("only quantities have lags"),
                    }
                }
                ExpressionNode::Unary(function, of) => {
                    self.emit(stage, to, &[parts[*of]], |of, to| {
                        Instruction::Unary(*function, of[0], to)
                    })
                }
                ExpressionNode::Binary(Binary::Times, [one, other])
                    if constants[*other] == Some(1.0) =>
                {
                    parts[*one]
                }
                ExpressionNode::Binary(Binary::Times, [one, other])
                    if constants[*one] == Some(1.0) =>
                {
                    parts[*other]
                }
                ExpressionNode::Binary(function, [one, other]) => {
                    self.emit(stage, to, &[parts[*one], parts[*other]], |of, to| {
                        Instruction::Binary(*function, [of[0], of[1]], to)
                    })
                }
                ExpressionNode::If([condition, one, other]) => match constants[*condition] {
                    Some(condition) => parts[if condition != 0.0 { *one } else { *other }],
                    None => {
                        let of = [parts[*condition], parts[*one], parts[*other]];
                        self.emit(stage, to, &of, |of, to| {
                            Instruction::Select([of[0], of[1], of[2]], to)
                        })
                    }
                },
                ExpressionNode::PastWindow(window) => {
                    let quantity = *of_window.expect("every window has a quantity");
                    match window.length {
                        None => {
                            let total = self.total(quantity);
                            let summary = window.summary;
                            self.emit(stage, to, &[], |_, to| {
                                Instruction::Total(total, summary, to)
                            })
                        }
                        Some(length) => {
                            let ring = self.ring(quantity);
                            let factor = window.factor.as_ref().map(|factor| {
                                let parameter = |index: usize| {
                                    let name = &factor.names[index].text;
                                    let parameters = self.model.parameters.iter();
                                    let index = { parameters }.position(|one| one.name == *name)?;
                                    Some(self.parameters[index])
                                };
                                numbers::constant(factor, &parameter).unwrap_or(f64::NAN)
                            });
                            let weights = weights(factor, length);
                            let divisor = match window.summary {
                                Summary::Mean => weights.iter().sum(),
                                Summary::Sum | Summary::Count => 1.0,
                            };
                            self.emit(stage, to, &[], |_, to| {
                                Instruction::Window(ring, weights, divisor, to)
                            })
                        }
                    }
                }
            };
            parts.push(part);
        }
        parts.pop().unwrap_or(Part::Constant(f64::NAN))
    }

    /// Appends an instruction on parts, into `to` or a buffer.
    fn emit(
        &mut self,
        stage: usize,
        to: Option<Operand>,
        of: &[Part],
        instruction: impl FnOnce(&[Operand], Operand) -> Instruction,
    ) -> Part {
        let of: Vec<Operand> = of.iter().map(|part| self.operand(*part)).collect();
        // A destination is never one of the operands.
        let to = to.unwrap_or_else(|| self.buffer());
        self.program.stages[stage].push(instruction(&of, to));
        self.release(&of);
        Part::At(to)
    }

    /// Checks of what leaves the model.
    fn roles(&mut self) {
        let roles = &self.model.roles;
        let features =
            roles.features.iter().map(|feature| (feature.source, feature.low, feature.high));
        for (source, low, high) in features {
            let part = self.target(source);
            let of = self.operand(part);
            if let Referent::Quantity(quantity) = source {
                let range = (low.max(f64::MIN), high.min(f64::MAX));
                let check = Check { of, range, quantity, parameter: None };
                self.program.stages[Moment::Before as usize].push(Instruction::Check(check));
            }
        }
        let others =
            [roles.outcome, roles.reward].into_iter().chain(roles.available).chain(roles.ends);
        // Variables first: a role is missing because a variable is.
        for quantity in roles.state.iter().copied().chain(others) {
            let of = Operand::Column(self.program.values[quantity]);
            let range = (f64::MIN, f64::MAX);
            let check = Check { of, range, quantity, parameter: None };
            let stage = self.model.quantities[quantity].stage;
            // What the outcome is computed from is known after the choice.
            let stage = match [roles.outcome, roles.reward].contains(&quantity) {
                true => Moment::After,
                false => stage,
            };
            self.program.stages[stage as usize].push(Instruction::Check(check));
        }
    }
}

/// The weights of the last values, newest first.
fn weights(factor: Option<f64>, length: u32) -> Vec<f64> {
    let factor = factor.unwrap_or(1.0);
    let powers = std::iter::successors(Some(1.0), |power| Some(power * factor));
    powers.take(length as usize).collect()
}
