//! A Linux program that owns the device of the ports and breaks every rule about it.
//!
//!     hostile SEED STEPS [FUNCTION]
//!
//! In each step it writes something nasty of 1 to 8 bytes to some place: the regions and what lies
//! between and behind them, the memory that it may only read, or the configuration
//! space of any function on the PCI bus. FUNCTION is a folder like the PCI function's in sysfs, and
//! only its own configuration is then written. Without it nothing happens on a machine that has no
//! function of Takt's; where there is one, the other functions may not survive either.
//!
//! Exit status 0: all steps are done, and the table of ports is what it was. What else must be
//! unharmed, the partitions beside this one, is for others to see.

#![deny(unsafe_code)]

mod bar;

use std::error::Error;
use std::fs::{self, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use bar::Bar;
use takt_port::Ports;
use takt_tests::random::Random;

const CONFIGURATION_BYTES: u64 = 256;

struct Target {
    readable: Bar,
    /// The same memory mapped for writing, if the kernel lets.
    forced: Option<Bar>,
    writable: Option<Bar>,
    configurations: Vec<PathBuf>,
}

#[derive(Debug, Default)]
struct Done {
    read_only: u64,
    writable: u64,
    configuration: u64,
    refused: u64,
}

impl Target {
    fn new(folder: &Path, configurations: Vec<PathBuf>) -> std::io::Result<Target> {
        Ok(Target {
            readable: Bar::readable(&folder.join("resource1"))?,
            forced: Bar::writable(&folder.join("resource1")).ok(),
            writable: Bar::writable(&folder.join("resource2")).ok(),
            configurations,
        })
    }

    fn step(&self, random: &mut Random, done: &mut Done) {
        let (bar, count) = match random.below(16) {
            0..8 => (&self.writable, &mut done.writable),
            8..12 => (&self.forced, &mut done.read_only),
            _ => {
                if self.configure(random) {
                    done.configuration += 1;
                } else {
                    done.refused += 1;
                }
                return;
            }
        };
        match bar {
            Some(bar) => {
                spoil(bar, random);
                *count += 1;
            }
            None => done.refused += 1,
        }
    }

    fn configure(&self, random: &mut Random) -> bool {
        let Some(path) = pick(&self.configurations, random) else { return false };
        let bytes = 1 << random.below(3);
        // The command register and the BARs are worth more than the rest.
        let end = if random.below(2) == 0 { 0x40 } else { CONFIGURATION_BYTES };
        let at = random.below(end);
        let value = random.nasty(0).to_le_bytes();
        let file = OpenOptions::new().write(true).open(path);
        file.and_then(|file| file.write_all_at(&value[..bytes], at)).is_ok()
    }
}

fn pick<'a>(from: &'a [PathBuf], random: &mut Random) -> Option<&'a PathBuf> {
    let count = from.len() as u64;
    (count > 0).then(|| &from[random.below(count) as usize])
}

/// Writes to headers and counters, which begin each page, as often as to all the rest.
fn spoil(bar: &Bar, random: &mut Random) {
    let page = random.below((bar.bytes() / 4096).max(1)) * 4096;
    let within = if random.below(2) == 0 { 192 } else { 4096 };
    let bytes = 1 << random.below(4);
    // Now and then across the natural alignment.
    let align = if random.below(8) == 0 { 1 } else { bytes };
    let at = (page + random.below(within)) / align * align;
    let value = random.nasty(bar.load(at & !7));
    bar.store(at, bytes, value);
}

/// The first page, as 64-bit words.
fn table(bar: &Bar) -> Vec<u64> {
    (0..4096).step_by(8).map(|at| bar.load(at)).collect()
}

fn run(seed: u64, steps: u64, function: Option<&str>) -> Result<bool, Box<dyn Error>> {
    let (folder, configurations) = match function {
        Some(folder) => (PathBuf::from(folder), vec![Path::new(folder).join("config")]),
        None => {
            let all = fs::read_dir("/sys/bus/pci/devices").into_iter().flatten().flatten();
            let all = all.map(|entry| entry.path().join("config")).collect();
            (Ports::discover()?.folder().to_owned(), all)
        }
    };
    let target = Target::new(&folder, configurations)?;
    let before = table(&target.readable);
    let (mut random, mut done) = (Random::new(seed), Done::default());
    for _ in 0..steps {
        target.step(&mut random, &mut done);
    }
    let unchanged = table(&target.readable) == before;
    let Done { read_only, writable, configuration, refused } = done;
    println!(
        "hostile: seed {seed}, writable {writable}, read-only {read_only}, \
         configuration {configuration}, refused {refused}, table {}",
        if unchanged { "unchanged" } else { "CHANGED" }
    );
    Ok(unchanged)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let parsed = match arguments[..] {
        [seed, steps] => seed.parse().ok().zip(steps.parse().ok()).map(|both| (both, None)),
        [seed, steps, folder] => {
            seed.parse().ok().zip(steps.parse().ok()).map(|both| (both, Some(folder)))
        }
        _ => None,
    };
    let Some(((seed, steps), function)) = parsed else {
        eprintln!("usage: hostile SEED STEPS [FUNCTION]");
        return ExitCode::from(64);
    };
    match run(seed, steps, function) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            println!("hostile: {error}");
            ExitCode::from(70)
        }
    }
}
