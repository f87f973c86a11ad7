//! Items by a key they share.

use std::collections::HashMap;
use std::hash::Hash;

/// The items of each key. Keys are in order of first appearance, and the items of a key keep their order.
pub fn grouped<K: Clone + Eq + Hash, T>(
    items: impl IntoIterator<Item = (K, T)>,
) -> Vec<(K, Vec<T>)> {
    let mut groups: Vec<(K, Vec<T>)> = Vec::new();
    let mut indices: HashMap<K, usize> = HashMap::new();
    for (key, item) in items {
        match indices.get(&key) {
            Some(index) => groups[*index].1.push(item),
            None => {
                indices.insert(key.clone(), groups.len());
                groups.push((key, vec![item]));
            }
        }
    }
    groups
}
