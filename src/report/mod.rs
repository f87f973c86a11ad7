//! Reports: figures, tables and a page from the findings of experiments. `assemble` reads the
//! store; the rest are pure functions. The module chooses no folder.

mod arm_tables;
mod assemble;
mod data_table;
mod diagnosands;
mod document;
mod environment_words;
mod escape;
mod figure;
mod kinds;
mod latex;
mod legend;
mod letters;
mod names;
mod optima;
mod page;
mod plain;
mod race;
mod race_context;
mod race_figure;
mod reproduction;
mod scene;
mod section;
mod shrinkage;
mod split;
mod symbols;
mod table;
mod tables;
mod words;

pub use assemble::{AssembleError, AssemblyWork, assemble};
pub use data_table::{DataTable, TableEntry, rounded, signed};
pub use diagnosands::check_diagnosands;
pub use document::{ReportFigure, ReportFile, figures, report, write_whole};
pub use environment_words::Words;
pub use escape::{defused, unused_stem};
pub use letters::undrawn;
pub use page::Hosts;
pub use plain::{
    PlainFigure, PlainLine, PlainPage, PlainPoint, PlainSection, plain_figures, plain_page,
};
pub use race::ReportedRace;
pub use section::{ReportedExperiment, no_experiment};
pub use split::splits;
pub use table::{SummaryLine, summary_table};
