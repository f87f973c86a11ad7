//! The built-in presets that a manifest can extend, as drafts.

use toml::de::DeTable;

use crate::manifest::draft::Draft;
use crate::manifest::value::sweep::Reader;

const PRESETS: [(&str, &str); 5] = [
    ("paper", include_str!("presets/paper.toml")),
    ("paper_text", include_str!("presets/paper_text.toml")),
    ("step_count_jitai", include_str!("presets/step_count_jitai.toml")),
    ("oralytics_v2", include_str!("presets/oralytics_v2.toml")),
    ("oralytics_v4", include_str!("presets/oralytics_v4.toml")),
];

/// The presets' names.
pub(super) fn names() -> [&'static str; PRESETS.len()] {
    PRESETS.map(|(name, _)| name)
}

/// The content of the preset `name`; an empty draft if there is no such preset.
pub(super) fn draft(name: &str) -> Draft {
    let text = PRESETS.iter().find(|(preset, _)| *preset == name).map_or("", |(_, text)| text);
    let (root, _) = DeTable::parse_recoverable(text);
    Reader::new(text).draft(root.get_ref())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::key::Value;
    use crate::manifest::draft::Settings;

    #[test]
    fn every_preset_reads_without_a_fault_and_extends_nothing() {
        for (name, text) in PRESETS {
            let root = DeTable::parse(text).unwrap();
            assert!(!root.get_ref().contains_key("extends"), "{name}");
            let mut reader = Reader::new(text);
            let draft = reader.draft(root.get_ref());
            assert!(reader.faults.is_empty(), "{name}: {:?}", reader.faults);
            let agents = if name.starts_with("oralytics") { 1 } else { 2 };
            assert_eq!(draft.agents.len(), agents, "{name}");
        }
    }

    #[test]
    fn the_agents_of_the_simulators_preset_are_those_of_the_papers() {
        let settings = |name| {
            let agents = draft(name).agents.into_iter();
            agents.map(|agent| format!("{:?}", given(&agent.settings))).collect::<Vec<_>>()
        };
        fn given(settings: &Settings) -> Vec<(usize, &[Value])> {
            let values = settings.given.iter().map(|(index, values)| (*index, &values.value[..]));
            let mut values: Vec<_> = values.collect();
            values.sort_by_key(|(index, _)| *index);
            values
        }
        assert_eq!(settings("step_count_jitai"), settings("paper"));
    }

    #[test]
    fn the_paper_preset_spells_out_the_defaults() {
        for agent in draft("paper").agents {
            let section = agent.settings.section;
            for (index, key) in section.keys().iter().enumerate() {
                let (key, default, before) = (key.name, key.default(), key.before());
                let given = agent.settings.given.get(&index).map(|values| values.value.clone());
                match given {
                    Some(values) => assert_eq!(values, [default.unwrap()], "{key}"),
                    // A key that was added later has its value of earlier jobs.
                    None if before.is_some() => assert_eq!(before, default, "{key}"),
                    None => assert_eq!(key, "engine"),
                }
            }
        }
    }
}
