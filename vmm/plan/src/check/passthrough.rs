//! What partitions get of the host's devices. It is the same under every schedule, and so is shown
//! once.

use super::line;
use crate::{
    Bar, DeviceMemory, InterruptSource, MemorySource, Partition, PartitionFile, Passthrough,
    PciFunction, SafePlace,
};

/// Said of what the host itself runs on, where the file says that it is meant.
const SHARED: &str = ", shared with the host";

/// Ports, memory, interrupts and safe values of each partition, in the order of the file; nothing if there are
/// none.
pub fn list(out: &mut String, file: &PartitionFile) {
    let has_any = |p: &&Partition| {
        let it = p.passthrough();
        !(it.ports.is_empty() && it.memory.is_empty() && it.interrupts.is_empty())
    };
    let owners: Vec<&Partition> = file.partitions().iter().filter(has_any).collect();
    if owners.is_empty() {
        return;
    }
    out.push_str("\ndevices of this machine\n");
    for partition in owners {
        line(out, &format!("  {}", partition.name()));
        let it = partition.passthrough();
        for ports in &it.ports {
            let shared = if ports.shared_with_host { SHARED } else { "" };
            let place = ports.bar.as_ref().map_or(shared.into(), |b| format!(": {}", bar(b)));
            line(out, &format!("    ports {:#x} to {:#x}{place}", ports.first, ports.last));
        }
        for memory in &it.memory {
            let source = match &memory.source {
                MemorySource::Pci(b) => bar(b),
                MemorySource::Uio { device, map } => format!("map {map} of {device}"),
                MemorySource::Physical { address, shared_with_host } => {
                    let shared = if *shared_with_host { SHARED } else { "" };
                    format!("physical {address:#x}{shared}")
                }
            };
            let last = memory.address + (memory.bytes - 1);
            let name = &memory.name;
            line(out, &format!("    {name} at {:#x} to {last:#x}: {source}", memory.address));
        }
        for interrupt in &it.interrupts {
            let source = match &interrupt.source {
                InterruptSource::Pci(function) => function.name(),
                InterruptSource::Uio(device) => device,
            };
            let name = interrupt.name.as_ref().map_or(String::new(), |name| format!(" {name}"));
            line(out, &format!("    interrupt {}{name}: of {source}", interrupt.vector));
        }
        for safe in &it.safe_values {
            let place = match &safe.place {
                SafePlace::Port(port) => format!("port {port:#x}"),
                SafePlace::Register { memory, offset } => {
                    let name = it.memory.get(*memory).map_or("", |memory| &memory.name);
                    format!("{name} + {offset:#x}")
                }
            };
            let digits = 2 + 2 * usize::from(safe.width);
            line(out, &format!("    at its end {:#0digits$x} to {place}", safe.value));
            if let Some(function) = confined(it, &safe.place) {
                let text = format!("a reset of {function} undoes this value when takt ends (vfio)");
                line(out, &format!("    warning: {text}"));
            }
        }
    }
}

/// The function in which a safe value is written, if that is VFIO's. It is if any entry of it says so.
fn confined<'a>(it: &'a Passthrough, place: &SafePlace) -> Option<&'a PciFunction> {
    let of_memory = |memory: &'a DeviceMemory| match &memory.source {
        MemorySource::Pci(bar) => Some(bar),
        _ => None,
    };
    let bar = match place {
        SafePlace::Port(port) => {
            let mut ports = it.ports.iter();
            ports.find(|ports| (ports.first..=ports.last).contains(port))?.bar.as_ref()?
        }
        SafePlace::Register { memory, .. } => of_memory(it.memory.get(*memory)?)?,
    };
    let all = it.ports.iter().filter_map(|ports| ports.bar.as_ref());
    let mut all = all.chain(it.memory.iter().filter_map(of_memory));
    all.any(|other| other.vfio && other.function == bar.function).then_some(&bar.function)
}

fn bar(bar: &Bar) -> String {
    let mut text = format!("register {} of {}", bar.bar, bar.function);
    if bar.unbind {
        text.push_str(", taken from its driver");
    }
    text.push_str(match (bar.trusted_dma, bar.vfio) {
        (true, _) => ", trusted with DMA",
        (false, true) => ", DMA to the partition's memory",
        (false, false) => ", no DMA",
    });
    text
}
