//! The built-in presets that a manifest can extend, as drafts.

use toml::de::DeTable;

use crate::key::free_key;
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

fn text(name: &str) -> &'static str {
    PRESETS.iter().find(|(preset, _)| *preset == name).map_or("", |(_, text)| text)
}

/// The content of the preset `name`, whose environment has these keys of parameters beside its own; an empty draft if there
/// is no such preset.
pub(super) fn draft(name: &str, beside: Vec<&'static str>) -> Draft {
    let (root, _) = DeTable::parse_recoverable(text(name));
    Reader { beside, ..Reader::new(text(name)) }.draft(root.get_ref())
}

/// The keys of the parameters that the preset `name` sets, whose names an author chooses.
pub(super) fn parameters(name: &str) -> Vec<&'static str> {
    let family = draft(name, Vec::new()).family();
    family.keys.iter().map(|key| key.name).filter(|name| free_key(name).is_some()).collect()
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
            let agents = draft(name, Vec::new()).agents.into_iter();
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
        for agent in draft("paper", Vec::new()).agents {
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
