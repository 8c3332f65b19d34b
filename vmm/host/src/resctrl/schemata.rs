//! The file `schemata` of a group: what of each cache and of each way to memory its threads may use.
//!
//! ```text
//!     L3:0=7ff;1=7ff
//!     MB:0=100;1=100
//! ```

/// What can be divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resource {
    /// The L3 cache: masks of ways.
    Cache,
    /// The way to memory: per cent.
    Bandwidth,
}

impl Resource {
    const fn name(self) -> &'static str {
        match self {
            Self::Cache => "L3",
            Self::Bandwidth => "MB",
        }
    }

    /// The line that gives one value in one domain and leaves all others as they are.
    #[must_use]
    pub fn line(self, domain: u32, value: u32) -> String {
        match self {
            Self::Cache => format!("L3:{domain}={value:x}"),
            Self::Bandwidth => format!("MB:{domain}={value}"),
        }
    }
}

/// What a group has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Schemata {
    text: String,
}

impl Schemata {
    /// By the text of the file. Lines of other resources, and what is no line, are passed over.
    #[must_use]
    pub fn new(text: &str) -> Self {
        Self { text: text.to_owned() }
    }

    /// All domains of a resource with their values.
    pub fn of(&self, resource: Resource) -> impl Iterator<Item = (u32, u32)> {
        let lines = self.text.lines().filter_map(|line| line.trim().split_once(':'));
        let values = lines.filter(move |(name, _)| *name == resource.name());
        let radix = if resource == Resource::Cache { 16 } else { 10 };
        values.flat_map(|(_, all)| all.split(';')).filter_map(move |one| {
            let (domain, value) = one.split_once('=')?;
            let value = u32::from_str_radix(value.trim(), radix).ok()?;
            Some((domain.trim().parse().ok()?, value))
        })
    }

    /// The same with these ways in each cache.
    #[must_use]
    pub fn with_all_ways(&self, ways: u32) -> Self {
        let lines = self.of(Resource::Cache).map(|(domain, _)| Resource::Cache.line(domain, ways));
        Self { text: lines.collect::<Vec<_>>().join("\n") }
    }

    /// The ways in one cache.
    #[must_use]
    pub fn ways(&self, domain: u32) -> Option<u32> {
        self.of(Resource::Cache).find(|(of, _)| *of == domain).map(|(_, ways)| ways)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_domain_has_its_value() {
        let schemata = Schemata::new("    L3:0=7ff;1=f\n    MB:0=100;1= 30\n    L2:0=3\n");
        assert_eq!(schemata.of(Resource::Cache).collect::<Vec<_>>(), [(0, 0x7ff), (1, 0xf)]);
        assert_eq!(schemata.of(Resource::Bandwidth).collect::<Vec<_>>(), [(0, 100), (1, 30)]);
        assert_eq!((schemata.ways(1), schemata.ways(2)), (Some(0xf), None));
        let whole = schemata.with_all_ways(0x7ff);
        assert_eq!((whole.ways(0), whole.ways(1)), (Some(0x7ff), Some(0x7ff)));
        assert_eq!(Resource::Cache.line(1, 0xf0), "L3:1=f0");
        assert_eq!(Resource::Bandwidth.line(0, 30), "MB:0=30");
    }

    #[test]
    fn nonsense_is_passed_over() {
        for text in ["", ":", "L3", "L3:", "L3:=;=1;0=;x=1;0=g;0", "\u{fffd}:0=1", "L3:0=fffffffff"]
        {
            assert_eq!(Schemata::new(text).of(Resource::Cache).count(), 0, "{text}");
        }
    }
}
