//! A Linux program that does to its machine what no kernel does.
//!
//!     hostile-machine SEED STEPS
//!
//! In each step it reads or writes an I/O port in one of three widths, with a string instruction
//! now and then: any port, or one of those that have a device behind them. Only what
//! ends the machine is left out: the registers of power and the keyboard's controller. The serial
//! port is put right at the end, so that the console can be read again.
//!
//! Exit status 0: all steps are done.

use std::arch::asm;
use std::process::ExitCode;

use takt_tests::random::Random;

const SERIAL: u16 = 0x3f8;
/// Ports that are never written: keyboard controller (reset), ACPI's sleep and reset.
const ENDS_IT: [u16; 5] = [0x60, 0x64, 0x600, 0x601, 0x602];
/// Where devices are: serial port, the keyboard's controller, ACPI, PCI configuration.
const DEVICES: [(u16, u64); 4] = [(SERIAL, 8), (0x60, 5), (0x600, 8), (0xcf8, 8)];
/// Registers of the serial port that hold what a driver has set: interrupts, line, modem.
const KEPT: [u16; 3] = [SERIAL + 1, SERIAL + 3, SERIAL + 4];
/// Divisor access, in the line register: then the first two registers are others.
const DIVISOR: u8 = 0x80;

macro_rules! ports {
    ($read:ident, $write:ident, $number:ty, $register:tt) => {
        fn $read(port: u16) -> $number {
            let value;
            // SAFETY: the machine is the one that is to be spoilt; no memory is involved.
            unsafe {
                asm!(concat!("in ", $register, ", dx"), in("dx") port, out($register) value,
                     options(nomem, nostack, preserves_flags));
            }
            value
        }
        fn $write(port: u16, value: $number) {
            // SAFETY: as above.
            unsafe {
                asm!(concat!("out dx, ", $register), in("dx") port, in($register) value,
                     options(nomem, nostack, preserves_flags));
            }
        }
    };
}

ports!(read8, write8, u8, "al");
ports!(read16, write16, u16, "ax");
ports!(read32, write32, u32, "eax");

/// A string of bytes from or to one port.
fn string(port: u16, write: bool, bytes: &mut [u8]) {
    // SAFETY: the instruction touches `rcx` bytes from the address on, which is the slice; the
    // direction flag is clear by the calling convention.
    unsafe {
        if write {
            asm!("rep outsb", in("dx") port, inout("rsi") bytes.as_ptr() => _,
                 inout("rcx") bytes.len() => _, options(readonly, nostack, preserves_flags));
        } else {
            asm!("rep insb", in("dx") port, inout("rdi") bytes.as_mut_ptr() => _,
                 inout("rcx") bytes.len() => _, options(nostack, preserves_flags));
        }
    }
}

/// True if an access of `width` bytes would end the machine.
fn ends_it(port: u16, width: u16) -> bool {
    ENDS_IT.iter().any(|end| (port..port.saturating_add(width)).contains(end))
}

fn step(random: &mut Random, string_bytes: &mut [u8]) {
    let port = if random.below(2) == 0 {
        random.number() as u16
    } else {
        let (first, count) = DEVICES[random.below(DEVICES.len() as u64) as usize];
        first + random.below(count) as u16
    };
    let value = random.nasty(0);
    let write = random.below(2) == 0;
    match (random.below(16), write) {
        // Text would flood the console below, and hide what the test looks for.
        _ if write && port == SERIAL => {}
        (0, _) if !ends_it(port, 1) => {
            let bytes = random.below(string_bytes.len() as u64) as usize;
            string(port, write, &mut string_bytes[..bytes]);
        }
        (1..6, true) if !ends_it(port, 1) => write8(port, value as u8),
        (6..11, true) if !ends_it(port, 2) => write16(port, value as u16),
        (11.., true) if !ends_it(port, 4) => write32(port, value as u32),
        (1..6, false) => _ = read8(port),
        (6..11, false) => _ = read16(port),
        (11.., false) => _ = read32(port),
        _ => {}
    }
}

fn main() -> ExitCode {
    let arguments: Vec<u64> = std::env::args().skip(1).flat_map(|word| word.parse()).collect();
    let [seed, steps] = arguments[..] else {
        eprintln!("usage: hostile-machine SEED STEPS");
        return ExitCode::from(64);
    };
    // SAFETY: it changes only what this thread may do.
    if unsafe { libc::iopl(3) } != 0 {
        println!("hostile-machine: {}", std::io::Error::last_os_error());
        return ExitCode::from(70);
    }
    let kept = KEPT.map(read8);
    let (mut random, mut string_bytes) = (Random::new(seed), vec![0; 10_000]);
    (0..steps).for_each(|_| step(&mut random, &mut string_bytes));
    write8(SERIAL + 3, kept[1] & !DIVISOR);
    KEPT.iter().zip(kept).for_each(|(port, value)| write8(*port, value));
    println!("hostile-machine: seed {seed}, {steps} steps done");
    ExitCode::SUCCESS
}
