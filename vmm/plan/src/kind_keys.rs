//! Which keys of a partition belong to which kind: one table, from which the rule and its message are made.

use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::raw::{Partition, Tables};

/// Which kind of partition a key belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    Both,
    Plc,
    Linux,
}

/// How a key is written.
#[derive(Clone, Copy)]
enum Form {
    Value(fn(&Partition) -> Option<Span>),
    Table(fn(&Partition) -> Option<Span>),
}

use Form::{Table, Value};
use Owner::{Both, Linux, Plc};

/// All keys of a partition, in the order in which messages name them. A test compares them with the raw form.
const KEYS: [(&str, Owner, Form); 32] = [
    ("name", Both, Value(|p| Some(p.name.span()))),
    ("kind", Both, Value(|p| Some(p.kind.span()))),
    ("cpu", Both, Value(|p| value(&p.cpu))),
    ("cpus", Linux, Value(|p| value(&p.cpus))),
    ("memory", Both, Value(|p| Some(p.memory.span()))),
    ("huge_pages", Both, Value(|p| value(&p.huge_pages))),
    ("bus_locks", Both, Value(|p| value(&p.bus_locks))),
    ("cache", Both, Value(|p| value(&p.cache))),
    ("memory_bandwidth", Both, Value(|p| value(&p.memory_bandwidth))),
    ("background", Linux, Value(|p| value(&p.background))),
    ("release_guard", Plc, Value(|p| value(&p.release_guard))),
    ("image", Plc, Value(|p| value(&p.image))),
    ("on_schedule_change", Plc, Value(|p| value(&p.on_schedule_change))),
    ("restarts", Both, Value(|p| value(&p.restarts))),
    ("kernel", Linux, Value(|p| value(&p.kernel))),
    ("initrd", Linux, Value(|p| value(&p.initrd))),
    ("cmdline", Linux, Value(|p| value(&p.cmdline))),
    ("console", Linux, Value(|p| value(&p.console))),
    ("console_log", Both, Value(|p| value(&p.console_log))),
    ("watchdog", Linux, Value(|p| value(&p.watchdog))),
    ("power_off", Linux, Value(|p| value(&p.power_off))),
    ("vsock", Linux, Value(|p| value(&p.vsock))),
    ("program", Plc, Table(|p| first(&p.program))),
    ("io", Plc, Table(|p| first(&p.io))),
    ("can", Plc, Table(|p| first(&p.can))),
    ("task", Plc, Table(|p| first(&p.task))),
    ("port_io", Plc, Table(|p| first(&p.port_io))),
    ("mmio", Plc, Table(|p| first(&p.mmio))),
    ("safe_value", Plc, Table(|p| first(&p.safe_value))),
    ("interrupt", Plc, Table(|p| first(&p.interrupt))),
    ("disk", Linux, Table(|p| first(&p.disk))),
    ("net", Linux, Table(|p| first(&p.net))),
];

fn value<T>(value: &Option<Spanned<T>>) -> Option<Span> {
    value.as_ref().map(Spanned::span)
}

fn first<T>(Tables(tables): &Tables<T>) -> Option<Span> {
    tables.first().map(Spanned::span)
}

impl Owner {
    const fn name(self) -> &'static str {
        match self {
            Both => "either",
            Plc => "plc",
            Linux => "linux",
        }
    }

    const fn other(self) -> Owner {
        match self {
            Both => Both,
            Plc => Linux,
            Linux => Plc,
        }
    }

    /// What is found: a key of the other kind, in a partition of this one.
    pub fn misplaced(self, key: &str, partition: &str) -> String {
        let (kind, owner, partition) = (self.name(), self.other().name(), quote(partition));
        format!("`{key}` belongs to kind \"{owner}\"; partition {partition} is of kind \"{kind}\"")
    }

    /// The keys that a partition of this kind may have.
    fn allowed(self) -> String {
        let own = KEYS.iter().filter(|(_, owner, _)| *owner != self.other());
        let mut names: Vec<String> = own
            .map(|(name, _, form)| match form {
                Value(_) => (*name).to_owned(),
                Table(_) => format!("[[partition.{name}]]"),
            })
            .collect();
        let last = names.pop().unwrap_or_default();
        format!("for a \"{}\": {} and {last}", self.name(), names.join(", "))
    }
}

/// Refuses the keys that belong to the other kind.
pub fn check(raw: &Partition, kind: Owner) -> Result<(), Diagnostic> {
    for (key, owner, form) in KEYS {
        let (Value(place) | Table(place)) = form;
        if let Some(span) = place(raw).filter(|_| owner == kind.other()) {
            let found = kind.misplaced(key, raw.name.get_ref());
            return Err(Diagnostic::new(span, found, kind.allowed()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_every_key_of_the_raw_form_and_no_other() {
        // What serde says of a key that there is not names all that there are.
        let text = "name = \"a\"\nkind = \"plc\"\ncpu = 0\nmemory = \"1MiB\"\nzzz = 0\n";
        let error = toml::from_str::<Partition>(text).unwrap_err().to_string();
        let (_, expected) = error.split_once("expected one of ").expect("an unknown key");
        let mut expected: Vec<&str> =
            expected.trim().split(", ").map(|key| key.trim_matches('`')).collect();
        let mut keys: Vec<&str> = KEYS.iter().map(|(name, _, _)| *name).collect();
        expected.sort_unstable();
        keys.sort_unstable();
        assert_eq!(keys, expected);
    }
}
