//! Reads the parameters of an outside program, whose names the author chooses.

use super::fault::Fault;
use super::read::shortened;
use super::sweep::{Node, Reader};
use crate::agent::{Algorithm, free_key};

/// Parameters with their keys, `parameters.<name>`.
type Free<'n> = Vec<(&'static str, &'n Node<'n>)>;

impl Reader<'_> {
    /// The external algorithm with the parameters in the table `node`, and their values. `None`, with
    /// faults reported, if `node` is not a valid table.
    pub fn free_parameters<'n>(
        &mut self,
        node: &'n Node<'n>,
    ) -> Option<(&'static Algorithm, Free<'n>)> {
        let Some(table) = node.get_ref().as_table() else {
            let expected = "a table, as in { learning_rate = [3e-4, 1e-3] }";
            self.expected("parameters", expected, node);
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
        let algorithm = Algorithm::external(given.iter().map(|(name, _)| *name));
        if algorithm.is_none() {
            let message = format!("`parameters`: at most 100, found {}", given.len());
            self.faults.add(Fault::at(node.span().into(), message));
        }
        Some((algorithm?, given))
    }
}
