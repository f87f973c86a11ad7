//! Where the numbers of a pilot come from: expressions of columns of the file.

use std::collections::{BTreeMap, HashSet};

use crate::env::declared::model::{Definition, ModelFile, Referent};
use crate::env::declared::pilot::file::{ColumnFormula, Header};
use crate::env::declared::pilot::section::{FitSection, RowsToOne, WrittenColumn};
use crate::text::{Fault, FaultList, shortened};

/// Where everything comes from: expressions of columns of the file.
pub(super) struct Sources {
    pub person: Option<usize>,
    pub order: Vec<ColumnFormula>,
    pub filter: Option<ColumnFormula>,
    pub action: Option<ColumnFormula>,
    pub probability: Vec<ColumnFormula>,
    pub available: Option<ColumnFormula>,
    /// By quantity.
    pub given: BTreeMap<usize, ColumnFormula>,
    /// Columns of people, by their index.
    pub people: BTreeMap<usize, (RowsToOne, ColumnFormula)>,
    /// Columns of people that the file has under their own name.
    pub constant: BTreeMap<usize, usize>,
}

impl Sources {
    pub fn new(
        model: &ModelFile,
        section: &FitSection,
        header: &Header,
        faults: &mut FaultList,
    ) -> Sources {
        let mut formula = |written: &WrittenColumn| match header.formula(written) {
            Ok(formula) => Some(formula),
            Err(fault) => {
                faults.add(fault);
                None
            }
        };
        let mut one = |written: &Option<WrittenColumn>| written.as_ref().and_then(&mut formula);
        let person = one(&section.person);
        let (filter, action, available) =
            (one(&section.filter), one(&section.action), one(&section.available));
        let order = section.order.iter().filter_map(&mut formula).collect();
        let probability: Vec<ColumnFormula> =
            section.probability.iter().filter_map(&mut formula).collect();
        let mut given = BTreeMap::new();
        let named = |name: &str| model.quantities.iter().position(|one| one.name == name);
        let is_variable = |index: usize| {
            let definition = &model.quantities[index].definition;
            index > 1 && !matches!(definition, Definition::Linear(_))
        };
        let mut unknown = Vec::new();
        for (name, at, written) in &section.columns {
            match named(name).filter(|index| is_variable(*index)) {
                Some(index) => _ = formula(written).map(|of| given.insert(index, of)),
                None => unknown.push((name, *at, "variable")),
            }
        }
        let mut people = BTreeMap::new();
        for (name, at, way, written) in &section.people {
            match model.columns.iter().position(|column| column.name == *name) {
                Some(index) => _ = formula(written).map(|of| people.insert(index, (*way, of))),
                None => unknown.push((name, *at, "column of people")),
            }
        }
        for (name, at) in &section.standardised {
            if !section.columns.iter().any(|(given, ..)| given == name)
                && !model.replayed.contains(name)
            {
                let says =
                    format!("`standardise`: the data give no variable `{}`", shortened(name));
                faults.add(Fault::at(*at, says).help("list it in `columns` of [fit] as well"));
            }
        }
        for (name, at, what) in unknown {
            let fault = Fault::at(at, format!("the model has no {what} `{}`", shortened(name)));
            let names = model.names();
            faults.add(fault.nearest(name, names));
        }
        if let Some(written) = section
            .person
            .as_ref()
            .filter(|_| !matches!(person, Some(ColumnFormula::Column(_)) | None))
        {
            faults.add(Fault::at(written.span, "`person`: expected the name of a column"));
        }
        let expected = model.actions.len() - 1;
        if !probability.is_empty() && probability.len() != expected {
            let says =
                format!("`probability`: expected {expected}, one for each action but the first");
            faults.add(Fault::at(section.probability[0].span, says));
        }
        // Rows that the model replays have the names of the file's columns, unless they are listed.
        for name in &model.replayed {
            let Some(index) = named(name).filter(|index| !given.contains_key(index)) else {
                continue;
            };
            if let Some(column) = header.column(name) {
                given.insert(index, ColumnFormula::Column(column));
            } else if !name.starts_with("residual_") {
                let says =
                    format!("the data have no column `{name}`, which the model's [replay] lists");
                faults.add(Fault::whole(says).help("say in `columns` of [fit] what it is"));
            }
        }
        let blocks: HashSet<usize> = block_columns(model);
        let constant = model.columns.iter().enumerate().filter_map(|(index, column)| {
            let own = header.column(&column.name)?;
            (!people.contains_key(&index) && !blocks.contains(&index)).then_some((index, own))
        });
        let constant = constant.collect();
        let person = person.map(|person| match person {
            ColumnFormula::Column(index) => index,
            ColumnFormula::Expression(..) => 0,
        });
        Sources { person, order, filter, action, probability, available, given, people, constant }
    }

    /// The columns of the file that are read as numbers.
    pub fn columns(&self) -> Vec<usize> {
        let all = self.numbers().into_iter().chain(&self.filter).flat_map(ColumnFormula::columns);
        all.chain(self.constant.values().copied()).collect()
    }

    /// The expressions whose numbers are used in the rows that are fitted.
    pub fn numbers(&self) -> Vec<&ColumnFormula> {
        let lists = self.order.iter().chain(&self.action);
        let lists = lists.chain(&self.probability).chain(&self.available);
        let lists = lists.chain(self.given.values());
        lists.chain(self.people.values().map(|(_, formula)| formula)).collect()
    }
}

/// The columns of people that are coefficients of blocks.
fn block_columns(model: &ModelFile) -> HashSet<usize> {
    let terms = model.quantities.iter().filter_map(|quantity| match &quantity.definition {
        Definition::Linear(terms) => Some(terms),
        _ => None,
    });
    let column = |referent: Referent| match referent {
        Referent::Column(index) => Some(index),
        _ => None,
    };
    terms.flatten().filter_map(|term| column(term.coefficient)).collect()
}
