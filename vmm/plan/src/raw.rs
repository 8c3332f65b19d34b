//! The file as it is written: keys, types and positions, no rules yet.
//!
//! Each value keeps the place it came from, so that a rule which is checked later can still point
//! at it. serde's `flatten`, untagged and internally tagged enums would be the shorter way to say
//! "these keys belong to that kind", but they buffer values and lose the places: `kind` is
//! therefore an ordinary key, and what belongs to which kind is a rule like any other.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use toml::Spanned;

use super::units::{Bytes, Duration, Guard};

/// The one thing that is read of a file whose version is not known yet.
#[derive(Debug, serde::Deserialize)]
pub struct Versioned {
    pub version: Spanned<i64>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    // Checked before, in `Versioned`; named here because every other key is refused.
    #[serde(rename = "version")]
    pub _version: i64,
    pub system: Spanned<Keys<System>>,
    #[serde(default)]
    pub partition: Tables<Partition>,
    #[serde(default)]
    pub schedule: Tables<Schedule>,
    #[serde(default)]
    pub channel: Tables<Channel>,
    #[serde(default)]
    pub health: Tables<Health>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct System {
    pub name: Spanned<String>,
    pub major_frame: Spanned<Duration>,
    pub control: Option<Spanned<String>>,
    pub viewers: Option<Spanned<String>>,
    pub watchdog: Option<Spanned<Duration>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Partition {
    pub name: Spanned<String>,
    pub kind: Spanned<String>,
    pub cpu: Option<Spanned<i64>>,
    pub cpus: Option<Spanned<Vec<Spanned<i64>>>>,
    pub memory: Spanned<Bytes>,
    pub huge_pages: Option<Spanned<String>>,
    pub bus_locks: Option<Spanned<Keys<BusLocks>>>,
    pub cache: Option<Spanned<i64>>,
    pub memory_bandwidth: Option<Spanned<i64>>,
    pub background: Option<Spanned<bool>>,
    pub release_guard: Option<Spanned<Guard>>,
    pub on_schedule_change: Option<Spanned<String>>,
    pub restarts: Option<Spanned<Keys<Restarts>>>,
    pub image: Option<Spanned<String>>,
    #[serde(default)]
    pub task: Tables<Task>,
    #[serde(default)]
    pub program: Tables<Program>,
    #[serde(default)]
    pub io: Tables<Io>,
    #[serde(default)]
    pub can: Tables<Can>,
    #[serde(default)]
    pub port_io: Tables<PortIo>,
    #[serde(default)]
    pub mmio: Tables<Mmio>,
    #[serde(default)]
    pub safe_value: Tables<SafeValue>,
    #[serde(default)]
    pub interrupt: Tables<Interrupt>,
    pub kernel: Option<Spanned<String>>,
    pub initrd: Option<Spanned<String>>,
    pub cmdline: Option<Spanned<String>>,
    pub console: Option<Spanned<String>>,
    pub console_log: Option<Spanned<String>>,
    pub watchdog: Option<Spanned<Duration>>,
    pub power_off: Option<Spanned<Duration>>,
    pub vsock: Option<Spanned<i64>>,
    #[serde(default)]
    pub disk: Tables<Disk>,
    #[serde(default)]
    pub net: Tables<Net>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Net {
    pub tap: Spanned<String>,
    pub mac: Spanned<String>,
    pub address: Option<Spanned<String>>,
    pub bridge: Option<Spanned<String>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Disk {
    pub path: Spanned<String>,
    pub read_only: Option<Spanned<bool>>,
    pub direct: Option<Spanned<bool>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    pub name: Spanned<String>,
    pub period: Spanned<Duration>,
    pub budget: Spanned<Duration>,
    pub priority: Spanned<i64>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Program {
    pub image: Spanned<String>,
    pub name: Option<Spanned<String>>,
    pub bank: Option<Spanned<Bytes>>,
    pub state: Option<Spanned<Bytes>>,
    pub second_state: Option<Spanned<bool>>,
    pub keys: Option<Spanned<Vec<Spanned<String>>>>,
    pub on_fault: Option<Spanned<String>>,
    pub on_overrun: Option<Spanned<String>>,
    pub on_deadline: Option<Spanned<String>>,
    pub watch: Option<Spanned<Bytes>>,
    pub allow_force: Option<Spanned<bool>>,
    pub retain: Option<Spanned<String>>,
    pub retain_every: Option<Spanned<Duration>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Io {
    pub program: Option<Spanned<String>>,
    pub point: Option<Spanned<String>>,
    pub at: Option<Spanned<String>>,
    pub channel: Option<Spanned<String>>,
    pub byte: Option<Spanned<i64>>,
    pub valid: Option<Spanned<bool>>,
    pub age: Option<Spanned<bool>>,
    pub port: Option<Spanned<String>>,
    pub mmio: Option<Spanned<String>>,
    pub offset: Option<Spanned<String>>,
    pub width: Option<Spanned<i64>>,
    pub bit: Option<Spanned<i64>>,
    pub output: Option<Spanned<String>>,
    pub output_of: Option<Spanned<String>>,
    pub can: Option<Spanned<String>>,
    pub id: Option<Spanned<String>>,
    pub extended: Option<Spanned<bool>>,
    pub count: Option<Spanned<bool>>,
    pub length: Option<Spanned<i64>>,
    pub send: Option<Spanned<String>>,
    pub simulate: Option<Spanned<Keys<Simulate>>>,
    pub task: Option<Spanned<String>>,
    pub on_stop: Option<Spanned<String>>,
    pub on_invalid: Option<Spanned<String>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulate {
    pub shape: Spanned<String>,
    pub value: Option<Spanned<f64>>,
    pub low: Option<Spanned<f64>>,
    pub high: Option<Spanned<f64>>,
    pub period: Option<Spanned<Duration>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Can {
    pub name: Spanned<String>,
    pub port: Option<Spanned<String>>,
    pub mmio: Option<Spanned<String>>,
    pub offset: Option<Spanned<String>>,
    pub stride: Option<Spanned<i64>>,
    pub bit_rate: Spanned<String>,
    pub frames_per_job: Option<Spanned<i64>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PortIo {
    pub ports: Spanned<String>,
    pub pci: Option<Spanned<String>>,
    pub bar: Option<Spanned<i64>>,
    pub unbind: Option<Spanned<bool>>,
    pub trusted_dma: Option<Spanned<bool>>,
    pub vfio: Option<Spanned<bool>>,
    pub shared_with_host: Option<Spanned<bool>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mmio {
    pub name: Spanned<String>,
    pub address: Spanned<String>,
    pub size: Spanned<Bytes>,
    pub pci: Option<Spanned<String>>,
    pub bar: Option<Spanned<i64>>,
    pub unbind: Option<Spanned<bool>>,
    pub trusted_dma: Option<Spanned<bool>>,
    pub vfio: Option<Spanned<bool>>,
    pub uio: Option<Spanned<String>>,
    pub map: Option<Spanned<i64>>,
    pub physical: Option<Spanned<String>>,
    pub shared_with_host: Option<Spanned<bool>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SafeValue {
    pub port: Option<Spanned<String>>,
    pub mmio: Option<Spanned<String>>,
    pub offset: Option<Spanned<String>>,
    pub width: Spanned<i64>,
    pub value: Spanned<String>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interrupt {
    pub name: Option<Spanned<String>>,
    pub vector: Spanned<i64>,
    pub pci: Option<Spanned<String>>,
    pub uio: Option<Spanned<String>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    pub name: Spanned<String>,
    #[serde(default)]
    pub window: Tables<Window>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    pub partition: Spanned<String>,
    pub offset: Spanned<Duration>,
    pub duration: Spanned<Duration>,
    pub period: Option<Spanned<Duration>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channel {
    pub name: Spanned<String>,
    pub kind: Spanned<String>,
    pub message_bytes: Spanned<i64>,
    pub source: Spanned<String>,
    pub destinations: Spanned<Vec<Spanned<String>>>,
    pub refresh_period: Option<Spanned<Duration>>,
    pub depth: Option<Spanned<i64>>,
    pub when_full: Option<Spanned<String>>,
    pub doorbell: Option<Spanned<bool>>,
    pub host_socket: Option<Spanned<String>>,
    pub host_file: Option<Spanned<String>>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Restarts {
    pub at_most: Spanned<i64>,
    pub within: Spanned<Duration>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BusLocks {
    pub at_most: Spanned<i64>,
    pub within: Spanned<Duration>,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Health {
    pub partition: Spanned<String>,
    pub error: Spanned<String>,
    pub action: Spanned<String>,
}

/// A table that is written with keys. serde's derived structs also take an array of the values in
/// the order in which the struct has them, which a partition file must not depend on.
#[derive(Debug)]
pub struct Keys<T>(pub T);

/// Any number of tables, each written `[[name]]`.
#[derive(Debug)]
pub struct Tables<T>(pub Vec<Spanned<Keys<T>>>);

impl<T> Default for Tables<T> {
    fn default() -> Tables<T> {
        Tables(Vec::new())
    }
}

struct KeysVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for KeysVisitor<T> {
    type Value = Keys<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a table of keys and values")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Keys<T>, A::Error> {
        T::deserialize(MapAccessDeserializer::new(map)).map(Keys)
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Keys<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Keys<T>, D::Error> {
        from.deserialize_map(KeysVisitor(PhantomData))
    }
}

struct TablesVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for TablesVisitor<T> {
    type Value = Tables<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of tables, each with two brackets on both sides of its name")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Tables<T>, A::Error> {
        let mut tables = Vec::new();
        while let Some(table) = seq.next_element()? {
            tables.push(table);
        }
        Ok(Tables(tables))
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Tables<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Tables<T>, D::Error> {
        from.deserialize_seq(TablesVisitor(PhantomData))
    }
}
