//! The questions of the documents: number, title and SQL, and the file that offers them in Datasette.

use std::fs;

/// A question of the documents.
pub struct Question {
    pub number: usize,
    pub title: String,
    pub sql: String,
}

/// The experiments whose names readers replace by names of their own.
const EXAMPLES: [&str; 3] = ["quickstart", "disengagement", "trial"];

impl Question {
    /// The name of its query in Datasette, which is part of its address.
    pub fn slug(&self) -> String {
        let words = self.title.to_lowercase();
        let words = words.split(|c: char| !c.is_ascii_alphanumeric());
        let words: Vec<&str> = words.filter(|word| !word.is_empty()).take(6).collect();
        format!("q{:02}-{}", self.number, words.join("-"))
    }

    /// The experiment that the SQL names, if any.
    pub fn experiment(&self) -> Option<&'static str> {
        EXAMPLES.into_iter().find(|name| self.sql.contains(&format!("'{name}'")))
    }
}

/// The questions in the order of the documents, each with the SQL block below its heading.
pub fn questions() -> Vec<Question> {
    let documents = ["analysis", "questions", "optimum", "decisions"];
    let text =
        documents.map(|page| fs::read_to_string(format!("docs/{page}.md")).unwrap()).concat();
    let sections = text.split("\n### ").skip(1);
    let question = |section: &str| {
        let (number, rest) = section.split_once(". ").unwrap();
        let title = rest.lines().next().unwrap().to_owned();
        let blocks: Vec<&str> = section.split("```sql\n").skip(1).collect();
        assert_eq!(blocks.len(), 1, "question {number} has one query");
        let sql = blocks[0].split("```").next().unwrap().to_owned();
        Question { number: number.parse().unwrap(), title, sql }
    };
    sections.map(question).collect()
}
