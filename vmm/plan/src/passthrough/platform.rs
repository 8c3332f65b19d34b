//! Ports and memory of a PC on which the host's own kernel runs.
//!
//! Their numbers are the same on every PC, so the file alone tells that a partition would get them.
//! Who may write to the host's interrupt controller, its timer or the messages that are its interrupts
//! takes time from every partition, or ends them all. A partition gets one only where the file says
//! `shared_with_host = true`. What has other numbers on each machine (the ports of its power
//! management, the map of its RAM) is looked at when the file is run.
//!
//! RAM is given away in no case: a page that a partition may write is the kernel's own at its next
//! allocation.

use toml::Spanned;

use super::super::diagnostic::{Diagnostic, Span};

/// A part of the platform: first and last number, and what it is.
type Part = ([u64; 2], &'static str);

/// `standard_io_resources` in the kernel's `arch/x86/kernel/setup.c`; the fixed I/O ranges of a
/// platform controller hub, Intel document 332690, section 7.2; PCI Local Bus 3.0, 3.2.2.3.
const PORTS: [Part; 18] = [
    ([0x00, 0x1f], "the host's DMA controller"),
    ([0x20, 0x21], "the host's interrupt controller (PIC)"),
    ([0x40, 0x43], "the host's timer (PIT)"),
    ([0x50, 0x53], "the host's timer (PIT)"),
    ([0x60, 0x60], "the host's keyboard controller, which can reset the machine"),
    ([0x61, 0x61], "the host's port for NMIs and its timer's gate"),
    ([0x64, 0x64], "the host's keyboard controller, which can reset the machine"),
    ([0x70, 0x77], "the host's clock (CMOS) and its switch for NMIs"),
    ([0x80, 0x8f], "the host's DMA controller and its port for delays"),
    ([0x92, 0x92], "the host's port for a fast reset"),
    ([0xa0, 0xa1], "the host's interrupt controller (PIC)"),
    ([0xb2, 0xb3], "the host's ports that start system management interrupts"),
    ([0xc0, 0xdf], "the host's DMA controller"),
    ([0xf0, 0xff], "the host's floating-point error port"),
    ([0x4d0, 0x4d1], "the host's interrupt controller (PIC)"),
    ([0xcf8, 0xcf8], "what configures every PCI function of the host"),
    ([0xcf9, 0xcf9], "the host's reset register and what configures every PCI function of it"),
    ([0xcfa, 0xcff], "what configures every PCI function of the host"),
];

/// Intel SDM 3A, 12.4.1 and 12.11.1 (local APIC, messages); the I/O APIC and the HPET lie where
/// chipsets have had them since the ICH (`IO_APIC_DEFAULT_PHYS_BASE` in the kernel's
/// `arch/x86/include/asm/apicdef.h`; IA-PC HPET 1.0a, 3.1.1).
const MEMORY: [Part; 3] = [
    ([0xfec0_0000, 0xfec0_0fff], "the host's I/O APIC"),
    ([0xfed0_0000, 0xfed0_0fff], "the host's timer (HPET)"),
    ([0xfee0_0000, 0xfeef_ffff], "the host's local APIC and where writes become interrupts"),
];

/// End of the RAM that every PC has at address 0 (`ISA_START_ADDRESS` in the kernel's
/// `arch/x86/include/asm/e820/api.h`).
const LOW_RAM_END: u64 = 0xa_0000;

/// Refuses ports of the platform.
pub fn check_ports(range: [u64; 2], place: &Span, shared: bool) -> Result<(), Diagnostic> {
    check(&PORTS, "these ports meet", range, place, shared)
}

/// Refuses memory of the platform, and RAM.
pub fn check_memory(range: [u64; 2], place: &Span, shared: bool) -> Result<(), Diagnostic> {
    if range[0] < LOW_RAM_END {
        let found =
            format!("this memory meets the host's RAM, which goes to {:#x}", LOW_RAM_END - 1);
        let allowed = format!(
            "memory of a device, from {LOW_RAM_END:#x} up; RAM is given by the partition's `memory`"
        );
        return Err(Diagnostic::new(place.clone(), found, allowed));
    }
    check(&MEMORY, "this memory meets", range, place, shared)
}

fn check(
    parts: &[Part],
    what: &str,
    range: [u64; 2],
    place: &Span,
    shared: bool,
) -> Result<(), Diagnostic> {
    let meets = |(part, _): &&Part| range[0] <= part[1] && part[0] <= range[1];
    let Some(([first, last], name)) = parts.iter().find(meets).filter(|_| !shared) else {
        return Ok(());
    };
    let numbers =
        if first == last { format!("{first:#x}") } else { format!("{first:#x} to {last:#x}") };
    let found = format!("{what} {name}, {numbers}");
    let allowed = "what no part of the host runs on; or `shared_with_host = true` beside it, if this \
                   partition may stop the host";
    Err(Diagnostic::new(place.clone(), found, allowed))
}

/// Whether a table says that it means what the host itself runs on; an error beside `pci` or `uio`,
/// since those are devices, and not numbers of the host.
pub fn check_shared(
    shared: Option<&Spanned<bool>>,
    device: Option<(&str, Span)>,
) -> Result<bool, Diagnostic> {
    match (shared, device) {
        (Some(shared), Some((key, span))) => {
            let found =
                format!("`shared_with_host` is about numbers of the host, not about `{key}`");
            let allowed = format!("`shared_with_host` without `{key}`, or no `shared_with_host`");
            Err(Diagnostic::new(shared.span(), found, allowed).and(span, "the device"))
        }
        (shared, _) => Ok(shared.is_some_and(|shared| *shared.get_ref())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ports(first: u64, last: u64) -> bool {
        check_ports([first, last], &(0..1), false).is_ok()
    }

    fn memory(first: u64, last: u64) -> bool {
        check_memory([first, last], &(0..1), false).is_ok()
    }

    #[test]
    fn the_ports_between_those_of_the_platform_are_free() {
        for (first, last) in
            [(0x22, 0x3f), (0x44, 0x4f), (0x62, 0x63), (0x78, 0x7f), (0x100, 0x4cf)]
        {
            assert!(ports(first, last), "{first:#x}");
            assert!(!ports(first, last + 1) && !ports(first - 1, last), "{first:#x}");
        }
        assert!(ports(0xd00, 0xffff) && !ports(0xcff, 0xd00));
    }

    #[test]
    fn memory_is_free_up_to_the_byte_before_the_platforms() {
        assert!(memory(0xfeb0_0000, 0xfebf_ffff) && !memory(0xfeb0_0000, 0xfec0_0000));
        assert!(memory(0xfef0_0000, u64::MAX) && !memory(0xfeef_ffff, 0xfef0_0000));
        assert!(memory(0xa_0000, 0xf_ffff) && !memory(0x9_f000, 0xa_0fff));
    }

    #[test]
    fn the_key_gives_the_platform_away_but_no_ram() {
        assert!(check_ports([0, 0xffff], &(0..1), true).is_ok());
        assert!(check_memory([0xfed0_0000, 0xfed0_0fff], &(0..1), true).is_ok());
        assert!(check_memory([0, 0xfff], &(0..1), true).is_err());
    }
}
