//! Everything that crosses the line between Takt and a PLC guest.
//!
//! Host and guest are compiled apart and neither trusts the other, so the one thing they must
//! agree on is written once, here, and imported by both: where things lie in the guest's physical
//! address space, the two pages through which release and scan are told, and the I/O ports that
//! are doorbells. The layouts are `repr(C)`, have no padding, and are checked at compile time;
//! [`VERSION`] changes whenever one of them does.
//!
//! # Who writes what
//!
//! | page | host | guest | why |
//! | --- | --- | --- | --- |
//! | [`Information`] | writes | reads (a read-only memory slot) | a guest cannot forge its own schedule |
//! | [`PortTable`] | writes, before the start | reads (a read-only memory slot) | which ports it has is the file's business |
//! | [`ProgramTable`](program::ProgramTable) | writes, before the start | reads (a read-only memory slot) | so are its programs |
//! | [`IoTable`](io::IoTable) | writes, before the start | reads (a read-only memory slot) | and what their inputs and outputs are |
//! | [`Status`] and text | reads | writes | a claim of the guest, checked before it is believed |
//!
//! The host writes the information page only while the vCPU is outside guest mode. A kick can take
//! it out between any two instructions, though, and the page may then be rewritten for the next
//! window. [`Information::release`] is therefore also a sequence number: it changes whenever any
//! other field does and never takes a value twice, so a copy that begins and ends with the same
//! one is whole.

#![no_std]
#![forbid(unsafe_code)]

pub mod can;
pub mod io;
pub mod live;
pub mod program;

/// Version of this interface. A guest that finds another in [`Information::version`] must stop.
pub const VERSION: u32 = 8;

/// First field of the information page: `"TAKT"`, little-endian.
pub const MAGIC: u32 = u32::from_le_bytes(*b"TAKT");

/// Where a PLC guest finds things in its physical address space.
pub mod memory {
    /// Smallest unit of mapping and of memory size.
    pub const PAGE: u64 = 4096;
    /// Start of the area that an image may occupy. Below it lie the structures the VMM needs to
    /// start a vCPU in long mode: descriptor table, page tables, first stack.
    pub const IMAGE_BASE: u64 = 0x10_0000;
    /// Largest RAM of a PLC guest, in bytes. The first 3 GiB are RAM, the fourth is for pages.
    pub const RAM_MAX: u64 = 0xc000_0000;
    /// Guest-physical address of the [`Information`](crate::Information) page (read-only).
    pub const INFORMATION: u64 = 0xc000_0000;
    /// Guest-physical address of the [`Status`](crate::Status) page (read-write).
    pub const STATUS: u64 = 0xc000_1000;
    /// Guest-physical address of the text that [`port::CONSOLE`](crate::port::CONSOLE) prints, in
    /// the second half of the status page.
    pub const TEXT: u64 = STATUS + PAGE / 2;
    /// Longest text of one call, in bytes.
    pub const TEXT_BYTES: usize = (PAGE / 2) as usize;
    /// Longest text of [`port::ERROR`](crate::port::ERROR), in bytes.
    pub const ERROR_TEXT_BYTES: usize = 64;
    /// Guest-physical address of the [`PortTable`](crate::PortTable) page (read-only).
    pub const PORT_TABLE: u64 = 0xc000_2000;
    /// Guest-physical address of the [`ProgramTable`](crate::program::ProgramTable) page (read-only), if
    /// the partition has programs.
    pub const PROGRAM_TABLE: u64 = 0xc000_3000;
    /// Guest-physical address of the [`IoTable`](crate::io::IoTable) (read-only), if the partition has
    /// programs.
    pub const IO_TABLE: u64 = 0xc000_4000;
    /// Its length, in pages.
    pub const IO_TABLE_PAGES: u64 = 4;
    /// Start of the area of channel pages. Each is readable, and writable if it is the guest's own.
    pub const CHANNELS: u64 = 0xc000_8000;
    /// End of that area: it and the pages before it are in one page table.
    pub const CHANNELS_END: u64 = 0xc020_0000;
    /// Start of the area in which the memory of devices lies, at the addresses of the partition
    /// file. A guest maps all of it uncached. An access that no device covers is an exit.
    pub const DEVICES: u64 = 0xd000_0000;
    /// End of that area.
    pub const DEVICES_END: u64 = 0xe000_0000;
}

/// The I/O ports that are the guest's calls to Takt. Each access is one VM exit.
pub mod port {
    use core::ops::RangeInclusive;

    /// What is kept for such calls, used or not: no port of the host's can be passed through here.
    pub const RESERVED: RangeInclusive<u16> = 0x7a00..=0x7aff;
    /// 32-bit write of a length: that many bytes at [`memory::TEXT`](crate::memory::TEXT) appear
    /// on Takt's console. They are taken without blocking; what does not fit is dropped and
    /// counted. (A string instruction would be one exit for each byte.)
    pub const CONSOLE: u16 = 0x7a0c;
    /// 32-bit write of [`done`], or of 0: the scan is done, the rest of the window is given away.
    /// The instruction completes when the next release is about to be due, or at once if the value is that
    /// of another window: a guest can be taken out just before it writes.
    pub const DONE: u16 = 0x7a00;
    /// The value for [`DONE`] that gives away the window of this release only; 0 gives away any. For one release in
    /// 2^32 it is 0.
    #[must_use]
    pub const fn done(release: u64) -> u32 {
        release.wrapping_add(1) as u32
    }
    /// 32-bit write of any value: an exception has been recorded in
    /// [`Status::exception`](crate::Status::exception); the guest does not run again.
    pub const EXCEPTION: u16 = 0x7a04;
    /// 32-bit write of an exit code: the guest ends itself; 0 is success.
    pub const EXIT: u16 = 0x7a08;
    /// 32-bit write of a code: the guest reports an error of its application, for the health
    /// monitor. What lies at [`memory::TEXT`](crate::memory::TEXT), up to a zero byte or
    /// [`memory::ERROR_TEXT_BYTES`](crate::memory::ERROR_TEXT_BYTES), is said with it. The guest
    /// goes on if its partition's table lets it.
    pub const ERROR: u16 = 0x7a14;
    /// 32-bit write of a port's place in the [`PortTable`](crate::PortTable), if that port is a
    /// source with a doorbell: the partitions that wait for its messages are woken. The host's kernel
    /// does it, within the instruction.
    pub const DOORBELL: u16 = 0x7a10;
    /// 32-bit write of a vector that the partition file gives to a device: the device may interrupt
    /// once more. To be written when the guest is ready for the first interrupt, and then after each
    /// one, when the device asks for none any more. The host's kernel takes it within the
    /// instruction.
    pub const ARM: u16 = 0x7a18;
    /// 32-bit write of a vector, from 32 to 254: from now on until the guest is started anew, a window
    /// begins with this interrupt if the guest has not said [`DONE`] in the window before. It comes
    /// before the release, if the guest's interrupt flag is set then; a guest whose flag is clear looks at
    /// [`Information::release`](crate::Information::release) itself. It needs no end of interrupt, and may come twice for
    /// one release: a handler looks there too. For a guest that has asked for this the
    /// end of a window before [`DONE`] is no overrun, if the scan of that window is complete
    /// ([`Status::done_tsc`](crate::Status::done_tsc)).
    pub const TICK: u16 = 0x7a1c;
}

/// The partition information page: what a partition is told about its own time.
///
/// At entry the guest's `rdi` holds its address. Instants are raw TSC values, durations are
/// TSC ticks unless named `_ns`; host and guest share one TSC (offset 0).
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Information {
    /// [`MAGIC`].
    pub magic: u32,
    /// [`VERSION`].
    pub version: u32,
    /// RAM of this guest in bytes, from guest-physical 0.
    pub memory_bytes: u64,
    /// TSC frequency in kHz.
    pub tsc_khz: u64,
    /// Length of the major frame in nanoseconds.
    pub major_frame_ns: u64,
    /// Sequence number of the next (or current) release of this partition, from 0. It counts every
    /// window of the schedule, also those that were lost.
    pub release: u64,
    /// Number of the major frame in which that release lies, from 0.
    pub frame: u64,
    /// TSC of that release: the scan must not start before it.
    pub release_tsc: u64,
    /// TSC at which that window ends: the guest is kicked out then.
    pub window_end_tsc: u64,
    /// TSC of the release after that one; 0 if it is not known yet, because the partition has no
    /// window in the coming frame.
    pub next_release_tsc: u64,
    /// TSC at which the window of that release ends; 0 if it is not known yet.
    pub next_window_end_tsc: u64,
    /// The schedule to which [`release`](Self::release) belongs, by its position in the partition
    /// file, from 0.
    pub schedule: u32,
    /// How the guest was started: [`start::COLD`] or [`start::WARM`].
    pub start_mode: u32,
    /// Why the guest was started: [`start::NORMAL`], [`start::PARTITION_RESTART`] or
    /// [`start::HEALTH_MONITOR`].
    pub start_condition: u32,
    /// What can interrupt the guest: [`interrupt_controller::NONE`] or
    /// [`interrupt_controller::LOCAL_APIC`].
    pub interrupt_controller: u32,
}

/// Values of [`Information::interrupt_controller`].
pub mod interrupt_controller {
    use core::ops::RangeInclusive;

    /// Nothing is ever injected, and a halt ends the guest.
    pub const NONE: u32 = 0;
    /// The processor's own controller: enabled, in x2APIC mode, with everything in it masked. The
    /// partition file gives vectors to devices; see [`port::ARM`](crate::port::ARM).
    pub const LOCAL_APIC: u32 = 1;
    /// Vectors that devices can have. Below are the processor's exceptions; the last one is the
    /// controller's own, for spurious interrupts.
    pub const VECTORS: RangeInclusive<u8> = 32..=254;
    /// Vector of spurious interrupts.
    pub const SPURIOUS: u8 = 255;
}

/// How and why a guest was started: operating modes and start conditions of ARINC 653.
pub mod start {
    /// All memory is as the image says, the rest is zero.
    pub const COLD: u32 = 1;
    /// As [`COLD`], but the image's retained segments have kept their content.
    pub const WARM: u32 = 2;
    /// First start since Takt was started.
    pub const NORMAL: u32 = 0;
    /// Takt has started the partition anew, for a reason that is not an error of it.
    pub const PARTITION_RESTART: u32 = 1;
    /// The health monitor has started the partition anew, for an error of it. (2 is its start of a
    /// whole module, which Takt does not do.)
    pub const HEALTH_MONITOR: u32 = 3;

    /// Flag of an ELF program header (in the mask for operating systems, `PF_MASKOS`): a warm
    /// start leaves this segment as it is. It must have no content in the file.
    pub const RETAINED_SEGMENT: u32 = 0x0010_0000;
}

/// The partition status page: what a guest says of its own scan.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Status {
    /// [`Information::release`] of the scan started last, plus one; 0 before the first.
    pub started: u64,
    /// TSC at which that scan started.
    pub start_tsc: u64,
    /// TSC at which the scan finished last was finished.
    pub done_tsc: u64,
    /// The exception that ended the guest; all zero while there is none.
    pub exception: Exception,
}

/// Most ports of a partition: what the port table has room for.
pub const PORTS_MAX: usize = 42;

/// The port table: the ends of channels that a partition has, fixed before it starts.
///
/// A PLC guest finds it at [`memory::PORT_TABLE`], with guest-physical addresses in it. A Linux
/// guest finds it in the first page of its PCI function's read-only memory, and the addresses are
/// byte offsets in the function's read-write ([`Port::own`]) and read-only ([`Port::peer`]) memory.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PortTable {
    /// [`MAGIC`].
    pub magic: u32,
    /// [`VERSION`].
    pub version: u32,
    /// How many of [`ports`](Self::ports) there are.
    pub count: u32,
    /// Zero.
    pub reserved: u32,
    /// TSC frequency in kHz, for the age of messages.
    pub tsc_khz: u64,
    /// The ports, in the order of the partition file; the rest is zero.
    pub ports: [Port; PORTS_MAX],
}

impl PortTable {
    /// No ports, and the frequency not known yet.
    pub const EMPTY: PortTable = PortTable {
        magic: MAGIC,
        version: VERSION,
        count: 0,
        reserved: 0,
        tsc_khz: 0,
        ports: [Port::NONE; PORTS_MAX],
    };
}

/// One end of a channel. The layout of the regions is that of the channel crate (`takt-channel`,
/// `docs/ports.md`).
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Port {
    /// Name of the port, filled up with zeros.
    pub name: [u8; 32],
    /// [`port_kind::SAMPLING`] or [`port_kind::QUEUING`].
    pub kind: u32,
    /// [`direction::SOURCE`] or [`direction::DESTINATION`].
    pub direction: u32,
    /// Longest message in bytes.
    pub maximum: u32,
    /// Messages that a queuing channel holds; 1 for a sampling channel.
    pub depth: u32,
    /// What a full queuing channel does: the channel crate's `Policy`; 0 for a sampling channel.
    pub policy: u32,
    /// Pages of [`own`](Self::own).
    pub own_pages: u32,
    /// Refresh period of a sampling channel; 0 for a queuing channel.
    pub refresh_ns: u64,
    /// Where the region that this partition may write lies; 0 if it has none.
    pub own: u64,
    /// Where the region that the other end writes lies; 0 if it has none.
    pub peer: u64,
    /// Pages of [`peer`](Self::peer).
    pub peer_pages: u32,
    /// 1 if the source rings a doorbell after a message, and a partition waits for it; else 0.
    pub doorbell: u32,
    /// Zero.
    pub reserved: [u32; 2],
}

impl Port {
    /// No port.
    pub const NONE: Port = Port {
        name: [0; 32],
        kind: 0,
        direction: 0,
        maximum: 0,
        depth: 0,
        policy: 0,
        own_pages: 0,
        refresh_ns: 0,
        own: 0,
        peer: 0,
        peer_pages: 0,
        doorbell: 0,
        reserved: [0; 2],
    };
}

/// Values of [`Port::kind`].
pub mod port_kind {
    /// Newest message, with its age.
    pub const SAMPLING: u32 = 1;
    /// First in, first out.
    pub const QUEUING: u32 = 2;
}

/// Values of [`Port::direction`].
pub mod direction {
    /// The partition sends.
    pub const SOURCE: u32 = 1;
    /// The partition receives.
    pub const DESTINATION: u32 = 2;
}

/// A processor exception as the guest's handler saw it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exception {
    /// Vector, 0 to 31.
    pub vector: u64,
    /// Error code pushed by the processor, 0 where there is none.
    pub error_code: u64,
    /// Interrupted instruction.
    pub rip: u64,
    /// Stack pointer at that instruction.
    pub rsp: u64,
    /// Flags at that instruction.
    pub rflags: u64,
    /// Fault address register; meaningful for vector 14.
    pub cr2: u64,
}

/// `None` for a vector that is reserved; else the name in the processor manuals.
#[must_use]
pub const fn exception_name(vector: u64) -> Option<&'static str> {
    Some(match vector {
        0 => "divide error",
        1 => "debug",
        2 => "non-maskable interrupt",
        3 => "breakpoint",
        4 => "overflow",
        5 => "bound range exceeded",
        6 => "invalid opcode",
        7 => "device not available",
        8 => "double fault",
        10 => "invalid TSS",
        11 => "segment not present",
        12 => "stack fault",
        13 => "general protection fault",
        14 => "page fault",
        16 => "x87 floating point",
        17 => "alignment check",
        18 => "machine check",
        19 => "SIMD floating point",
        20 => "virtualisation",
        21 => "control protection",
        _ => return None,
    })
}

const _: () = {
    assert!(size_of::<Information>() == 96);
    assert!(size_of::<Port>() == 96);
    assert!(size_of::<PortTable>() as u64 <= memory::PAGE);
    assert!(size_of::<Exception>() == 48);
    assert!(size_of::<Status>() == 24 + 48);
    assert!(memory::STATUS + size_of::<Status>() as u64 <= memory::TEXT);
    assert!(memory::INFORMATION >= memory::RAM_MAX);
    assert!(memory::PROGRAM_TABLE < memory::CHANNELS);
};
