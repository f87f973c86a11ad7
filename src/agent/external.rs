//! The declaration of an outside program as an agent.

use crate::key::{Kind, keys};

keys! {
    /// A program of the author's that trains and acts; `docs/external.md` has its protocol.
    pub struct External {
        /// the program and its arguments, started without a shell in the folder of the manifest
        command: Vec<String>, in Kind::Words { most: 1000, longest: 10_000 };
        /// version of the program, a text; another version makes other jobs
        version: String, in Kind::Text { most: 100 };
        /// maximum number of training episodes
        episodes: u32 = 1000, in Kind::EPISODES;
    }
}
