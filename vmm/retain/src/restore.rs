//! From a generation to what a program begins with.

use std::collections::BTreeMap;
use std::fmt;

use crate::generation::{Entry, Generation};
use crate::layout::{Layout, Part};

/// Names of a list that are told.
const TOLD: usize = 16;

/// What a program begins with after a start of Takt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Restored {
    /// The block.
    pub block: Vec<u8>,
    /// RETAIN values are in it, not only PERSISTENT ones: it was the same image.
    pub retain: bool,
    /// Kept values of which the file has none.
    pub new: Vec<String>,
    /// Values of the file that nothing takes.
    pub dropped: Vec<String>,
    /// Values of another type: they start anew.
    pub retyped: Vec<String>,
    /// Arrays of which some elements were taken.
    pub partial: Vec<String>,
    /// RETAIN values that start anew since another image ran.
    pub anew: usize,
}

impl Layout {
    /// What of a generation a program with this layout begins with. A program of the same image gets all of it. Of
    /// another one, which is a download, PERSISTENT values are taken over by name and type, elements of arrays by
    /// their index.
    #[must_use]
    pub fn restore(&self, generation: &Generation) -> Restored {
        self.take_over(&generation.entries, generation.image == self.image())
    }

    /// The block with the values that a block of another version has, by name and type: an online change, over which
    /// RETAIN values are kept, too.
    #[must_use]
    pub fn carry(&self, from: &Layout, block: &[u8]) -> Vec<u8> {
        let entry = |part: &Part| {
            let Part { name, ty, lower, count, bytes, .. } = part.clone();
            Some(Entry { name, ty, lower, count, bytes, value: block.get(part.range())?.to_vec() })
        };
        let entries: Vec<Entry> = from.parts().iter().filter_map(entry).collect();
        self.take_over(&entries, true).block
    }

    fn take_over(&self, entries: &[Entry], same: bool) -> Restored {
        // Not hashed: what loads a program anew may not ask the kernel for random numbers.
        let mut there: BTreeMap<&str, &Entry> =
            entries.iter().map(|entry| (entry.name.as_str(), entry)).collect();
        let mut restored = Restored {
            block: self.initial().to_vec(),
            retain: same,
            new: Vec::new(),
            dropped: Vec::new(),
            retyped: Vec::new(),
            partial: Vec::new(),
            anew: 0,
        };
        for part in self.parts() {
            let entry = there.remove(part.name.as_str());
            if !same && !part.persistent {
                restored.anew += 1;
                continue;
            }
            match entry {
                None => restored.new.push(part.name.clone()),
                Some(entry) if (&entry.ty, entry.bytes) != (&part.ty, part.bytes) => {
                    restored.retyped.push(format!("{} ({} -> {})", part.name, entry.ty, part.ty));
                }
                Some(entry) => {
                    let taken = restored.take(part, entry);
                    if taken < part.count.max(entry.count) {
                        restored.partial.push(format!("{} ({taken} elements)", part.name));
                    }
                }
            }
        }
        restored.dropped = there.into_keys().map(str::to_owned).collect();
        restored
    }
}

impl Restored {
    /// Takes the elements that both have. Returns how many.
    fn take(&mut self, part: &Part, entry: &Entry) -> u32 {
        let end = |lower: i64, count: u32| i128::from(lower) + i128::from(count);
        let from = part.lower.max(entry.lower);
        let to = end(part.lower, part.count).min(end(entry.lower, entry.count));
        let Ok(count) = u32::try_from(to - i128::from(from)) else { return 0 };
        let bytes = part.bytes as usize;
        let offset = |lower: i64| from.abs_diff(lower) as usize * bytes;
        let length = count as usize * bytes;
        let (at, source) = (part.at + offset(part.lower), offset(entry.lower));
        let to = self.block.get_mut(at..at + length);
        let from = entry.value.get(source..source + length);
        match (to, from) {
            (Some(to), Some(from)) => to.copy_from_slice(from),
            _ => return 0,
        }
        count
    }

    /// True if there is something to tell: not all values were taken as they were.
    #[must_use]
    pub fn is_partial(&self) -> bool {
        self.anew > 0
            || [&self.new, &self.dropped, &self.retyped, &self.partial]
                .iter()
                .any(|list| !list.is_empty())
    }
}

/// What was not taken as it was.
impl fmt::Display for Restored {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut between = "";
        if self.anew > 0 {
            write!(f, "{} RETAIN values start anew, because another image ran", self.anew)?;
            between = "; ";
        }
        let lists = [
            ("new", &self.new),
            ("dropped", &self.dropped),
            ("of another type, start anew", &self.retyped),
            ("in part", &self.partial),
        ];
        for (what, names) in lists.into_iter().filter(|(_, names)| !names.is_empty()) {
            write!(f, "{between}{what}: {}", names[..names.len().min(TOLD)].join(", "))?;
            if names.len() > TOLD {
                write!(f, " and {} more", names.len() - TOLD)?;
            }
            between = "; ";
        }
        Ok(())
    }
}
