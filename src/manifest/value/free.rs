//! Reads the parameters of outside programs and models, whose names the author chooses, and the family of the environment.

use toml::de::DeTable;

use crate::env::Family;
use crate::key::{free_key, free_keys};
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::{Fault, shortened};

/// The table of the parameters of an outside program or a model, in its [[agent]] or in [environment].
pub(in crate::manifest) const PARAMETERS: &str = "parameters";

/// The key of `[environment]` that names its family.
pub(in crate::manifest) const FAMILY: &str = "family";

/// Parameters with their keys, `parameters.<name>`.
pub(in crate::manifest) type Free<'n> = Vec<(&'static str, &'n Node<'n>)>;

impl Reader<'_> {
    /// The parameters of an outside program in the table `node`. `None`, with faults reported, if `node` is not
    /// a valid table.
    pub fn free_parameters<'n>(&mut self, node: &'n Node<'n>) -> Option<Free<'n>> {
        let Some(table) = node.get_ref().as_table() else {
            let expected = "a table, as in { learning_rate = [3e-4, 1e-3] }";
            self.expected(PARAMETERS, expected, node);
            return None;
        };
        let mut given = Free::new();
        for (name, node) in table {
            let found = name.get_ref();
            match free_key(&format!("parameters.{found}")) {
                Some(key) => given.push((key.name, node)),
                None => {
                    let found = shortened(found);
                    let message = format!("`{found}` is not a name of a parameter");
                    let help = "names have at most 64 letters, digits and underscores, and do not \
                                begin with a digit";
                    self.faults.add(Fault::at(name.span().into(), message).help(help));
                }
            }
        }
        if free_keys(given.iter().map(|(name, _)| *name)).is_none() {
            let message = format!("`parameters`: at most 100, found {}", given.len());
            self.faults.add(Fault::at(node.span().into(), message));
            return None;
        }
        Some(given)
    }

    /// The family that the table `environment` names, with the parameters whose names the author chooses. Faults are reported.
    pub fn family<'n>(&mut self, environment: &'n DeTable<'n>) -> (&'static Family, Free<'n>) {
        let Some(node) = environment.get(FAMILY) else { return (Family::first(), Free::new()) };
        if let Some((family, instead)) = node.get_ref().as_str().and_then(Family::retired) {
            let says = format!("this release no longer simulates the family `{}`", family.name);
            self.faults.add(Fault::at(node.span().into(), says).help(instead));
            // Its other keys are not reported as well.
            return (family, Free::new());
        }
        let names: Vec<&str> = Family::all().iter().map(|family| family.name).collect();
        let named = self.word("environment.family", &names, node).and_then(Family::named);
        // A misspelt family is the one that the other keys are of, so that they are not reported as well.
        let meant = || {
            let mut families = Family::all().iter().rev().copied();
            families.find(|family| family.keys.iter().any(|key| environment.contains_key(key.name)))
        };
        let family = named.or_else(meant).unwrap_or(Family::first());
        let Some(with_parameters) = family.with_parameters else { return (family, Free::new()) };
        let free = environment.get(PARAMETERS).and_then(|node| self.free_parameters(node));
        let free = free.unwrap_or_default();
        let names: Vec<&str> =
            free.iter().map(|(name, _)| *name).chain(self.beside.iter().copied()).collect();
        (with_parameters(&names).unwrap_or(family), free)
    }
}
