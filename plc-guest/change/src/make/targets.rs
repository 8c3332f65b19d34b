//! References follow the first byte of their targets, so all of a target must be behind it in the new version, too.

use std::collections::{HashMap, HashSet};
use std::string::{String, ToString};
use std::vec::Vec;

use takt_program::TypeId;

use super::refusal::Refusal;

/// Types of the old version that references lead to, and such as are not whole behind their first byte.
#[derive(Default)]
pub struct Targets {
    types: HashSet<TypeId>,
    /// With the name of one variable of each.
    broken: HashMap<TypeId, String>,
}

impl Targets {
    /// A reference to this type comes along.
    pub fn refer_to(&mut self, ty: TypeId) {
        self.types.insert(ty);
    }

    /// Something of this type is not whole.
    pub fn breaks(&mut self, ty: TypeId, name: &str) {
        self.broken.entry(ty).or_insert_with(|| name.to_string());
    }

    /// What is broken and referred to.
    pub fn refusals(&self) -> Vec<Refusal> {
        let broken = self.broken.iter().filter(|(ty, _)| self.types.contains(ty));
        let mut names: Vec<_> = broken.map(|(_, name)| name.clone()).collect();
        names.sort_unstable();
        names.into_iter().map(|name| Refusal::Target { name }).collect()
    }
}
