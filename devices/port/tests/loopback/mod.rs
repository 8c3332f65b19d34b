//! A folder that looks like the function's, of a partition whose channels end in itself: `resource1`
//! and `resource2` are the same file, so that what one port writes another one reads.

use std::fs;
use std::mem::offset_of;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use takt_abi::{Port, PortTable};
use takt_port::channel::{Geometry, Load, Policy, Store};

const PAGE: usize = 4096;
/// Longest message of each port.
pub const MAXIMUM: u32 = 512;
/// Depth of the queues.
pub const DEPTH: u32 = 4;

/// The folder; it goes when this value does.
pub struct Loopback {
    folder: PathBuf,
}

struct Image(Vec<u8>);

impl Image {
    fn put(&mut self, at: usize, bytes: &[u8]) {
        self.0[at..at + bytes.len()].copy_from_slice(bytes);
    }

    /// Adds pages, formats them, and returns where they are.
    fn region(&mut self, bytes: usize, format: impl Fn(&mut Words<'_>)) -> (u64, u32) {
        let start = self.0.len();
        self.0.resize(start + bytes.next_multiple_of(PAGE), 0);
        format(&mut Words(&mut self.0[start..]));
        (start as u64, bytes.div_ceil(PAGE) as u32)
    }
}

struct Words<'a>(&'a mut [u8]);

impl Load for Words<'_> {
    fn words(&self) -> usize {
        self.0.len() / 8
    }

    fn load(&self, word: usize) -> u64 {
        u64::from_le_bytes(self.0.as_chunks::<8>().0[word])
    }
}

impl Store for Words<'_> {
    fn store(&mut self, word: usize, value: u64) {
        self.0.as_chunks_mut::<8>().0[word] = value.to_le_bytes();
    }
}

impl Loopback {
    /// Channels from `out` to `in` (sampling), `send` to `receive` (a queue that refuses), and
    /// `log` to `trail` (one that overwrites).
    pub fn new() -> Loopback {
        Loopback::with_source("out")
    }

    /// The same with another name for `out`.
    pub fn with_source(source: &str) -> Loopback {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("takt-loopback-{}-{number}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("resource1"), image(source)).unwrap();
        symlink("resource1", folder.join("resource2")).unwrap();
        Loopback { folder }
    }

    pub fn path(&self) -> &Path {
        &self.folder
    }

    /// Overwrites bytes of the memory, as a program that breaks every rule would.
    pub fn damage(&self, offset: usize, bytes: &[u8]) {
        let file = fs::OpenOptions::new().write(true).open(self.folder.join("resource1")).unwrap();
        std::os::unix::fs::FileExt::write_all_at(&file, bytes, offset as u64).unwrap();
    }
}

impl Drop for Loopback {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
}

fn image(source: &str) -> Vec<u8> {
    let mut image = Image(vec![0; PAGE]);
    image.put(offset_of!(PortTable, magic), &takt_abi::MAGIC.to_le_bytes());
    image.put(offset_of!(PortTable, version), &takt_abi::VERSION.to_le_bytes());
    image.put(offset_of!(PortTable, tsc_khz), &1_000_000_u64.to_le_bytes());
    let channels = [
        (Geometry::sampling(MAXIMUM).unwrap(), source, "in", [1, 1, 0]),
        (
            Geometry::queuing(MAXIMUM, DEPTH, Policy::Refuse).unwrap(),
            "send",
            "receive",
            [2, DEPTH, 1],
        ),
        (
            Geometry::queuing(MAXIMUM, DEPTH, Policy::Overwrite).unwrap(),
            "log",
            "trail",
            [2, DEPTH, 2],
        ),
    ];
    let mut index = 0;
    for (geometry, source, destination, [kind, depth, policy]) in channels {
        let messages =
            image.region(geometry.source_bytes(), |region| geometry.format_source(region).unwrap());
        let taken = match geometry.destination_bytes() {
            0 => (0, 0),
            bytes => image.region(bytes, |region| geometry.format_destination(region).unwrap()),
        };
        for (name, direction, own, peer) in
            [(source, 1_u32, messages, taken), (destination, 2, taken, messages)]
        {
            let at = offset_of!(PortTable, ports) + index * size_of::<Port>();
            let mut put = |field: usize, value: u32| image.put(at + field, &value.to_le_bytes());
            put(offset_of!(Port, kind), kind);
            put(offset_of!(Port, direction), direction);
            put(offset_of!(Port, maximum), MAXIMUM);
            put(offset_of!(Port, depth), depth);
            put(offset_of!(Port, policy), policy);
            put(offset_of!(Port, own_pages), own.1);
            put(offset_of!(Port, peer_pages), peer.1);
            put(offset_of!(Port, doorbell), 1);
            image.put(at, name.as_bytes());
            image.put(at + offset_of!(Port, own), &own.0.to_le_bytes());
            image.put(at + offset_of!(Port, peer), &peer.0.to_le_bytes());
            if kind == 1 {
                // One second.
                image.put(at + offset_of!(Port, refresh_ns), &1_000_000_000_u64.to_le_bytes());
            }
            index += 1;
        }
    }
    image.put(offset_of!(PortTable, count), &(index as u32).to_le_bytes());
    image.0
}
