//! Kernels and PLC images. They come from the administrator too, but from further away: a vendor, a
//! compiler, a broken download.

use std::cell::LazyCell;
use std::thread_local;

use takt::boot::acpi::AcpiConfig;
use takt::boot::plc::{PlcImage, Source};
use takt::boot::{StartMode, linux};
use takt::memory::{GuestMemory, Pages};

use super::scratch;

const PLC_RAM: u64 = 2 << 20;
const LINUX_RAM: u64 = 16 << 20;

thread_local! {
    // One for all cases: what the last one left there is as good as anything.
    static PLC: LazyCell<GuestMemory> =
        LazyCell::new(|| GuestMemory::for_plc(PLC_RAM, Pages::Small, &[]).expect("memory"));
    static LINUX: LazyCell<GuestMemory> =
        LazyCell::new(|| GuestMemory::for_linux(LINUX_RAM, Pages::Small, &[], 0).expect("memory"));
}

/// Loads the image of a PLC, and loads it again as a warm start does.
///
/// # Panics
/// If it would be entered outside of its memory.
pub fn plc(data: &[u8]) {
    let path = scratch::file("plc.elf", data);
    let Ok(image) = PlcImage::read(Source::File(&path), PLC_RAM) else { return };
    PLC.with(|memory| {
        if let Ok(entry) = image.load(memory) {
            assert!(entry.rip < PLC_RAM, "entry at {:#x}", entry.rip);
        }
        let _ = image.reload(memory, StartMode::Warm);
    });
}

/// Loads a kernel, with a RAM disk beside it.
pub fn linux(data: &[u8]) {
    let kernel = scratch::file("kernel", data);
    let initrd = scratch::file("initrd", &[0x55; 5000]);
    let [Ok(mut kernel), Ok(mut initrd)] = [&kernel, &initrd].map(|path| linux::Image::open(path))
    else {
        return;
    };
    LINUX.with(|memory| {
        let disk = Some(&mut initrd);
        let _ = linux::load(memory, &mut kernel, disk, "console=ttyS0", AcpiConfig::default());
    });
}
